"""Bloom is the area above half of full scale, counted in column pitches."""

import numpy as np
import pytest

from charact import bloom
from charact.bloom.spot import extent
from charact.method import Context
from labdata.frames import FrameStack

QUICK = Context(seed=1, quick=True)
METHODS = ["halo-profile", "threshold"]


def disc(radius: float, shape=(81, 91), centre=(40, 45), row_pitch=1.0):
    rows, cols = np.indices(shape)
    return np.where(np.hypot(cols - centre[1], (rows - centre[0]) * row_pitch) <= radius, 200.0, 10.0)


@pytest.mark.parametrize("radius", [3.3, 8.0, 15.6])
@pytest.mark.parametrize("row_pitch", [1.0, 13.0 / 11.0])
def test_a_disc_has_its_own_diameter_whatever_the_row_pitch(radius, row_pitch):
    diameter, _, touches = extent(disc(radius, row_pitch=row_pitch), 40.0, 45.0, 100.0, row_pitch)
    assert diameter == pytest.approx(2 * radius, abs=0.45)
    assert not touches


def test_only_what_hangs_together_with_the_source_counts():
    image = disc(5.0)
    image[5:20, 5:20] = 200.0
    assert extent(image, 40.0, 45.0, 100.0, 1.0)[0] == pytest.approx(10.0, abs=0.45)


def test_a_streak_is_as_long_as_its_column():
    image = disc(4.0)
    image[20:70, 45] = 180.0
    diameter, streak, _ = extent(image, 40.0, 45.0, 100.0, 1.0)
    assert streak == 50.0
    assert diameter > 8.0


def test_a_bloom_that_leaves_the_frame_says_so():
    assert extent(disc(60.0), 40.0, 45.0, 100.0, 1.0)[2]


@pytest.mark.parametrize("method", METHODS)
def test_a_gaussian_core_blooms_by_the_root_of_the_logarithm(in_memory, seed, method):
    """D = 2 s sqrt(2 ln OL) with OL the peak over the threshold (physics reference, 2.1)."""
    rng = np.random.default_rng(seed)
    rows, cols = np.indices((111, 121))
    radius2 = (rows - 55.2) ** 2 + (cols - 60.4) ** 2
    width = 3.0
    stacks = []
    for index, overload in enumerate((0.3, 3.0, 30.0, 300.0)):
        light = 12.0 + overload * 121.5 * np.exp(-radius2 / (2 * width**2))
        noisy = light + rng.normal(0.0, 1.0, (4, 111, 121))
        data = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        stacks.append((f"point-{index}", FrameStack(data=data, full_scale_dn=255.0), overload))
    result = bloom.measure(in_memory(stacks), method=method, context=QUICK)
    assert result.find("bloom_diameter", stack="point-0")[0].status == "refused"
    for index, overload in ((1, 3.0), (2, 30.0), (3, 300.0)):
        (found,) = result.find("bloom_diameter", stack=f"point-{index}")
        truth = 2 * width * np.sqrt(2 * np.log(overload))
        half = 0.5 * (found.interval68[1] - found.interval68[0])
        assert found.status == "ok"
        assert abs(found.value - truth) < 4.5 * half
    assert result.find("halo_diameter")[0].status == "refused"
    assert result.evidence["bloom-series"]["overload_known"]


def test_without_darks_the_level_is_assumed_and_flagged(point, in_memory, seed):
    session = in_memory([("point", point(np.random.default_rng(seed), 1e5), 1.0)], darks=False)
    (found,) = bloom.measure(session, method="threshold", context=QUICK).find("bloom_diameter")
    assert "no-darks" in found.flags


def test_a_single_image_is_enough_for_an_extent(point, in_memory, seed):
    session = in_memory([("point", point(np.random.default_rng(seed), 1e5, frames=1), 1.0)])
    result = bloom.measure(session, context=QUICK)
    (found,) = result.find("bloom_diameter")
    assert found.value > 5.0 and found.interval95[0] < found.value < found.interval95[1]


def test_the_forward_model_is_the_method_taken_where_nothing_else_is_known():
    from charact.method.registry import of_kind

    assert next(iter(of_kind("bloom"))) == "halo-profile"
