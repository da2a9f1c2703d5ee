"""Random places, lights and cameras: what the economy of light is tried on, each from a number of
its own.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta

import numpy as np

from labdata import Conditions, load_camera
from simulate.camera.scene_to_photoelectrons import camera_from_description
from simulate.outdoor_rendering import OutdoorRendering, render_sensor_of
from simulate.radiance.integrator.camera_rays import radiance_along
from simulate.radiance.integrator.integrator_settings import IntegratorSettings
from simulate.radiance.lamps.spectra import KINDS
from simulate.radiance.materials import material, material_names
from simulate.radiance.outdoor.materials import MaterialSpec
from simulate.radiance.outdoor.scene import LampPlacement, Object, OutdoorScene, SceneCamera, Where
from simulate.radiance.sky.moon import ObserverLocation
from simulate.radiance.sky.night_sky import NightSky

# Frames are small, so that the exact mode takes seconds; the lens is shorter, so that they show
# half the usual field.
SHAPE, FIELD = (6, 8), 0.5
CAMERAS = ("pulnix-ag5745ef3", "gen3-digital-iccd", "emccd-512")
# Elevations of sun and moon, deg: what is by day, at dusk, by moonlight and without any.
LIGHTS: dict[str, tuple[tuple[float, float], tuple[float, float]]] = {
    "day": ((5.0, 70.0), (-90.0, 90.0)),
    "dusk": ((-12.0, -1.0), (-90.0, 90.0)),
    "moon": ((-90.0, -18.0), (5.0, 90.0)),
    "stars": ((-90.0, -18.0), (-90.0, -5.0)),
    "no sky": ((-90.0, 90.0), (-90.0, 90.0)),
}
# Photoelectrons of the median pixel, by which exposures are chosen as an operator would: from
# grainy to full.
LEVELS_PE = 0.3, 300.0
SHORTEST_S = 1e-7
LUMENS = 0.3, 3000.0
PLACES = ((43.16, -77.61), (-33.9, 18.4), (64.1, -21.9), (1.3, 103.8))
TRIES = 2000


@dataclass(frozen=True, kw_only=True)
class SceneCase:
    """A scene before a camera.

    Parameters
    ----------
    number
        The number it follows from.
    light
        What lights it, in a word; "with lamps" where there are any.
    sensor
        The camera's name.
    night
        Scene, camera and exposure.
    """

    number: int
    light: str
    sensor: str
    night: OutdoorRendering


def case_of(number: int) -> SceneCase:
    """Return the scene of a number before a camera whose exposure suits it."""
    rng = np.random.default_rng([number, 2027])
    light, sensor = str(rng.choice(list(LIGHTS))), str(rng.choice(CAMERAS))
    scene = _scene(rng, light)
    camera = camera_from_description(_small(sensor))
    longest_s = camera.field_s
    night = OutdoorRendering(scene, camera, _exposure_conditions(sensor, longest_s))
    wanted, found = _between(rng, *LEVELS_PE), _median_pe(night)
    open_s = float(np.clip(longest_s * wanted / max(found, 1e-30), SHORTEST_S, longest_s))
    named = f"{light} with lamps" if scene.lamp else light
    return SceneCase(
        number=number,
        light=named,
        sensor=sensor,
        night=replace(night, conditions=_exposure_conditions(sensor, open_s)),
    )


def _small(sensor: str):
    """A camera of few pixels with a shorter lens."""
    camera = load_camera(sensor)
    shorter = SHAPE[1] / camera.ccd.columns / FIELD
    focal = camera.optics.focal_length_mm
    optics = replace(
        camera.optics,
        focal_length_mm=replace(focal, value=float(focal) * shorter, low=None, high=None),
    )
    return replace(camera, optics=optics, ccd=replace(camera.ccd, rows=SHAPE[0], columns=SHAPE[1]))


def _exposure_conditions(sensor: str, open_s: float) -> Conditions:
    camera = load_camera(sensor)
    if camera.has_tube:
        return Conditions(gate_ns=1e9 * open_s, mcp_v=float(camera.microchannel_plate.reference_v))
    return Conditions(exposure_s=open_s)


def _median_pe(night: OutdoorRendering) -> float:
    """Photoelectrons of the median pixel by direct light and open sky."""
    eye = render_sensor_of(night.camera, night.conditions)
    stage = night.site.on(night.site.bands(eye.response_nm, eye.response, 0.02))
    view = night.view
    row, col = (axis.ravel() + 0.5 for axis in np.indices(view.shape))
    effort = IntegratorSettings(max_bounces=0, sky_shadowing=False)
    light = radiance_along(
        stage, *view.rays(row, col), effort, np.random.default_rng(0), gather_rays=1
    ).total()
    return float(np.median(light @ eye.weight(stage.bsdfs.wavelength_nm)))


def _scene(rng: np.random.Generator, light: str) -> OutdoorScene:
    names = [name for name in material_names() if not any(material(name).transmittance)]
    surfaces = tuple(
        MaterialSpec(label=f"m{i}", library=str(name))
        for i, name in enumerate(rng.choice(names, 5, replace=False))
    )
    things = (
        Object(label="ground", shape="ground", size_m=(400.0,), material="m0"),
        *(_thing(rng, i) for i in range(int(rng.integers(2, 8)))),
    )
    most = 3 if light == "no sky" or rng.random() < 0.5 else 0
    lamps = tuple(_lamp(rng, i) for i in range(int(rng.integers(1, most + 1)) if most else 0))
    return OutdoorScene(
        name=light,
        camera=SceneCamera(
            position_m=(0.0, -_between(rng, 12.0, 40.0), rng.uniform(1.5, 6.0)),
            look_at_m=(0.0, 4.0, 2.0),
        ),
        place=None if light == "no sky" else _place(rng, *LIGHTS[light]),
        material=surfaces,
        object=things,
        lamp=lamps,
    )


def _thing(rng: np.random.Generator, number: int) -> Object:
    """A shape somewhere on the ground before the camera."""
    shapes: dict[str, Callable[[], tuple[float, ...]]] = {
        "box": lambda: tuple(rng.uniform(0.5, 5.0, 3)),
        "cylinder": lambda: tuple(rng.uniform([0.3, 0.5], [1.5, 5.0])),
        "cone": lambda: tuple(rng.uniform([0.3, 0.5], [2.0, 4.0])),
        "sphere": lambda: tuple(rng.uniform(0.3, 2.0, 1)),
        "shed": lambda: (rng.uniform(4.0, 8.0), rng.uniform(3.0, 7.0), 2.5, 3.5),
    }
    name = str(rng.choice(list(shapes)))
    size = tuple(float(length) for length in shapes[name]())
    up = size[0] if name == "sphere" else 0.02
    return Object(
        label=f"{name} {number}",
        shape=name,
        size_m=size,
        material=f"m{rng.integers(1, 5)}",
        position_m=(rng.uniform(-7.0, 7.0), rng.uniform(-3.0, 14.0), up),
        heading_deg=rng.uniform(0.0, 360.0),
    )


def _lamp(rng: np.random.Generator, number: int) -> LampPlacement:
    """A lamp above all things, so that it sticks in none."""
    beam = str(rng.choice(["isotropic", "cosine", "spot"]))
    return LampPlacement(
        label=f"lamp {number}",
        kind=str(rng.choice(KINDS)),
        lumens=_between(rng, *LUMENS),
        position_m=(rng.uniform(-8.0, 8.0), rng.uniform(-6.0, 12.0), rng.uniform(5.5, 9.0)),
        beam=beam,  # pyright: ignore[reportArgumentType]
        half_angle_deg=rng.uniform(15.0, 60.0),
        radius_m=rng.uniform(0.03, 0.3),
    )


def _place(rng: np.random.Generator, sun: tuple[float, float], moon: tuple[float, float]) -> Where:
    """A place and a time at which sun and moon stand where they should."""
    for _ in range(TRIES):
        latitude, longitude = PLACES[rng.integers(len(PLACES))]
        when = datetime(2020, 1, 1, tzinfo=UTC) + timedelta(
            minutes=int(rng.integers(5 * 365 * 1440))
        )
        bodies = NightSky.at(
            ObserverLocation(latitude_deg=latitude, longitude_deg=longitude), when
        ).bodies
        up = {body.name: body.elevation_deg for body in bodies}
        if sun[0] <= up["sun"] <= sun[1] and moon[0] <= up["moon"] <= moon[1]:
            return Where(latitude_deg=latitude, longitude_deg=longitude, time=when.isoformat())
    raise RuntimeError(f"no time found with the sun within {sun} and the moon within {moon} deg")


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is even."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
