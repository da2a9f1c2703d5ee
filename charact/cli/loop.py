"""The verbs `demo` and `simulate`: the whole loop on the virtual bench, and frames of a scene through a sensor."""

from pathlib import Path
from typing import Annotated

import typer

from charact.cli import options
from charact.cli.output import bad_input_ends


def add_to(app: typer.Typer) -> None:
    """Add the verbs to the command."""
    app.command()(demo)
    app.command()(simulate)


def demo(
    out: Annotated[Path, typer.Argument(help="Folder for the session, the fitted sensor and the report.")] = Path(
        "demo"
    ),
    quick: Annotated[bool, typer.Option("--quick", help="Fewer frames and no Markov chains.")] = False,
    seed: Annotated[
        int | None, typer.Option(help="Seed of the specimen and of all noise; else from the clock.")
    ] = None,
    events: options.Events = False,
) -> None:
    """The whole loop on the virtual bench: acquire, characterize, fit, simulate, validate, report.

    Example: charact demo
    """
    with bad_input_ends(str(out), events=events):
        from charact.cli.demonstration import demonstrate

        if not demonstrate(out, quick=quick, seed=seed, events=events):
            raise typer.Exit(1)


def simulate(
    scene: Annotated[Path, typer.Argument(help="Scene, TOML.")],
    out: Annotated[Path, typer.Argument(help="Folder of the session of simulated frames.")],
    sensor: Annotated[str, typer.Option("--sensor", help="A shipped sensor's name, or a path to a (fitted) TOML.")],
    kind: Annotated[str, typer.Option(help="Target before the camera: dark, flat, edge, bars or point.")] = "edge",
    illuminance_lux: Annotated[float, typer.Option(help="Illuminance on the photocathode, lux.", min=0.0)] = 1e-4,
    mcp_v: Annotated[float | None, typer.Option(help="Microchannel plate voltage, V; else its nominal one.")] = None,
    gate_ns: Annotated[float, typer.Option(help="Time the gate is open in a field, ns.", min=0.0)] = 1.6e7,
    frequency: Annotated[float | None, typer.Option(help="Frequency of bars, cy/px.")] = None,
    frames: Annotated[int, typer.Option(help="Number of frames.", min=1)] = 8,
    seed: options.Seed = 0,
    events: options.Events = False,
) -> None:
    """Radiance of a scene, then frames of it, into a session that every measuring verb takes.

    Example: charact simulate lab.toml frames --sensor pulnix-ag5745ef3 --kind edge
    """
    with bad_input_ends(str(scene), events=events):
        from charact.cli.simulating import simulated
        from labdata.conditions import Conditions
        from labdata.target import Target

        conditions = Conditions(illuminance_lux=illuminance_lux, mcp_v=mcp_v, gate_ns=gate_ns)
        target = Target(frequency_cy_per_px=frequency)
        shown = options.parsed_kind(kind)
        simulated(scene, out, sensor=sensor, kind=shown, target=target, conditions=conditions, frames=frames, seed=seed)
        print(f"{out}: {frames} frames\nNext: charact measure {out}")
