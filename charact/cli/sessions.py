"""The verbs of a session: noise, bloom, measure, fit, validate, report."""

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from charact import __version__
from charact.cli import options
from charact.cli.output import exit_on_bad_input, print_message, print_result, progress_bar
from charact.cli.single_image import bloom_of_image, is_image, open_session_only
from labdata.errors import BadInput

if TYPE_CHECKING:
    from charact.method import Context
    from charact.validation import Statistic, Validation
    from labdata.measurement import Result
    from labdata.session import Session

SessionFolder = Annotated[Path, typer.Argument(help="Session folder.")]
SessionFolders = Annotated[list[Path], typer.Argument(help="Session folders.")]
FITTED = "fitted.toml"


def noise(
    sessions: SessionFolders,
    method: options.MethodName = "auto",
    within: options.Within = 2.0,
    quick: options.Quick = False,
    seed: options.Seed = 0,
    scheduler: options.Scheduler = None,
    as_json: options.Json = False,
    events: options.Events = False,
) -> None:
    """Measure noise and gain from flat and dark stacks of one or more sessions.

    Each session prints its own result (with --json one object per line). A failed session does not stop the others;
    the exit code is 1 if any session gives no value.

    Example: charact noise ccd12 --json
    """

    def one(session: Path) -> None:
        _analyse("noise", session, method, within, quick, seed, as_json, events, scheduler)

    each(sessions, one, as_json=as_json, events=events)


def bloom(
    session: SessionFolder,
    method: options.MethodName = "auto",
    within: options.Within = 2.0,
    quick: options.Quick = False,
    seed: options.Seed = 0,
    as_json: options.Json = False,
    events: options.Events = False,
    map_to: options.BloomMap = None,
    map_of: options.BloomMapOf = None,
    plane: options.Plane = None,
    axis: options.Axis = None,
) -> None:
    """Measure halo and bloom extent from point sources; optionally write a bloom map.

    A single image may be given instead of a session; only single-frame quantities are measured.

    Example: charact bloom day1 --map bloom.png
    """
    if map_to is None and map_of is not None:
        raise typer.BadParameter("needs --map", param_hint="'--map-of'")
    if is_image(session):
        bloom_of_image(
            session, method=method, within=within, quick=quick, seed=seed, mapped=map_to is not None, plane=plane,
            axis=axis, as_json=as_json, events=events,
        )  # fmt: skip
        return
    drawn = None
    if map_to is not None:
        from functools import partial

        from charact.report.bloom_images import write_bloom_map

        drawn = partial(write_bloom_map, label=map_of, path=map_to)
    _analyse("bloom", session, method, within, quick, seed, as_json, events, drawn=drawn)


def _analyse(
    room: str, folder: Path, method: str, within: float, quick: bool, seed: int, as_json: bool, events: bool,
    scheduler: str | None = None, drawn: "Callable[[Session, Result, Context], None] | None" = None,
) -> None:  # fmt: skip
    with exit_on_bad_input(str(folder), as_json=as_json, events=events), progress_bar(events=events) as progress:
        from importlib import import_module

        from charact.method.cluster import parallel_map
        from charact.session_measurement import method_context

        given = open_session_only(folder)
        analysis = import_module(f"charact.{room}")
        with parallel_map(scheduler) as spread:
            context = method_context(given, quick=quick, seed=seed, progress=progress, spread=spread)
            result = analysis.measure(given, method=method, within_percent=within, context=context)
        print_result(
            result,
            given=str(folder),
            as_json=as_json,
            events=events,
            next_verb=f"charact measure {folder}",
            then=None if drawn is None else lambda: drawn(given, result, context),
        )


def measure(
    session: SessionFolder,
    within: options.Within = 2.0,
    quick: options.Quick = False,
    seed: options.Seed = 0,
    scheduler: options.Scheduler = None,
    as_json: options.Json = False,
    events: options.Events = False,
) -> None:
    """Measure everything the stacks of a session support and store the result in the session.

    Example: charact measure day1 --quick
    """
    with exit_on_bad_input(str(session), as_json=as_json, events=events):
        from labdata import result_io

        result = measure_folder(session, quick=quick, seed=seed, within=within, events=events, scheduler=scheduler)
        print_result(
            result,
            given=str(session),
            as_json=as_json,
            events=events,
            next_verb=f"charact report {session}",
            then=lambda: result_io.save(result, open_session_only(session).folder),
        )


def measure_and_save(folder: Path, *, quick: bool = False, seed: int = 0, events: bool = False) -> "Result":
    """Measure a session and save the result in it."""
    from labdata import result_io

    result = measure_folder(folder, quick=quick, seed=seed, events=events)
    result_io.save(result, open_session_only(folder).folder)
    return result


def measure_folder(
    folder: Path, *, quick: bool = False, seed: int = 0, within: float = 2.0, events: bool = False,
    scheduler: str | None = None,
) -> "Result":  # fmt: skip
    """Measure a session."""
    from charact.method.cluster import parallel_map
    from charact.session_measurement import measure as measure_session
    from charact.session_measurement import with_inputs
    from labdata.session import UNUSED

    session = open_session_only(folder)
    for note in session.notes:
        if UNUSED in note:
            print_message(note, events=events)
    with progress_bar(events=events) as progress, parallel_map(scheduler) as spread:
        result = measure_session(
            session, quick=quick, seed=seed, within_percent=within, progress=progress, spread=spread
        )
    return with_inputs(result, session)


def load_or_measure(folder: Path, *, seed: int, events: bool):
    """Return the result saved in a session, measured first if there is none."""
    from labdata import result_io

    if (result := result_io.load(open_session_only(folder).folder)) is not None:
        return result
    print_message(f"{folder} has not been measured yet: measuring it first", events=events)
    return measure_and_save(folder, seed=seed, events=events)


def fit(
    session: SessionFolder,
    sensor_out: Annotated[Path, typer.Option("--sensor-out", help="Output TOML file of the fitted sensor.")],
    seed: options.Seed = 0,
    events: options.Events = False,
) -> None:
    """Fit the sensor: identified parameters with joint posterior draws, the others at their priors and marked.

    Example: charact fit day1 --sensor-out day1/fitted.toml
    """
    with exit_on_bad_input(str(session), events=events):
        from charact.fit import fit_sensor
        from labdata.sensors import save_sensor

        result = load_or_measure(session, seed=seed, events=events)
        with progress_bar(events=events) as progress:
            fitted = fit_sensor(open_session_only(session), result, seed=seed, progress=progress)
        save_sensor(fitted, sensor_out)
        for path, p in fitted.parameters().items():
            if p.standing in ("fitted", "prior"):
                print(f"{path} {p.value:.4g} [{p.low:.4g}, {p.high:.4g}] 95 %, {p.standing}")
        print(f"{sensor_out}\nNext: charact validate {session} --sensor {sensor_out}")


def validate(
    session: SessionFolder,
    sensor: options.SensorName = None,
    seed: options.Seed = 0,
    as_json: options.Json = False,
    events: options.Events = False,
) -> None:
    """Compare simulated with measured frames, using only the fitted sensor, by tests that can fail.

    Example: charact validate day1 --sensor day1/fitted.toml
    """
    with exit_on_bad_input(str(session), as_json=as_json, events=events):
        print_validation(
            validate_and_save(session, sensor or session / FITTED, seed=seed, events=events), session, as_json=as_json
        )


def report(
    session: SessionFolder,
    out: Annotated[Path | None, typer.Option(help="Output HTML file (default: report.html in the session).")] = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="Also write a PDF.")] = False,
    seed: options.Seed = 0,
    events: options.Events = False,
) -> None:
    """Write a self-contained HTML report: figures, quantities with intervals, validation, provenance.

    Example: charact report day1 --pdf
    """
    with exit_on_bad_input(str(session), events=events):
        from charact.report import write
        from charact.validation import load

        given = open_session_only(session)
        result = load_or_measure(session, seed=seed, events=events)
        path = write(given, result, out or session / "report.html", validation=load(given.folder), pdf=pdf)
        print(path)


def each(folders: Sequence[Path], one: Callable[[Path], None], *, as_json: bool, events: bool) -> None:
    """Process every session; sessions without a value are listed last, with exit code 1.

    Parameters
    ----------
    folders
        Session folders.
    one
        Measures and prints one session; raises `typer.Exit` with code 1 if there is no value.
    as_json, events
        Output format; without JSON the folder is printed above the lines of each session.
    """
    if len(folders) == 1:
        one(folders[0])
        return
    failed = []
    for folder in folders:
        if not as_json:
            print(f"{folder}:")
        try:
            one(folder)
        except typer.Exit as end:
            if end.exit_code != 1:
                raise
            failed.append(str(folder))
        sys.stdout.flush()
    if failed:
        print_message(f"{len(failed)} of {len(folders)} sessions gave no value: {', '.join(failed)}", events=events)
        raise typer.Exit(1)


def validate_and_save(folder: Path, sensor: str | Path, *, seed: int, events: bool) -> "Validation":
    """Validate a session against a fitted sensor and save the result in the session folder."""
    from charact import validation
    from labdata.sensors import load_sensor

    session = open_session_only(folder)
    if isinstance(sensor, Path) and not sensor.is_file():
        raise BadInput(
            f"validate needs a fitted sensor, got no file {sensor}; run charact fit {folder} --sensor-out {sensor}"
        )
    fitted = load_sensor(sensor)
    if not fitted.draws.values:
        print_message(
            f"{fitted.name} has no posterior draws: it is simulated without parameter uncertainty",
            events=events,
        )
    with progress_bar(events=events) as progress:
        done = validation.validate(session, fitted, seed=seed, progress=progress)
    validation.save(done, session.folder)
    return done


def print_validation(validation: "Validation", given: Path, *, as_json: bool) -> None:
    """Print a validation: one line per statistic, both controls, and the verdict."""
    if as_json:
        from charact.validation import as_json as document

        print(json.dumps({"charact": __version__, "input": str(given), "validation": document(validation)}))
        return
    print("\n".join(_lines(validation)))
    print(f"Next: charact report {given}")


def _lines(validation: "Validation") -> Iterator[str]:
    yield from map(_line, validation.statistics)
    for control in validation.controls:
        yield f"{control.name} control ({control.title}): {'held' if control.passed else 'DID NOT HOLD'}"
        yield from (f"    {_line(statistic)}" for statistic in control.statistics)
    yield f"validation: {'passed' if validation.passed else 'FAILED'}"


def _line(statistic: "Statistic") -> str:
    verdict = "agrees" if statistic.passed else "differs"
    return f"{statistic.title}: p {statistic.p_value:.3g} at level {statistic.level:.3g}, {verdict}"
