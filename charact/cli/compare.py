"""The verbs of decisions: compare two sessions, and check a session against limits."""

import json
import shutil
import sys
from pathlib import Path
from typing import Annotated

import typer

from charact import __version__
from charact.cli import options
from charact.cli.output import exit_on_bad_input
from charact.cli.sessions import SessionFolder, load_or_measure, open_session_only, session_in

EXIT_CODES = {"pass": 0, "fail": 3, "undecided": 4}
Anyway = Annotated[
    bool, typer.Option("--anyway", help="Compare sessions of unlike conditions, with a flag.")
]
LimitsFile = Annotated[
    Path,
    typer.Option(
        "--limits",
        help="TOML file of limits: [[limit]] with quantity, min, max, and unit or stack.",
    ),
]


def compare(
    a: Annotated[Path, typer.Argument(help="Session folder A.", metavar="A", callback=session_in)],
    b: Annotated[Path, typer.Argument(help="Session folder B.", metavar="B", callback=session_in)],
    anyway: Anyway = False,
    seed: options.Seed = 0,
    everything: Annotated[
        bool, typer.Option("--all", help="Print every difference and condition.")
    ] = False,
    as_json: options.Json = False,
    events: options.Events = False,
) -> None:
    """Compare two sessions: difference B - A of each quantity with interval and probability.

    Refuses unlike conditions (exit code 1) unless --anyway is given.

    Example: charact compare day1 day2
    """
    with exit_on_bad_input(f"{a} {b}", as_json=as_json, events=events):
        import numpy as np

        from charact.comparison import compare as compare_results
        from charact.comparison import comparison_json, require_alike

        sessions, remedy = (open_session_only(a), open_session_only(b)), "--anyway"
        if not anyway:  # before an analysis that takes minutes
            require_alike(*sessions, remedy=remedy)
        one, other = (load_or_measure(folder, seed=seed, events=events) for folder in (a, b))
        rng = np.random.default_rng(seed)
        found = compare_results(
            one, other, sessions=sessions, anyway=anyway, remedy=remedy, rng=rng
        )
        if as_json:
            whole = {"charact": __version__, "input": [str(a), str(b)], **comparison_json(found)}
            print(json.dumps(whole, allow_nan=False))
            return
        from charact.reporting.comparison import comparison_text

        names = str(a), str(b)
        print(
            comparison_text(
                found, names=names, sessions=sessions, everything=everything, width=_columns()
            )
        )
        _suggest(f"charact report {b}")


def check(
    session: SessionFolder,
    limits: LimitsFile,
    seed: options.Seed = 0,
    as_json: options.Json = False,
    events: options.Events = False,
) -> None:
    """Check the measurements of a session against limits, and save the verdicts in the session.

    Exit code 0: all pass; 3: a limit fails; 4: none fails and some are undecided; 1: bad input.

    Example: charact check day1 --limits limits.toml
    """
    with exit_on_bad_input(str(session), as_json=as_json, events=events):
        from charact.comparison import check as check_limits
        from charact.comparison import check_json, load_limits, save_check

        given, demanded = open_session_only(session), load_limits(limits)
        result = load_or_measure(session, seed=seed, events=events)
        checked = check_limits(result, demanded, name=limits.name)
        if as_json:
            whole = {"charact": __version__, "input": str(session), **check_json(checked)}
            print(json.dumps(whole, allow_nan=False))
        else:
            from charact.reporting.comparison import check_text

            print(check_text(checked, session=str(session), width=_columns()))
        sys.stdout.flush()
    with exit_on_bad_input("", events=events):  # the JSON object is already printed
        save_check(checked, given.folder)
    if not as_json:
        _suggest(f"charact report {session}")
    raise typer.Exit(EXIT_CODES[checked.verdict])


def _suggest(command: str) -> None:
    """Name the next verb on a terminal."""
    if sys.stdout.isatty():
        print(f"\nNext: {command}")


def _columns() -> int:
    return min(100, shutil.get_terminal_size((100, 40)).columns)
