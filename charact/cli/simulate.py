"""The verb `simulate`: frames of a scene, image or radiance cube."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from charact.cli.options import Events
from charact.cli.output import exit_on_bad_input, print_message, progress_bar
from charact.cli.outputs import Force, remove_session, require_free_session
from labdata.settings import Seed

if TYPE_CHECKING:
    from labdata.camera.description import Camera
    from labdata.conditions import Conditions
    from simulate.api import SimulationRequest
    from simulate.shot import Shot

Source = Annotated[
    Path,
    typer.Argument(
        help="Scene (.toml, or a name), image (.tif .png .npy .fits ...) or radiance cube (.npz)."
    ),
]
Sensors = Annotated[
    list[str],
    typer.Option(
        "--sensor",
        help="Name of a shipped sensor description, or path to a TOML file; several for a rig.",
    ),
]
Gain = Annotated[
    float | None, typer.Option(help="Luminous gain of the tube, lm/lm, or EM gain of an EMCCD.")
]
Gate = Annotated[
    float | None,
    typer.Option(help="Gate time per exposure, ns (default: whole exposure).", min=0.0),
]
Lux = Annotated[
    float | None, typer.Option(help="Bench: photocathode illuminance, lx (default: 1e-4).", min=0.0)
]
PerDn = Annotated[
    float | None,
    typer.Option(
        help="Image input: mean photoelectrons per pixel and exposure for each DN above black."
    ),
]


def simulate(
    source: Source,
    out: Annotated[Path, typer.Argument(help="Output session folder.")],
    sensor: Sensors,
    kind: Annotated[
        str | None,
        typer.Option(
            help=(
                "Target kind: dark, flat, edge, bars, point or scene (default: edge on a bench, "
                "otherwise scene)."
            )
        ),
    ] = None,
    frames: Annotated[int, typer.Option(help="Number of frames of each sensor.", min=1)] = 8,
    seed: Seed = 0,
    photoelectrons_per_dn: PerDn = None,
    black_dn: Annotated[
        float | None, typer.Option(help="Black level of the input image, DN (default: 0).")
    ] = None,
    phosphor: Annotated[
        str | None,
        typer.Option(
            help=(
                "Phosphor: p20, p43, p46, p47 or a TOML file; total light per photoelectron is "
                "unchanged."
            )
        ),
    ] = None,
    gain: Gain = None,
    mcp_v: Annotated[float | None, typer.Option(help="MCP voltage, V (default: nominal).")] = None,
    gain_control: Annotated[
        float | None, typer.Option(help="Tube gain control word, counts.", min=0.0)
    ] = None,
    automatic_gain: Annotated[
        bool | None,
        typer.Option("--automatic-gain", help="Enable the camera's automatic gain control (AGC)."),
    ] = None,
    brightness_control: Annotated[
        bool | None,
        typer.Option(
            "--brightness-control", help="Enable the tube's automatic brightness control (ABC)."
        ),
    ] = None,
    gate_ns: Gate = None,
    temperature_c: Annotated[
        float | None, typer.Option(help="Camera temperature, °C (default: 25).")
    ] = None,
    illuminance_lux: Lux = None,
    frequency: Annotated[float | None, typer.Option(help="Bench, bars: frequency, cy/px.")] = None,
    pinhole_px: Annotated[
        float | None, typer.Option(help="Bench, point: pinhole image diameter, px.")
    ] = None,
    error_budget: Annotated[
        float,
        typer.Option(
            help="Error budget for neglected effects, percent of the temporal noise.", min=0.0
        ),
    ] = 10.0,
    exact: Annotated[
        bool,
        typer.Option(
            "--exact", help="Neglect no effect and sample every photoelectron pulse (slow)."
        ),
    ] = False,
    explain: Annotated[
        bool,
        typer.Option(
            "--explain", help="Print the bound on each effect and which effects are neglected."
        ),
    ] = False,
    preview: Annotated[
        bool, typer.Option("--preview", help="Outdoor scene: render the radiance only, no frames.")
    ] = False,
    stage_images: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the image after each stage: float TIFF files and a contact sheet."
        ),
    ] = None,
    radiance: Annotated[
        str | None,
        typer.Option(
            help="Outdoor scene: write radiance/NAME with bands and geometry: npz, fits, envi, exr."
        ),
    ] = None,
    force: Force = False,
    events: Events = False,
) -> None:
    """Simulate frames of a scene, image or radiance cube and store them as a session.

    Example: charact simulate bench.toml frames --sensor pulnix-ag5745ef3 --kind edge

    Example: charact simulate airfield night --sensor pulnix-ag5745ef3

    Example: charact simulate hangar night --sensor pulnix-ag5745ef3 --sensor scanning-lwir

    Example: charact simulate house.tif frames --sensor gen3-digital-iccd --photoelectrons-per-dn
    0.01
    """
    interrupted = f"interrupted; frames simulated so far are kept in {out}"
    with (
        exit_on_bad_input(str(source), events=events, interrupted=interrupted),
        progress_bar(events=events) as progress,
    ):
        require_free_session(out, "simulation", force=force, sources=(source, *map(Path, sensor)))
        from labdata.target import Target, kind_of
        from simulate import api

        _require_radiance_format(radiance)
        given = {
            "gain": gain,
            "mcp_v": mcp_v,
            "gain_control": gain_control,
            "automatic_gain": automatic_gain,
            "brightness_control": brightness_control,
            "gate_ns": gate_ns,
            "temperature_c": temperature_c,
            "illuminance_lux": illuminance_lux,
        }
        rig = _set_cameras(_load_cameras(sensor, phosphor), given, events)
        request = api.SimulationRequest(
            source=source,
            kind=None if kind is None else kind_of(kind),
            target=Target(frequency_cy_per_px=frequency, pinhole_px=pinhole_px),
            photoelectrons_per_dn=photoelectrons_per_dn,
            black_dn=black_dn,
            tolerance=None if exact else error_budget / 100.0,
            seed=seed,
            sensor=next(iter(rig)),
        )
        if preview:
            _save_previews(
                request, rig, out, stage_images, force=force, explain=explain, events=events
            )
            print(
                f"Next: charact simulate {source} {out} "
                f"{' '.join(f'--sensor {name}' for name in sensor)}"
            )
            return
        shots = _simulate(request, rig, progress)
        for shot in shots.values():
            for sentence in () if shot.view is None else shot.view.left_out:
                print_message(sentence, events=events)
            if explain:
                print(shot.explanation)
        if force:
            remove_session(out, "simulation")
        _save_frames(shots, rig, out, frames, seed, progress)
        _save_light(shots, out, radiance)
        if stage_images is not None:
            _save_stages(shots, rig, stage_images, seed)
        print("\n".join(_summary(shots, out, frames)))


@dataclass(frozen=True, kw_only=True)
class _Sensor:
    """A camera of the rig with its settings and the notes of its stack."""

    description: "Camera"
    conditions: "Conditions"
    notes: tuple[str, ...]


def _require_radiance_format(form: str | None) -> None:
    """Raise BadInput unless a format of radiance is known or None."""
    from labdata.errors import BadInput
    from simulate.radiance_files import FORMATS

    if form is not None and form not in FORMATS:
        raise BadInput(f"--radiance must be one of {', '.join(FORMATS)}, got {form!r}")


def _load_cameras(sensors: list[str], phosphor: str | None) -> "dict[str, Camera]":
    """Return the descriptions of the sensors by the stems of their names; equal ones raise
    BadInput.
    """
    from labdata.errors import BadInput
    from simulate import load_described_camera

    names = [Path(name).stem for name in sensors]
    if repeated := {name for name in names if names.count(name) > 1}:
        raise BadInput(f"sensors of one rig must have different names, got {min(repeated)!r} twice")
    return dict(
        zip(names, (load_described_camera(name, phosphor) for name in sensors), strict=True)
    )


def _set_cameras(
    cameras: "dict[str, Camera]", given: dict[str, Any], events: bool
) -> dict[str, _Sensor]:
    """Return the cameras with the options `given`; with visible ones a thermal imager takes
    none.
    """
    from simulate import conditions_of, voltage_limit_warnings

    visible, found = not all(camera.is_thermal for camera in cameras.values()), {}
    for name, camera in cameras.items():
        conditions = conditions_of(camera, **({} if camera.is_thermal and visible else given))
        beyond = voltage_limit_warnings(camera, conditions)
        for sentence in beyond:
            print_message(sentence, events=events)
        notes = [f"camera {camera.name}"]
        if not camera.is_thermal:
            notes += [] if given["gain"] is None else [f"requested gain {given['gain']:g}"]
            unknown = given["temperature_c"] is None
            notes += ["temperature not given: EBI and dark current as described"] if unknown else []
        found[name] = _Sensor(description=camera, conditions=conditions, notes=(*notes, *beyond))
    return found


def _save_previews(
    request: "SimulationRequest",
    rig: dict[str, _Sensor],
    out: Path,
    stage_images: Path | None,
    *,
    force: bool,
    explain: bool,
    events: bool,
) -> None:
    """Render an outdoor scene in few pixels for each sensor and write the pictures."""
    from labdata.errors import BadInput
    from simulate import api, session_files

    if stage_images is not None:
        raise BadInput("--preview has no stages, got --stage-images")
    views = {
        name: api.preview(replace(request, sensor=name), sensor.description, sensor.conditions)
        for name, sensor in rig.items()
    }
    if force:
        remove_session(out, "simulation")
    for name, view in views.items():
        if explain:
            print(view.text())
        folder = out if len(rig) == 1 else out / name
        session_files.save_view(view, folder)
        _save_pictures(view, folder / "radiance.png")
        for sentence in view.left_out:
            print_message(sentence, events=events)
        print(f"{folder}/radiance.png: a preview")


def _simulate(
    request: "SimulationRequest", rig: dict[str, _Sensor], progress: Callable[[str, float], None]
) -> "dict[str, Shot]":
    """Return the cameras with their light, by the names of the sensors."""
    from simulate import api

    if len(rig) == 1:
        ((name, only),) = rig.items()
        return {name: api.simulate(request, only.description, only.conditions, progress)}
    cameras = {name: (sensor.description, sensor.conditions) for name, sensor in rig.items()}
    return api.simulate_rig(request, cameras, progress)


def _save_frames(
    shots: "dict[str, Shot]",
    rig: dict[str, _Sensor],
    out: Path,
    frames: int,
    seed: int,
    progress: Callable[[str, float], None],
) -> None:
    """Simulate the frames of all sensors and store them as one session."""
    from simulate import session_files

    shared: dict[str, Any] = {"frames": frames, "seed": seed, "progress": progress}
    if len(rig) == 1:
        ((name, only),) = rig.items()
        session_files.save_session(shots[name], only.description, out, notes=only.notes, **shared)
        return
    descriptions = {name: sensor.description for name, sensor in rig.items()}
    notes = {name: sensor.notes for name, sensor in rig.items()}
    session_files.save_rig_session(shots, descriptions, out, notes=notes, **shared)


def _summary(shots: "dict[str, Shot]", out: Path, frames: int) -> tuple[str, str]:
    """Return the lines that name what was written and what comes next."""
    if len(shots) > 1:
        return (
            f"{out}: {frames} frames each of {', '.join(shots)}",
            f"{out}/sensor has their descriptions",
        )
    (shot,) = shots.values()
    further = (
        f"{out}/sensor.toml is its camera"
        if shot.kind == "scene"
        else f"Next: charact measure {out}"
    )
    return f"{out}: {frames} frames", further


def _save_light(shots: "dict[str, Shot]", out: Path, form: str | None) -> None:
    """Write the picture of each sensor's light, and where asked its radiance as numbers."""
    from labdata.errors import BadInput
    from simulate.radiance_files import FORMATS, save_view_radiance

    for name, shot in shots.items():
        if shot.view is None:
            if form is not None:
                raise BadInput("--radiance needs an outdoor scene, got another source")
            continue
        _save_pictures(
            shot.view, out / "radiance.png" if len(shots) == 1 else out / "radiance" / f"{name}.png"
        )
        if form is not None:
            save_view_radiance(shot.view, out / "radiance" / f"{name}{FORMATS[form]}")


def _save_pictures(view: Any, path: Path) -> None:
    """Draw the light of a view: radiance, or of an infrared one apparent temperature."""
    from charact.cli.image_figures import save_apparent_temperature, save_radiance

    if hasattr(view.picture, "apparent_k"):
        across, down = view.viewpoint.focal_px
        save_apparent_temperature(view.picture.apparent_k(), view.title, path, across / down)
    else:
        save_radiance(view.picture.cube, view.title, path)


def _save_stages(
    shots: "dict[str, Shot]", rig: dict[str, _Sensor], folder: Path, seed: int
) -> None:
    """Write the images after each stage of each sensor."""
    from charact.cli.image_figures import save_stages

    for name, shot in shots.items():
        own = folder if len(shots) == 1 else folder / name
        title = f"{rig[name].description.name}, one frame through the chain, seed {seed}"
        print(f"{own}: {save_stages(shot.stages(seed=seed), own, title)} stages")
