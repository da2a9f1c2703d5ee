"""The verbs of a session: noise, bloom, measure, fit, validate, report."""

import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from charact import __version__
from charact.cli import options
from charact.cli.output import exit_on_bad_input, print_message, print_result, progress_bar
from charact.cli.outputs import FITTED, Force, require_free, why_other_kind
from labdata.errors import BadInput

if TYPE_CHECKING:
    from charact.fitting.prior import Camera
    from charact.method import Context
    from charact.validation import Validation
    from labdata.measurement import Result
    from labdata.session import Session


def session_in(folder: Path) -> Path:
    """Return the session folder inside the folder of a demonstration, else the folder."""
    from labdata.session import MANIFEST

    inside = folder / "session"
    return inside if (inside / MANIFEST).is_file() and not (folder / MANIFEST).is_file() else folder


def _sessions_in(folders: list[Path]) -> list[Path]:
    return [session_in(folder) for folder in folders]


HELP = "Session folder, or that of a demonstration."
SessionFolder = Annotated[Path, typer.Argument(help=HELP, callback=session_in)]
SessionFolders = Annotated[list[Path], typer.Argument(help=HELP, callback=_sessions_in)]


def is_image(path: Path) -> bool:
    """Whether a path is a file of frames, not a session."""
    from labdata.importers import module_of
    from labdata.session import MANIFEST

    return module_of(path) is not None and not (path / MANIFEST).is_file()


def require_session(path: Path) -> None:
    """Raise BadInput if the path is a file of frames."""
    if is_image(path):
        raise BadInput(
            f"a session must be a folder with a session.toml, got the file {path}; create one "
            f"with charact import frames {path} OUT --kind KIND, or use charact bloom or charact "
            "mtf"
        )


def open_session_only(path: Path) -> "Session":
    """Open a session; a file of frames raises BadInput."""
    from labdata.session import open_session

    require_session(path)
    return open_session(path)


@options.with_options(
    "method", "within", "quick", "seed", "scheduler", "everything", "as_json", "events"
)
def noise(sessions: SessionFolders, **settings: Any) -> None:
    """Measure noise and gain from flat and dark stacks of one or more sessions.

    Each session prints its own result (with --json one object per line). A failed session does not
    stop the others; the exit code is 1 if any session gives no value.

    Example: charact noise ccd12 --json
    """
    failed = []
    for session in sessions:
        if len(sessions) > 1 and not settings["as_json"]:
            print(f"{session}:")
        try:
            _analyse("noise", session, **settings)
        except typer.Exit as end:
            if end.exit_code != 1 or len(sessions) == 1:
                raise
            failed.append(str(session))
        sys.stdout.flush()
    if failed:
        sentence = f"{len(failed)} of {len(sessions)} sessions gave no value: {', '.join(failed)}"
        print_message(sentence, events=settings["events"])
        raise typer.Exit(1)


@options.with_options(
    "method",
    "within",
    "quick",
    "seed",
    "everything",
    "as_json",
    "events",
    "map_to",
    "map_of",
    "plane",
    "axis",
)
def bloom(
    session: SessionFolder,
    *,
    map_to: Path | None,
    map_of: str | None,
    plane: str | None,
    axis: str | None,
    **settings: Any,
) -> None:
    """Measure halo and bloom extent from point sources; optionally write a bloom map.

    A single image may be given instead of a session; only single-frame quantities are measured.

    Example: charact bloom day1 --map bloom.png
    """
    if map_to is None and map_of is not None:
        raise typer.BadParameter("needs --map", param_hint="'--map-of'")
    if is_image(session):
        _bloom_of_image(session, mapped=map_to is not None, plane=plane, axis=axis, **settings)
        return
    drawn = None
    if map_to is not None:
        from charact.reporting.bloom_images import write_bloom_map

        drawn = partial(write_bloom_map, label=map_of, path=map_to)
    _analyse("bloom", session, drawn=drawn, **settings)


def _analyse(
    room: str,
    folder: Path,
    *,
    method: str,
    within: float,
    quick: bool,
    seed: int,
    everything: bool,
    as_json: bool,
    events: bool,
    scheduler: str | None = None,
    drawn: "Callable[[Session, Result, Context], None] | None" = None,
) -> None:
    with (
        exit_on_bad_input(str(folder), as_json=as_json, events=events),
        progress_bar(events=events) as progress,
    ):
        from charact.method.registry import parallel_map
        from charact.session_measurement import (
            measure_bloom,
            measure_noise,
            method_context,
            with_inputs,
        )
        from labdata import result_io

        given = open_session_only(folder)
        analysis = measure_noise if room == "noise" else measure_bloom

        def keep(given: "Session", result: "Result", context: "Context") -> None:
            try:
                result_io.save_into(with_inputs(result, given), given.folder)
            except OSError as error:  # a folder of others may be read-only
                print_message(
                    f"the result is not kept in {given.folder}: {error.strerror or error}",
                    events=events,
                )
            if drawn is not None:
                drawn(given, result, context)

        with parallel_map(scheduler) as spread:
            context = method_context(
                given, quick=quick, seed=seed, progress=progress, spread=spread
            )
            result = analysis(given, method=method, within_percent=within, context=context)
        print_result(
            result,
            given=str(folder),
            verb=room,
            as_json=as_json,
            events=events,
            everything=everything,
            next_verb=f"charact measure {folder}",
            then=lambda: keep(given, result, context),
        )


def _bloom_of_image(
    path: Path,
    *,
    mapped: bool,
    plane: str | None,
    axis: str | None,
    within: float,
    everything: bool,
    as_json: bool,
    events: bool,
    **settings: Any,
) -> None:
    """Measure and print the bloom extent of a point source in a single image."""
    with exit_on_bad_input(str(path), as_json=as_json, events=events):
        from charact.api import bloom, frames_of

        if mapped:
            raise BadInput(
                f"--map needs a session with point sources, got the file {path}; create one with "
                f"charact import frames {path} OUT --kind point"
            )
        frames = frames_of(path, plane=plane, axis=axis)
        with progress_bar(events=events) as progress:
            result = bloom(
                frames, within_percent=within, progress=progress, label=path.stem, **settings
            )
        further = f"charact import frames {path} mine --kind point, then charact measure mine"
        print_result(
            result,
            given=str(path),
            verb="bloom",
            as_json=as_json,
            events=events,
            everything=everything,
            next_verb=further,
        )


@options.with_options(
    "within",
    "quick",
    "seed",
    "scheduler",
    "units",
    "pitch_um",
    "demagnification",
    "focal_length_mm",
    "everything",
    "as_json",
    "events",
)
def measure(
    session: SessionFolder,
    *,
    units: str,
    pitch_um: float | None,
    demagnification: float | None,
    focal_length_mm: float | None,
    everything: bool,
    as_json: bool,
    events: bool,
    **settings: Any,
) -> None:
    """Measure everything the stacks of a session support and store the result in the session.

    Example: charact measure day1 --quick
    """
    with exit_on_bad_input(str(session), as_json=as_json, events=events):
        from charact.reporting.frequency_unit import FrequencyUnit
        from labdata import result_io
        from labdata.lazy_stack import open_lazy_stack

        given = open_session_only(session)
        first = given.stacks[0] if given.stacks else None
        frequency = FrequencyUnit.of(
            given.camera,
            rows=open_lazy_stack(first).shape[1] if first else None,
            sample_pitch_px=first.sampling()[1] if first else 1,
            unit=units,
            pitch_um=pitch_um,
            demagnification=demagnification,
            focal_length_mm=focal_length_mm,
        )
        result = measure_folder(session, events=events, **settings)
        print_result(
            result,
            given=str(session),
            verb="measure",
            as_json=as_json,
            events=events,
            everything=everything,
            frequency=frequency,
            next_verb=f"charact report {session}",
            then=lambda: result_io.save(result, open_session_only(session).folder),
        )


def measure_folder(
    folder: Path,
    *,
    quick: bool = False,
    seed: int = 0,
    within: float = 2.0,
    events: bool = False,
    scheduler: str | None = None,
    save: bool = False,
) -> "Result":
    """Measure a session; `save`: store the result in it."""
    from charact.method.registry import parallel_map
    from charact.session_measurement import measure as measure_session
    from charact.session_measurement import with_inputs
    from labdata import result_io
    from labdata.session import UNUSED

    session = open_session_only(folder)
    for note in session.notes:
        if UNUSED in note:
            print_message(note, events=events)
    with progress_bar(events=events) as progress, parallel_map(scheduler) as spread:
        result = measure_session(
            session, quick=quick, seed=seed, within_percent=within, progress=progress, spread=spread
        )
    result = with_inputs(result, session)
    if save:
        result_io.save(result, session.folder)
    return result


def load_or_measure(folder: Path, *, seed: int, events: bool) -> "Result":
    """Return the result saved in a session, measured first if there is none."""
    from labdata import result_io

    if (result := result_io.load(open_session_only(folder).folder)) is not None:
        return result
    print_message(f"{folder} has not been measured yet: measuring it first", events=events)
    return measure_folder(folder, seed=seed, events=events, save=True)


def fit(
    session: SessionFolder,
    sensor_out: Annotated[
        Path, typer.Option("--sensor-out", help="Output TOML file of the fitted sensor.")
    ],
    force: Force = False,
    seed: options.Seed = 0,
    events: options.Events = False,
) -> None:
    """Fit the sensor: identified parameters with joint posterior draws, the others at their priors
    and marked.

    Example: charact fit day1 --sensor-out day1/fitted.toml
    """
    with exit_on_bad_input(str(session), events=events):
        require_free(sensor_out, force=force, kept=lambda: _why_no_fit(sensor_out, session))
        result = load_or_measure(session, seed=seed, events=events)
        fitted = fit_and_save(session, result, sensor_out, seed=seed, events=events)
        for path, p in fitted.parameters().items():
            if p.standing in ("fitted", "prior"):
                print(f"{path} {p.value:.4g} [{p.low:.4g}, {p.high:.4g}] 95 %, {p.standing}")
        described = open_session_only(session).camera
        for note in fitted.notes[len(described.notes) if described else 0 :]:
            print(f"note: {note}")
        print(f"{sensor_out}\nNext: charact validate {session} --sensor {sensor_out}")


def _findings_in(fitted: "Camera") -> tuple[str, ...]:
    """Return the notes of a fitted camera that are findings of its fit."""
    from labdata.flags import FLAGS

    return tuple(note for note in fitted.notes if note.partition(":")[0] in FLAGS)


def _why_no_fit(path: Path, session: Path) -> str | None:
    """Return what a file is that is no fitted sensor, or is the camera of the session; else
    None.
    """
    from labdata.sensors import load_camera

    if path.resolve() == (session / "sensor.toml").resolve():
        return "the camera of the session"
    try:
        return None if load_camera(path).draws.values else "a sensor that was not fitted"
    except BadInput:
        return "a file that is no sensor"


def fit_and_save(folder: Path, result: "Result", out: Path, *, seed: int, events: bool) -> "Camera":
    """Fit the sensor of a session and save it as a TOML file."""
    from charact.fitting import fit_sensor
    from labdata.sensors import save_sensor

    with progress_bar(events=events) as progress:
        fitted = fit_sensor(open_session_only(folder), result, seed=seed, progress=progress)
    fitted = replace(fitted, notes=(*fitted.notes, _frames_note(folder.name, result)))
    save_sensor(fitted, out)
    return fitted


def _frames_note(name: str, result: "Result") -> str:
    """Return the note by which validate knows the frames that a sensor was fitted to: a digest of
    their digests.
    """
    known = [m.provenance.inputs for m in result.measurements if m.provenance is not None]
    digests = sorted({digest for inputs in known for digest in inputs.values()})
    return (
        f"Fitted to the frames of {name}, digest "
        f"{sha256(''.join(digests).encode()).hexdigest()[:16]}."
    )


def _of_same_frames(fitted: "Camera", session: "Session") -> bool:
    """Whether a sensor was fitted to the frames of a session, as they were when it was measured."""
    from labdata import result_io

    result = result_io.load(session.folder)
    if result is None:
        return False
    digest = _frames_note("", result).rpartition(", ")[2]
    return any(
        note.startswith("Fitted to the frames of ") and note.endswith(digest)
        for note in fitted.notes
    )


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
        done = validate_and_save(session, sensor or session / FITTED, seed=seed, events=events)
        if as_json:
            from charact.validation import as_json as document

            print(
                json.dumps(
                    {"charact": __version__, "input": str(session), "validation": document(done)}
                )
            )
        else:
            print("\n".join(_lines(done)))
            print(f"Next: charact report {session}")


def validate_and_save(folder: Path, sensor: str | Path, *, seed: int, events: bool) -> "Validation":
    """Validate a session against a fitted sensor and save the result in the session folder."""
    from charact import validation
    from labdata.sensors import load_camera

    session = open_session_only(folder)
    if isinstance(sensor, Path) and not sensor.is_file():
        raise BadInput(
            f"validate needs a fitted sensor, got no file {sensor}; run charact fit {folder} "
            f"--sensor-out {sensor}"
        )
    fitted = load_camera(sensor)
    if fitted.is_thermal:
        raise BadInput(
            f"validate needs a camera of visible light, got {fitted.name!r} of the thermal infrared"
        )
    if not fitted.draws.values:
        sentence = (
            f"{fitted.name} has no posterior draws: it is simulated without parameter uncertainty"
        )
        print_message(sentence, events=events)
    with progress_bar(events=events) as progress:
        done = validation.validate(session, fitted, seed=seed, progress=progress)
    notes = (*done.notes, *(f"fit of {fitted.name}: {note}" for note in _findings_in(fitted)))
    own = Path(sensor).resolve().parent == session.folder.resolve()
    done = replace(done, notes=notes, same_session=own or _of_same_frames(fitted, session))
    validation.save(done, session.folder)
    return done


def _lines(validation: "Validation") -> Iterator[str]:
    """Yield one line per statistic, what the controls noticed and did not, detectable errors, and
    the verdict.
    """
    for one in validation.statistics:
        yield f"{one.title}: p {one.p_text}, {'agrees' if one.passed else 'DIFFERS'}"
        if not one.passed:
            yield f"    most in {one.worst}; may come from {one.cause}"
    for control in validation.controls:
        if control.name == "null":
            failing = "" if control.passed else f": {', '.join(control.noticed_by)}"
            yield (
                f"null control, {control.title}: {'passes' if control.passed else 'FAILS'}{failing}"
            )
    negative = [one for one in validation.controls if one.name == "negative"]
    unseen = [one.title for one in negative if not one.passed]
    yield f"negative controls: {len(negative) - len(unseen)} of {len(negative)} noticed" + (
        f"; not seen: {', '.join(unseen)}" if unseen else ""
    )
    found = [f"{one.title} {one.percent}" for one in validation.power if one.statistic]
    if found:
        share = f"{100.0 * validation.power[0].probability:g} %"
        yield f"errors that would have been found in {share} of cases: {', '.join(found)}"
    yield from (f"likely cause: {one.note}" for one in validation.likely_causes)
    yield from (f"note: {note}" for note in (validation.origin, *validation.notes))
    yield f"validation: {'passed' if validation.passed else 'FAILED'}"


def report(
    session: SessionFolder,
    out: Annotated[
        Path | None, typer.Option(help="Output HTML file (default: report.html in the session).")
    ] = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="Also write a PDF.")] = False,
    force: Force = False,
    seed: options.Seed = 0,
    events: options.Events = False,
) -> None:
    """Write a self-contained HTML report: figures, quantities with intervals, validation,
    provenance.

    Example: charact report day1 --pdf
    """
    with exit_on_bad_input(str(session), events=events):
        from charact.reporting.session_page import write
        from charact.validation import load

        for path in () if out is None else (out, *((out.with_suffix(".pdf"),) if pdf else ())):
            require_free(
                path,
                force=force,
                kept=lambda path=path: why_other_kind(path, b"<!doctype html", b"%PDF"),
            )
        given = open_session_only(session)
        result = load_or_measure(session, seed=seed, events=events)
        print(
            write(
                given,
                result,
                out or session / "report.html",
                validation=load(given.folder),
                pdf=pdf,
            )
        )
