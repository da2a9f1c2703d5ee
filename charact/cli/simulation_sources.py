"""Simulation request: a scene, image or radiance cube, a camera and its conditions."""

import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.limits import TubeLimits
from labdata.sensor import Sensor
from labdata.session import Kind
from labdata.solid_state import SolidStateCamera
from labdata.target import Target

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from labdata.sensor import Sensor
    from labdata.solid_state import SolidStateCamera
    from simulate.effect_selection import EffectSelection
    from simulate.outdoor_rendering import OutdoorRendering, RenderedView
    from simulate.radiance.outdoor.scene import OutdoorScene
    from simulate.radiance.scene import LabScene

    Description = Sensor | SolidStateCamera

Progress = Callable[[str, float], None]
# Field of a target: its option and its kind of target.
OF_A_TARGET: dict[str, tuple[str, Kind]] = {
    "frequency_cy_per_px": ("--frequency", "bars"),
    "pinhole_px": ("--pinhole-px", "point"),
}


@dataclass(frozen=True, kw_only=True)
class SimulationRequest:
    """Light source of a simulation.

    Parameters
    ----------
    source
        A scene (.toml, or a shipped one's name), a radiance cube (.npz) or an image.
    kind
        Kind of the stack; None: edge for a bench scene, else scene.
    target
        Target on the bench.
    photoelectrons_per_dn
        Scale of an image, see `charact.cli.image_source`.
    black_dn
        Black level of an image, DN; None: 0.
    tolerance
        Error budget of all neglected effects as a fraction of the temporal noise; None: no effect is neglected and
        every pulse is sampled.
    seed
        Seed of the camera rays of an outdoor scene.
    """

    source: Path
    kind: Kind | None = None
    target: Target = field(default_factory=Target)
    photoelectrons_per_dn: float | None = None
    black_dn: float | None = None
    tolerance: float | None = None
    seed: int = 0


@dataclass(frozen=True, kw_only=True)
class Shot:
    """A camera, its light and the metadata of the session.

    Parameters
    ----------
    camera
        The simulated camera.
    light
        Expected photoelectrons at the MCP, or in the sensor of a camera without tube.
    kind, conditions, target, notes
        Metadata of the stack.
    seen
        Input of the camera: an image in photoelectrons, a radiance cube, or None.
    plan
        Effect selection; None for a camera without tube, where all effects are retained.
    exact
        Whether every pulse is sampled.
    view
        Rendering of an outdoor scene: radiance, effect selection and auxiliary layers.
    """

    camera: Any
    light: Any
    kind: Kind
    conditions: Conditions
    seen: Any = None
    target: Target = field(default_factory=Target)
    notes: tuple[str, ...] = ()
    plan: "EffectSelection | None" = None
    exact: bool = False
    view: "RenderedView | None" = None

    def frames(self, *, seed: int) -> "Iterator[Any]":
        """Yield frames without end."""
        threads = min(2, os.cpu_count() or 1)
        return self.camera.frames(self.light, self.conditions, seed=seed, exact=self.exact, threads=threads)

    @property
    def explanation(self) -> str:
        """Text of retained and neglected effects of light and camera with their bounds."""
        light = () if self.view is None else (self.view.plan.text(), "")
        camera = "camera without tube: all effects are retained" if self.plan is None else self.plan.text()
        return "\n".join((*light, camera))


def load_described_camera(sensor: str, phosphor: str | None) -> "Description":
    """Return the sensor description of a camera, with another phosphor if one is given."""
    from labdata.phosphors import load_phosphor
    from labdata.sensors import load_camera
    from labdata.solid_state import SolidStateCamera

    camera = load_camera(sensor)
    if phosphor is None:
        return camera
    if isinstance(camera, SolidStateCamera):
        raise BadInput(f"--phosphor needs a camera with a tube, got {camera.name!r}")
    return camera.with_phosphor(load_phosphor(phosphor))


def shot_of(
    request: SimulationRequest,
    description: "Description",
    conditions: Conditions,
    progress: Progress = lambda sentence, share: None,
) -> Shot:
    """Return camera and light of a request; rendering an outdoor scene reports its progress."""
    if is_scene(request.source):
        return _of_scene(request, description, conditions, progress)
    _require_no_bench_options(request, conditions)
    if request.source.suffix == ".npz":
        return _of_cube(request, description, conditions)
    return _of_picture(request, description, conditions)


def is_scene(source: Path) -> bool:
    """Whether a source is a scene file or the name of a shipped scene."""
    return source.suffix == ".toml" or (not source.suffix and not source.is_file())


def _require_no_bench_options(request: SimulationRequest, conditions: Conditions) -> None:
    if conditions.illuminance_lux is not None:
        raise BadInput("--illuminance-lux is only for bench scenes")
    for name, (option, kind) in OF_A_TARGET.items():
        if getattr(request.target, name) is not None:
            raise BadInput(f"{option} is only for --kind {kind} of a bench scene, got it with {request.source.name}")


def _with_bench_light(conditions: Conditions, kind: Kind) -> Conditions:
    """Return the conditions with the illuminance of the bench, 0 for a dark."""
    lux = conditions.illuminance_lux
    if kind == "dark" and lux:
        raise BadInput(f"a dark must have no light, got --illuminance-lux {lux:g}")
    # Default illuminance of the bench, lux.
    unasked = 0.0 if kind == "dark" else 1e-4
    return replace(conditions, illuminance_lux=unasked if lux is None else lux)


def _require_matching_target(target: Target, kind: Kind) -> None:
    """Raise BadInput if a target lacks a field of its kind or has one of another kind."""
    for name, (option, of) in OF_A_TARGET.items():
        value = getattr(target, name)
        if kind == of and value is None:
            raise BadInput(f"--kind {kind} of a bench scene needs {option}, got none")
        if kind != of and value is not None:
            raise BadInput(f"{option} is only for --kind {of} of a bench scene, got it with --kind {kind}")


def _require_dark(request: SimulationRequest, seen: "NDArray[np.floating]") -> None:
    """Raise BadInput if --kind is dark and the source has light."""
    if request.kind == "dark" and (lit := float((seen > 0.0).mean())):
        raise BadInput(f"a dark must have no light, got it on {100.0 * lit:.3g} % of {request.source.name}")


def _of_scene(
    request: SimulationRequest, description: "Description", conditions: Conditions, progress: Progress
) -> Shot:
    from simulate.radiance.scene import LabScene, load_scene

    _require_no_image_options(request)
    scene = load_scene(request.source)
    if isinstance(scene, LabScene):
        return _of_bench(request, scene, description, conditions)
    return _of_night(request, scene, description, conditions, progress)


def night_of(request: SimulationRequest, description: "Description", conditions: Conditions) -> "OutdoorRendering":
    """Return the outdoor scene of a request with its camera; another source raises BadInput."""
    from simulate.iiccd.scene_to_photoelectrons import camera_from_description
    from simulate.outdoor_rendering import OutdoorRendering
    from simulate.radiance.outdoor.scene import OutdoorScene
    from simulate.radiance.scene import load_scene

    scene = load_scene(request.source) if is_scene(request.source) else None
    if not isinstance(scene, OutdoorScene):
        raise BadInput(f"--preview needs an outdoor scene, got {request.source.name}")
    _require_no_image_options(request)
    _require_no_bench_options(request, conditions)
    return OutdoorRendering(scene, camera_from_description(description), conditions)


def _of_night(
    request: SimulationRequest,
    scene: "OutdoorScene",
    description: "Description",
    conditions: Conditions,
    progress: Progress,
) -> Shot:
    from simulate.iiccd.scene_to_photoelectrons import camera_from_description, photoelectrons_from_radiance
    from simulate.outdoor_rendering import OutdoorRendering

    _require_no_bench_options(request, conditions)
    if request.kind == "dark":
        raise BadInput(f"a dark must have no light, got the scene {scene.name!r}")
    camera = camera_from_description(description)
    sentence = "light"

    def announce(seconds: float) -> None:
        nonlocal sentence
        # A rendering that takes longer announces its time, s.
        sentence = f"light, about {seconds / 60.0:.0f} min" if seconds > 60.0 else "light"
        progress(sentence, 0.0)

    view = OutdoorRendering(scene, camera, conditions).render(
        tolerance=request.tolerance,
        seed=request.seed,
        progress=lambda share: progress(sentence, share),
        announce=announce,
    )
    cube = view.picture.cube
    photoelectrons = photoelectrons_from_radiance(camera, cube, conditions)
    camera, planned = _select_effects(camera, photoelectrons, conditions, request)
    light, kind = camera.to_mcp_input(photoelectrons, conditions), request.kind or "scene"
    notes = (f"scene {scene.name}", *view.notes)
    return Shot(
        camera=camera, light=light, kind=kind, conditions=conditions, seen=cube, notes=notes, view=view, **planned
    )


def _of_bench(
    request: SimulationRequest, scene: "LabScene", description: "Description", conditions: Conditions
) -> Shot:
    from labdata.sensor import Sensor
    from simulate.lab import LabBench
    from simulate.radiance.target_mesh import as_stood

    if not isinstance(description, Sensor):
        raise BadInput(f"a bench scene needs a camera with a tube, got {description.name!r}")
    kind = request.kind or "edge"
    _require_matching_target(request.target, kind)
    target = as_stood(kind, request.target)
    conditions, bench = _with_bench_light(conditions, kind), LabBench(description, scene)
    _, planned = _select_effects(bench.camera, bench.photoelectrons(kind, target, conditions), conditions, request)
    bench = bench.without(planned["plan"].names)
    light = bench.mcp_input(kind, target, conditions)
    return Shot(camera=bench.camera, light=light, kind=kind, conditions=conditions, target=target, **planned)


def _select_effects(
    camera: Any, photoelectrons: Any, conditions: Conditions, request: SimulationRequest
) -> tuple[Any, dict[str, Any]]:
    """Return the camera without the effects that this light does not need, and the fields of the shot."""
    from simulate.effect_selection import EffectSelection
    from simulate.iiccd.effect_bounds import NoiseBudget, bound_effects, per_pixel, select_camera_effects

    exact = request.tolerance is None
    if not camera.has_tube:
        return camera, {"exact": exact}
    if request.tolerance is None:
        effects = bound_effects(NoiseBudget(camera, per_pixel(camera, photoelectrons), conditions))
        return camera, {"exact": True, "plan": EffectSelection(tolerance=0.0, kept=tuple(effects), left_out=())}
    camera, plan = select_camera_effects(camera, photoelectrons, conditions, request.tolerance)
    return camera, {"exact": False, "plan": plan}


def _of_picture(request: SimulationRequest, description: "Description", conditions: Conditions) -> Shot:
    from charact.cli.image_source import photoelectrons_of
    from simulate.iiccd.scene_to_photoelectrons import camera_from_description, photoelectrons_from_image

    camera = camera_from_description(description)
    image, notes = photoelectrons_of(
        request.source,
        photoelectrons_per_dn=request.photoelectrons_per_dn,
        black_dn=request.black_dn or 0.0,
        shape=camera.shape,
    )
    _require_dark(request, image)
    photoelectrons = photoelectrons_from_image(camera, image)
    camera, planned = _select_effects(camera, photoelectrons, conditions, request)
    light, kind = camera.to_mcp_input(photoelectrons, conditions), request.kind or "scene"
    return Shot(camera=camera, light=light, kind=kind, conditions=conditions, seen=image, notes=notes, **planned)


def _of_cube(request: SimulationRequest, description: "Description", conditions: Conditions) -> Shot:
    from charact.cli.image_source import cube_of
    from simulate.iiccd.scene_to_photoelectrons import camera_from_description, photoelectrons_from_radiance

    _require_no_image_options(request)
    camera = camera_from_description(description)
    cube = cube_of(request.source)
    _require_dark(request, cube.radiance)
    photoelectrons = photoelectrons_from_radiance(camera, cube, conditions)
    camera, planned = _select_effects(camera, photoelectrons, conditions, request)
    light, kind = camera.to_mcp_input(photoelectrons, conditions), request.kind or "scene"
    notes = (f"spectral radiance of {request.source.name}",)
    return Shot(camera=camera, light=light, kind=kind, conditions=conditions, seen=cube, notes=notes, **planned)


def _require_no_image_options(request: SimulationRequest) -> None:
    for option, value in (("--photoelectrons-per-dn", request.photoelectrons_per_dn), ("--black-dn", request.black_dn)):
        if value is not None:
            raise BadInput(f"{option} is only for an image, got it with {request.source.name}")


# Options of a tube, by the name of their condition.
_OF_A_TUBE = {
    "mcp_v": "--mcp-v",
    "gain_control": "--gain-control",
    "gate_ns": "--gate-ns",
    "brightness_control": "--brightness-control",
}


def conditions_of(camera: Sensor | SolidStateCamera, *, gain: float | None = None, **options: Any) -> Conditions:
    """Return the conditions of the options; others have their nominal values.

    Parameters
    ----------
    camera
        The description.
    gain
        Luminous gain of the tube, lm/lm, or multiplication of an electron-multiplying register.
    options
        Conditions by name; None: option not given.

    Raises
    ------
    BadInput
        If an option does not apply to the camera or conflicts with another one.
    """
    given = {name: value for name, value in options.items() if value is not None}
    if gain is not None and not (math.isfinite(gain) and gain > 0.0):
        raise BadInput(f"--gain must be positive, got {gain:g}")
    exposure_s = 1.0 / float(camera.video.field_rate_hz)
    if given.get("automatic_gain") and not camera.video.automatic_gain:
        raise BadInput(f"--automatic-gain needs a camera that has it, got {camera.name!r}")
    if isinstance(camera, SolidStateCamera):
        return Conditions(exposure_s=exposure_s, em_gain=_em_gain(camera, gain), **_without_tube(camera, given))
    if len(ways := [name for name in ("mcp_v", "gain_control") if name in given] + ["gain"] * (gain is not None)) > 1:
        raise BadInput(f"the gain must be set once, got {' and '.join('--' + way.replace('_', '-') for way in ways)}")
    nominal = {"gate_ns": exposure_s * 1e9, **({} if ways else {"mcp_v": voltage_of(camera, None)})}
    set_by_gain = {} if gain is None else {"mcp_v": voltage_of(camera, gain)}
    return Conditions(exposure_s=exposure_s, **{**nominal, **set_by_gain, **given})


def voltage_limit_warnings(camera: Sensor | SolidStateCamera, conditions: Conditions) -> tuple[str, ...]:
    """Return a warning if the MCP voltage exceeds the limit of the description, which the bench would refuse."""
    mcp_v = conditions.mcp_v
    if isinstance(camera, SolidStateCamera) or mcp_v is None:
        return ()
    limit = camera.limits.mcp_v
    if limit == TubeLimits().mcp_v or mcp_v <= float(limit):
        return ()
    return (f"mcp_v of {mcp_v:.4g} exceeds the limit {float(limit):g} of {camera.name!r}: its bench would refuse it",)


def voltage_of(sensor: Sensor, luminous_gain: float | None) -> float:
    """Return the MCP voltage for a luminous gain, V = V0 (G/G0)^(1/m); None: the reference voltage."""
    mcp = sensor.microchannel_plate
    if luminous_gain is None:
        return float(mcp.reference_v)
    if not float(mcp.gain_exponent) > 0.0:
        raise BadInput(f"--gain needs a tube with a positive gain exponent, got 0 in {sensor.name!r}")
    return float(mcp.reference_v) * (luminous_gain / float(sensor.tube.luminous_gain)) ** (
        1.0 / float(mcp.gain_exponent)
    )


def _em_gain(camera: SolidStateCamera, gain: float | None) -> float:
    most = float(camera.register.em_gain)
    if gain is not None and not 1.0 <= gain <= most:
        raise BadInput(f"--gain of {camera.name!r} must lie between 1 and {most:g}, got {gain:g}")
    return most if gain is None else gain


def _without_tube(camera: SolidStateCamera, given: dict[str, Any]) -> dict[str, Any]:
    if unfit := [option for name, option in _OF_A_TUBE.items() if name in given]:
        raise BadInput(f"{unfit[0]} needs a camera with a tube, got {camera.name!r}")
    return given
