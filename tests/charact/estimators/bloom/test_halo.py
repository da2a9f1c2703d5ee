"""The halo is a disc four gaps wide: found behind a saturated core, at any light, and refused where
there is none.
"""

import numpy as np
import pytest

from charact.estimators import bloom
from charact.method import Context
from labdata import BadInput, FrameStack
from tests.truth.counted_pulses import errors
from tests.truth.thrown_halos import point_frames, point_session

QUICK = Context(seed=1, quick=True)
LIGHTS = (1e3, 1e4, 1e5)


def halo_of(result):
    (found,) = result.find("halo_diameter")
    return found


def series(rng, lights=LIGHTS, **settings):
    return point_session(
        [
            (f"point-{i}", point_frames(rng, light, **settings), light)
            for i, light in enumerate(lights)
        ]
    )


@pytest.mark.parametrize("diameter_px, elastic_share", [(30.0, 0.4), (40.0, 1.0), (40.0, 0.15)])
def test_the_diameter_before_blur_is_found_behind_a_saturated_core(
    seed, diameter_px, elastic_share
):
    rng = np.random.default_rng(seed)
    session = series(rng, diameter_px=diameter_px, elastic_share=elastic_share)
    halo = halo_of(bloom.measure(session, method="series-forward", context=QUICK))
    assert halo.status == "ok", (halo.flags, halo.notes, halo.interval95)
    assert abs(errors(halo, diameter_px)) < 4.5
    assert (halo.interval68[1] - halo.interval68[0]) / 2 < 0.03 * diameter_px


def test_geometry_not_light_sets_the_diameter(seed):
    """Two decades of light: each level's own diameter agrees with the common one."""
    session = series(np.random.default_rng(seed), lights=(3e3, 3e4, 3e5), frames=8)
    result = bloom.measure(session, method="series-forward", context=QUICK)
    levels = result.evidence["halo-constancy"]
    assert len(levels["halo_diameter_px"]) >= 2
    for own, (low, high) in zip(levels["halo_diameter_px"], levels["interval95_px"], strict=True):
        assert abs(own - levels["joint_px"]) < 4.5 * (high - low) / 3.92


def test_a_source_without_halo_is_refused_one(seed):
    session = series(np.random.default_rng(seed), halo_fraction=0.0)
    assert halo_of(bloom.measure(session, context=QUICK)).status == "refused"


@pytest.mark.parametrize("kind", ["uniform", "normal", "sparse"])
def test_pure_noise_has_neither_halo_nor_bloom(seed, kind):
    rng = np.random.default_rng(seed)
    data = {
        "uniform": lambda: rng.integers(0, 256, (6, 110, 120)),
        "normal": lambda: np.clip(rng.normal(120, 30, (6, 110, 120)), 0, 255),
        "sparse": lambda: 12 + rng.poisson(0.02, (6, 110, 120)) * 5,
    }[kind]()
    session = point_session(
        [("noise", FrameStack(data=data.astype(np.uint8), full_scale_dn=255.0), 1.0)]
    )
    for measurement in bloom.measure(session, context=QUICK).measurements:
        assert measurement.status != "ok", measurement


def test_a_session_without_point_sources_is_bad_input():
    session = point_session([("point", FrameStack(data=np.zeros((1, 8, 8), np.uint8)), 1.0)])
    bare = type(session)(folder=session.folder, name="bare", stacks=session.of_kind("dark"))
    with pytest.raises(BadInput, match="point"):
        bloom.measure(bare, context=QUICK)
