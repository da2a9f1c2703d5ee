"""Beside a lit edge the halo is a ramp half its diameter wide: closed-form half planes and doors,
saturated and not.
"""

import numpy as np
import pytest

from charact.estimators import bloom
from charact.estimators.bloom import measure_lit_edge
from charact.method import Context
from labdata import BadInput, Conditions, FrameStack, Session
from tests.truth.bloom_light import BloomScene, radial_light
from tests.truth.counted_pulses import errors
from tests.truth.sessions import session_in_memory, stack_in_memory

QUICK = Context(seed=1, quick=True, full_scale_dn=255.0)
SCENE = BloomScene(rows=150, cols=200)
MARGIN = 75


def through(world: np.ndarray, scene: BloomScene) -> np.ndarray:
    """A picture through the scene's spread by plain sums, its border carried on outwards."""
    from scipy.signal import fftconvolve

    y, x = np.mgrid[-MARGIN : MARGIN + 1, -MARGIN : MARGIN + 1]
    kernel = np.interp(
        np.hypot(y, x), table := np.arange(0.0, 120.0, 0.05), radial_light(scene, table)
    )
    wide = fftconvolve(np.pad(world, MARGIN, mode="edge"), kernel, mode="same")
    return wide[MARGIN:-MARGIN, MARGIN:-MARGIN]


def half_plane(
    level_dn: float, *, at: float = 85.3, slope: float = 0.06, shape=(150, 200)
) -> np.ndarray:
    """An edge whose true place is column `at` + `slope` * row."""
    rows, cols = np.indices(shape)
    return 4.0 + level_dn * np.clip(at + slope * rows - cols + 0.5, 0.0, 1.0)


def door(level_dn: float, *, height: int = 110, width: int = 60, shape=(170, 220)) -> np.ndarray:
    world = np.full(shape, 4.0)
    world[30 : 30 + height, 40 : 40 + width] += level_dn
    return world


def session_of(levels, world, rng, scene=SCENE, *, turned=False, frames=4) -> Session:
    entries = []
    for number, level in enumerate(levels):
        light = through(world(level), scene)
        noise = np.sqrt(
            0.4 * scene.photoelectron_dn * scene.excess * light + scene.read_noise_dn**2
        )
        data = 12.0 + light + noise * rng.standard_normal((frames, *light.shape))
        data = np.clip(np.rint(data), 0, 255).astype(np.uint8)
        data = np.swapaxes(data, 1, 2)[:, ::-1] if turned else data
        entries.append(
            stack_in_memory(
                "edge",
                FrameStack(data=data, full_scale_dn=255.0),
                Conditions(illuminance_lux=1e-6 * level),
                label=f"edge-{number}",
            )
        )
    dark = FrameStack(data=np.full((2, 8, 8), 12, np.uint8), full_scale_dn=255.0)
    entries.append(stack_in_memory("dark", dark))
    return session_in_memory(entries)


def found_of(session, context=QUICK):
    result = measure_lit_edge(session, context=context)
    return result.find("halo_diameter")[0], result.find("halo_fraction")[0], result


@pytest.mark.parametrize("turned", [False, True])
def test_diameter_and_share_come_from_an_edge_that_saturates(seed, turned):
    rng = np.random.default_rng(seed)
    diameter, fraction, result = found_of(
        session_of((150.0, 3000.0), half_plane, rng, turned=turned)
    )
    assert diameter.status == "ok" and fraction.status == "ok"
    assert diameter.value == pytest.approx(46.0, rel=0.02)
    assert abs(errors(diameter, 46.0)) < 4.5 and abs(errors(fraction, 0.1)) < 4.5
    assert fraction.value == pytest.approx(0.1, rel=0.1)
    assert result.evidence["lit-edge"]["bic_gain_of_halo"] > 100


def test_a_lit_door_is_narrower_than_a_half_plane_and_told_as_well(seed):
    diameter, fraction, _ = found_of(session_of((150.0, 3000.0), door, np.random.default_rng(seed)))
    assert diameter.value == pytest.approx(46.0, rel=0.02)
    assert abs(errors(diameter, 46.0)) < 4.5 and abs(errors(fraction, 0.1)) < 4.5


def test_cut_levels_alone_tell_the_diameter_less_surely_and_no_share(seed):
    diameter, fraction, _ = found_of(
        session_of((1500.0, 6000.0), half_plane, np.random.default_rng(seed))
    )
    assert fraction.status == "refused" and "bright" in fraction.reason
    if diameter.value is not None:
        assert abs(errors(diameter, 46.0)) < 4.5
        assert diameter.interval95[1] - diameter.interval95[0] > 0.5


def test_without_a_halo_it_is_refused(seed):
    rng = np.random.default_rng(seed)
    for scene in (BloomScene(halo_fraction=0.0), BloomScene(halo_fraction=0.0, wing_share=0.2)):
        diameter, fraction, _ = found_of(session_of((150.0, 3000.0), half_plane, rng, scene))
        assert diameter.status == fraction.status == "refused"


def test_a_border_within_the_halo_is_refused_or_flagged(seed):
    def near(level):
        return half_plane(level, at=172.0, slope=0.03)

    diameter, _, _ = found_of(session_of((150.0, 3000.0), near, np.random.default_rng(seed)))
    assert diameter.status != "ok"


def test_bloom_takes_the_edge_where_there_is_no_point(seed):
    session = session_of((150.0, 3000.0), half_plane, np.random.default_rng(seed))
    assert bloom.measure(session, context=QUICK).find("halo_diameter")[0].method == "lit-edge"
    with pytest.raises(BadInput, match="edge"):
        measure_lit_edge(session_in_memory(()), context=QUICK)
