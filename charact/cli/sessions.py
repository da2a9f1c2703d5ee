"""The verbs that take a session: noise, bloom, measure, fit, validate, report."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from charact.cli import options
from charact.cli.one_picture import bloom_of_picture, is_picture, opened
from charact.cli.output import bad_input_ends, say, show
from charact.cli.progress import progress_bar

if TYPE_CHECKING:
    from charact.method import Context
    from labdata.measurement import Result
    from labdata.session import Session

SessionFolder = Annotated[Path, typer.Argument(help="Folder of a session.")]
SessionFolders = Annotated[list[Path], typer.Argument(help="Folders of sessions.")]
FITTED = "fitted.toml"


def add_to(app: typer.Typer) -> None:
    """Add the verbs to the command."""
    for verb in (noise, bloom, measure, fit, validate, report):
        app.command()(verb)


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
    """Noise and gain from flats and darks, of one session or of many.

    Of many, each prints its own result (with --json one object a line); one that fails does not stop the others, and
    the exit code is 1 if any gave no number.

    Example: charact noise ccd12 --json
    """
    from charact.cli.many import each

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
    """Halo and blooming extent from point sources; a map of the share of each pixel that is blooming.

    A bare picture instead of a session is read for what one frame can tell.

    Example: charact bloom day1 --map bloom.png
    """
    if map_to is None and map_of is not None:
        raise typer.BadParameter("names the stack of a map: give --map too", param_hint="'--map-of'")
    if is_picture(session):
        bloom_of_picture(
            session, method=method, within=within, quick=quick, seed=seed, mapped=map_to is not None, plane=plane,
            axis=axis, as_json=as_json, events=events,
        )  # fmt: skip
        return
    drawn = None
    if map_to is not None:
        from functools import partial

        from charact.cli.bloom_map import mapped

        drawn = partial(mapped, label=map_of, path=map_to)
    _analyse("bloom", session, method, within, quick, seed, as_json, events, drawn=drawn)


def _analyse(
    room: str, folder: Path, method: str, within: float, quick: bool, seed: int, as_json: bool, events: bool,
    scheduler: str | None = None, drawn: "Callable[[Session, Result, Context], None] | None" = None,
) -> None:  # fmt: skip
    with bad_input_ends(str(folder), as_json=as_json, events=events), progress_bar(events=events) as progress:
        from importlib import import_module

        from charact.measuring import context_of
        from charact.method.cluster import spread_over

        given = opened(folder)
        analysis = import_module(f"charact.{room}")
        with spread_over(scheduler) as spread:
            context = context_of(given, quick=quick, seed=seed, progress=progress, spread=spread)
            result = analysis.measure(given, method=method, within_percent=within, context=context)
        show(
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
    """All that the session's stacks allow; the result is kept in the session for report and fit.

    Example: charact measure day1 --quick
    """
    with bad_input_ends(str(session), as_json=as_json, events=events):
        from labdata import document

        result = measured(session, quick=quick, seed=seed, within=within, events=events, scheduler=scheduler)
        show(
            result,
            given=str(session),
            as_json=as_json,
            events=events,
            next_verb=f"charact report {session}",
            then=lambda: document.save(result, opened(session).folder),
        )


def measured_and_kept(folder: Path, *, quick: bool = False, seed: int = 0, events: bool = False) -> "Result":
    """Measure a session and keep the result in it."""
    from labdata import document

    result = measured(folder, quick=quick, seed=seed, events=events)
    document.save(result, opened(folder).folder)
    return result


def measured(
    folder: Path, *, quick: bool = False, seed: int = 0, within: float = 2.0, events: bool = False,
    scheduler: str | None = None,
) -> "Result":  # fmt: skip
    """Measure a session."""
    from charact.measuring import measure as measure_session
    from charact.measuring import with_inputs
    from charact.method.cluster import spread_over
    from labdata.session import UNUSED

    session = opened(folder)
    for note in session.notes:
        if UNUSED in note:
            say(note, events=events)
    with progress_bar(events=events) as progress, spread_over(scheduler) as spread:
        result = measure_session(
            session, quick=quick, seed=seed, within_percent=within, progress=progress, spread=spread
        )
    return with_inputs(result, session)


def kept_or_measured(folder: Path, *, seed: int, events: bool):
    """The result kept in a session; measured now if there is none."""
    from labdata import document

    if (result := document.load(opened(folder).folder)) is not None:
        return result
    say(f"{folder} has not been measured yet: measuring it first", events=events)
    return measured_and_kept(folder, seed=seed, events=events)


def fit(
    session: SessionFolder,
    sensor_out: Annotated[Path, typer.Option("--sensor-out", help="TOML file for the fitted sensor.")],
    seed: options.Seed = 0,
    events: options.Events = False,
) -> None:
    """Fit the sensor: identified parameters with joint posterior draws, every other one at its prior and marked.

    Example: charact fit day1 --sensor-out day1/fitted.toml
    """
    with bad_input_ends(str(session), events=events):
        from charact.fit import fit_sensor
        from labdata.sensors import save_sensor

        result = kept_or_measured(session, seed=seed, events=events)
        with progress_bar(events=events) as progress:
            fitted = fit_sensor(opened(session), result, seed=seed, progress=progress)
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
    """Simulated beside measured frames, from the fitted sensor alone, under statistics that can fail.

    Example: charact validate day1 --sensor day1/fitted.toml
    """
    with bad_input_ends(str(session), as_json=as_json, events=events):
        from charact.cli.validating import shown, validated_and_kept

        shown(
            validated_and_kept(session, sensor or session / FITTED, seed=seed, events=events), session, as_json=as_json
        )


def report(
    session: SessionFolder,
    out: Annotated[Path | None, typer.Option(help="HTML file; else report.html in the session.")] = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="Write a PDF beside it.")] = False,
    seed: options.Seed = 0,
    events: options.Events = False,
) -> None:
    """One self-contained HTML file: figures, quantities with intervals and verdicts, validation, provenance.

    Example: charact report day1 --pdf
    """
    with bad_input_ends(str(session), events=events):
        from charact.cli.validating import kept_validation
        from charact.report import write

        given = opened(session)
        result = kept_or_measured(session, seed=seed, events=events)
        path = write(given, result, out or session / "report.html", validation=kept_validation(given), pdf=pdf)
        print(path)
