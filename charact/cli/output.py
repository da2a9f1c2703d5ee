"""Output of a verb: result as JSON or lines, messages, progress and exit code."""

import codecs
import json
import os
import re
import shutil
import sys
import unicodedata
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, NoReturn

import typer

from charact import __version__
from charact.cli.options import Events, Everything, Json, error_in_options, in_options
from labdata.errors import BadInput
from labdata.settings import Progress

if TYPE_CHECKING:
    from charact.reporting.summary import Frequency
    from charact.verdict.purpose import Decision
    from labdata.measurement import Result


# Name of the error handler of stdout and stderr, and characters that other letters stand for.
SPELT_OUT = "charact-spelt-out"
SPELLINGS = str.maketrans(
    {
        "→": "->",
        "✓": "+",
        "▲": "!",
        "✕": "x",
        "±": "+-",
        "−": "-",
        "×": "x",
        "µ": "u",
        "Ω": "ohm",
        "σ": "sigma",
        "χ": "chi",
        "°": "deg ",
    }
)
SUPERSCRIPT = re.compile("[⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+")


def _spell_out(error: UnicodeError) -> tuple[str, int]:
    """Return what an encoding can write in place of characters that it lacks: µ becomes u, ² ^2."""
    assert isinstance(error, UnicodeEncodeError)
    lacking = SUPERSCRIPT.sub(r"^\g<0>", error.object[error.start : error.end])
    plain = unicodedata.normalize("NFKD", lacking.translate(SPELLINGS)).replace("−", "-")
    written = "".join(letter for letter in plain if not unicodedata.combining(letter))
    return written.encode("ascii", "replace").decode("ascii"), error.end


codecs.register_error(SPELT_OUT, _spell_out)


def print_text(text: str) -> None:
    """Print a text on stdout at once, with options for the parameters that it names."""
    print(in_options(text), flush=True)


def print_message(sentence: str, *, events: bool = False) -> None:
    """Print one sentence on stderr, with `events` as a JSON line."""
    sentence = in_options(sentence)
    print(json.dumps({"message": sentence}) if events else sentence, file=sys.stderr)


def fail(sentence: str, *, given: str, as_json: bool, events: bool = False) -> NoReturn:
    """Exit with code 1 and one sentence."""
    one_line = error_in_options(" ".join(sentence.split()))
    if as_json:
        with suppress(OSError):  # stdout may be the file that failed
            print(json.dumps({"charact": __version__, "input": given, "error": one_line}))
    print_message(one_line if events else f"charact: {one_line}", events=events)
    raise typer.Exit(1)


@contextmanager
def exit_on_bad_input(
    given: str, *, as_json: bool = False, events: bool = False, interrupted: str = "interrupted"
) -> Iterator[None]:
    """Exit with code 1 and one sentence on bad input and file system errors, with code 130 on an
    interrupt.
    """
    try:
        yield
    except BadInput as error:
        fail(str(error), given=given, as_json=as_json, events=events)
    except KeyboardInterrupt:
        print_message(interrupted if events else f"charact: {interrupted}", events=events)
        raise typer.Exit(130) from None
    except BrokenPipeError:
        # The reader closed the pipe (`| head`); Python would write to stdout again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(1) from None
    except MemoryError as error:
        reason = (
            f"the frames must fit into memory, got: {error or 'too little memory'}; give "
            f"fewer or smaller frames"
        )
        fail(reason, given=given, as_json=as_json, events=events)
    except OSError as error:
        named = f" ({error.filename})" if error.filename else ""
        fail(
            f"file system error: {error.strerror or error}{named}",
            given=given,
            as_json=as_json,
            events=events,
        )


def print_result(
    result: "Result",
    *,
    given: str,
    verb: str,
    as_json: Json = False,
    events: Events = False,
    everything: Everything = False,
    frequency: "Frequency | None" = None,
    next_verb: str | None = None,
    decision: "Decision | None" = None,
    then: Callable[[], object] | None = None,
) -> None:
    """Print a result; exit with code 1 and a sentence if no measurement has a value.

    `verb` and `given` are the title; `everything`: print all values and notes, not a summary.
    `frequency` converts cy/px to the display unit (JSON is always in cy/px), `next_verb` is
    suggested on a terminal. `then` writes further output files after the result; its failure is
    reported on stderr, with exit code 1. `decision` is the last line, and in the JSON.
    """
    if as_json:
        from labdata.result_io import to_json

        document = to_json(result, given=given, version=__version__)
        if decision is not None:
            document["verdict"] = decision.as_json()
        print_text(json.dumps(document, allow_nan=False))
    else:
        from charact.reporting.lines import text_of

        width = min(100, shutil.get_terminal_size((100, 40)).columns)
        print_text(text_of(result, f"{verb} of {given}", frequency, width, everything=everything))
    if then is not None:
        # The JSON object is already printed.
        with exit_on_bad_input("", events=events):
            then()
    if decision is not None and not as_json:
        print_text(decision.line)
    if all(m.value is None for m in result.measurements):
        reasons = list(dict.fromkeys(m.reason for m in result.measurements if m.reason))
        print_message(
            f"charact: {reasons[0] if reasons else 'nothing could be measured'}", events=events
        )
        raise typer.Exit(1)
    if next_verb and sys.stdout.isatty() and not as_json:
        print(f"\nNext: {next_verb}")


@contextmanager
def progress_bar(*, events: bool = False) -> Iterator[Progress]:
    """Yield a function of a sentence and the fraction done (0..1): a bar on a terminal, JSON lines
    with `events`.

    Compilation is announced on stderr.
    """
    from charact.method.stopwatch import announce_compilation

    def announce(sentence: str) -> None:
        print_message(sentence if events else f"charact: {sentence}", events=events)

    def report(sentence: str, share: float) -> None:
        if events:
            print(json.dumps({"progress": round(share, 4), "message": sentence}), file=sys.stderr)

    if events or not sys.stderr.isatty():
        with announce_compilation(announce):
            yield report
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with (
        Progress(*columns, console=Console(stderr=True), transient=True) as bar,
        announce_compilation(announce),
    ):
        task = bar.add_task("", total=1.0)
        yield lambda sentence, share: bar.update(task, description=sentence, completed=share)
