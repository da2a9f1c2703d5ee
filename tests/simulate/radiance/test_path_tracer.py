"""Light followed by compiled loops is the light that batches for all kinds of surfaces find."""

from dataclasses import replace

import numpy as np
import pytest

from simulate.radiance.brdf.glossy import Glossy
from simulate.radiance.brdf.protocol import grey
from simulate.radiance.geometry.surfaces import box, plane
from simulate.radiance.integrator.integrator_settings import IntegratorSettings
from simulate.radiance.integrator.light_sources import LampLight, lamp_arrays, lamp_pattern
from simulate.radiance.integrator.outgoing_radiance import outgoing_radiance
from simulate.radiance.integrator.path_tracer import WAVE, follow_paths
from simulate.radiance.integrator.sampling import SequenceSlice
from simulate.radiance.integrator.spectral_scene import SpectralScene
from simulate.radiance.lamps.distribution import Cosine, Isotropic, MeasuredDistribution, SpotBeam, tabulated
from tests.simulate.radiance.staging import OVERCAST, at, disc_light, inside_out, lamp, staged

# A glow of a hundred times the rest around a place 30 degrees high.
GLOWING = lambda way: np.ones((2, 1)) * (0.2 + 20.0 * np.exp(-(((1.0 - way @ [0.866, 0.0, 0.5]) / 0.02) ** 2)))  # noqa: E731
ONCE = IntegratorSettings(max_bounces=1)
EVEN = {"effort": IntegratorSettings(max_bounces=3), "sky": OVERCAST, "lamps": (lamp((0, 0, 3), 5.0, 0.2),)}
# Things that glow unlike each other; the plate shines upwards, and its underside is dark.
SHINING = {"beam": 1.0, "box": 3.0, "plate": 20.0}
UPWARDS = {"beam": 1e-3, "plate": 1.0}
DARK = {"sky": None, "lamps": (), "glow": SHINING}
# Below the plate; and before the box, so that part of the lamp is within it.
CLOSE = (lamp((-1.2, 0.6, 0.75), 1.0, 0.1), lamp((0.4, 0.8, 0.5), 1.0, 0.15))
CASES = {
    "a lamp under an overcast sky": EVEN,
    "one bounce": {**EVEN, "effort": ONCE},
    "without hidden sky": {**EVEN, "effort": IntegratorSettings(max_bounces=2, sky_shadowing=False)},
    "many lamps": {
        **EVEN,
        "sky": None,
        "lamps": tuple(lamp((x, 0.5, 2), 2.0 + x, 0.1) for x in (-2.0, -1.0, 0.0, 1.5)),
    },
    "the sun and a glow around it": {**EVEN, "sky": GLOWING, "lamps": (), "discs": (disc_light((0.866, 0, 0.5)),)},
    "paths that chance ends": {**EVEN, "effort": IntegratorSettings(max_bounces=100, roulette_depth=1)},
    "glowing things alone, without bounces": {**DARK, "effort": IntegratorSettings(max_bounces=0)},
    "a glow by way of the ceiling": {**DARK, "effort": ONCE, "glow": UPWARDS, "ceiling": True},
    "glowing and glossy things": {**EVEN, "glow": SHINING, "gloss": True},
    "lamps close to a plate and half within a box": {
        **EVEN,
        "sky": None,
        "lamps": CLOSE,
        "close": [True, True],
        "rays": 32,
    },
    "a lamp close to something glossy": {
        **EVEN,
        "sky": None,
        "lamps": (lamp((0.0, -0.7, 0.54), 1.0, 0.04),),
        "gloss": True,
        "close": [True],
        "rays": 64,
    },
}


def crowded(case: dict) -> SpectralScene:
    """A box, a beam and a plate over a floor; the beam may be glossy, and they may glow."""
    gloss = Glossy(reflectance=grey(0.3), roughness=0.3) if case.get("gloss") else 0.3
    parts = [
        ("floor", "floor", plane(12, 12)),
        ("box", "box", at(box(1, 1, 1), 1.0, 0.8, 0.0)),
        ("beam", "beam", at(box(4, 0.3, 0.3), 0.0, -0.7, 0.6)),
        ("plate", "plate", at(plane(1, 1), -1.2, 0.6, 0.9)),
    ]
    if case.get("ceiling"):
        parts.append(("ceiling", "floor", inside_out(at(plane(12, 12), 0.0, 0.0, 2.0))))
    rho = {"floor": 0.5, "box": 0.7, "beam": gloss, "plate": 0.2}
    lights = {"sky": case["sky"], "lamps": case["lamps"], "discs": case.get("discs", ()), "glow": case.get("glow")}
    return staged(parts, rho, **lights)


@pytest.mark.parametrize(("number", "name"), list(enumerate(CASES)))
def test_loops_find_what_batches_find(number, name, seed):
    """Light asked for in parts is gathered in batches: over 300 places the means agree to four standard errors."""
    case, known = CASES[name], (1.0, 0.4)[number % 2]
    stage, rng = crowded(case), np.random.default_rng(seed)
    if "close" in case:
        assert stage.beams.worth.tolist() == case["close"]
    place = np.column_stack([rng.uniform(-2.0, 2.0, (300, 2)), np.zeros(300)])
    down, share = np.broadcast_to([0.0, 0.0, -1.0], place.shape), np.full(300, known, np.float32)
    points = stage.bsdfs.points(stage.surfaces, np.zeros(300, np.int64), place, down, share)
    found = np.array(
        [
            [
                outgoing_radiance(stage, points, case["effort"], rng, rays=case.get("rays", 16), split=split).total()[
                    :, 0
                ]
                for split in (True, False)
            ]
            for _ in range(16)
        ],
        float,
    )
    apart = (found[:, 0] - found[:, 1]).mean(axis=1)
    mean, error = apart.mean(), apart.std(ddof=1) / np.sqrt(len(apart))
    assert abs(mean) < 4.0 * error
    assert error < 0.015 * found.mean()


def measured() -> MeasuredDistribution:
    azimuth, polar = np.array([0.0, 30.0, 90.0, 180.0]), np.array([0.0, 20.0, 50.0, 120.0])
    return MeasuredDistribution(
        polar_deg=polar, azimuth_deg=azimuth, candela=np.random.default_rng(1).uniform(1.0, 9.0, (4, 4))
    )


def same_around() -> MeasuredDistribution:
    return MeasuredDistribution(
        polar_deg=np.array([10.0, 40.0, 90.0]), azimuth_deg=np.zeros(1), candela=np.array([[5.0, 2.0, 1.0]])
    )


def loops_alone(
    stage: SpectralScene, face: int, place: list[float], up: list[float], even: SequenceSlice, *, sky_shadowing: bool
) -> np.ndarray:
    """What compiled loops find once around places of which no sky is known, shape (place,)."""
    many = len(even.start)
    points = stage.bsdfs.points(
        stage.surfaces,
        np.full(many, face),
        np.tile(place, (many, 1)),
        -np.tile(up, (many, 1)),
        np.zeros(many, np.float32),
    )
    effort = replace(ONCE, sky_shadowing=sky_shadowing)
    found, _ = follow_paths(stage, points, even, effort, None, control=points.sky_control_fraction, depth=0, seed=1)
    return found[:, 0]


def test_stretches_go_on_where_waves_end(seed):
    """Rays of an open place find the sky where its stretch of even numbers says, however many waves they take."""
    stage = staged([("floor", "floor", plane(12, 12))], {"floor": 0.3}, sky=GLOWING)
    even = SequenceSlice.random(3, WAVE + WAVE // 3, np.random.default_rng(seed))
    found = loops_alone(stage, 0, [0, 0, 0], [0, 0, 1.0], even, sky_shadowing=True)
    square, turn = np.moveaxis(even.pairs(), -1, 0)
    flat, turn = np.sqrt(square), 2.0 * np.pi * turn
    way = np.stack([flat * np.cos(turn), flat * np.sin(turn), np.sqrt(1.0 - square)], axis=-1)
    sky = stage.lighting.environment_map.radiance(way.reshape(-1, 3))[:, 0].reshape(way.shape[:2])
    np.testing.assert_allclose(found, np.pi * sky.mean(axis=1), rtol=1e-5)


def test_no_ray_of_a_full_wave_is_lost(seed):
    """Under a ceiling close to a wide floor all rays find what the floor sends, and its sky is taken as known."""
    parts = [("floor", "floor", plane(400, 400)), ("ceiling", "floor", inside_out(at(plane(1, 1), 0, 0, 0.1)))]
    stage = staged(parts, {"floor": 0.4}, sky=lambda way: np.full((1, len(way)), 2.0))
    even = SequenceSlice.random(5, WAVE, np.random.default_rng(seed))
    found = loops_alone(stage, 2, [0, 0, 0.1], [0, 0, -1.0], even, sky_shadowing=False)
    np.testing.assert_allclose(found, 0.4 * 2.0 * np.pi, rtol=1e-3)


@pytest.mark.parametrize(
    "distribution", [Isotropic(), Cosine(), SpotBeam(half_angle_deg=12.0), measured(), same_around()]
)
def test_loops_know_where_lamps_shine(distribution, seed):
    """Also as a table, which serves any shape: but for its last quarter of a degree before the dark."""
    rng = np.random.default_rng(seed)
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    way = rng.normal(size=(500, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    light = LampLight(
        name="lamp",
        position_m=np.zeros(3),
        radius_m=0.0,
        spectrum=np.ones(2, np.float32),
        distribution=distribution,
        frame=frame,
    )
    *_, axes, ends, tables = lamp_arrays((light, light), 2)
    found = [lamp_pattern(tables[ends[1] : ends[2]], axes[1], *towards) for towards in way]
    assert found == pytest.approx(light.per_sr(way), rel=1e-9, abs=1e-12)
    table = tabulated(distribution).per_sr(way)
    assert np.mean(np.abs(table - distribution.per_sr(way)) > 0.02 * table.max()) < 0.02
