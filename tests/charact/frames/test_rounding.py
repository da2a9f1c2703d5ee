"""What rounding does to means, told from codes alone, is what rounding of drawn noise does."""

import numpy as np
import pytest

from charact.estimators.mtf.point.parametric_noise import dark_sd_from_histogram
from charact.estimators.mtf.point.thresholds import ACCURACY as POINT_ACCURACY
from charact.frames import CLIPPING, rounding_shifts


@pytest.mark.parametrize("sd", [0.02, 0.2, 0.35])
def test_shifts_are_those_of_rounded_noise(sd: float, seed: int) -> None:
    """Means of a million draws lie no further off than the shifts say, beyond five of their
    standard errors.
    """
    rng = np.random.default_rng(seed)
    level = np.array([10.0, 10.2, 10.37, 10.8])
    drawn = np.rint(level + sd * rng.standard_normal((1_000_000, level.size)))
    shifts = rounding_shifts(level, np.full(level.size, 0.2))
    assert shifts.shape == (CLIPPING.rounding_offsets, level.size)
    true = drawn.mean(axis=0) - level
    error = 5.0 * drawn.std(axis=0) / 1000.0
    assert np.all(np.abs(true) <= np.abs(shifts).max(axis=0) + error)


def test_noise_that_hides_the_steps_leaves_no_shift() -> None:
    assert rounding_shifts(np.array([10.0, 10.3]), np.array([0.6, 2.0])).shape == (0, 2)


def test_shifts_of_all_places_cancel() -> None:
    """Where black lies between two codes is not known: on the average over all places nothing
    moves.

    Without noise the shift is even within half a code; six terms of its series hold 95 % of its
    size.
    """
    shifts = rounding_shifts(np.linspace(20.0, 23.0, 31), np.full(31, 0.1))
    np.testing.assert_allclose(shifts.mean(axis=0), 0.0, atol=1e-12)
    assert shifts.std() == pytest.approx(np.sqrt(1.0 / 12.0), rel=0.06)


@pytest.mark.parametrize("place", [-0.4, 0.0, 0.3])
@pytest.mark.parametrize("sd", [0.6, 1.0, 2.0])
def test_the_noise_of_quiet_pixels_is_told_beside_pulses_of_light(
    sd: float, place: float, seed: int
) -> None:
    """Pulses of several codes in one pixel of twenty hardly move it: within 8 % of 60,000
    values.
    """
    rng = np.random.default_rng(seed)
    values = 12.0 + place + sd * rng.standard_normal(60_000)
    values += np.where(rng.random(values.size) < 0.05, rng.gamma(2.0, 1.5, values.size), 0.0)
    found = dark_sd_from_histogram(np.rint(values).astype(np.uint8))
    assert found == pytest.approx(sd, rel=0.08)
    assert abs(float(np.rint(values).std()) / sd - 1.0) > 0.01


def test_noise_that_rounding_hides_is_taken_for_little() -> None:
    codes = np.full(10_000, 12, np.uint8)
    codes[:500] = 15
    assert dark_sd_from_histogram(codes) == POINT_ACCURACY.hidden_sd_dn
