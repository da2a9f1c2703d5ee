"""Likelihood of many transfers at once: the Gaussian with step, level and slopes left free, and phases as they are."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from charact.mtf.edge_likelihood import EdgeLikelihood, _turned

GRID = np.concatenate([[1e-5, 1e-3], np.linspace(0.01, 4.3, 40)])
STEP_DN = 500.0


@pytest.mark.parametrize("slope_sd", [0.02, 3.0])
def test_step_level_and_slopes_are_marginalised(slope_sd, seed):
    """Against scipy's Gaussian whose covariance holds them, as wide as makes them free: the differences are alike."""
    rng = np.random.default_rng(seed)
    bins, transfers = 30, rng.random((6, GRID.size))
    white, data = rng.standard_normal((2 * GRID.size, bins)), 10.0 * rng.standard_normal(bins)
    levels = rng.standard_normal((3, bins))
    fixed, shift = np.stack([np.sinc(GRID), 0.1 * GRID]), rng.uniform(-0.3, 0.3, 6)
    precision = np.array([0.0, slope_sd**-2, slope_sd**-2])
    found = EdgeLikelihood(GRID, fixed, 0.05, white, levels, data, precision, STEP_DN)(transfers, shift)
    turn = np.exp(-2j * np.pi * (shift - 0.05)[:, None] * GRID)
    whole = transfers * (fixed[0] + 1j * fixed[1]) * turn
    spread = np.concatenate([whole.real, whole.imag], axis=1) @ white
    free = 1e5
    known = np.eye(bins) + levels.T @ np.diag([free, slope_sd**2, slope_sd**2]) @ levels
    expected = [multivariate_normal.logpdf(data, cov=known + free * np.outer(one, one)) for one in spread]
    assert found - found[0] == pytest.approx(np.array(expected) - expected[0], abs=2e-3)
    assert np.ptp(found) > 1.0


def test_phases_of_shifts_near_and_far_are_those_of_numpy(seed):
    """From none to hundreds of turns, and where a quarter begins."""
    rng = np.random.default_rng(seed)
    shift = np.concatenate([[0.0], np.arange(-2.0, 2.01, 0.125), 30.0 * rng.standard_normal(200)])
    modulus, fixed = rng.random((shift.size, GRID.size)), rng.standard_normal((2, GRID.size))
    grid = np.where(GRID > 0.1, GRID, np.round(GRID, 1) + 0.5)
    expected = modulus * (fixed[0] + 1j * fixed[1]) * np.exp(-2j * np.pi * shift[:, None] * grid)
    found = _turned(modulus, shift, grid, fixed)
    # Turns by the hundred have lost the last three digits before any sine is taken.
    assert found == pytest.approx(np.concatenate([expected.real, expected.imag], axis=1), abs=1e-11)
