"""Simulation of a scene, image or radiance cube through a described camera, and its storage as a session.

from pathlib import Path
from simulate import api

camera = api.load_described_camera("pulnix-ag5745ef3")
shot = api.simulate(api.SimulationRequest(source=Path("bench"), kind="flat"), camera, api.conditions_of(camera))
api.save_session(shot, camera, Path("frames"), frames=8, seed=0)
"""

import json
import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.file_io import write_atomically
from labdata.limits import TubeLimits
from labdata.sensor import Sensor
from labdata.session import Kind
from labdata.solid_state import SolidStateCamera
from labdata.target import Target
from simulate.image_source import read_cube, read_image

if TYPE_CHECKING:
    from simulate.effect_selection import EffectSelection
    from simulate.outdoor_rendering import OutdoorRendering, RenderedView

Description = Sensor | SolidStateCamera
Progress = Callable[[str, float], None]
Stage = tuple[str, str, NDArray[Any]]  # name, quantity with unit, image (row, col)
# Field of a target: its option and its kind of target.
OF_A_TARGET: dict[str, tuple[str, Kind]] = {
    "frequency_cy_per_px": ("--frequency", "bars"),
    "pinhole_px": ("--pinhole-px", "point"),
}


def _ignore_progress(sentence: str, share: float) -> None:
    """Ignore progress."""


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
    photoelectrons_per_dn, black_dn
        Image: mean photoelectrons per pixel as read and exposure for each DN above black, and black level (None: 0).
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
    """A simulated camera, its light and the metadata of the session.

    Parameters
    ----------
    camera, light
        The camera, and expected photoelectrons at the MCP, or in the sensor of a camera without tube.
    kind, conditions, target, notes
        Metadata of the stack.
    seen
        Input of the camera: an image in photoelectrons, a radiance cube, or None.
    plan, exact
        Effect selection (None for a camera without tube, where all are retained); whether every pulse is sampled.
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

    def stages(self, *, seed: int) -> "Iterator[Stage]":
        """Yield the input, the expected photoelectrons or radiance behind the lens, and the image after each stage."""
        from simulate.iiccd.stage_images import stage_images
        from simulate.radiance.cube import RadianceCube

        if isinstance(self.seen, RadianceCube):
            yield from stage_images(self.camera, self.seen, self.conditions, seed)
            return
        if self.seen is not None:
            yield "picture", "photoelectrons per exposure and pixel, expected", self.seen
        place = "at the plate" if self.camera.has_tube else "in the chip"
        inside = self.light.values[(..., *self.light.grid.inside)]
        yield f"photoelectrons {place}", "photoelectrons per exposure and cell, expected", inside
        yield from stage_images(self.camera, self.light, self.conditions, seed)

    @property
    def explanation(self) -> str:
        """Text of retained and neglected effects of light and camera with their bounds."""
        light = () if self.view is None else (self.view.plan.text(), "")
        camera = "camera without tube: all effects are retained" if self.plan is None else self.plan.text()
        return "\n".join((*light, camera))

    @property
    def economy_note(self) -> str:
        """Note on neglected effects."""
        if self.plan is None or self.exact:
            return "nothing left out"
        names = ", ".join(effect.name for effect in self.plan.left_out) or "nothing"
        share = f"{100.0 * self.plan.influence:.2g} % of the temporal noise, of {100.0 * self.plan.tolerance:g} %"
        return f"left out, together at most {share} allowed: {names}; see economy.json"


def load_described_camera(sensor: str, phosphor: str | None = None) -> Description:
    """Return the sensor description of a camera, with another phosphor if one is given."""
    from labdata.phosphors import load_phosphor
    from labdata.sensors import load_camera

    camera = load_camera(sensor)
    if phosphor is None:
        return camera
    if isinstance(camera, SolidStateCamera):
        raise BadInput(f"--phosphor needs a camera with a tube, got {camera.name!r}")
    return camera.with_phosphor(load_phosphor(phosphor))


def simulate(
    request: SimulationRequest, description: Description, conditions: Conditions, progress: Progress = _ignore_progress
) -> Shot:
    """Return camera and light of a request, without the effects that its tolerance allows to neglect.

    Raises
    ------
    BadInput
        If the source cannot be read, or an option does not apply to it.
    """
    from simulate.iiccd.scene_to_photoelectrons import (
        camera_from_description,
        photoelectrons_from_image,
        photoelectrons_from_radiance,
    )

    view, seen, notes, scene = None, None, (), None
    if is_scene(request.source):
        from simulate.radiance.scene import LabScene, load_scene

        _require_no_image_options(request)
        if isinstance(scene := load_scene(request.source), LabScene):
            return _bench_shot(request, scene, description, conditions)
        if request.kind == "dark":
            raise BadInput(f"a dark must have no light, got the scene {scene.name!r}")
    _require_no_bench_options(request, conditions)
    camera = camera_from_description(description)
    if scene is not None:
        from simulate.outdoor_rendering import OutdoorRendering

        view = _render(OutdoorRendering(scene, camera, conditions), request, progress)
        seen, notes = view.picture.cube, (f"scene {scene.name}", *view.notes)
    elif request.source.suffix == ".npz":
        _require_no_image_options(request)
        seen, notes = read_cube(request.source), (f"spectral radiance of {request.source.name}",)
    if seen is not None:
        _require_dark(request, seen.radiance)
        photoelectrons = photoelectrons_from_radiance(camera, seen, conditions)
    else:
        seen, notes = read_image(
            request.source, photoelectrons_per_dn=request.photoelectrons_per_dn, black_dn=request.black_dn or 0.0,
            shape=camera.shape,
        )  # fmt: skip
        _require_dark(request, seen)
        photoelectrons = photoelectrons_from_image(camera, seen)
    camera, planned = _select_effects(camera, photoelectrons, conditions, request)
    light, kind = camera.to_mcp_input(photoelectrons, conditions), request.kind or "scene"
    return Shot(
        camera=camera, light=light, kind=kind, conditions=conditions, seen=seen, notes=notes, view=view, **planned
    )


def is_scene(source: Path) -> bool:
    """Whether a source is a scene file or the name of a shipped scene."""
    return source.suffix == ".toml" or (not source.suffix and not source.is_file())


def outdoor_view(request: SimulationRequest, description: Description, conditions: Conditions) -> "OutdoorRendering":
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


def _render(view: "OutdoorRendering", request: SimulationRequest, progress: Progress) -> "RenderedView":
    """Render an outdoor scene; a rendering of more than a minute announces its time."""
    sentence = "light"

    def announce(seconds: float) -> None:
        nonlocal sentence
        sentence = f"light, about {seconds / 60.0:.0f} min" if seconds > 60.0 else "light"
        progress(sentence, 0.0)

    return view.render(
        tolerance=request.tolerance, seed=request.seed, progress=lambda share: progress(sentence, share),
        announce=announce,
    )  # fmt: skip


def _bench_shot(request: SimulationRequest, scene: Any, description: Description, conditions: Conditions) -> Shot:
    from simulate.lab import LabBench
    from simulate.radiance.lab_target import as_stood

    if not isinstance(description, Sensor):
        raise BadInput(f"a bench scene needs a camera with a tube, got {description.name!r}")
    kind, lux = request.kind or "edge", conditions.illuminance_lux
    for name, (option, of) in OF_A_TARGET.items():
        value = getattr(request.target, name)
        if kind == of and value is None:
            raise BadInput(f"--kind {kind} of a bench scene needs {option}, got none")
        if kind != of and value is not None:
            raise BadInput(f"{option} is only for --kind {of} of a bench scene, got it with --kind {kind}")
    if kind == "dark" and lux:
        raise BadInput(f"a dark must have no light, got --illuminance-lux {lux:g}")
    target = as_stood(kind, request.target)
    if lux is None:
        conditions = replace(conditions, illuminance_lux=0.0 if kind == "dark" else 1e-4)
    bench = LabBench(description, scene)
    _, planned = _select_effects(bench.camera, bench.photoelectrons(kind, target, conditions), conditions, request)
    bench = bench.without(planned["plan"].names)
    light = bench.mcp_input(kind, target, conditions)
    return Shot(camera=bench.camera, light=light, kind=kind, conditions=conditions, target=target, **planned)


def _require_no_bench_options(request: SimulationRequest, conditions: Conditions) -> None:
    if conditions.illuminance_lux is not None:
        raise BadInput("--illuminance-lux is only for bench scenes")
    for name, (option, kind) in OF_A_TARGET.items():
        if getattr(request.target, name) is not None:
            raise BadInput(f"{option} is only for --kind {kind} of a bench scene, got it with {request.source.name}")


def _require_no_image_options(request: SimulationRequest) -> None:
    for option, value in (("--photoelectrons-per-dn", request.photoelectrons_per_dn), ("--black-dn", request.black_dn)):
        if value is not None:
            raise BadInput(f"{option} is only for an image, got it with {request.source.name}")


def _require_dark(request: SimulationRequest, seen: NDArray[np.floating]) -> None:
    """Raise BadInput if --kind is dark and the source has light."""
    if request.kind == "dark" and (lit := float((seen > 0.0).mean())):
        raise BadInput(f"a dark must have no light, got it on {100.0 * lit:.3g} % of {request.source.name}")


def _select_effects(
    camera: Any, photoelectrons: Any, conditions: Conditions, request: SimulationRequest
) -> tuple[Any, dict[str, Any]]:
    """Return the camera without the effects that this light does not need, and the fields of the shot."""
    from simulate.effect_selection import EffectSelection
    from simulate.iiccd.effect_bounds import NoiseBudget, bound_effects, per_pixel, select_camera_effects

    if not camera.has_tube:
        return camera, {"exact": request.tolerance is None}
    if request.tolerance is None:
        effects = bound_effects(NoiseBudget(camera, per_pixel(camera, photoelectrons), conditions))
        return camera, {"exact": True, "plan": EffectSelection(tolerance=0.0, kept=tuple(effects), left_out=())}
    camera, plan = select_camera_effects(camera, photoelectrons, conditions, request.tolerance)
    return camera, {"exact": False, "plan": plan}


def save_session(
    shot: Shot, description: Description, out: Path, *, frames: int, seed: int, notes: tuple[str, ...] = (),
    progress: Progress = _ignore_progress,
) -> None:  # fmt: skip
    """Simulate frames and store them as a session, one frame at a time, with effect selection and auxiliary layers."""
    from labdata.sensors import save_sensor
    from labdata.store import SessionWriter

    stream, kind = shot.frames(seed=seed), shot.kind
    first, video = next(stream), description.video
    with SessionWriter.create(
        out, name=f"simulated {kind}", sensor="sensor.toml", bit_depth=video.bit_depth, interlaced=video.interlaced
    ) as writer:
        save_sensor(description, out / "sensor.toml")
        with writer.begin_stack(kind, kind, first.shape, first.dtype, shot.conditions, target=shot.target) as stack:
            stack.append(first, 0.0, 0)
            for number, frame in enumerate(islice(stream, frames - 1), 1):
                stack.append(frame, number * shot.camera.frame_s, number)
                progress(f"frame {number + 1} of {frames}", (number + 1) / frames)
            maker = f"simulated by charact {version('charact')}, seed {seed}"
            stack.finish(notes=(maker, *shot.notes, shot.economy_note, *notes))
        if shot.view is not None:
            save_view(shot.view, out)
        if shot.plan is not None:
            write_atomically(out / "economy.json", json.dumps(shot.plan.document(), indent=1).encode())


def save_view(view: "RenderedView", out: Path) -> None:
    """Save the rendering of an outdoor scene: auxiliary layers and selected effects."""
    out.mkdir(parents=True, exist_ok=True)
    view.picture.truth.save(out / "truth.npz")
    write_atomically(out / "light.json", view.document())


# Options of a tube, by the name of their condition.
_OF_A_TUBE = {
    "mcp_v": "--mcp-v",
    "gain_control": "--gain-control",
    "gate_ns": "--gate-ns",
    "brightness_control": "--brightness-control",
}


def conditions_of(camera: Description, *, gain: float | None = None, **options: Any) -> Conditions:
    """Return the conditions of the options that are not None; others have their nominal values.

    `gain`: luminous gain of the tube, lm/lm, or multiplication of an electron-multiplying register. Raises BadInput if
    an option does not apply to the camera or conflicts with another one.
    """
    given = {name: value for name, value in options.items() if value is not None}
    if gain is not None and not (math.isfinite(gain) and gain > 0.0):
        raise BadInput(f"--gain must be positive, got {gain:g}")
    exposure_s = 1.0 / float(camera.video.field_rate_hz)
    if given.get("automatic_gain") and not camera.video.automatic_gain:
        raise BadInput(f"--automatic-gain needs a camera that has it, got {camera.name!r}")
    if isinstance(camera, SolidStateCamera):
        most = float(camera.register.em_gain)
        if gain is not None and not 1.0 <= gain <= most:
            raise BadInput(f"--gain of {camera.name!r} must lie between 1 and {most:g}, got {gain:g}")
        if unfit := [option for name, option in _OF_A_TUBE.items() if name in given]:
            raise BadInput(f"{unfit[0]} needs a camera with a tube, got {camera.name!r}")
        return Conditions(exposure_s=exposure_s, em_gain=most if gain is None else gain, **given)
    if len(ways := [name for name in ("mcp_v", "gain_control") if name in given] + ["gain"] * (gain is not None)) > 1:
        raise BadInput(f"the gain must be set once, got {' and '.join('--' + way.replace('_', '-') for way in ways)}")
    nominal: dict[str, Any] = {"gate_ns": exposure_s * 1e9}
    if gain is not None or not ways:
        nominal["mcp_v"] = voltage_of(camera, gain)
    return Conditions(exposure_s=exposure_s, **{**nominal, **given})


def voltage_of(sensor: Sensor, luminous_gain: float | None) -> float:
    """Return the MCP voltage for a luminous gain, V = V0 (G/G0)^(1/m); None: the reference voltage."""
    mcp = sensor.microchannel_plate
    if luminous_gain is None:
        return float(mcp.reference_v)
    if not (exponent := float(mcp.gain_exponent)) > 0.0:
        raise BadInput(f"--gain needs a tube with a positive gain exponent, got 0 in {sensor.name!r}")
    return float(mcp.reference_v) * (luminous_gain / float(sensor.tube.luminous_gain)) ** (1.0 / exponent)


def voltage_limit_warnings(camera: Description, conditions: Conditions) -> tuple[str, ...]:
    """Return a warning if the MCP voltage exceeds the limit of the description, which the bench would refuse."""
    mcp_v = conditions.mcp_v
    if isinstance(camera, SolidStateCamera) or mcp_v is None:
        return ()
    limit = camera.limits.mcp_v
    if limit == TubeLimits().mcp_v or mcp_v <= float(limit):
        return ()
    return (f"mcp_v of {mcp_v:.4g} exceeds the limit {float(limit):g} of {camera.name!r}: its bench would refuse it",)
