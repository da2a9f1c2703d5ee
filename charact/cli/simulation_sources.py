"""What is to be simulated: a scene, a picture or a radiance cube before a camera, ready to be drawn."""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.session import Kind
from labdata.target import Target

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from labdata.sensor import Sensor
    from labdata.solid_state import SolidStateCamera
    from simulate.effect_selection import EffectSelection
    from simulate.outdoor_rendering import OutdoorRendering, RenderedView
    from simulate.radiance.outdoor.description.scene import OutdoorScene
    from simulate.radiance.scene import LabScene

    Description = Sensor | SolidStateCamera

Progress = Callable[[str, float], None]
# Light that takes longer than this says so before it begins, s.
LONG_S = 60.0
# What a target states -> its option, and the kind of target that it belongs to.
OF_A_TARGET: dict[str, tuple[str, Kind]] = {
    "frequency_cy_per_px": ("--frequency", "bars"),
    "pinhole_px": ("--pinhole-px", "point"),
}
# Illuminance of the bench where none is asked for, lux.
BENCH_LUX = 1e-4


@dataclass(frozen=True, kw_only=True)
class SimulationRequest:
    """What goes before the camera.

    Parameters
    ----------
    source
        A scene (.toml, or a shipped one's name), a radiance cube (.npz) or a picture.
    kind
        What the stack is said to show; None: an edge of a bench scene, else a scene.
    target
        Target on the bench.
    photoelectrons_per_dn
        Scale of a picture, see `charact.cli.image_source`.
    black_dn
        Level of the picture that stands for no light, DN; None: 0.
    tolerance
        What effects left out may change together, as a share of the temporal noise; None: nothing is left out and every
        pulse is drawn by itself.
    seed
        Seed of the rays of a scene out of doors.
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
    """A camera, the light that reaches it, and what is known of both.

    Parameters
    ----------
    camera
        The simulated camera.
    light
        Expected photoelectrons at the plate, or in the chip of a camera without a tube.
    kind, conditions, target, notes
        As the session records them.
    seen
        What went before the light that the camera draws from: a picture in photoelectrons, a radiance cube, or None.
    plan
        What of the camera this light does not need; None for a camera without a tube, of which all is kept.
    exact
        Whether every pulse is drawn by itself.
    view
        What a scene out of doors showed: radiance, its plan and the truth of each pixel.
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
        """Yield its frames, without end."""
        from simulate.iiccd import sampler_choice
        from simulate.iiccd.camera import IntensifiedCamera

        if not isinstance(self.camera, IntensifiedCamera):
            return self.camera.frames(self.light, self.conditions, seed=seed)
        tier, threads = (
            sampler_choice.most_exact_tier(self.camera, self.light) if self.exact else None,
            min(2, os.cpu_count() or 1),
        )
        return sampler_choice.generate_frames(
            self.camera, self.light, self.conditions, seed=seed, tier=tier, threads=threads
        )

    @property
    def explanation(self) -> str:
        """What light and camera leave out, and what each effect can change."""
        light = () if self.view is None else (self.view.plan.text(), "")
        camera = "a camera without a tube: every stage is kept" if self.plan is None else self.plan.text()
        return "\n".join((*light, camera))


def load_described_camera(sensor: str, phosphor: str | None) -> "Description":
    """Return the description of a camera, with another screen if one is asked for."""
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
    asked: SimulationRequest,
    description: "Description",
    conditions: Conditions,
    progress: Progress = lambda sentence, share: None,
) -> Shot:
    """Return the light of a source on a camera; rendering a scene out of doors tells its progress."""
    if is_scene(asked.source):
        return _of_scene(asked, description, conditions, progress)
    _no_bench(asked, conditions)
    if asked.source.suffix == ".npz":
        return _of_cube(asked, description, conditions)
    return _of_picture(asked, description, conditions)


def is_scene(source: Path) -> bool:
    """Whether a source is a scene's file or the name of a shipped one."""
    return source.suffix == ".toml" or (not source.suffix and not source.is_file())


def _no_bench(asked: SimulationRequest, conditions: Conditions) -> None:
    if conditions.illuminance_lux is not None:
        raise BadInput("--illuminance-lux belongs to a bench scene; a picture or a radiance cube brings its own light")
    for name, (option, kind) in OF_A_TARGET.items():
        if getattr(asked.target, name) is not None:
            raise BadInput(f"{option} belongs to the {kind} of a bench scene, got it with {asked.source.name}")


def _with_bench_light(conditions: Conditions, kind: Kind) -> Conditions:
    """Return the conditions with the bench's light, of which a dark has none."""
    lux = conditions.illuminance_lux
    if kind == "dark" and lux:
        raise BadInput(f"a dark must have no light, got --illuminance-lux {lux:g}")
    unasked = 0.0 if kind == "dark" else BENCH_LUX
    return replace(conditions, illuminance_lux=unasked if lux is None else lux)


def _require_matching_target(target: Target, kind: Kind) -> None:
    """Refuse a target that lacks what its kind needs, or states what belongs to another."""
    for name, (option, of) in OF_A_TARGET.items():
        value = getattr(target, name)
        if kind == of and value is None:
            raise BadInput(f"--kind {kind} of a bench scene needs {option}, got none")
        if kind != of and value is not None:
            raise BadInput(f"{option} belongs to the {of} of a bench scene, got it with --kind {kind}")


def _require_dark(asked: SimulationRequest, seen: "NDArray[np.floating]") -> None:
    """Refuse to call dark what has light."""
    if asked.kind == "dark" and (lit := float((seen > 0.0).mean())):
        raise BadInput(f"a dark must have no light, got it on {100.0 * lit:.3g} % of {asked.source.name}")


def _of_scene(asked: SimulationRequest, description: "Description", conditions: Conditions, progress: Progress) -> Shot:
    from simulate.radiance.scene import LabScene, load_scene

    _no_picture(asked)
    scene = load_scene(asked.source)
    if isinstance(scene, LabScene):
        return _of_bench(asked, scene, description, conditions)
    return _of_night(asked, scene, description, conditions, progress)


def night_of(asked: SimulationRequest, description: "Description", conditions: Conditions) -> "OutdoorRendering":
    """Return the scene out of doors that a source is, before its camera; another kind of source is refused."""
    from simulate.iiccd.scene_to_photoelectrons import camera_from_description
    from simulate.outdoor_rendering import OutdoorRendering
    from simulate.radiance.outdoor.description.scene import OutdoorScene
    from simulate.radiance.scene import load_scene

    scene = load_scene(asked.source) if is_scene(asked.source) else None
    if not isinstance(scene, OutdoorScene):
        raise BadInput(f"a preview shows a scene with a camera in it, got {asked.source.name}")
    _no_picture(asked)
    _no_bench(asked, conditions)
    return OutdoorRendering(scene, camera_from_description(description), conditions)


def _of_night(
    asked: SimulationRequest,
    scene: "OutdoorScene",
    description: "Description",
    conditions: Conditions,
    progress: Progress,
) -> Shot:
    from simulate.iiccd.scene_to_photoelectrons import camera_from_description, photoelectrons_from_radiance
    from simulate.outdoor_rendering import OutdoorRendering

    _no_bench(asked, conditions)
    if asked.kind == "dark":
        raise BadInput(f"a dark must have no light, got the scene {scene.name!r}")
    camera = camera_from_description(description)
    sentence = "light"

    def announce(seconds: float) -> None:
        nonlocal sentence
        sentence = f"light, about {seconds / 60.0:.0f} min" if seconds > LONG_S else "light"
        progress(sentence, 0.0)

    view = OutdoorRendering(scene, camera, conditions).render(
        tolerance=asked.tolerance,
        seed=asked.seed,
        progress=lambda share: progress(sentence, share),
        announce=announce,
    )
    cube = view.picture.cube
    freed = photoelectrons_from_radiance(camera, cube, conditions)
    camera, planned = _select_effects(camera, freed, conditions, asked)
    light, kind = camera.to_mcp_input(freed, conditions), asked.kind or "scene"
    notes = (f"scene {scene.name}", *view.notes)
    return Shot(
        camera=camera, light=light, kind=kind, conditions=conditions, seen=cube, notes=notes, view=view, **planned
    )


def _of_bench(asked: SimulationRequest, scene: "LabScene", description: "Description", conditions: Conditions) -> Shot:
    from labdata.sensor import Sensor
    from simulate.lab import LabBench
    from simulate.radiance.target_mesh import as_stood

    if not isinstance(description, Sensor):
        raise BadInput(f"a bench scene needs a camera with a tube, got {description.name!r}")
    kind = asked.kind or "edge"
    _require_matching_target(asked.target, kind)
    target = as_stood(kind, asked.target)
    conditions, bench = _with_bench_light(conditions, kind), LabBench(description, scene)
    _, planned = _select_effects(bench.camera, bench.photoelectrons(kind, target, conditions), conditions, asked)
    bench = bench.without(planned["plan"].names)
    light = bench.mcp_input(kind, target, conditions)
    return Shot(camera=bench.camera, light=light, kind=kind, conditions=conditions, target=target, **planned)


def _select_effects(
    camera: Any, freed: Any, conditions: Conditions, asked: SimulationRequest
) -> tuple[Any, dict[str, Any]]:
    """Return the camera without what this light does not need, and the fields of the shot that say so."""
    from simulate.effect_selection import EffectSelection
    from simulate.iiccd.camera import IntensifiedCamera
    from simulate.iiccd.effect_bounds.camera_effects import bound_effects, select_camera_effects
    from simulate.iiccd.effect_bounds.noise_budget import NoiseBudget, per_pixel

    exact = asked.tolerance is None
    if not isinstance(camera, IntensifiedCamera):
        return camera, {"exact": exact}
    if asked.tolerance is None:
        effects = bound_effects(NoiseBudget(camera, per_pixel(camera, freed), conditions))
        return camera, {"exact": True, "plan": EffectSelection(tolerance=0.0, kept=tuple(effects), left_out=())}
    camera, plan = select_camera_effects(camera, freed, conditions, asked.tolerance)
    return camera, {"exact": False, "plan": plan}


def _of_picture(asked: SimulationRequest, description: "Description", conditions: Conditions) -> Shot:
    from charact.cli.image_source import photoelectrons_of
    from simulate.iiccd.scene_to_photoelectrons import camera_from_description, photoelectrons_from_image

    camera = camera_from_description(description)
    image, notes = photoelectrons_of(
        asked.source,
        photoelectrons_per_dn=asked.photoelectrons_per_dn,
        black_dn=asked.black_dn or 0.0,
        shape=camera.shape,
    )
    _require_dark(asked, image)
    freed = photoelectrons_from_image(camera, image)
    camera, planned = _select_effects(camera, freed, conditions, asked)
    light, kind = camera.to_mcp_input(freed, conditions), asked.kind or "scene"
    return Shot(camera=camera, light=light, kind=kind, conditions=conditions, seen=image, notes=notes, **planned)


def _of_cube(asked: SimulationRequest, description: "Description", conditions: Conditions) -> Shot:
    from charact.cli.image_source import cube_of
    from simulate.iiccd.scene_to_photoelectrons import camera_from_description, photoelectrons_from_radiance

    _no_picture(asked)
    camera = camera_from_description(description)
    cube = cube_of(asked.source)
    _require_dark(asked, cube.radiance)
    freed = photoelectrons_from_radiance(camera, cube, conditions)
    camera, planned = _select_effects(camera, freed, conditions, asked)
    light, kind = camera.to_mcp_input(freed, conditions), asked.kind or "scene"
    notes = (f"spectral radiance of {asked.source.name}",)
    return Shot(camera=camera, light=light, kind=kind, conditions=conditions, seen=cube, notes=notes, **planned)


def _no_picture(asked: SimulationRequest) -> None:
    for option, value in (("--photoelectrons-per-dn", asked.photoelectrons_per_dn), ("--black-dn", asked.black_dn)):
        if value is not None:
            raise BadInput(f"{option} belongs to a picture, got it with {asked.source.name}")
