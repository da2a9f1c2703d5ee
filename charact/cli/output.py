"""What a verb says: one JSON object, or lines for people; and the exit code that goes with it."""

import json
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import groupby
from typing import TYPE_CHECKING, NoReturn

import typer

from charact import __version__
from labdata.errors import BadInput
from labdata.flags import FLAGS
from labdata.quantity import convert_frequency

if TYPE_CHECKING:
    from labdata.measurement import Measurement, Result

Frequency = Callable[[float], tuple[float, str]]


def in_cycles_per_pixel(frequency_cy_per_px: float) -> tuple[float, str]:
    """The frequency and unit of the contract."""
    return frequency_cy_per_px, "cy/px"


def say(sentence: str, *, events: bool = False) -> None:
    """Say one sentence on stderr, as an event if asked."""
    print(json.dumps({"message": sentence}) if events else sentence, file=sys.stderr)


def fail(sentence: str, *, given: str, as_json: bool, events: bool = False) -> NoReturn:
    """End with exit code 1 and one sentence."""
    one_line = " ".join(sentence.split())
    if as_json:
        print(json.dumps({"charact": __version__, "input": given, "error": one_line}))
    say(one_line if events else f"charact: {one_line}", events=events)
    raise typer.Exit(1)


@contextmanager
def bad_input_ends(
    given: str, *, as_json: bool = False, events: bool = False, interrupted: str = "interrupted"
) -> Iterator[None]:
    """Turn bad input, a failing bench and a file system that refuses into one sentence and exit code 1.

    An interrupt ends with its own sentence and exit code 130.
    """
    try:
        yield
    except BadInput as error:
        fail(str(error), given=given, as_json=as_json, events=events)
    except KeyboardInterrupt:
        say(interrupted if events else f"charact: {interrupted}", events=events)
        raise typer.Exit(130) from None
    except BrokenPipeError:
        # Who reads has read enough (`| head`): nothing more may be written, not even when Python tidies up.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(1) from None
    except OSError as error:
        named = f" ({error.filename})" if error.filename else ""
        fail(f"the file system refused: {error.strerror or error}{named}", given=given, as_json=as_json, events=events)


def show(
    result: "Result",
    *,
    given: str,
    as_json: bool,
    events: bool = False,
    frequency: Frequency = in_cycles_per_pixel,
    next_verb: str | None = None,
) -> None:
    """Print a result; exit with 1 and a sentence if no measurement carries a number.

    Parameters
    ----------
    frequency
        Converts a frequency in cy/px to the unit people asked for. JSON stays in cy/px.
    next_verb
        The next sensible command, named on a terminal.
    """
    if as_json:
        from labdata.document import to_json

        print(json.dumps(to_json(result, given=given, version=__version__), allow_nan=False))
    else:
        print("\n".join(lines_of(result.measurements, frequency)))
    if all(m.value is None for m in result.measurements):
        reasons = list(dict.fromkeys(m.reason for m in result.measurements if m.reason))
        say(f"charact: {reasons[0] if reasons else 'nothing could be measured'}", events=events)
        raise typer.Exit(1)
    if next_verb and sys.stdout.isatty() and not as_json:
        print(f"\nNext: {next_verb}")


def lines_of(measurements: Iterable["Measurement"], frequency: Frequency = in_cycles_per_pixel) -> Iterator[str]:
    """One line for each measurement; after those of one stack and method, one for each of their flags and notes."""
    for _, group in groupby(measurements, key=lambda m: (m.stack, m.method)):
        members = tuple(group)
        told = Counter((m.quantity, m.frequency_cy_per_px) for m in members)
        for m in members:
            yield _line(m, frequency, directed=told[m.quantity, m.frequency_cy_per_px] > 1)
        for flag in dict.fromkeys(flag for m in members for flag in m.flags):
            yield f"    {flag}: {FLAGS[flag]}"
        for note in dict.fromkeys(note for m in members for note in m.notes):
            yield f"    note: {note}"


def _line(m: "Measurement", frequency: Frequency, *, directed: bool) -> str:
    """Return one measurement's line; `directed` names its direction."""
    where = "" if m.frequency_cy_per_px is None else " at {:.3g} {}".format(*frequency(m.frequency_cy_per_px))
    where += f" along {m.orientation_deg:.3g} deg" if directed and m.orientation_deg is not None else ""
    where += f" of {m.stack}" if m.stack else ""
    spent = f", {m.seconds:.1f} s" if m.seconds is not None else ""
    if m.value is None:
        return f"{m.quantity}{where}: refused: {m.reason} ({m.method}{spent})"
    convert = frequency if m.unit == "cy/px" else lambda value: (value, "" if m.unit == "1" else m.unit)
    value, unit = convert(m.value)
    low, high = (convert(end)[0] for end in m.interval95) if m.interval95 else (None, None)
    band = "no interval" if low is None else f"[{low:.4g}, {high:.4g}] 95 %"
    verdict = m.status + (f" ({', '.join(m.flags)})" if m.flags else "")
    return f"{m.quantity}{where} {value:.4g} {unit} {band}, {verdict}, {m.method}{spent}".replace("  ", " ")


def frequency_converter(
    unit: str, pitch_um: float | None, rows: int | None, focal_length_mm: float | None
) -> Frequency:
    """Return the conversion of a frequency in cy/px to a unit; raises BadInput now if a length is missing."""

    def convert(frequency_cy_per_px: float) -> tuple[float, str]:
        return (
            convert_frequency(
                frequency_cy_per_px,
                unit,
                pitch_um=pitch_um,
                picture_height_px=rows,
                focal_length_mm=focal_length_mm,
            ),
            unit,
        )

    convert(0.1)
    return convert
