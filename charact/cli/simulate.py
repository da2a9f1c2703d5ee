"""The verb `simulate`: a scene, a picture of one's own or a radiance cube through a camera, into a session."""

from pathlib import Path
from typing import Annotated

import typer

from charact.cli import options
from charact.cli.output import exit_on_bad_input, print_message, progress_bar

Source = Annotated[
    Path, typer.Argument(help="Scene (.toml, or a name), picture (.tif .png .npy .fits ...) or radiance cube (.npz).")
]
Sensor = Annotated[str, typer.Option("--sensor", help="A shipped camera's name, or a path to a (fitted) TOML.")]
Gain = Annotated[float | None, typer.Option(help="Luminous gain of the tube, lm/lm, or EM gain of an EMCCD.")]
Gate = Annotated[float | None, typer.Option(help="Time the gate is open in an exposure, ns; else all of it.", min=0.0)]
Lux = Annotated[float | None, typer.Option(help="Bench: illuminance on the photocathode, lux; else 1e-4.", min=0.0)]
PerDn = Annotated[
    float | None, typer.Option(help="Picture: mean photoelectrons per pixel and exposure for each DN above black.")
]


def simulate(
    source: Source,
    out: Annotated[Path, typer.Argument(help="Folder of the session of simulated frames.")],
    sensor: Sensor,
    kind: Annotated[
        str | None, typer.Option(help="What it shows: dark, flat, edge, bars, point or scene. Bench: edge; else scene.")
    ] = None,
    frames: Annotated[int, typer.Option(help="Number of frames.", min=1)] = 8,
    seed: options.Seed = 0,
    photoelectrons_per_dn: PerDn = None,
    black_dn: Annotated[float | None, typer.Option(help="Picture: level without light, DN; else 0.")] = None,
    phosphor: Annotated[
        str | None, typer.Option(help="Another screen: p20, p43, p46, p47 or TOML; photons per photoelectron stay.")
    ] = None,
    gain: Gain = None,
    mcp_v: Annotated[float | None, typer.Option(help="Microchannel plate voltage, V; else its nominal one.")] = None,
    gain_control: Annotated[
        float | None, typer.Option(help="Control word of the tube's gain, counts.", min=0.0)
    ] = None,
    automatic_gain: Annotated[bool | None, typer.Option("--automatic-gain", help="Camera's gain control on.")] = None,
    brightness_control: Annotated[
        bool | None, typer.Option("--brightness-control", help="Tube's brightness control on.")
    ] = None,
    gate_ns: Gate = None,
    temperature_c: Annotated[float | None, typer.Option(help="Temperature of the camera, C; else 25.")] = None,
    illuminance_lux: Lux = None,
    frequency: Annotated[float | None, typer.Option(help="Bench, bars: their frequency, cy/px.")] = None,
    pinhole_px: Annotated[
        float | None, typer.Option(help="Bench, point: diameter of the pinhole's image, column pitches.")
    ] = None,
    within: Annotated[
        float, typer.Option(help="What leaving effects out may change together, % of the temporal noise.", min=0.0)
    ] = 10.0,
    exact: Annotated[
        bool, typer.Option("--exact", help="Leave nothing out and draw every pulse by itself (slow).")
    ] = False,
    explain: Annotated[
        bool, typer.Option("--explain", help="Print what each effect can change, and what is left out.")
    ] = False,
    preview: Annotated[
        bool, typer.Option("--preview", help="Scene out of doors: its radiance alone, in seconds; no frames.")
    ] = False,
    stage_images: Annotated[
        Path | None, typer.Option(help="Folder for the image after each stage: float TIFFs and a contact sheet.")
    ] = None,
    events: options.Events = False,
) -> None:
    """Light through a camera, stage by stage, into a session that every measuring verb takes.

    Example: charact simulate bench.toml frames --sensor pulnix-ag5745ef3 --kind edge

    Example: charact simulate airfield night --sensor pulnix-ag5745ef3

    Example: charact simulate house.tif frames --sensor gen3-digital-iccd --photoelectrons-per-dn 0.01
    """
    interrupted = f"interrupted; the frames so far are kept in {out}"
    with (
        exit_on_bad_input(str(source), events=events, interrupted=interrupted),
        progress_bar(events=events) as progress,
    ):
        from charact.cli.simulated_session import preview_into, save_frames, save_stage_images
        from charact.cli.simulation_sources import (
            SimulationRequest,
            beyond_limit,
            conditions_of,
            load_described_camera,
            shot_of,
        )
        from labdata.errors import BadInput
        from labdata.target import Target

        camera = load_described_camera(sensor, phosphor)
        conditions = conditions_of(
            camera,
            gain=gain,
            mcp_v=mcp_v,
            gain_control=gain_control,
            automatic_gain=automatic_gain,
            brightness_control=brightness_control,
            gate_ns=gate_ns,
            temperature_c=temperature_c,
            illuminance_lux=illuminance_lux,
        )
        asked = SimulationRequest(
            source=source,
            kind=None if kind is None else options.parse_kind(kind),
            target=Target(frequency_cy_per_px=frequency, pinhole_px=pinhole_px),
            photoelectrons_per_dn=photoelectrons_per_dn,
            black_dn=black_dn,
            tolerance=None if exact else within / 100.0,
            seed=seed,
        )
        beyond = beyond_limit(camera, conditions)
        for sentence in beyond:
            print_message(sentence, events=events)
        if preview:
            if stage_images is not None:
                raise BadInput("a preview has no stages, got --stage-images")
            for sentence in preview_into(out, asked, camera, conditions, explain=explain):
                print_message(sentence, events=events)
            print(f"{out}/radiance.png: a preview\nNext: charact simulate {source} {out} --sensor {sensor}")
            return
        shot = shot_of(asked, camera, conditions, progress)
        for sentence in () if shot.view is None else shot.view.left_out:
            print_message(sentence, events=events)
        if explain:
            print(shot.explanation)
        notes = (*_not_asked(camera.name, gain, temperature_c), *beyond)
        save_frames(shot, camera, out, frames=frames, seed=seed, notes=notes, progress=progress)
        if stage_images is not None:
            stages = save_stage_images(shot, camera, stage_images, seed=seed)
            print(f"{stage_images}: {stages} stages")
        further = f"{out}/sensor.toml is its camera" if shot.kind == "scene" else f"Next: charact measure {out}"
        print(f"{out}: {frames} frames\n{further}")


def _not_asked(camera: str, gain: float | None, temperature_c: float | None) -> tuple[str, ...]:
    """What a session's notes say of the camera and of what was left to it."""
    asked = () if gain is None else (f"asked for the gain {gain:g}",)
    cold = "no temperature asked for: dark emission and current as described"
    return (f"camera {camera}", *asked, *((cold,) if temperature_c is None else ()))
