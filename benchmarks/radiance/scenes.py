"""Five scenes that our renderer and a path tracer are both given: a yard, a lab, a hangar, a road
and a closed room.

All surfaces are matt and grey, there is one band and no air, lamps are points: what both can be
told exactly.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.brdf.protocol import Lambert, grey
from simulate.radiance.geometry.viewpoint import Viewpoint
from simulate.radiance.integrator.environment_map import environment_map
from simulate.radiance.integrator.light_sources import Lighting
from simulate.radiance.integrator.spectral_scene import Air, BsdfSet, SpectralScene
from simulate.radiance.outdoor.built_scene import BuiltScene
from simulate.radiance.outdoor.materials import MaterialSpec
from simulate.radiance.outdoor.scene import LampPlacement, Object, OutdoorScene, Pose, SceneCamera
from simulate.radiance.scene import load_scene

# A third of the PULNiX frame each way, square pixels.
SHAPE = (164, 256)
# Bands that are added up into the one that is rendered, nm.
BANDS_NM = np.linspace(450.0, 900.0, 19)
# Radius of a lamp that casts a shadow as sharp as a point's, m.
POINT_M = 1e-4


@dataclass(frozen=True, kw_only=True)
class Case:
    """A scene to be rendered by both.

    Parameters
    ----------
    name
        Its name.
    site
        Where lamps are described.
    stage
        The scene on one band.
    view
        The camera.
    max_bounces
        Reflections that are followed before the one that the eye sees; None: all.
    even_sky
        Radiance of a sky that is the same everywhere; None where it is not, or is dark.
    """

    name: str
    site: BuiltScene
    stage: SpectralScene
    view: Viewpoint
    max_bounces: int | None
    even_sky: float | None = None

    @property
    def open_air(self) -> bool:
        """Whether it has a sky."""
        return not self.stage.lighting.environment_map.is_dark


def cases() -> tuple[Case, ...]:
    """Return all five."""
    return (
        _case("yard", _yard(), field_deg=40.0, max_bounces=0, even_sky=5e-4),
        _case("lab", _lab(), field_deg=32.0, max_bounces=3),
        _case("hangar", _shipped("hangar"), field_deg=36.0, max_bounces=3),
        _case("road", _shipped("road"), field_deg=30.0, max_bounces=3),
        _case("room", _room(), field_deg=75.0, max_bounces=None),
    )


def _case(
    name: str,
    scene: OutdoorScene,
    *,
    field_deg: float,
    max_bounces: int | None,
    even_sky: float | None = None,
) -> Case:
    site = BuiltScene(scene)
    stage = _grey(site.on(BANDS_NM))
    if even_sky is not None:
        even = environment_map(lambda way: np.full((1, len(way)), even_sky))
        stage = replace(stage, lighting=replace(stage.lighting, environment_map=even))
    focal = 0.5 * SHAPE[1] / np.tan(np.deg2rad(0.5 * field_deg))
    ahead = np.subtract(scene.camera.look_at_m, scene.camera.position_m)
    ahead /= np.linalg.norm(ahead)
    view = Viewpoint(
        position_m=scene.camera.position_m,
        forward=(float(ahead[0]), float(ahead[1]), float(ahead[2])),
        shape=SHAPE,
        focal_px=(focal, focal),
    )
    return Case(
        name=name, site=site, stage=stage, view=view, max_bounces=max_bounces, even_sky=even_sky
    )


def _grey(stage: SpectralScene) -> SpectralScene:
    """Return a stage whose bands are added up to one, matt, without air, its lamps as small as
    points.
    """
    weight = np.full(len(BANDS_NM), 1.0 / len(BANDS_NM), np.float32)
    light = stage.lighting
    panels = light.panels
    lighting = Lighting(
        environment_map=replace(
            light.environment_map,
            radiance_table=(light.environment_map.radiance_table @ weight)[..., None],
            irradiance_table=(light.environment_map.irradiance_table @ weight)[..., None],
        ),
        lamps=tuple(
            replace(lamp, spectrum=_one(lamp.spectrum, weight), radius_m=POINT_M)
            for lamp in light.lamps
        ),
        discs=tuple(
            replace(disc, irradiance=_one(disc.irradiance, weight)) for disc in light.discs
        ),
        panels=None
        if panels is None
        else replace(panels, spectra=(panels.spectra @ weight)[:, None]),
    )
    nm = np.array([float(BANDS_NM.mean())])
    brdfs = tuple(Lambert(reflectance=grey(_share(brdf, weight))) for brdf in stage.bsdfs.brdfs)
    return SpectralScene(
        surfaces=stage.surfaces, bsdfs=BsdfSet.of(brdfs, nm), lighting=lighting, air=Air()
    )


def _one(spectrum: NDArray[np.float32], weight: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.array([spectrum @ weight], np.float32)


def _share(brdf, weight: NDArray[np.float32]) -> float:
    return float(brdf.reflectance.at(BANDS_NM) @ weight)


def _shipped(name: str) -> OutdoorScene:
    scene = load_scene(name)
    assert isinstance(scene, OutdoorScene)
    return scene


def _surfaces(**reflectance: float) -> tuple[MaterialSpec, ...]:
    return tuple(
        MaterialSpec(label=label, reflectance=(share,)) for label, share in reflectance.items()
    )


def _boxes(
    label: str, material: str, *placed: tuple[tuple[float, float, float], Pose]
) -> tuple[Object, ...]:
    return tuple(
        Object(label=f"{label} {number}", material=material, shape="box", size_m=size, **vars(pose))
        for number, (size, pose) in enumerate(placed)
    )


def _yard() -> OutdoorScene:
    """Ground, eight boxes, a lamp, a sky that is even."""
    rng = np.random.default_rng(8)
    boxes = []
    for number in range(8):
        place = (
            6.0 * (number % 4) - 9.0 + rng.uniform(-1, 1),
            7.0 * (number // 4) - 2.0 + rng.uniform(-1, 1),
            0.0,
        )
        size = (rng.uniform(1.5, 3.0), rng.uniform(1.5, 3.0), rng.uniform(1.0, 4.0))
        boxes.append((size, Pose(position_m=place, heading_deg=rng.uniform(0, 90))))
    return OutdoorScene(
        name="yard",
        camera=SceneCamera(position_m=(-4.0, -26.0, 13.0), look_at_m=(0.0, 1.0, 0.5)),
        material=_surfaces(ground=0.25, crate=0.5),
        object=(
            Object(label="ground", material="ground", shape="ground", size_m=(2000.0,)),
            *_boxes("crate", "crate", *boxes),
        ),
        lamp=(
            LampPlacement(
                label="lamp",
                kind="incandescent",
                lumens=3e4,
                position_m=(-3.0, 2.0, 7.0),
                radius_m=POINT_M,
            ),
        ),
    )


def _lab() -> OutdoorScene:
    """A bench in a dark room: a plate with four bars before a glowing port, a ring that stands out,
    a dim lamp.
    """
    bars = tuple(
        ((0.004, 0.001, 0.03), Pose(position_m=(-0.03 + 0.008 * i, -0.0025, 0.235)))
        for i in range(4)
    )
    return OutdoorScene(
        name="lab",
        camera=SceneCamera(position_m=(0.0, -1.0, 0.32), look_at_m=(0.0, 0.0, 0.24)),
        material=(
            *_surfaces(wall=0.3, table=0.15, plate=0.6, bar=0.05, ring=0.25),
            MaterialSpec(label="port", reflectance=(0.05,), glow_lm_per_m2=30.0),
        ),
        object=(
            Object(
                label="table",
                material="table",
                shape="box",
                size_m=(1.6, 1.2, 0.04),
                position_m=(0, 0, 0.06),
            ),
            Object(
                label="wall",
                material="wall",
                shape="box",
                size_m=(4.0, 0.1, 3.0),
                position_m=(0, 0.9, -0.9),
            ),
            Object(
                label="plate",
                material="plate",
                shape="box",
                size_m=(0.12, 0.004, 0.12),
                position_m=(0, 0, 0.19),
            ),
            Object(
                label="foot",
                material="bar",
                shape="box",
                size_m=(0.04, 0.04, 0.09),
                position_m=(0, 0.01, 0.1),
            ),
            *_boxes("bar", "bar", *bars),
            Object(
                label="ring",
                material="ring",
                shape="cylinder",
                size_m=(0.022, 0.012),
                position_m=(0.032, -0.002, 0.25),
                pitch_deg=90,
            ),
            Object(
                label="sphere",
                material="port",
                shape="sphere",
                size_m=(0.09,),
                position_m=(0.3, 0.25, 0.19),
            ),
        ),
        lamp=(
            LampPlacement(
                label="room light",
                kind="incandescent",
                lumens=6.0,
                position_m=(-0.4, -1.2, 0.95),
                radius_m=POINT_M,
            ),
        ),
    )


def _room() -> OutdoorScene:
    """A closed white room with a lamp panel in its ceiling, a chest and a ball: light that is
    reflected many times.
    """
    walls = (
        ((6.0, 5.0, 0.1), Pose(position_m=(0, 0, -0.1))),
        ((6.0, 5.0, 0.1), Pose(position_m=(0, 0, 2.6))),
        ((0.1, 5.0, 2.6), Pose(position_m=(-3.0, 0, 0))),
        ((0.1, 5.0, 2.6), Pose(position_m=(3.0, 0, 0))),
        ((6.0, 0.1, 2.6), Pose(position_m=(0, -2.5, 0))),
        ((6.0, 0.1, 2.6), Pose(position_m=(0, 2.5, 0))),
    )
    return OutdoorScene(
        name="closed room",
        camera=SceneCamera(position_m=(-1.9, -2.2, 1.6), look_at_m=(0.5, 1.0, 1.0)),
        material=(
            *_surfaces(wall=0.75, chest=0.5, ball=0.6),
            MaterialSpec(label="panel", reflectance=(0.5,), glow_lm_per_m2=300.0),
        ),
        object=(
            *_boxes("wall", "wall", *walls),
            Object(
                label="chest",
                material="chest",
                shape="box",
                size_m=(1.2, 0.7, 0.8),
                position_m=(0.9, 1.2, 0),
                heading_deg=25,
            ),
            Object(
                label="ball",
                material="ball",
                shape="sphere",
                size_m=(0.4,),
                position_m=(-0.9, 1.0, 0.4),
            ),
            Object(
                label="panel",
                material="panel",
                shape="box",
                size_m=(1.2, 0.6, 0.05),
                position_m=(0, 0.2, 2.55),
            ),
        ),
    )
