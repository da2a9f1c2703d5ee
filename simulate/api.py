"""Simulation of a scene, image or radiance cube through a described camera.

from pathlib import Path
from simulate import SimulationRequest, conditions_of, load_described_camera, save_session, simulate

camera = load_described_camera("pulnix-ag5745ef3")
request = SimulationRequest(source=Path("bench"), kind="flat")
shot = simulate(request, camera, conditions_of(camera))
save_session(shot, camera, Path("frames"), frames=8, seed=0)
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from labdata import BadInput, Camera, Conditions, Kind, Target
from labdata.settings import Progress, ignore_progress
from simulate.camera.scene_to_photoelectrons import (
    camera_from_description,
    photoelectrons_from_image,
    photoelectrons_from_radiance,
)
from simulate.image_source import name_of, read_cube, read_image
from simulate.motion import Look, Motion
from simulate.radiance.scene import LabScene, load_scene
from simulate.shot import InfraredShot, Shot

if TYPE_CHECKING:
    from simulate.infrared_view import InfraredView
    from simulate.outdoor_rendering import OutdoorRendering, RenderedView
    from simulate.radiance.outdoor.scene import OutdoorScene
    from simulate.thermal.temperatures import Temperatures

# Field of a target, and its kind of target.
OF_A_TARGET: dict[str, Kind] = {"frequency_cy_per_px": "bars", "pinhole_px": "point"}


@dataclass(frozen=True, kw_only=True)
class SimulationRequest:
    """Light source of a simulation.

    Parameters
    ----------
    source
        A scene (.toml, or a shipped one's name), a radiance cube (.npz) or an image, as a file or
        array.
    kind
        Kind of the stack; None: edge for a bench scene, else scene.
    target
        Target on the bench.
    photoelectrons_per_dn, black_dn
        Image: mean photoelectrons per pixel as read and exposure for each DN above black, and black
        level (None: 0).
    tolerance
        Error budget of all neglected effects as a fraction of the temporal noise; None: no effect
        is neglected and every pulse is sampled.
    seed
        Seed of the camera rays of an outdoor scene.
    sensor
        Name of the camera in the scene's rig; None: it stands in the place of the scene's camera.
    temperatures
        Surface temperatures of the scene, shared by several sensors; None: computed where a thermal
        imager needs them.
    """

    source: "Path | NDArray[Any]"
    kind: Kind | None = None
    target: Target = field(default_factory=Target)
    photoelectrons_per_dn: float | None = None
    black_dn: float | None = None
    tolerance: float | None = None
    seed: int = 0
    sensor: str | None = None
    temperatures: "Temperatures | None" = None


def simulate(
    request: SimulationRequest,
    description: Camera,
    conditions: Conditions,
    progress: Progress = ignore_progress,
) -> Shot:
    """Return camera and light of a request, without the effects that its tolerance allows to
    neglect.

    Raises
    ------
    BadInput
        If the source cannot be read, or an option does not apply to it.
    """
    if description.is_thermal:
        return _infrared_shot(request, description, conditions, progress)
    if is_scene(request.source):
        _require_no_image_options(request)
        if isinstance(scene := load_scene(request.source), LabScene):
            return _bench_shot(request, scene, description, conditions)
        return _outdoor_shot(request, scene, description, conditions, progress)
    _require_no_bench_options(request, conditions)
    camera = camera_from_description(description)
    if isinstance(request.source, Path) and request.source.suffix == ".npz":
        _require_no_image_options(request)
        source_image, notes = (
            read_cube(request.source),
            (f"spectral radiance of {name_of(request.source)}",),
        )
        _require_dark(request, source_image.radiance)
        photoelectrons = photoelectrons_from_radiance(camera, source_image, conditions)
    else:
        source_image, notes = read_image(
            request.source,
            photoelectrons_per_dn=request.photoelectrons_per_dn,
            black_dn=request.black_dn or 0.0,
            shape=camera.shape,
        )
        _require_dark(request, source_image)
        photoelectrons = photoelectrons_from_image(camera, source_image)
    camera, selection = _select_effects(camera, photoelectrons, conditions, request)
    light, kind = camera.to_mcp_input(photoelectrons, conditions), request.kind or "scene"
    return Shot(
        camera=camera,
        light=light,
        kind=kind,
        conditions=conditions,
        seen=source_image,
        notes=notes,
        **selection,
    )


def _outdoor_shot(
    request: SimulationRequest,
    scene: "OutdoorScene",
    description: Camera,
    conditions: Conditions,
    progress: Progress,
) -> Shot:
    """Return a camera of visible light before an outdoor scene."""
    from simulate.outdoor_rendering import OutdoorRendering

    if request.kind == "dark":
        raise BadInput(f"a dark must have no light, got the scene {scene.name!r}")
    _require_no_bench_options(request, conditions)
    full_camera, temperatures, delay_s = (
        camera_from_description(description),
        request.temperatures,
        _delay_s(request, scene),
    )

    def render(
        scene: "OutdoorScene", seed: int, reference_view: "RenderedView | None" = None
    ) -> "tuple[RenderedView, Any]":
        """Return a view of the scene as it stands, and its photoelectrons."""
        rendering = OutdoorRendering(scene, full_camera, conditions)
        view = _render(rendering, replace(request, seed=seed), progress, reference_view)
        if temperatures is not None:
            temperature_k = temperatures.moved(scene).map_k(rendering.view)
            truth = replace(view.picture.truth, temperature_k=temperature_k)
            view = replace(view, picture=replace(view.picture, truth=truth))
        return view, photoelectrons_from_radiance(full_camera, view.picture.cube, conditions)

    view, photoelectrons = render(scene.at(delay_s).for_sensor(request.sensor), request.seed)
    camera, selection = _select_effects(full_camera, photoelectrons, conditions, request)

    def look(scene: "OutdoorScene", seed: int) -> Look:
        look_view, photoelectrons = render(scene, seed, view)
        return Look(view=look_view, light=camera.to_mcp_input(photoelectrons, conditions))

    return Shot(
        camera=camera,
        light=camera.to_mcp_input(photoelectrons, conditions),
        kind=request.kind or "scene",
        conditions=conditions,
        seen=view.picture.cube,
        notes=(f"scene {scene.name}", *view.notes),
        view=view,
        delay_s=delay_s,
        motion=_motion(scene, request, look),
        **selection,
    )


def _delay_s(request: SimulationRequest, scene: "OutdoorScene") -> float:
    """Return the time by which the first frame of the requested sensor is later than the scene's
    time, s.
    """
    return scene.rig[request.sensor].delay_s if request.sensor in scene.rig else 0.0


def _motion(
    scene: "OutdoorScene", request: SimulationRequest, look: "Callable[[OutdoorScene, int], Look]"
) -> Motion | None:
    """Return the motion of a scene before a camera; None where it has no keyframes."""
    return (
        Motion(scene=scene, sensor=request.sensor, look=look, seed=request.seed)
        if scene.moves
        else None
    )


def _infrared_shot(
    request: SimulationRequest,
    description: Camera,
    conditions: Conditions,
    progress: Progress,
    *,
    preview: bool = False,
) -> InfraredShot:
    """Return a thermal imager before an outdoor scene; another source is BadInput."""
    from simulate.camera.thermal_imager import ThermalImager
    from simulate.infrared_view import view_infrared
    from simulate.thermal.temperatures import temperatures_of

    scene = _outdoor_scene(request, "a thermal imager needs")
    _require_no_image_options(request)
    _require_no_bench_options(request, conditions)
    if request.kind not in (None, "scene"):
        raise BadInput(f"kind of an outdoor scene must be scene, got {request.kind}")
    progress("surface temperatures", 0.0)
    temperatures, delay_s = (
        request.temperatures or temperatures_of(scene, seed=request.seed),
        _delay_s(request, scene),
    )

    def view(
        scene: "OutdoorScene", camera: ThermalImager, seed: int, is_set: bool
    ) -> "InfraredView":
        return view_infrared(
            scene,
            camera,
            temperatures.moved(scene),
            tolerance=request.tolerance,
            seed=seed,
            preview=preview,
            is_set=is_set,
            progress=lambda fraction: progress("infrared light", fraction),
        )

    first_view = view(
        scene.at(delay_s).for_sensor(request.sensor),
        ThermalImager(description),
        request.seed,
        False,
    )

    def look(scene: "OutdoorScene", seed: int) -> Look:
        look_view = view(scene, first_view.camera, seed, True)
        return Look(view=look_view, light=look_view.signal)

    return InfraredShot(
        camera=first_view.camera,
        light=first_view.signal,
        kind="scene",
        conditions=conditions,
        seen=first_view,
        notes=(f"scene {scene.name}", *first_view.notes),
        view=first_view,
        exact=True,
        delay_s=delay_s,
        motion=_motion(scene, request, look),
    )


def simulate_rig(
    request: SimulationRequest,
    sensors: "Mapping[str, tuple[Camera, Conditions]]",
    progress: Progress = ignore_progress,
) -> dict[str, Shot]:
    """Return camera and light of each sensor of a rig before one outdoor scene, which share its
    surface temperatures.

    Parameters
    ----------
    request
        Scene and options for all of them.
    sensors
        Description and conditions by the names that the scene's rig and the session use.
    """
    from simulate.thermal.temperatures import temperatures_of

    scene = _outdoor_scene(request, "several sensors need")
    if any(description.is_thermal for description, _ in sensors.values()):
        progress("surface temperatures", 0.0)
        request = replace(request, temperatures=temperatures_of(scene, seed=request.seed))
    return {
        name: simulate(
            replace(request, sensor=name),
            *camera,
            lambda sentence, fraction, sensor_name=name: progress(
                f"{sensor_name}: {sentence}", fraction
            ),
        )
        for name, camera in sensors.items()
    }


def is_scene(source: "Path | NDArray[Any]") -> TypeGuard[Path]:
    """Whether a source is a scene file or the name of a shipped scene."""
    if not isinstance(source, Path):
        return False
    return source.suffix == ".toml" or (not source.suffix and not source.is_file())


def _outdoor_scene(request: SimulationRequest, requirement: str) -> "OutdoorScene":
    """Return the outdoor scene of a request; another source is BadInput, which begins with
    the requirement.
    """
    from simulate.radiance.outdoor.scene import OutdoorScene

    scene = load_scene(request.source) if is_scene(request.source) else None
    if not isinstance(scene, OutdoorScene):
        raise BadInput(f"{requirement} an outdoor scene, got {name_of(request.source)}")
    return scene


def preview(
    request: SimulationRequest, description: Camera, conditions: Conditions
) -> "RenderedView | InfraredView":
    """Return an outdoor scene in few pixels of a camera; another source raises BadInput."""
    if description.is_thermal:
        return _infrared_shot(request, description, conditions, ignore_progress, preview=True).seen
    from simulate.outdoor_rendering import OutdoorRendering

    scene = _outdoor_scene(request, "a preview needs")
    _require_no_image_options(request)
    _require_no_bench_options(request, conditions)
    posed_scene = scene.at(_delay_s(request, scene)).for_sensor(request.sensor)
    rendering = OutdoorRendering(posed_scene, camera_from_description(description), conditions)
    return rendering.render(tolerance=request.tolerance, seed=request.seed, preview=True)


def _render(
    view: "OutdoorRendering",
    request: SimulationRequest,
    progress: Progress,
    reference_view: "RenderedView | None",
) -> "RenderedView":
    """Render an outdoor scene; a rendering of more than a minute announces its time."""
    sentence = "light"

    def announce(seconds: float) -> None:
        nonlocal sentence
        sentence = f"light, about {seconds / 60.0:.0f} min" if seconds > 60.0 else "light"
        progress(sentence, 0.0)

    return view.render(
        tolerance=request.tolerance,
        seed=request.seed,
        like=reference_view,
        progress=lambda fraction: progress(sentence, fraction),
        announce=announce,
    )


def _bench_shot(
    request: SimulationRequest, scene: Any, description: Camera, conditions: Conditions
) -> Shot:
    from simulate.lab import LabBench
    from simulate.radiance.lab_target import as_stood

    if description.is_thermal:
        raise BadInput(f"a bench scene needs a camera of visible light, got {description.name!r}")
    kind, lux = request.kind or "edge", conditions.illuminance_lux
    for name, target_kind in OF_A_TARGET.items():
        value = getattr(request.target, name)
        if kind == target_kind and value is None:
            raise BadInput(f"kind {kind} of a bench scene needs {name}, got none")
        if kind != target_kind and value is not None:
            raise BadInput(
                f"{name} is only for kind {target_kind} of a bench scene, got it with kind {kind}"
            )
    if kind == "dark" and lux:
        raise BadInput(f"a dark must have no light, got illuminance_lux {lux:g}")
    target = as_stood(kind, request.target)
    if lux is None:
        if kind != "dark" and not description.has_tube:
            raise BadInput(
                f"a bench scene before {description.name!r} needs illuminance_lux at its chip, "
                "got none"
            )
        conditions = replace(conditions, illuminance_lux=0.0 if kind == "dark" else 1e-4)
    bench = LabBench(description, scene)
    _, selection = _select_effects(
        bench.camera, bench.photoelectrons(kind, target, conditions), conditions, request
    )
    if "plan" in selection:
        bench = bench.without(selection["plan"].names)
    light = bench.mcp_input(kind, target, conditions)
    return Shot(
        camera=bench.camera,
        light=light,
        kind=kind,
        conditions=conditions,
        target=target,
        **selection,
    )


def _require_no_bench_options(request: SimulationRequest, conditions: Conditions) -> None:
    if conditions.illuminance_lux is not None:
        raise BadInput("illuminance_lux is only for bench scenes")
    for name, kind in OF_A_TARGET.items():
        if getattr(request.target, name) is not None:
            source = name_of(request.source)
            raise BadInput(f"{name} is only for kind {kind} of a bench scene, got it with {source}")


def _require_no_image_options(request: SimulationRequest) -> None:
    for name in ("photoelectrons_per_dn", "black_dn"):
        if getattr(request, name) is not None:
            raise BadInput(f"{name} is only for an image, got it with {name_of(request.source)}")


def _require_dark(request: SimulationRequest, source_image: NDArray[np.floating]) -> None:
    """Raise BadInput if the kind is dark and the source has light."""
    if request.kind == "dark" and (lit := float((source_image > 0.0).mean())):
        raise BadInput(
            f"a dark must have no light, got it on {100.0 * lit:.3g} % of {name_of(request.source)}"
        )


def _select_effects(
    camera: Any, photoelectrons: Any, conditions: Conditions, request: SimulationRequest
) -> tuple[Any, dict[str, Any]]:
    """Return the camera without the effects that this light does not need, and the fields of the
    shot.
    """
    from simulate.camera.effect_bounds import (
        NoiseBudget,
        bound_effects,
        select_camera_effects,
    )
    from simulate.effect_selection import EffectSelection

    if not camera.has_tube:
        return camera, {"exact": request.tolerance is None}
    if request.tolerance is None:
        effects = bound_effects(
            NoiseBudget(camera, camera.photoelectrons_per_pixel(photoelectrons), conditions)
        )
        return camera, {
            "exact": True,
            "plan": EffectSelection(tolerance=0.0, kept=tuple(effects), left_out=()),
        }
    camera, plan = select_camera_effects(camera, photoelectrons, conditions, request.tolerance)
    return camera, {"exact": False, "plan": plan}
