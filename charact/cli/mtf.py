"""The verbs `mtf edge|bars|point|flats`: the MTF of one image or stack, or of flat fields."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from charact import __version__
from charact.api import measuring
from charact.cli.options import frequency_unit, of, verb
from charact.cli.output import (
    exit_on_bad_input,
    print_message,
    print_result,
    print_text,
    progress_bar,
)
from charact.cli.sessions import session_in
from labdata import BadInput, Setting
from labdata.file_io import require_folder_of

if TYPE_CHECKING:
    from charact.api.analysis import Analysis
    from charact.reporting.frequency_unit import FrequencyUnit
    from labdata.frames import FrameStack

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
Plot = Annotated[Path | None, Setting("Write the MTF curves as a figure: .png, .svg or .pdf.")]
Csv = Annotated[Path | None, Setting("Write every value with its 95 % interval as CSV.")]
OF_TARGET = ("bars", "frequency_cy_per_px", "pinhole_px")


def _measure(
    kind: str,
    files: list[Path],
    *,
    annotate: Annotated[
        Path | None, Setting("Write a PNG of the frame with measured regions and MTF50.")
    ] = None,
    plot: Plot = None,
    csv: Csv = None,
    **settings: Any,
) -> None:
    """Measure the targets of a kind in each file, and print the result, or a table of several
    files.
    """
    as_json, events = settings["as_json"], settings["events"]
    with exit_on_bad_input(str(files[0]), as_json=as_json, events=events):
        if plot is not None:  # before an analysis that takes minutes
            from charact.reporting.style import require_figure_file

            require_figure_file(plot)
        for path in filter(None, (annotate, csv)):
            require_folder_of(path)
        if annotate is not None:
            from charact.reporting.annotated_image import require_png

            require_png(annotate)
            if len(files) > 1:
                raise BadInput(f"--annotate takes one image, got {len(files)}")
    if len(files) > 1:
        _measure_each(kind, files, plot=plot, csv=csv, **settings)
        return
    (file,) = files
    with exit_on_bad_input(str(file), as_json=as_json, events=events):
        result, stack, frequency = _measure_file(kind, file, **settings)

        def write() -> None:
            if annotate is not None:
                from charact.reporting.annotated_image import unusable_edges, write_annotated_image

                unusable = (
                    unusable_edges(stack, result)
                    if kind == "edge" and settings["roi"] is None
                    else ()
                )
                write_annotated_image(stack, result, annotate, frequency, unusable)
                further = f"; {len(unusable)} further edges cannot be measured" if unusable else ""
                print_message(
                    f"{annotate}: every region with its value, or why it has none{further}",
                    events=events,
                )
            _write_table_and_plot({str(file): result}, plot=plot, csv=csv, frequency=frequency)

        print_result(
            result,
            given=str(file),
            verb=f"mtf {kind}",
            frequency=frequency,
            then=write,
            next_verb=f"charact import frames {file} mine --kind {kind}, then charact measure mine",
            **of(print_result, settings),
        )


def _measure_file(
    kind: str, file: Path, **settings: Any
) -> "tuple[Analysis, FrameStack, FrequencyUnit]":
    """Measure a region of a stack or, without one, all detected targets of a kind."""
    from charact.api.inputs import frames_of, sensor_of
    from labdata.importers import read_frames
    from labdata.session import MANIFEST

    if (file / MANIFEST).is_file():
        raise BadInput(
            f"mtf {kind} takes images or stacks, got the session {file}: charact measure {file}"
        )
    settings["sensor"] = sensor_of(settings["sensor"])
    stack = frames_of(file, **of(read_frames, settings))
    frequency = frequency_unit(
        settings["sensor"],
        rows=stack.shape[1],
        sample_pitch_px=stack.sample_pitch_px,
        **of(frequency_unit, settings),
    )
    with progress_bar(events=settings["events"]) as progress:
        chosen = of(measuring.mtf, settings)
        result = measuring.mtf(stack, kind, progress=progress, **chosen)
    return result, stack, frequency


def _measure_each(
    kind: str, files: list[Path], *, plot: Path | None, csv: Path | None, **settings: Any
) -> None:
    """Measure several files: one line, or with --json one object, each; a bad one does not stop the
    others.
    """
    as_json, events = settings["as_json"], settings["events"]
    results: dict[str, Analysis] = {}
    failed, frequency = [], None
    for file in files:
        try:
            with exit_on_bad_input(str(file), as_json=as_json, events=events):
                result, _, frequency = _measure_file(kind, file, **settings)
        except typer.Exit as end:
            if end.exit_code != 1:
                raise
            failed.append(str(file))
            continue
        results[str(file)] = result
        if as_json:
            from labdata.result_io import to_json

            document = to_json(result, given=str(file), version=__version__)
            print_text(json.dumps(document, allow_nan=False))
        else:
            from charact.reporting.summary import rows_of_file

            print_text("\n".join(rows_of_file(str(file), result, frequency)))
        if all(m.value is None for m in result.measurements):
            failed.append(str(file))
    with exit_on_bad_input("", events=events):
        _write_table_and_plot(results, plot=plot, csv=csv, frequency=frequency)
    if failed:
        print_message(
            f"{len(failed)} of {len(files)} files gave no value: {', '.join(failed)}",
            events=events,
        )
        raise typer.Exit(1)


def _write_table_and_plot(
    results: "dict[str, Analysis]",
    *,
    plot: Plot = None,
    csv: Csv = None,
    frequency: "FrequencyUnit | None" = None,
) -> None:
    """Write the measurements of files as CSV, and their curves as a figure."""
    from labdata.file_io import write_atomically

    if csv is not None:
        from charact.reporting.exports import table_of_files

        write_atomically(csv, table_of_files(results).encode())
    if plot is not None and results:
        from charact.reporting.mtf_curves import plot_files
        from charact.reporting.style import save_figure
        from charact.reporting.summary import in_cycles_per_pixel

        save_figure(plot_files(results, frequency=frequency or in_cycles_per_pixel), plot)


CALLED = (measuring.mtf, _measure, frequency_unit, print_result)


@app.command()
@verb(*CALLED, without=OF_TARGET)
def edge(files: Files, **settings: Any) -> None:
    """Measure the MTF of a slanted edge.

    Example: charact mtf edge my-edge.tif --roi 100,200,80,60 --annotate edge.png

    Example: charact mtf edge day1/*.tif --csv day1.csv --plot day1.png
    """
    _measure("edge", files, **settings)


@app.command()
@verb(*CALLED, without=("pinhole_px", "also"))
def bars(files: Files, **settings: Any) -> None:
    """Measure the MTF at the frequency of a bar target.

    Example: charact mtf bars usaf.tif --roi 100,200,80,60
    """
    _measure("bars", files, **settings)


@app.command()
@verb(*CALLED, without=("bars", "frequency_cy_per_px", "black_dn", "also"))
def point(files: Files, **settings: Any) -> None:
    """Measure the MTF of a point source.

    Example: charact mtf point pinhole.tif --pinhole-px 1.0 --roi 200,300,96,96
    """
    _measure("point", files, **settings)


@app.command()
@verb(
    measuring.mtf,
    frequency_unit,
    print_result,
    without=(*OF_TARGET, "roi", "black_dn", "max_targets", "also"),
)
def flats(
    file: Annotated[
        Path,
        typer.Argument(help="Folder of a session with flats and darks, or one stack of flats."),
    ],
    **settings: Any,
) -> None:
    """Measure the post-gain MTF from the noise power spectrum of flat fields (no target needed).

    Example: charact mtf flats my-session --quick
    """
    as_json, events = settings["as_json"], settings["events"]
    with exit_on_bad_input(str(file), as_json=as_json, events=events):
        from charact.api.inputs import flats_of
        from labdata.camera.description import has_tube

        session = flats_of(session_in(file), **of(flats_of, settings))
        stacks = session.of_kind("flat")
        rows = stacks[0].read().shape[1] if stacks else 0
        settings["sensor"] = None  # it is that of the session now
        camera = session.camera if has_tube(session.camera) else None
        frequency = frequency_unit(camera, rows=rows, **of(frequency_unit, settings))
        with progress_bar(events=events) as progress:
            chosen = of(measuring.mtf, settings)
            result = measuring.mtf(session, "flats", progress=progress, **chosen)
        print_result(
            result,
            given=str(file),
            verb="mtf flats",
            frequency=frequency,
            next_verb=(
                "charact mtf edge FILE: the MTF of the complete camera with lens and proximity gap"
            ),
            **of(print_result, settings),
        )
