"""Likelihood of many transfers at once: the Gaussian with step, level and slopes left free, and
phases as they are.
"""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from charact.estimators.mtf.edge.fit.edge_maps import EdgeMaps, Marginal, apply_phases
from charact.estimators.mtf.edge.fit.model_fit import BLOCK, EdgeFitter, form_of
from charact.estimators.mtf.edge.pixels.prepare_edge import PreparedEdge, prepare_edge
from charact.estimators.mtf.known_transfer import known_transfer
from charact.method import Context
from charact.transfer import BlurModel
from tests.truth.edge import EdgeScene

GRID = np.concatenate([[1e-5, 1e-3], np.linspace(0.01, 4.3, 40)])
STEP_DN = 500.0


@pytest.mark.parametrize("slope_sd", [0.02, 3.0])
def test_step_level_and_slopes_are_marginalised(slope_sd, seed):
    """Against scipy's Gaussian whose covariance holds them, as wide as makes them free: the
    differences are alike.
    """
    rng = np.random.default_rng(seed)
    bins, transfers = 30, rng.random((6, GRID.size))
    white, data = rng.standard_normal((2 * GRID.size, bins)), 10.0 * rng.standard_normal(bins)
    levels = rng.standard_normal((3, bins))
    precision = np.array([0.0, slope_sd**-2, slope_sd**-2])
    stacked = np.concatenate([transfers, 0.1 * rng.standard_normal(transfers.shape)], axis=1)
    found = Marginal(white, levels, data, precision, STEP_DN).log_likelihood(stacked)
    spread = stacked @ white
    free = 1e5
    known = np.eye(bins) + levels.T @ np.diag([free, slope_sd**2, slope_sd**2]) @ levels
    covariances = known + free * spread[:, :, None] * spread[:, None, :]
    expected = [multivariate_normal(cov=one).logpdf(data) for one in covariances]  # pyright: ignore[reportArgumentType]
    assert found - found[0] == pytest.approx(np.array(expected) - expected[0], abs=2e-3)
    assert np.ptp(found) > 1.0


def test_maps_made_elsewhere_tell_the_same(seed):
    """The likelihood of a place of the edge does not hang on the shift around which the maps are
    made.
    """
    maps = EdgeMaps(*_profile_and_optics(seed))
    modulus = np.exp(-((maps.grid / 0.3) ** 2))[None].repeat(5, axis=0)
    shifts, free = np.linspace(0.1, 0.5, 5), np.array([0.0, 0.01, 0.01])

    def likelihood():
        turns = np.multiply.outer(shifts - maps.centre_px, maps.grid)
        marginal = Marginal(maps.white, maps.levels, maps.data, free, maps.profile.step)
        return marginal.log_likelihood(apply_phases(modulus, turns, maps.fixed))

    here = likelihood()
    maps.rebuild_for(0.4)
    assert np.ptp(here) > 100.0
    assert likelihood() == pytest.approx(here, abs=1e-3 * np.ptp(here))


def test_points_asked_together_are_as_probable_as_each_alone(seed):
    """None, one, and more than stay in the processor's cache."""
    fitter, family = EdgeFitter(*_profile_and_optics(seed)), BlurModel(core="exponential")
    log_probability = fitter.log_probability(form_of(family), 1e-4)
    points = np.array([0.0, np.log(0.3), 1.8]) + 0.05 * np.random.default_rng(seed).standard_normal(
        (2 * BLOCK + 3, 3)
    )
    together = log_probability(points)
    assert log_probability(points[:0]).shape == (0,)
    for index in (0, BLOCK - 1, BLOCK, 2 * BLOCK, 2 * BLOCK + 2):
        assert log_probability(points[index : index + 1])[0] == pytest.approx(
            together[index], abs=1e-6
        )


def _profile_and_optics(seed):
    edge = prepare_edge(
        EdgeScene(snr=30.0).frames_drawn(np.random.default_rng(seed)), None, Context()
    )
    assert isinstance(edge, PreparedEdge)
    return edge.profile, known_transfer(edge.picture, edge.profile.angle_rad, Context())


def test_phases_of_shifts_near_and_far_are_those_of_numpy(seed):
    """From none to hundreds of turns, and where a quarter begins."""
    rng = np.random.default_rng(seed)
    shift = np.concatenate([[0.0], np.arange(-2.0, 2.01, 0.125), 30.0 * rng.standard_normal(200)])
    modulus, fixed = rng.random((shift.size, GRID.size)), rng.standard_normal((2, GRID.size))
    grid = np.where(GRID > 0.1, GRID, np.round(GRID, 1) + 0.5)
    expected = modulus * (fixed[0] + 1j * fixed[1]) * np.exp(-2j * np.pi * shift[:, None] * grid)
    found = apply_phases(modulus, shift[:, None] * grid, fixed)
    # Turns by the hundred have lost the last three digits before any sine is taken.
    assert found == pytest.approx(np.concatenate([expected.real, expected.imag], axis=1), abs=1e-11)
