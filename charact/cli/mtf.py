"""The verbs `mtf edge|bars|point|flats`: the MTF of one image or stack, or of flat fields."""

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from charact import __version__
from charact.cli import options
from charact.cli.output import exit_on_bad_input, print_message, print_result, progress_bar
from labdata.errors import BadInput

if TYPE_CHECKING:
    from charact.api import Analysis
    from charact.reporting.frequency_unit import FrequencyUnit
    from labdata.camera.description import Camera
    from labdata.frames import FrameStack
    from labdata.session import Session

app = typer.Typer(
    no_args_is_help=True,
    help="Measure the MTF from a slanted edge, bar target, point source or flat-field noise.",
)

Files = Annotated[
    list[Path],
    typer.Argument(
        help="Images or stacks: .tif .npy .fits .png .jpg .dng .h5 ...; several make a table."
    ),
]


@app.command()
@options.with_options(*options.OF_A_TARGET)
def edge(files: Files, **settings: Any) -> None:
    """Measure the MTF of a slanted edge.

    Example: charact mtf edge my-edge.tif --roi 100,200,80,60 --annotate edge.png

    Example: charact mtf edge day1/*.tif --csv day1.csv --plot day1.png
    """
    _measure("edge", files, **settings)


@app.command()
@options.with_options(*options.OF_A_TARGET)
def bars(
    files: Files,
    frequency: Annotated[
        float | None,
        typer.Option(
            help="Bar frequency, cy/px (default: groups along rows and columns are found)."
        ),
    ] = None,
    bars: Annotated[
        int | None, typer.Option(help="Number of bars (default: counted in the image).", min=2)
    ] = None,
    **settings: Any,
) -> None:
    """Measure the MTF at the frequency of a bar target.

    Example: charact mtf bars usaf.tif --roi 100,200,80,60
    """
    _measure("bars", files, frequency_cy_per_px=frequency, bars=bars, **settings)


@app.command()
@options.with_options(*(name for name in options.OF_A_TARGET if name != "black_dn"))
def point(
    files: Files,
    pinhole_px: Annotated[
        float | None,
        typer.Option(help="Diameter of the pinhole's image, px (default: ideal point)."),
    ] = None,
    **settings: Any,
) -> None:
    """Measure the MTF of a point source.

    Example: charact mtf point pinhole.tif --pinhole-px 1.0 --roi 200,300,96,96
    """
    _measure("point", files, pinhole_px=pinhole_px, **settings)


@app.command()
@options.with_options(
    "plane",
    "axis",
    "method",
    "within",
    "quick",
    "seed",
    "sensor",
    "units",
    "pitch_um",
    "demagnification",
    "focal_length_mm",
    "everything",
    "as_json",
    "events",
)
def flats(
    file: Annotated[
        Path,
        typer.Argument(help="Folder of a session with flats and darks, or one stack of flats."),
    ],
    *,
    plane: str | None,
    axis: str | None,
    method: str,
    within: float,
    quick: bool,
    seed: int,
    sensor: str | None,
    units: str,
    everything: bool,
    as_json: bool,
    events: bool,
    **lengths: Any,
) -> None:
    """Measure the post-gain MTF from the noise power spectrum of flat fields (no target needed).

    Example: charact mtf flats my-session --quick
    """
    with exit_on_bad_input(str(file), as_json=as_json, events=events):
        from charact.estimators.mtf import measure_flats
        from charact.reporting.frequency_unit import FrequencyUnit
        from charact.session_measurement import method_context
        from labdata.camera.description import has_tube

        session = _flats_of(file, _sensor(sensor), plane, axis)
        rows = session.of_kind("flat")[0].read().shape[1] if session.of_kind("flat") else 0
        camera = session.camera if has_tube(session.camera) else None
        frequency = FrequencyUnit.of(camera, rows=rows, unit=units, **lengths)
        with progress_bar(events=events) as progress:
            context = method_context(session, quick=quick, seed=seed, progress=progress)
            result = measure_flats(session, method=method, within_percent=within, context=context)
        print_result(
            result,
            given=str(file),
            verb="mtf flats",
            as_json=as_json,
            events=events,
            everything=everything,
            frequency=frequency,
            next_verb=(
                "charact mtf edge FILE: the MTF of the complete camera with lens and proximity gap"
            ),
        )


def _flats_of(
    file: Path, sensor: "Camera | None", plane: str | None, axis: str | None
) -> "Session":
    """Return the session in a folder, or a session of one stack of flats."""
    from labdata.conditions import Conditions
    from labdata.session import MANIFEST, Session, StackEntry, open_session

    if file.name == MANIFEST or (file / MANIFEST).is_file():
        session = open_session(file)
        return session if sensor is None else replace(session, camera=sensor)
    if not file.exists() or (file.is_dir() and not (file / "zarr.json").is_file()):
        raise BadInput(
            f"flats must be a session folder with a {MANIFEST}, or a file of frames, got {file}"
        )
    entry = StackEntry(
        label=file.stem,
        kind="flat",
        frames=file.name,
        conditions=Conditions(),
        folder=file.parent,
        axis=axis,
        plane=plane,
    )
    return Session(folder=file.parent, name=file.name, stacks=(entry,), camera=sensor)


def _measure(
    kind: str,
    files: list[Path],
    *,
    annotate: Path | None,
    plot: Path | None,
    csv: Path | None,
    as_json: bool,
    events: bool,
    everything: bool,
    **settings: Any,
) -> None:
    """Measure the targets of a kind in each file, and print the result, or a table of several
    files.
    """
    with exit_on_bad_input(str(files[0]), as_json=as_json, events=events):
        if plot is not None:  # before an analysis that takes minutes
            from charact.reporting.style import require_figure_file

            require_figure_file(plot)
        if annotate is not None:
            from charact.cli.annotate import require_png

            require_png(annotate)
            if len(files) > 1:
                raise BadInput(f"--annotate takes one image, got {len(files)}")
    if len(files) > 1:
        _measure_each(kind, files, plot=plot, csv=csv, as_json=as_json, events=events, **settings)
        return
    (file,) = files
    with exit_on_bad_input(str(file), as_json=as_json, events=events):
        result, stack, frequency = _measure_file(kind, file, events=events, **settings)

        def write() -> None:
            if annotate is not None:
                from charact.cli.annotate import unusable_edges, write_annotated_image

                unusable = (
                    unusable_edges(stack, result)
                    if kind == "edge" and settings["roi"] is None
                    else ()
                )
                write_annotated_image(stack, result, annotate, frequency, unusable)
                left = f"; {len(unusable)} further edges cannot be measured" if unusable else ""
                print_message(
                    f"{annotate}: every region with its value, or why it has none{left}",
                    events=events,
                )
            _write_table_and_plot({str(file): result}, plot=plot, csv=csv)

        print_result(
            result,
            given=str(file),
            verb=f"mtf {kind}",
            as_json=as_json,
            events=events,
            everything=everything,
            frequency=frequency,
            then=write,
            next_verb=f"charact import frames {file} mine --kind {kind}, then charact measure mine",
        )


def _measure_file(
    kind: str,
    file: Path,
    *,
    roi: str | None,
    method: str,
    within: float,
    quick: bool,
    seed: int,
    max_targets: int,
    plane: str | None,
    axis: str | None,
    sensor: str | None,
    events: bool,
    units: str,
    pitch_um: float | None,
    demagnification: float | None,
    focal_length_mm: float | None,
    black_dn: float | None = None,
    **target: Any,
) -> "tuple[Analysis, FrameStack, FrequencyUnit]":
    """Measure a region of a stack or, without one, all detected targets of a kind."""
    from charact.api import frames_of, mtf
    from charact.reporting.frequency_unit import FrequencyUnit
    from labdata.session import MANIFEST

    if (file / MANIFEST).is_file():
        raise BadInput(
            f"mtf {kind} takes images or stacks, got the session {file}: charact measure {file}"
        )
    description, region = _sensor(sensor), options.parse_region(roi)
    stack = frames_of(file, plane=plane, axis=axis, black_dn=black_dn)
    frequency = FrequencyUnit.of(
        description,
        rows=stack.shape[1],
        sample_pitch_px=stack.sample_pitch_px,
        unit=units,
        pitch_um=pitch_um,
        demagnification=demagnification,
        focal_length_mm=focal_length_mm,
    )
    with progress_bar(events=events) as progress:
        result = mtf(
            stack,
            kind,
            roi=region,
            method=method,
            within_percent=within,
            quick=quick,
            seed=seed,
            sensor=description,
            max_targets=max_targets,
            progress=progress,
            **target,
        )
    return result, stack, frequency


def _measure_each(
    kind: str,
    files: list[Path],
    *,
    plot: Path | None,
    csv: Path | None,
    as_json: bool,
    events: bool,
    **settings: Any,
) -> None:
    """Measure several files: one line, or with --json one object, each; a bad one does not stop the
    others.
    """
    results: dict[str, Analysis] = {}
    failed = []
    for file in files:
        try:
            with exit_on_bad_input(str(file), as_json=as_json, events=events):
                result, _, frequency = _measure_file(kind, file, events=events, **settings)
        except typer.Exit as end:
            if end.exit_code != 1:
                raise
            failed.append(str(file))
            continue
        results[str(file)] = result
        if as_json:
            from labdata.result_io import to_json

            print(
                json.dumps(to_json(result, given=str(file), version=__version__), allow_nan=False)
            )
        else:
            from charact.reporting.summary import rows_of_file

            print(*rows_of_file(str(file), result, frequency), sep="\n", flush=True)
        if all(m.value is None for m in result.measurements):
            failed.append(str(file))
    with exit_on_bad_input("", events=events):
        _write_table_and_plot(results, plot=plot, csv=csv)
    if failed:
        print_message(
            f"{len(failed)} of {len(files)} files gave no value: {', '.join(failed)}", events=events
        )
        raise typer.Exit(1)


def _write_table_and_plot(
    results: "dict[str, Analysis]", *, plot: Path | None, csv: Path | None
) -> None:
    """Write the measurements of files as CSV, and their curves as a figure."""
    from labdata.file_io import write_atomically

    if csv is not None:
        from charact.reporting.exports import table_of_files

        write_atomically(csv, table_of_files(results).encode())
    if plot is not None and results:
        from charact.reporting.curves import plot_files
        from charact.reporting.style import save_figure

        save_figure(plot_files(results), plot)


def _sensor(name: str | None):
    if name is None:
        return None
    from labdata.sensors import load_sensor

    return load_sensor(name)
