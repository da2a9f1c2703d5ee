"""The verbs of a session: noise, bloom, measure, fit, validate, report."""

import json
import sys
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from charact import __version__
from charact.api import measuring, modelling
from charact.cli.options import Events, Json, frequency_unit, of, verb
from charact.cli.output import (
    exit_on_bad_input,
    print_message,
    print_result,
    print_text,
    progress_bar,
)
from charact.cli.outputs import Force, require_free, why_other_kind
from labdata import BadInput, Setting
from labdata.file_io import require_folder_of

if TYPE_CHECKING:
    from charact.api.analysis import Analysis
    from charact.validation import Validation
    from labdata import Camera, Result, Session


EXIT_CODES = {"agrees": 0, "differs": 3, "undecided": 4}


def session_in(folder: Path) -> Path:
    """Return the session folder inside the folder of a demonstration, else the folder."""
    from labdata.session import MANIFEST

    session = folder / "session"
    return (
        session if (session / MANIFEST).is_file() and not (folder / MANIFEST).is_file() else folder
    )


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


@verb(measuring.noise, print_result)
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


@verb(measuring.bloom, print_result)
def bloom(
    session: SessionFolder,
    map_to: Annotated[
        Path | None,
        Setting(
            "Write the bloom map (fraction of each pixel's signal that is blooming): .png or .npz.",
            option="--map",
        ),
    ] = None,
    map_of: Annotated[
        str | None,
        Setting("Stack to map (default: a scene stack, otherwise the brightest point stack)."),
    ] = None,
    **settings: Any,
) -> None:
    """Measure halo and bloom extent from point sources; optionally write a bloom map.

    A single image may be given instead of a session; only single-frame quantities are measured.

    Example: charact bloom day1 --map bloom.png
    """
    if map_to is None and map_of is not None:
        raise typer.BadParameter("needs --map", param_hint="'--map-of'")
    _analyse("bloom", session, map_to=map_to, map_of=map_of, **settings)


def _analyse(
    room: str,
    source: Path,
    *,
    map_to: Path | None = None,
    map_of: str | None = None,
    **settings: Any,
) -> None:
    """Measure noise or bloom of a session, or bloom of an image, and keep the result of a
    session.
    """
    events = settings["events"]
    with exit_on_bad_input(str(source), as_json=settings["as_json"], events=events):
        image = room == "bloom" and is_image(source)
        if map_to is not None:
            require_folder_of(map_to)
        if image and map_to is not None:
            raise BadInput(
                f"--map needs a session with point sources, got the file {source}; create one with "
                f"charact import frames {source} OUT --kind point"
            )
        measured = source
        if not image:
            measured = open_session_only(source)
            _print_doubts(measured, events=events)
        analysis = getattr(measuring, room)
        with progress_bar(events=events) as progress:
            result = analysis(measured, progress=progress, **of(analysis, settings))

        def keep() -> None:
            if image:
                return
            from charact.session_measurement import method_context, with_inputs
            from labdata import result_io

            session = result.session
            try:
                result_io.save_into(with_inputs(result, session), session.folder)
            except OSError as error:  # a folder of others may be read-only
                print_message(
                    f"the result is not kept in {session.folder}: {error.strerror or error}",
                    events=events,
                )
            if map_to is not None:
                from charact.reporting.bloom_images import write_bloom_map

                context = method_context(session, quick=settings["quick"], seed=settings["seed"])
                write_bloom_map(session, result, context, label=map_of, path=map_to)

        further = f"charact import frames {source} mine --kind point, then charact measure mine"
        print_result(
            result,
            given=str(source),
            verb=room,
            next_verb=further if image else f"charact measure {source}",
            then=keep,
            **of(print_result, settings),
        )


@verb(measuring.measure, frequency_unit, print_result)
def measure(session: SessionFolder, **settings: Any) -> None:
    """Measure everything the stacks of a session support and store the result in the session.

    The last line says whether that is enough for a purpose, and which frames to add.

    Example: charact measure day1 --quick

    Example: charact measure day1 --for emva1288
    """
    events = settings["events"]
    with exit_on_bad_input(str(session), as_json=settings["as_json"], events=events):
        from labdata import open_lazy_stack, result_io

        opened = open_session_only(session)
        first = opened.stacks[0] if opened.stacks else None
        frequency = frequency_unit(
            opened.camera,
            rows=open_lazy_stack(first).shape[1] if first else None,
            sample_pitch_px=first.sampling()[1] if first else 1,
            **of(frequency_unit, settings),
        )
        result = measure_folder(session, events=events, **of(measuring.measure, settings))

        decision = result.verdict
        assert decision is not None

        def keep() -> None:
            result_io.save(result, opened.folder)
            if settings["purpose"] is None and not settings["as_json"]:
                print_text(f"Purpose by the frames: {decision.purpose} (`purpose` states another)")

        print_result(
            result,
            given=str(session),
            verb="measure",
            frequency=frequency,
            next_verb=f"charact report {session}",
            decision=decision,
            then=keep,
            **of(print_result, settings),
        )


def _print_doubts(session: "Session", *, events: bool) -> None:
    """Print which fields of targets are not used, and what headers of files contradict."""
    from labdata.session import UNUSED

    of_headers = {note for entry in session.stacks for note in entry.header_notes}
    for note in session.notes:
        if UNUSED in note or note in of_headers:
            print_message(note, events=events)


def measure_folder(
    folder: Path, *, events: bool = False, save: bool = False, **settings: Any
) -> "Analysis":
    """Measure a session; `save`: store the result in it."""
    from charact.session_measurement import with_inputs
    from labdata import result_io

    session = open_session_only(folder)
    _print_doubts(session, events=events)
    with progress_bar(events=events) as progress:
        result = with_inputs(measuring.measure(session, progress=progress, **settings), session)
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


@verb(modelling.fit)
def fit(
    session: SessionFolder,
    sensor_out: Annotated[
        Path, typer.Option("--sensor-out", help="Output TOML file of the fitted sensor.")
    ],
    force: Force = False,
    events: Events = False,
    **settings: Any,
) -> None:
    """Fit the sensor: identified parameters with joint posterior draws, the others at their priors
    and marked.

    Example: charact fit day1 --sensor-out day1/fitted.toml
    """
    with exit_on_bad_input(str(session), events=events):
        require_free(
            require_folder_of(sensor_out),
            force=force,
            kept=lambda: _why_no_fit(sensor_out, session),
        )
        result = load_or_measure(session, events=events, **settings)
        fitted = fit_and_save(session, result, sensor_out, events=events, **settings)
        for path, p in fitted.parameters().items():
            if p.standing in ("fitted", "prior", "not-converged"):
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
    from labdata.sensors import load_description

    if path.resolve() == (session / "sensor.toml").resolve():
        return "the camera of the session"
    try:
        return None if load_description(path).draws.values else "a sensor that was not fitted"
    except BadInput:
        return "a file that is no sensor"


def fit_and_save(
    folder: Path, result: "Result", out: Path, *, events: bool, **settings: Any
) -> "Camera":
    """Fit the sensor of a session and save it as a TOML file."""
    from labdata.sensors import save_sensor

    with progress_bar(events=events) as progress:
        fitted = modelling.fit(open_session_only(folder), result, progress=progress, **settings)
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


@verb(modelling.validate)
def validate(
    session: SessionFolder, as_json: Json = False, events: Events = False, **settings: Any
) -> None:
    """Compare simulated with measured frames, using only the fitted sensor, by tests that can fail.

    Exit code 0: they agree within the tolerances; 3: one differs beyond its tolerance; 4:
    undecided; 1: bad input.

    Example: charact validate day1 --sensor day1/fitted.toml
    """
    with exit_on_bad_input(str(session), as_json=as_json, events=events):
        validation = validate_and_save(session, events=events, **settings)
        if as_json:
            from charact.validation import as_json as document_of

            document = document_of(validation)
            print_text(
                json.dumps({"charact": __version__, "input": str(session), "validation": document})
            )
        else:
            from charact.reporting.validation_text import lines_of

            print("\n".join(lines_of(validation)))
            print(f"Next: charact report {session}")
    raise typer.Exit(EXIT_CODES[validation.verdict])


def validate_and_save(
    folder: Path, *, sensor: str | None = None, events: bool, **settings: Any
) -> "Validation":
    """Validate a session against a fitted sensor and save the result in the session folder."""
    from charact import validation

    session = open_session_only(folder)
    fitted = modelling.fitted_sensor_of(session, sensor)
    if not fitted.draws.values:
        sentence = (
            f"{fitted.name} has no posterior draws: it is simulated without parameter uncertainty"
        )
        print_message(sentence, events=events)
    with progress_bar(events=events) as progress:
        compared = modelling.validate(session, fitted, progress=progress, **settings)
    notes = (*compared.notes, *(f"fit of {fitted.name}: {note}" for note in _findings_in(fitted)))
    in_session = sensor is None or Path(sensor).resolve().parent == session.folder.resolve()
    compared = replace(
        compared, notes=notes, same_session=in_session or _of_same_frames(fitted, session)
    )
    validation.save(compared, session.folder)
    return compared


@verb(modelling.report)
def report(
    session: SessionFolder,
    open_page: Annotated[bool, Setting("Open the page in the browser.", option="--open")] = False,
    force: Force = False,
    events: Events = False,
    **settings: Any,
) -> None:
    """Write a self-contained HTML report: figures, quantities with intervals, validation,
    provenance.

    Example: charact report day1 --pdf
    """
    with exit_on_bad_input(str(session), events=events):
        out = settings["out"]
        for path in () if out is None else (out, *((out.with_suffix(".pdf"),) * settings["pdf"])):
            require_free(
                path,
                force=force,
                kept=lambda path=path: why_other_kind(path, b"<!doctype html", b"%PDF"),
            )
        result = load_or_measure(session, seed=settings["seed"], events=events)
        page = modelling.report(session, result=result, **settings)
        print(page)
        if open_page and typer.launch(page.absolute().as_uri()) != 0:
            print_message(f"no browser could be started: open {page}", events=events)
