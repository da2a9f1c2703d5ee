"""The verbs `mtf edge|bars|point`: the MTF of one image or stack."""

from pathlib import Path
from typing import Annotated, Any

import typer

from charact.cli import options
from charact.cli.output import bad_input_ends, frequency_converter, show
from labdata.errors import BadInput

app = typer.Typer(no_args_is_help=True, help="MTF of one image or stack: a slanted edge, a bar target, a point source.")

File = Annotated[Path, typer.Argument(help="Image or stack: .tif .npy .fits .png .dng")]


@app.command()
def edge(
    file: File,
    roi: options.Roi = None,
    method: options.MethodName = "auto",
    within: options.Within = 2.0,
    quick: options.Quick = False,
    seed: options.Seed = 0,
    plane: options.Plane = None,
    sensor: options.SensorName = None,
    units: options.Units = "cy/px",
    pitch_um: options.PitchUm = None,
    annotate: options.Annotate = None,
    as_json: options.Json = False,
    events: options.Events = False,
) -> None:
    """MTF of a slanted edge.

    Example: charact mtf edge my-edge.tif --roi 100,200,80,60 --annotate edge.png
    """
    _measure("edge", **locals())


@app.command()
def bars(
    file: File,
    frequency: Annotated[float, typer.Option(help="Frequency of the bars, cy/px along the direction across them.")],
    bars: Annotated[int, typer.Option(help="Number of bars.", min=2)] = 4,
    roi: options.Roi = None,
    method: options.MethodName = "auto",
    within: options.Within = 2.0,
    quick: options.Quick = False,
    seed: options.Seed = 0,
    plane: options.Plane = None,
    sensor: options.SensorName = None,
    units: options.Units = "cy/px",
    pitch_um: options.PitchUm = None,
    annotate: options.Annotate = None,
    as_json: options.Json = False,
    events: options.Events = False,
) -> None:
    """MTF at the frequency of a bar target.

    Example: charact mtf bars four-bar.tif --bars 4 --frequency 0.12
    """
    _measure("bars", **locals())


@app.command()
def point(
    file: File,
    pinhole_px: Annotated[
        float | None, typer.Option(help="Diameter of the pinhole's image, column pitches; else taken as a point.")
    ] = None,
    roi: options.Roi = None,
    method: options.MethodName = "auto",
    within: options.Within = 2.0,
    quick: options.Quick = False,
    seed: options.Seed = 0,
    plane: options.Plane = None,
    sensor: options.SensorName = None,
    units: options.Units = "cy/px",
    pitch_um: options.PitchUm = None,
    annotate: options.Annotate = None,
    as_json: options.Json = False,
    events: options.Events = False,
) -> None:
    """MTF of a point source.

    Example: charact mtf point pinhole.tif --pinhole-px 1.0 --roi 200,300,96,96
    """
    _measure("point", **locals())


def _measure(
    kind: str,
    *,
    file: Path,
    roi: str | None,
    method: str,
    within: float,
    quick: bool,
    seed: int,
    plane: str | None,
    sensor: str | None,
    units: str,
    pitch_um: float | None,
    annotate: Path | None,
    as_json: bool,
    events: bool,
    **target: Any,
) -> None:
    with bad_input_ends(str(file), as_json=as_json, events=events):
        from charact import mtf
        from charact.method import Context
        from labdata.importers import read_frames

        known = _sensor(sensor)
        region = options.parsed_region(roi)
        stack = read_frames(file, plane=plane)
        frequency = _frequency(units, pitch_um, known, rows=stack.shape[1])
        context = Context(seed=seed, quick=quick, sensor=known, interlaced=known is not None and known.video.interlaced)
        if kind == "bars":
            target = {"bars": target["bars"], "frequency_cy_per_px": target["frequency"]}
        result = mtf.measure(
            kind, stack, region=region, method=method, within_percent=within, context=context, **target
        )
        if annotate is not None:
            from charact.cli.annotate import annotated

            annotated(stack, result, annotate)
        show(
            result,
            given=str(file),
            as_json=as_json,
            events=events,
            frequency=frequency,
            next_verb=f"charact import frames {file} mine, then charact measure mine",
        )


def _sensor(name: str | None):
    if name is None:
        return None
    from labdata.sensors import load_sensor

    return load_sensor(name)


def _frequency(units: str, pitch_um: float | None, sensor, *, rows: int):
    if pitch_um is not None and pitch_um <= 0:
        raise BadInput(f"--pitch-um must be positive, got {pitch_um:g}")
    focal_length_mm = None if sensor is None else float(sensor.optics.focal_length_mm)
    if pitch_um is None and sensor is not None:
        pitch_um = float(sensor.ccd.pitch_x_um)
    return frequency_converter(units, pitch_um, rows, focal_length_mm)
