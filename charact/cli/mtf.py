"""The verbs `mtf edge|bars|point|flats`: the MTF of one image or stack, or of flat fields."""

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from charact.cli import options
from charact.cli.output import FrequencyUnit, exit_on_bad_input, in_file_coordinates, print_result, progress_bar
from labdata.errors import BadInput

if TYPE_CHECKING:
    from labdata.frames import FrameStack
    from labdata.sensor import Sensor
    from labdata.session import Session

app = typer.Typer(
    no_args_is_help=True, help="Measure the MTF from a slanted edge, bar target, point source or flat-field noise."
)

File = Annotated[Path, typer.Argument(help="Image or stack: .tif .npy .fits .png .jpg .dng .h5 ... (docs/formats.md)")]


@app.command()
@options.with_options(*options.OF_A_TARGET)
def edge(file: File, **settings: Any) -> None:
    """Measure the MTF of a slanted edge.

    Example: charact mtf edge my-edge.tif --roi 100,200,80,60 --annotate edge.png
    """
    _measure("edge", file=file, **settings)


@app.command()
@options.with_options(*options.OF_A_TARGET)
def bars(
    file: File,
    frequency: Annotated[
        float | None, typer.Option(help="Bar frequency, cy/px (default: groups along rows and columns are found).")
    ] = None,
    bars: Annotated[int | None, typer.Option(help="Number of bars (default: counted in the image).", min=2)] = None,
    **settings: Any,
) -> None:
    """Measure the MTF at the frequency of a bar target.

    Example: charact mtf bars usaf.tif --roi 100,200,80,60
    """
    _measure("bars", file=file, frequency_cy_per_px=frequency, bars=bars, **settings)


@app.command()
@options.with_options(*(name for name in options.OF_A_TARGET if name != "black_dn"))
def point(
    file: File,
    pinhole_px: Annotated[
        float | None, typer.Option(help="Diameter of the pinhole's image, px (default: ideal point).")
    ] = None,
    **settings: Any,
) -> None:
    """Measure the MTF of a point source.

    Example: charact mtf point pinhole.tif --pinhole-px 1.0 --roi 200,300,96,96
    """
    _measure("point", file=file, pinhole_px=pinhole_px, **settings)


@app.command()
@options.with_options(
    "plane", "axis", "method", "within", "quick", "seed", "sensor", "units", "pitch_um", "demagnification",
    "focal_length_mm", "as_json", "events",
)  # fmt: skip
def flats(
    file: Annotated[Path, typer.Argument(help="Folder of a session with flats and darks, or one stack of flats.")],
    *, plane: str | None, axis: str | None, method: str, within: float, quick: bool, seed: int, sensor: str | None,
    as_json: bool, events: bool, **lengths: Any,
) -> None:  # fmt: skip
    """Measure the post-gain MTF from the noise power spectrum of flat fields (no target needed).

    Example: charact mtf flats my-session --quick
    """
    with exit_on_bad_input(str(file), as_json=as_json, events=events):
        from charact import mtf
        from charact.session_measurement import method_context

        session = _flats_of(file, _sensor(sensor), plane, axis)
        rows = session.of_kind("flat")[0].read().shape[1] if session.of_kind("flat") else 0
        frequency = _unit(session.sensor, rows=rows, **lengths)
        with progress_bar(events=events) as progress:
            context = method_context(session, quick=quick, seed=seed, progress=progress)
            result = mtf.measure_flats(session, method=method, within_percent=within, context=context)
        print_result(
            result, given=str(file), as_json=as_json, events=events, frequency=frequency,
            next_verb="charact mtf edge FILE: the MTF of the complete camera with lens and proximity gap",
        )  # fmt: skip


def _flats_of(file: Path, sensor: "Sensor | None", plane: str | None, axis: str | None) -> "Session":
    """Return the session in a folder, or a session of one stack of flats."""
    from labdata.conditions import Conditions
    from labdata.session import MANIFEST, Session, StackEntry, open_session

    if file.name == MANIFEST or (file / MANIFEST).is_file():
        session = open_session(file)
        return session if sensor is None else replace(session, sensor=sensor)
    if not file.exists() or (file.is_dir() and not (file / "zarr.json").is_file()):
        raise BadInput(f"flats must be a session folder with a {MANIFEST}, or a file of frames, got {file}")
    entry = StackEntry(
        label=file.stem, kind="flat", frames=file.name, conditions=Conditions(), folder=file.parent, axis=axis,
        plane=plane,
    )  # fmt: skip
    return Session(folder=file.parent, name=file.name, stacks=(entry,), sensor=sensor)


def _measure(
    kind: str, *, file: Path, roi: str | None, method: str, within: float, quick: bool, seed: int, max_targets: int,
    plane: str | None, axis: str | None, sensor: str | None, annotate: Path | None, as_json: bool, events: bool,
    units: str, pitch_um: float | None, demagnification: float | None, focal_length_mm: float | None,
    black_dn: float | None = None, **target: Any,
) -> None:  # fmt: skip
    """Measure a region of a stack or, without one, all detected targets of a kind, and print the result."""
    with exit_on_bad_input(str(file), as_json=as_json, events=events):
        from charact import mtf
        from charact.method import Context
        from labdata.importers import read_frames
        from labdata.session import MANIFEST

        if (file / MANIFEST).is_file():
            raise BadInput(f"mtf {kind} takes one image or stack, got the session {file}: charact measure {file}")
        then = None
        if annotate is not None:
            from charact.cli.annotate import require_png, write_annotated_image

            require_png(annotate)
        description = _sensor(sensor)
        region = options.parse_region(roi)
        stack = _with_black(read_frames(file, plane=plane, axis=axis), black_dn)
        frequency = _unit(
            description, rows=stack.shape[1], units=units, pitch_um=pitch_um, demagnification=demagnification,
            focal_length_mm=focal_length_mm,
        )  # fmt: skip
        interlaced = description is not None and description.video.interlaced
        with progress_bar(events=events) as progress:
            context = Context(seed=seed, quick=quick, sensor=description, interlaced=interlaced, progress=progress)
            arguments = {"method": method, "within_percent": within, "context": context, **target}
            if region is None:
                result = mtf.measure_all(kind, stack, max_targets=max_targets, **arguments)
            else:
                # The border of the file may have been cropped.
                inside = (region[0] - stack.origin[0], region[1] - stack.origin[1], *region[2:])
                result = mtf.measure(kind, stack, region=inside, **arguments)
        if annotate is not None:
            then = partial(write_annotated_image, stack, result, annotate, frequency)
        print_result(
            in_file_coordinates(result, stack), given=str(file), as_json=as_json, events=events, frequency=frequency,
            next_verb=f"charact import frames {file} mine --kind {kind}, then charact measure mine", then=then,
        )  # fmt: skip


def _with_black(stack: "FrameStack", black_dn: float | None) -> "FrameStack":
    """Return the stack with the given black level, if any."""
    if black_dn is None:
        return stack
    highest = float(stack.data.max())
    if not -math.inf < black_dn < highest:
        raise BadInput(
            f"--black-dn must be below the largest grey value of the frames, {highest:g} DN, got {black_dn:g}"
        )
    return replace(stack, black_level_dn=black_dn)


def _sensor(name: str | None):
    if name is None:
        return None
    from labdata.sensors import load_sensor

    return load_sensor(name)


def _unit(
    sensor: "Sensor | None", *, rows: int, units: str, pitch_um: float | None, demagnification: float | None,
    focal_length_mm: float | None,
) -> FrequencyUnit:  # fmt: skip
    """Return the display unit of frequency; missing lengths come from the sensor description."""
    pitch_y_um = pitch_um
    if sensor is not None:
        if pitch_um is None:
            pitch_um, pitch_y_um = float(sensor.ccd.pitch_x_um), float(sensor.ccd.pitch_y_um)
        if demagnification is None:
            demagnification = float(sensor.taper.demagnification) / float(sensor.tube.magnification)
        if focal_length_mm is None:
            focal_length_mm = float(sensor.optics.focal_length_mm)
    return FrequencyUnit(
        unit=units, pitch_x_um=pitch_um, pitch_y_um=pitch_y_um, rows=rows, focal_length_mm=focal_length_mm,
        demagnification=demagnification,
    )  # fmt: skip
