"""The verbs `mtf edge|bars|point|flats`: the MTF of one image or stack, or of flat fields."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from charact.cli import options
from charact.cli.output import Progress, exit_on_bad_input, print_result, progress_bar
from labdata.errors import BadInput

if TYPE_CHECKING:
    from charact.cli.output import FrequencyUnit
    from charact.mtf.mean_frame import Region
    from labdata.frames import FrameStack
    from labdata.measurement import Result
    from labdata.sensor import Sensor
    from labdata.session import Session

app = typer.Typer(
    no_args_is_help=True,
    help="Measure the MTF from a slanted edge, bar target, point source or flat-field noise.",
)

File = Annotated[Path, typer.Argument(help="Image or stack: .tif .npy .fits .png .jpg .dng .h5 ... (docs/formats.md)")]


@app.command()
def edge(
    file: File,
    roi: options.Roi = None,
    method: options.MethodName = "auto",
    within: options.Within = 2.0,
    quick: options.Quick = False,
    seed: options.Seed = 0,
    plane: options.Plane = None,
    axis: options.Axis = None,
    black_dn: options.BlackDn = None,
    sensor: options.SensorName = None,
    units: options.Units = "cy/px",
    pitch_um: options.PitchUm = None,
    demagnification: options.Demagnification = None,
    focal_length_mm: options.FocalLengthMm = None,
    at_most: options.AtMost = 24,
    annotate: options.Annotate = None,
    as_json: options.Json = False,
    events: options.Events = False,
) -> None:
    """Measure the MTF of a slanted edge.

    Example: charact mtf edge my-edge.tif --roi 100,200,80,60 --annotate edge.png
    """
    _measure("edge", **locals())


@app.command()
def bars(
    file: File,
    frequency: Annotated[
        float | None,
        typer.Option(help="Bar frequency, cy/px (default: groups along rows and columns are found)."),
    ] = None,
    bars: Annotated[int | None, typer.Option(help="Number of bars (default: counted in the image).", min=2)] = None,
    roi: options.Roi = None,
    method: options.MethodName = "auto",
    within: options.Within = 2.0,
    quick: options.Quick = False,
    seed: options.Seed = 0,
    plane: options.Plane = None,
    axis: options.Axis = None,
    black_dn: options.BlackDn = None,
    sensor: options.SensorName = None,
    units: options.Units = "cy/px",
    pitch_um: options.PitchUm = None,
    demagnification: options.Demagnification = None,
    focal_length_mm: options.FocalLengthMm = None,
    at_most: options.AtMost = 24,
    annotate: options.Annotate = None,
    as_json: options.Json = False,
    events: options.Events = False,
) -> None:
    """Measure the MTF at the frequency of a bar target.

    Example: charact mtf bars usaf.tif --roi 100,200,80,60
    """
    _measure("bars", **locals())


@app.command()
def point(
    file: File,
    pinhole_px: Annotated[
        float | None, typer.Option(help="Diameter of the pinhole's image, px (default: ideal point).")
    ] = None,
    roi: options.Roi = None,
    method: options.MethodName = "auto",
    within: options.Within = 2.0,
    quick: options.Quick = False,
    seed: options.Seed = 0,
    plane: options.Plane = None,
    axis: options.Axis = None,
    sensor: options.SensorName = None,
    units: options.Units = "cy/px",
    pitch_um: options.PitchUm = None,
    demagnification: options.Demagnification = None,
    focal_length_mm: options.FocalLengthMm = None,
    at_most: options.AtMost = 24,
    annotate: options.Annotate = None,
    as_json: options.Json = False,
    events: options.Events = False,
) -> None:
    """Measure the MTF of a point source.

    Example: charact mtf point pinhole.tif --pinhole-px 1.0 --roi 200,300,96,96
    """
    _measure("point", **locals())


@app.command()
def flats(
    file: Annotated[Path, typer.Argument(help="Folder of a session with flats and darks, or one stack of flats.")],
    plane: options.Plane = None,
    axis: options.Axis = None,
    method: options.MethodName = "auto",
    within: options.Within = 2.0,
    quick: options.Quick = False,
    seed: options.Seed = 0,
    sensor: options.SensorName = None,
    units: options.Units = "cy/px",
    pitch_um: options.PitchUm = None,
    demagnification: options.Demagnification = None,
    focal_length_mm: options.FocalLengthMm = None,
    as_json: options.Json = False,
    events: options.Events = False,
) -> None:
    """Measure the post-gain MTF from the noise power spectrum of flat fields (no target needed).

    Example: charact mtf flats my-session --quick
    """
    with exit_on_bad_input(str(file), as_json=as_json, events=events):
        from charact import mtf
        from charact.session_measurement import method_context

        session = _flats_of(file, _sensor(sensor), plane, axis)
        rows = session.of_kind("flat")[0].read().shape[1] if session.of_kind("flat") else 0
        frequency = _unit(units, pitch_um, demagnification, focal_length_mm, session.sensor, rows=rows)
        with progress_bar(events=events) as progress:
            context = method_context(session, quick=quick, seed=seed, progress=progress)
            result = mtf.measure_flats(session, method=method, within_percent=within, context=context)
        print_result(
            result,
            given=str(file),
            as_json=as_json,
            events=events,
            frequency=frequency,
            next_verb="charact mtf edge FILE: the MTF of the complete camera with lens and proximity gap",
        )


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
    kind: str,
    *,
    file: Path,
    plane: str | None,
    axis: str | None,
    sensor: str | None,
    units: str,
    pitch_um: float | None,
    demagnification: float | None,
    focal_length_mm: float | None,
    annotate: Path | None,
    as_json: bool,
    events: bool,
    black_dn: float | None = None,
    **settings: Any,
) -> None:
    with exit_on_bad_input(str(file), as_json=as_json, events=events):
        from charact.cli.single_image import in_file_coordinates, region_in
        from labdata.importers import read_frames

        _require_frames(file, kind)
        if annotate is not None:
            from charact.cli.annotate import require_png, write_annotated_image

            require_png(annotate)
        description = _sensor(sensor)
        region = options.parse_region(settings.pop("roi"))
        stack = _with_black(read_frames(file, plane=plane, axis=axis), black_dn)
        frequency = _unit(units, pitch_um, demagnification, focal_length_mm, description, rows=stack.shape[1])
        with progress_bar(events=events) as progress:
            result = _result(kind, stack, region_in(stack, region), description, progress, **settings)
        print_result(
            in_file_coordinates(result, stack),
            given=str(file),
            as_json=as_json,
            events=events,
            frequency=frequency,
            next_verb=f"charact import frames {file} mine --kind {kind}, then charact measure mine",
            then=None if annotate is None else lambda: write_annotated_image(stack, result, annotate, frequency),
        )


def _require_frames(file: Path, kind: str) -> None:
    """Reject a session folder and point to `charact measure`."""
    from labdata.session import MANIFEST

    if (file / MANIFEST).is_file():
        raise BadInput(f"mtf {kind} takes one image or stack, got the session {file}: charact measure {file}")


def _result(
    kind: str,
    stack: "FrameStack",
    region: "Region | None",
    sensor: "Sensor | None",
    progress: Progress,
    *,
    method: str,
    within: float,
    quick: bool,
    seed: int,
    at_most: int,
    **target: Any,
) -> "Result":
    """Measure a region of a stack or, without one, all detected targets of this kind."""
    from charact import mtf
    from charact.method import Context

    context = Context(
        seed=seed,
        quick=quick,
        sensor=sensor,
        interlaced=sensor is not None and sensor.video.interlaced,
        progress=progress,
    )
    if kind == "bars":
        target = {"bars": target["bars"], "frequency_cy_per_px": target["frequency"]}
    arguments = {"method": method, "within_percent": within, "context": context, **target}
    if region is None:
        return mtf.measure_all(kind, stack, at_most=at_most, **arguments)
    return mtf.measure(kind, stack, region=region, **arguments)


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
    units: str,
    pitch_um: float | None,
    demagnification: float | None,
    focal_length_mm: float | None,
    sensor: "Sensor | None",
    *,
    rows: int,
) -> "FrequencyUnit":
    """Return the display unit of frequency; missing lengths come from the sensor description."""
    from charact.cli.output import FrequencyUnit

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
