"""The verbs of decisions: compare two sessions, check one against limits, choose an exposure."""

import json
import shutil
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from charact import __version__
from charact.api import deciding, exposing
from charact.cli.options import Events, Json, verb
from charact.cli.output import exit_on_bad_input, print_text
from charact.cli.sessions import SessionFolder, load_or_measure, open_session_only, session_in
from labdata.settings import Setting

EXIT_CODES = {"pass": 0, "fail": 3, "undecided": 4}


@verb(deciding.compare)
def compare(
    a: Annotated[Path, typer.Argument(help="Session folder A.", metavar="A", callback=session_in)],
    b: Annotated[Path, typer.Argument(help="Session folder B.", metavar="B", callback=session_in)],
    everything: Annotated[
        bool, Setting("Print every difference and condition.", option="--all")
    ] = False,
    as_json: Json = False,
    events: Events = False,
    **settings: Any,
) -> None:
    """Compare two sessions: difference B - A of each quantity with interval and probability.

    Refuses unlike conditions (exit code 1) unless --anyway is given.

    Example: charact compare day1 day2
    """
    with exit_on_bad_input(f"{a} {b}", as_json=as_json, events=events):
        from charact.api.analysis import Analysis
        from charact.comparison import comparison_json, require_alike

        sessions = open_session_only(a), open_session_only(b)
        if not settings["anyway"]:  # before an analysis that takes minutes
            require_alike(*sessions)
        measured = (
            Analysis.of(
                load_or_measure(folder, seed=settings["seed"], events=events), str(folder), session
            )
            for folder, session in zip((a, b), sessions, strict=True)
        )
        comparison = deciding.compare(*measured, **settings)
        if as_json:
            document = {"charact": __version__, "input": [str(a), str(b)]}
            print_text(json.dumps(document | comparison_json(comparison), allow_nan=False))
            return
        from charact.reporting.comparison import comparison_text

        print_text(
            comparison_text(
                comparison,
                names=(str(a), str(b)),
                sessions=sessions,
                everything=everything,
                width=_columns(),
            )
        )
        _suggest(f"charact report {b}")


@verb(deciding.check)
def check(
    session: SessionFolder, as_json: Json = False, events: Events = False, **settings: Any
) -> None:
    """Check the measurements of a session against limits, and save the verdicts in the session.

    Exit code 0: all pass; 3: a limit fails; 4: none fails and some are undecided; 1: bad input.

    Example: charact check day1 --limits limits.toml
    """
    with exit_on_bad_input(str(session), as_json=as_json, events=events):
        from charact.comparison import check_json, load_limits, save_check

        folder = open_session_only(session).folder
        load_limits(settings["limits"])  # before an analysis that takes minutes
        result = load_or_measure(session, seed=settings["seed"], events=events)
        checked = deciding.check(result, **settings)
        if as_json:
            document = {"charact": __version__, "input": str(session)}
            print_text(json.dumps(document | check_json(checked), allow_nan=False))
        else:
            from charact.reporting.comparison import check_text

            print_text(check_text(checked, session=str(session), width=_columns()))
    with exit_on_bad_input("", events=events):  # the JSON object is already printed
        save_check(checked, folder)
    if not as_json:
        _suggest(f"charact report {session}")
    raise typer.Exit(EXIT_CODES[checked.verdict])


@verb(exposing.expose)
def expose(
    sensor: Annotated[
        str, typer.Argument(help="Name of a shipped camera, or its TOML file, as of charact fit.")
    ],
    as_json: Json = False,
    **settings: Any,
) -> None:
    """Compute gate or exposure, gain and frames that reach a signal-to-noise ratio.

    Example: charact expose day1/fitted.toml --snr 10 --lux 1e-4
    """
    with exit_on_bad_input(sensor, as_json=as_json):
        exposure = exposing.expose(sensor, **settings)
        stated = {name: x for name, x in vars(exposure.conditions).items() if x is not None}
        found = vars(exposure) | {"conditions": stated}
        document = {"charact": __version__, "input": sensor, "exposure": found}
        print_text(json.dumps(document, allow_nan=False) if as_json else str(exposure))


def _suggest(command: str) -> None:
    """Name the next verb on a terminal."""
    if sys.stdout.isatty():
        print(f"\nNext: {command}")


def _columns() -> int:
    return min(100, shutil.get_terminal_size((100, 40)).columns)
