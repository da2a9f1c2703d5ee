"""The verb `simulate`: frames of a scene, image or radiance cube."""

from pathlib import Path
from typing import Annotated

import typer

from charact.cli import options
from charact.cli.output import exit_on_bad_input, print_message, progress_bar

Source = Annotated[
    Path, typer.Argument(help="Scene (.toml, or a name), image (.tif .png .npy .fits ...) or radiance cube (.npz).")
]
Sensor = Annotated[str, typer.Option("--sensor", help="Name of a shipped sensor description, or path to a TOML file.")]
Gain = Annotated[float | None, typer.Option(help="Luminous gain of the tube, lm/lm, or EM gain of an EMCCD.")]
Gate = Annotated[float | None, typer.Option(help="Gate time per exposure, ns (default: whole exposure).", min=0.0)]
Lux = Annotated[float | None, typer.Option(help="Bench: photocathode illuminance, lx (default: 1e-4).", min=0.0)]
PerDn = Annotated[
    float | None, typer.Option(help="Image input: mean photoelectrons per pixel and exposure for each DN above black.")
]


def simulate(
    source: Source,
    out: Annotated[Path, typer.Argument(help="Output session folder.")],
    sensor: Sensor,
    kind: Annotated[
        str | None,
        typer.Option(
            help="Target kind: dark, flat, edge, bars, point or scene (default: edge on a bench, otherwise scene)."
        ),
    ] = None,
    frames: Annotated[int, typer.Option(help="Number of frames.", min=1)] = 8,
    seed: options.Seed = 0,
    photoelectrons_per_dn: PerDn = None,
    black_dn: Annotated[float | None, typer.Option(help="Black level of the input image, DN (default: 0).")] = None,
    phosphor: Annotated[
        str | None,
        typer.Option(help="Phosphor: p20, p43, p46, p47 or a TOML file; total light per photoelectron is unchanged."),
    ] = None,
    gain: Gain = None,
    mcp_v: Annotated[float | None, typer.Option(help="MCP voltage, V (default: nominal).")] = None,
    gain_control: Annotated[float | None, typer.Option(help="Tube gain control word, counts.", min=0.0)] = None,
    automatic_gain: Annotated[
        bool | None, typer.Option("--automatic-gain", help="Enable the camera's automatic gain control (AGC).")
    ] = None,
    brightness_control: Annotated[
        bool | None, typer.Option("--brightness-control", help="Enable the tube's automatic brightness control (ABC).")
    ] = None,
    gate_ns: Gate = None,
    temperature_c: Annotated[float | None, typer.Option(help="Camera temperature, °C (default: 25).")] = None,
    illuminance_lux: Lux = None,
    frequency: Annotated[float | None, typer.Option(help="Bench, bars: frequency, cy/px.")] = None,
    pinhole_px: Annotated[float | None, typer.Option(help="Bench, point: pinhole image diameter, px.")] = None,
    error_budget: Annotated[
        float, typer.Option(help="Error budget for neglected effects, percent of the temporal noise.", min=0.0)
    ] = 10.0,
    exact: Annotated[
        bool, typer.Option("--exact", help="Neglect no effect and sample every photoelectron pulse (slow).")
    ] = False,
    explain: Annotated[
        bool, typer.Option("--explain", help="Print the bound on each effect and which effects are neglected.")
    ] = False,
    preview: Annotated[
        bool, typer.Option("--preview", help="Outdoor scene: render the radiance only, no frames.")
    ] = False,
    stage_images: Annotated[
        Path | None, typer.Option(help="Folder for the image after each stage: float TIFF files and a contact sheet.")
    ] = None,
    events: options.Events = False,
) -> None:
    """Simulate frames of a scene, image or radiance cube and store them as a session.

    Example: charact simulate bench.toml frames --sensor pulnix-ag5745ef3 --kind edge

    Example: charact simulate airfield night --sensor pulnix-ag5745ef3

    Example: charact simulate house.tif frames --sensor gen3-digital-iccd --photoelectrons-per-dn 0.01
    """
    interrupted = f"interrupted; frames simulated so far are kept in {out}"
    with (
        exit_on_bad_input(str(source), events=events, interrupted=interrupted),
        progress_bar(events=events) as progress,
    ):
        from charact.cli.image_figures import save_radiance, save_stages
        from labdata.errors import BadInput
        from labdata.target import Target
        from simulate import api

        camera = api.load_described_camera(sensor, phosphor)
        conditions = api.conditions_of(
            camera, gain=gain, mcp_v=mcp_v, gain_control=gain_control, automatic_gain=automatic_gain,
            brightness_control=brightness_control, gate_ns=gate_ns, temperature_c=temperature_c,
            illuminance_lux=illuminance_lux,
        )  # fmt: skip
        request = api.SimulationRequest(
            source=source,
            kind=None if kind is None else options.parse_kind(kind),
            target=Target(frequency_cy_per_px=frequency, pinhole_px=pinhole_px),
            photoelectrons_per_dn=photoelectrons_per_dn,
            black_dn=black_dn,
            tolerance=None if exact else error_budget / 100.0,
            seed=seed,
        )
        beyond = api.voltage_limit_warnings(camera, conditions)
        for sentence in beyond:
            print_message(sentence, events=events)
        if preview:
            if stage_images is not None:
                raise BadInput("--preview has no stages, got --stage-images")
            rendering = api.outdoor_view(request, camera, conditions)
            view = rendering.render(tolerance=request.tolerance, seed=seed, preview=True)
            if explain:
                print(view.plan.text())
            save_radiance(view.picture.cube, view.title, out / "radiance.png")
            api.save_view(view, out)
            for sentence in view.left_out:
                print_message(sentence, events=events)
            print(f"{out}/radiance.png: a preview\nNext: charact simulate {source} {out} --sensor {sensor}")
            return
        shot = api.simulate(request, camera, conditions, progress)
        for sentence in () if shot.view is None else shot.view.left_out:
            print_message(sentence, events=events)
        if explain:
            print(shot.explanation)
        notes = [f"camera {camera.name}"]
        notes += [] if gain is None else [f"requested gain {gain:g}"]
        notes += ["temperature not given: EBI and dark current as described"] if temperature_c is None else []
        api.save_session(shot, camera, out, frames=frames, seed=seed, notes=(*notes, *beyond), progress=progress)
        if shot.view is not None:
            save_radiance(shot.view.picture.cube, shot.view.title, out / "radiance.png")
        if stage_images is not None:
            title = f"{camera.name}, one frame through the chain, seed {seed}"
            stages = save_stages(shot.stages(seed=seed), stage_images, title)
            print(f"{stage_images}: {stages} stages")
        further = f"{out}/sensor.toml is its camera" if shot.kind == "scene" else f"Next: charact measure {out}"
        print(f"{out}: {frames} frames\n{further}")
