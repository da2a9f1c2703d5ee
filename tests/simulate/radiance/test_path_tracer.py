"""Light followed by compiled loops is the light that batches for all kinds of surfaces find."""

import numpy as np
import pytest

from simulate.radiance.brdf import Glossy, grey
from simulate.radiance.geometry import box, plane
from simulate.radiance.integrator import (
    IntegratorSettings,
    LampLight,
    SpectralScene,
    lamp_arrays,
    lamp_pattern,
    outgoing_radiance,
)
from simulate.radiance.lamps import Cosine, Isotropic, MeasuredDistribution, SpotBeam
from tests.simulate.radiance.staging import OVERCAST, at, disc_light, inside_out, lamp, staged


def glowing(way: np.ndarray) -> np.ndarray:
    """A glow of a hundred times the rest around a place 30 degrees high."""
    return np.ones((2, 1)) * (0.2 + 20.0 * np.exp(-(((1.0 - way @ [0.866, 0.0, 0.5]) / 0.02) ** 2)))


ONCE = IntegratorSettings(max_bounces=1)
EVEN = {
    "effort": IntegratorSettings(max_bounces=3),
    "sky": OVERCAST,
    "lamps": (lamp((0, 0, 3), 5.0, 0.2),),
}
# Things that glow unlike each other; the plate shines upwards, and its underside is dark.
SHINING = {"beam": 1.0, "box": 3.0, "plate": 20.0}
UPWARDS = {"beam": 1e-3, "plate": 1.0}
DARK = {"sky": None, "lamps": (), "glow": SHINING}
# Below the plate; and before the box, so that part of the lamp is within it.
CLOSE = (lamp((-1.2, 0.6, 0.75), 1.0, 0.1), lamp((0.4, 0.8, 0.5), 1.0, 0.15))
CASES = {
    "a lamp under an overcast sky": EVEN,
    "one bounce": {**EVEN, "effort": ONCE},
    "without hidden sky": {
        **EVEN,
        "effort": IntegratorSettings(max_bounces=2, sky_shadowing=False),
    },
    "many lamps": {
        **EVEN,
        "sky": None,
        "lamps": tuple(lamp((x, 0.5, 2), 2.0 + x, 0.1) for x in (-2.0, -1.0, 0.0, 1.5)),
    },
    "the sun and a glow around it": {
        **EVEN,
        "sky": glowing,
        "lamps": (),
        "discs": (disc_light((0.866, 0, 0.5)),),
    },
    "paths that chance ends": {
        **EVEN,
        "effort": IntegratorSettings(max_bounces=100, roulette_depth=1),
    },
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
    lights = {
        "sky": case["sky"],
        "lamps": case["lamps"],
        "discs": case.get("discs", ()),
        "glow": case.get("glow"),
    }
    return staged(parts, rho, **lights)


@pytest.mark.parametrize(("number", "name"), list(enumerate(CASES)))
def test_loops_find_what_batches_find(number, name, seed):
    """Light asked for in parts is gathered in batches: over 300 places the means agree to four
    standard errors.
    """
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
                outgoing_radiance.outgoing_radiance(
                    stage, points, case["effort"], rng, rays=case.get("rays", 16), split=split
                ).total()[:, 0]
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
        polar_deg=polar,
        azimuth_deg=azimuth,
        candela=np.random.default_rng(1).uniform(1.0, 9.0, (4, 4)),
    )


def same_around() -> MeasuredDistribution:
    return MeasuredDistribution(
        polar_deg=np.array([10.0, 40.0, 90.0]),
        azimuth_deg=np.zeros(1),
        candela=np.array([[5.0, 2.0, 1.0]]),
    )


@pytest.mark.parametrize(
    "distribution",
    [Isotropic(), Cosine(), SpotBeam(half_angle_deg=12.0), measured(), same_around()],
)
def test_loops_know_where_lamps_shine(distribution, seed):
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
