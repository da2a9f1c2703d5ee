"""The verbs `simulate`, frames of a scene, image or radiance cube, and `temperatures`, of its
surfaces.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from charact.cli.options import Events, Json
from charact.cli.output import exit_on_bad_input, print_message, print_result, progress_bar
from charact.cli.outputs import Force, remove_session, require_free, require_free_session
from labdata.settings import OfType, SceneCamera, Seed, Setting, WithinMk

if TYPE_CHECKING:
    from labdata import Camera, Conditions
    from simulate.api import SimulationRequest
    from simulate.shot import Shot
    from simulate.surface_temperatures import SurfaceTemperatures

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
Gain = Annotated[float | None, Setting("Luminous gain of the tube, lm/lm, or EM gain of an EMCCD.")]
Gate = Annotated[
    float | None,
    Setting("Gate time per exposure, ns (default: whole exposure).", minimum=0.0),
]
Lux = Annotated[
    float | None, Setting("Bench: photocathode illuminance, lx (default: 1e-4).", minimum=0.0)
]
PerDn = Annotated[
    float | None,
    Setting("Image input: mean photoelectrons per pixel and exposure for each DN above black."),
]


def simulate(
    source: Source,
    out: Annotated[Path, typer.Argument(help="Output session folder.")],
    sensor: Sensors,
    kind: Annotated[
        str | None,
        Setting(
            "Target kind: dark, flat, edge, bars, point or scene (default: edge on a bench, "
            "otherwise scene)."
        ),
    ] = None,
    frames: Annotated[int, Setting("Number of frames of each sensor.", minimum=1)] = 8,
    seed: Seed = 0,
    photoelectrons_per_dn: PerDn = None,
    black_dn: Annotated[
        float | None, Setting("Black level of the input image, DN (default: 0).")
    ] = None,
    phosphor: Annotated[
        str | None,
        Setting(
            "Phosphor: p20, p43, p46, p47 or a TOML file; total light per photoelectron is "
            "unchanged."
        ),
    ] = None,
    gain: Gain = None,
    mcp_v: Annotated[float | None, Setting("MCP voltage, V (default: nominal).")] = None,
    gain_control: Annotated[
        float | None, Setting("Tube gain control word, counts.", minimum=0.0)
    ] = None,
    automatic_gain: Annotated[
        bool | None,
        Setting("Enable the camera's automatic gain control (AGC)."),
    ] = None,
    brightness_control: Annotated[
        bool | None,
        Setting("Enable the tube's automatic brightness control (ABC)."),
    ] = None,
    gate_ns: Gate = None,
    temperature_c: Annotated[float | None, Setting("Camera temperature, °C (default: 25).")] = None,
    illuminance_lux: Lux = None,
    frequency: Annotated[float | None, Setting("Bench, bars: frequency, cy/px.")] = None,
    pinhole_px: Annotated[
        float | None, Setting("Bench, point: pinhole image diameter, px.")
    ] = None,
    error_budget: Annotated[
        float,
        Setting("Error budget for neglected effects, percent of the temporal noise.", minimum=0.0),
    ] = 10.0,
    exact: Annotated[
        bool,
        Setting("Neglect no effect and sample every photoelectron pulse (slow)."),
    ] = False,
    explain: Annotated[
        bool,
        Setting("Print the bound on each effect and which effects are neglected."),
    ] = False,
    preview: Annotated[
        bool, Setting("Outdoor scene: render the radiance only, no frames.")
    ] = False,
    stage_images: Annotated[
        Path | None,
        Setting("Folder for the image after each stage: float TIFF files and a contact sheet."),
    ] = None,
    radiance: Annotated[
        str | None,
        Setting(
            "Outdoor scene: write radiance/NAME with bands and geometry: npz, fits, envi, exr."
        ),
    ] = None,
    of_type: OfType = False,
    force: Force = False,
    events: Events = False,
) -> None:
    """Simulate frames of a scene, image or radiance cube and store them as a session.

    Example: charact simulate bench frames --sensor pulnix-ag5745ef3 --kind edge

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
        cameras = _load_cameras(sensor, phosphor)
        if of_type:
            cameras = {name: replace(camera, maps=None) for name, camera in cameras.items()}
        rig = _set_cameras(cameras, given, events)
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
    from charact.cli.figures import save_apparent_temperature, save_radiance

    if hasattr(view.picture, "apparent_k"):
        across, down = view.viewpoint.focal_px
        save_apparent_temperature(view.picture.apparent_k(), view.title, path, across / down)
    else:
        save_radiance(view.picture.cube, view.title, path)


def _save_stages(
    shots: "dict[str, Shot]", rig: dict[str, _Sensor], folder: Path, seed: int
) -> None:
    """Write the images after each stage of each sensor."""
    from charact.cli.figures import save_stages

    for name, shot in shots.items():
        own = folder if len(shots) == 1 else folder / name
        title = f"{rig[name].description.name}, one frame through the chain, seed {seed}"
        print(f"{own}: {save_stages(shot.stages(seed=seed), own, title)} stages")


def temperatures(
    scene: Annotated[
        Path, typer.Argument(help="Outdoor scene (.toml, or name of a shipped scene).")
    ],
    out: Annotated[Path, typer.Argument(help="New folder for tables and figures.")],
    sensor: SceneCamera = "pulnix-ag5745ef3",
    within_mk: WithinMk = 20.0,
    seed: Seed = 0,
    force: Force = False,
    explain: Annotated[
        bool, Setting("Print the bound on each term and which terms are neglected.")
    ] = False,
    as_json: Json = False,
    events: Events = False,
) -> None:
    """Compute surface temperatures of a scene over the day before its time, and their map at its
    time.

    Example: charact temperatures hangar warm --explain
    """
    with (
        exit_on_bad_input(str(scene), as_json=as_json, events=events),
        progress_bar(events=events) as progress,
    ):
        taken = out.exists() and (not out.is_dir() or any(out.iterdir()))
        other = (
            None
            if (out / "temperatures.json").is_file()
            else "something without a temperatures.json"
        )
        require_free(out, force=force, taken=taken, kept=lambda: other)
        import simulate
        from charact.cli.figures import save_png, temperature_curves, temperature_map

        warm = simulate.temperatures(
            scene, sensor=sensor, within_mk=within_mk, seed=seed, progress=progress
        )
        for note in warm.notes:
            print_message(note, events=events)
        if explain:
            print("\n".join(_terms(warm, within_mk)), file=sys.stderr if as_json else sys.stdout)
        title = f"{warm.scene}, {warm.moment.isoformat(sep=' ', timespec='minutes')}"
        warm.save(out)
        save_png(temperature_curves(warm, title), out / "temperatures.png")
        save_png(temperature_map(warm.map_k, title), out / "map.png")
        if as_json:
            print_result(warm, given=str(scene), verb="temperatures", as_json=True, events=events)
            return
        print("\n".join(_last_row(warm)))
        print(
            f"{out}: temperatures.csv, temperatures.png, map.png, map.npz (kelvin), "
            f"temperatures.json (numbers used)"
        )


def _last_row(warm: "SurfaceTemperatures") -> list[str]:
    """Return lines on surfaces at the scene's time, the warmest first, with 95 % intervals."""
    from charact.reporting.summary import LINES

    count = LINES - 10
    ordered = sorted(warm.measurements, key=lambda m: -(m.value or 0.0))
    lines = [f"{'surface at the scene time':44}  {'mean, C':>8}  {'95 %':>6}"]
    for m in ordered[:count]:
        low, high = m.interval95 or (0.0, 0.0)
        lines.append(f"{m.stack or '':44}  {m.value:8.1f}  ±{0.5 * (high - low):5.1f}")
    more = len(ordered) - count
    return [*lines, *([f"and {more} more in temperatures.csv"] if more > 0 else [])]


def _terms(warm: "SurfaceTemperatures", within_mk: float) -> list[str]:
    """Return lines on retained and neglected terms."""
    lines = [f"{'term':58}  {'changes at most, mK':>20}"]
    for term in sorted(warm.terms, key=lambda term: (not term.kept, -term.changes_mk)):
        verdict = "kept" if term.kept else "left out"
        lines.append(f"{term.name:58}  {term.changes_mk:20.3g}  {verdict}")
    together = sum(term.changes_mk for term in warm.terms if not term.kept)
    lines.append(f"left out together: at most {together:.3g} mK; each may have {within_mk:g} mK")
    lines.append(f"{'uncertain input':58}  {'1 sd, at most, mK':>20}")
    largest = sorted(warm.input_errors_mk.items(), key=lambda error: -error[1])
    return [*lines, *(f"{name:58}  {size:20.3g}" for name, size in largest)]
