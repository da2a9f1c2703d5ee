"""Black that is cut off is told from black that is quiet."""

import numpy as np
import pytest

from charact.estimators import mtf
from charact.frames import is_clipped_at_black
from charact.method import Context
from tests.truth.point import PointScene

PIXELS = (8, 4000)


def codes(values: np.ndarray) -> np.ndarray:
    return np.rint(np.maximum(values, 0.0)).astype(np.uint16)


@pytest.mark.parametrize("sd_dn", [2.0, 6.0, 40.0])
@pytest.mark.parametrize("black_sd", [1.25, 0.5, 0.0, -1.0])
def test_black_within_the_noise_of_the_lowest_code_is_clipped(
    sd_dn: float, black_sd: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    assert is_clipped_at_black(codes(rng.normal(black_sd * sd_dn, sd_dn, PIXELS)))


@pytest.mark.parametrize("sd_dn", [2.0, 6.0, 40.0])
def test_black_well_above_the_lowest_code_is_not(sd_dn: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    assert not is_clipped_at_black(codes(rng.normal(4.0 * sd_dn, sd_dn, PIXELS)))


@pytest.mark.parametrize("sd_dn", [0.05, 0.2, 0.3, 0.45])
@pytest.mark.parametrize("black_dn", [12.0, 12.25, 12.5])
@pytest.mark.parametrize("pulses", [0.0, 0.02, 0.3])
def test_quiet_pixels_are_not_whether_pulses_light_some_or_none(
    sd_dn: float, black_dn: float, pulses: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    light = rng.poisson(pulses, PIXELS) * rng.exponential(4.0, PIXELS)
    assert not is_clipped_at_black(codes(rng.normal(black_dn, sd_dn, PIXELS) + light))


@pytest.mark.parametrize("method", ["point-parametric", "point-forward", "point-spread"])
def test_a_spot_on_clipped_black_says_so(method: str) -> None:
    """Black one read noise above code 0: what is cut off lifts the dark, MTF50 comes out high."""
    for black_dn in (3.0, 20.0):
        scene = PointScene(read_dn=3.0, black_dn=black_dn)
        stack = scene.frames_drawn(np.random.default_rng(2))
        found = mtf.measure("point", stack, method=method, context=Context(quick=True)).measurements
        assert all(("clipped" in one.flags) == (black_dn == 3.0) for one in found)
