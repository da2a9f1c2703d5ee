"""A result as text: every measurement with its flags and notes, or the summary."""

import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import groupby

from charact.method.stopwatch import time_text
from charact.reporting.summary import LINES, Frequency, in_cycles_per_pixel, summary_of
from labdata import FLAGS, Measurement, Result


def text_of(
    result: Result, title: str, frequency: Frequency | None, width: int, *, everything: bool
) -> str:
    """Return a result as text: a summary that fits the terminal, or every line."""
    frequency = frequency or in_cycles_per_pixel
    # One line per region suits the targets of one image; session quantities have no region.
    of_one_picture = not any(m.stack for m in result.measurements)
    if len({m.region for m in result.measurements}) > 1 and of_one_picture:
        lines = list(lines_of_regions(result.measurements, frequency))
        if everything:
            return "\n".join(lines)
        wrapped = [
            part for line in lines for part in textwrap.wrap(line, width, subsequent_indent=" " * 8)
        ]
        more = (
            [f"and {len(wrapped) - LINES + 1} more lines (`everything`)"]
            if len(wrapped) > LINES
            else []
        )
        return "\n".join([*wrapped[: LINES - len(more)], *more])
    if everything:
        return "\n".join(lines_of(result.measurements, frequency))
    return summary_of(result, title=title, frequency=frequency, width=width)


def lines_of(
    measurements: Iterable[Measurement], frequency: Frequency = in_cycles_per_pixel
) -> Iterator[str]:
    """Yield one line per measurement and, after those of one stack and method, one per flag and
    note.
    """
    for _, group in groupby(measurements, key=lambda m: (m.stack, m.method, m.amplifier)):
        members = tuple(group)
        counts = Counter((m.quantity, m.frequency_cy_per_px) for m in members)
        placed = len({m.region for m in members}) > 1
        for m in members:
            yield _line(
                m, frequency, directed=counts[m.quantity, m.frequency_cy_per_px] > 1, placed=placed
            )
        flags, notes = _flags_and_notes(members)
        yield from (f"    {flag}" for flag in flags)
        yield from (f"    note: {note}" for note in notes)


def _flags_and_notes(members: Iterable[Measurement]) -> tuple[list[str], list[str]]:
    """Return one line for each flag (its findings, else its sentence), and the other notes, without
    repetition.
    """
    measurements = tuple(members)
    notes = list(dict.fromkeys(note for m in measurements for note in m.notes))
    lines: list[str] = []
    for flag in dict.fromkeys(flag for m in measurements for flag in m.flags):
        findings = [note for note in notes if note.startswith(f"{flag}: ")]
        lines += findings or [f"{flag}: {FLAGS[flag]}"]
    return lines, [note for note in notes if note not in lines]


def _line(m: Measurement, frequency: Frequency, *, directed: bool, placed: bool) -> str:
    """Return the line of a measurement; `directed` adds its direction, `placed` its region as
    ROW,COL,HEIGHT,WIDTH.
    """
    where = _at(m, frequency)
    where += (
        f" along {m.orientation_deg:.3g} deg" if directed and m.orientation_deg is not None else ""
    )
    where += f" of {m.stack}" if m.stack else ""
    where += f" of amplifier {m.amplifier}" if m.amplifier else ""
    where += f" in {_place(m.region)}" if placed and m.region is not None else ""
    spent = f", {time_text(m.seconds)}" if m.seconds is not None else ""
    if m.value is None:
        return f"{m.quantity}{where}: refused: {m.reason} ({m.method}{spent})"
    return f"{m.quantity}{where} {number_of(m, frequency)}, {_verdict(m)}, {m.method}{spent}"


def _place(region: tuple[int, int, int, int]) -> str:
    """Return ROW,COL,HEIGHT,WIDTH."""
    return ",".join(map(str, region))


def _at(m: Measurement, frequency: Frequency) -> str:
    """Return " at FREQUENCY" of a measurement at one frequency, else an empty string."""
    return (
        ""
        if m.frequency_cy_per_px is None
        else " at {:.3g} {}".format(*frequency(m.frequency_cy_per_px, m))
    )


def in_unit(m: Measurement, frequency: Frequency) -> tuple[float, str, tuple[float, float] | None]:
    """Return value, unit and 95 % interval of a measurement with a value, frequencies in the
    display unit.
    """
    assert m.value is not None
    if m.unit != "cy/px":
        return m.value, m.unit, m.interval95
    ends = (
        None
        if m.interval95 is None
        else (frequency(m.interval95[0], m)[0], frequency(m.interval95[1], m)[0])
    )
    return *frequency(m.value, m), ends


def number_of(m: Measurement, frequency: Frequency = in_cycles_per_pixel) -> str:
    """Return the value with unit and 95 % interval."""
    if m.value is None:
        return "refused"
    value, unit, ends = in_unit(m, frequency)
    band = "no interval" if ends is None else f"[{ends[0]:.4g}, {ends[1]:.4g}] 95 %"
    return f"{value:.4g} {band}" if unit == "1" else f"{value:.4g} {unit} {band}"


def _verdict(m: Measurement) -> str:
    return m.status + (f" ({', '.join(m.flags)})" if m.flags else "")


def lines_of_regions(
    measurements: Iterable[Measurement], frequency: Frequency = in_cycles_per_pixel
) -> Iterator[str]:
    """Yield one line per region, then the flags and notes of all."""
    by_region: dict[object, list[Measurement]] = {}
    for m in measurements:
        by_region.setdefault(m.region, []).append(m)
    for number, members in enumerate(by_region.values(), 1):
        yield f"{number:3d}  {_region_line(members, frequency)}"
    everything = [m for members in by_region.values() for m in members]
    flags, notes = _flags_and_notes(everything)
    yield from (f"    {flag}" for flag in flags)
    yield from (f"    note{_where(note, by_region)}: {note}" for note in notes)


def _region_line(members: list[Measurement], frequency: Frequency) -> str:
    """Return the line of a region: its position, then its main quantity in each direction."""
    first = members[0]
    leading = [m for m in members if m.quantity == "mtf50"] or [
        m for m in members if m.quantity == first.quantity
    ]
    place = "all together" if first.region is None else _place(first.region)
    if all(m.value is None for m in leading):
        return f"{place:<16} {first.quantity} refused: {leading[0].reason}"
    values = (
        f"{m.quantity}{_at(m, frequency)} {number_of(m, frequency)}"
        + (f", {m.orientation_deg:.1f} deg" if m.orientation_deg is not None else "")
        + f", {_verdict(m)}"
        for m in leading
    )
    return f"{place:<16} {'; '.join(values)}"


def _where(note: str, by_region: dict[object, list[Measurement]]) -> str:
    """Return the numbers of the regions that a note concerns, unless it concerns all."""
    having = [
        k
        for k, members in enumerate(by_region.values(), 1)
        if any(note in m.notes for m in members)
    ]
    return (
        ""
        if len(having) == len(by_region)
        else " of " + ", ".join(str(number) for number in having)
    )
