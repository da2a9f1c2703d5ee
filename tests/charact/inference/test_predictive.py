"""Predictive probabilities are uniform under the right model, and the examples of the physics
reference are told.
"""

import numpy as np
import pytest
from scipy.stats import binom, chi2, norm

from charact.inference import find_maximum, predictive_check, sample
from labdata import BadInput

PLACES = np.linspace(-1.0, 1.0, 60)
SHAPES = np.stack([np.ones(60), PLACES, PLACES**2, np.exp(-0.5 * (PLACES / 0.2) ** 2)], axis=1)
PRIOR_SD = np.array([1.0, 1.0, 1.0, 0.2])


def linear_posterior(data, covariance, rng, draws=1000):
    """Draws of the linear model's conjugate posterior."""
    weight = np.linalg.inv(covariance)
    spread = np.linalg.inv(SHAPES.T @ weight @ SHAPES + np.diag(PRIOR_SD**-2.0))
    mean = spread @ SHAPES.T @ weight @ data
    return mean + rng.standard_normal((draws, 4)) @ np.linalg.cholesky(spread).T


def test_probabilities_are_uniform_where_the_model_is_right_and_one_in_a_hundred_is_called_wrong(
    seed,
):
    rng, trials = np.random.default_rng(seed), 160
    lags = np.abs(np.subtract.outer(np.arange(60), np.arange(60)))
    covariance = 0.25 * 0.6**lags
    root = np.linalg.cholesky(covariance)
    found, wrong = [], 0
    for _ in range(trials):
        data = SHAPES @ (PRIOR_SD * rng.standard_normal(4)) + root @ rng.standard_normal(60)
        check = predictive_check(
            data,
            linear_posterior(data, covariance, rng) @ SHAPES.T,
            covariance,
            rng=rng,
            replicates=400,
        )
        found.append([check.chi_squared, check.runs, check.neighbours])
        wrong += check.flags != ()
    found = np.array(found)
    # A uniform number has mean 1/2 and variance 1/12; its square about the mean has variance 1/180.
    assert np.all(np.abs(found.mean(0) - 0.5) < 4.5 / np.sqrt(12 * trials))
    assert np.all(np.abs(((found - 0.5) ** 2).mean(0) - 1 / 12) < 4.5 / np.sqrt(180 * trials))
    counts = np.array([np.histogram(one, bins=10, range=(0, 1))[0] for one in found.T])
    assert np.all(chi2.sf(((counts - trials / 10) ** 2 / (trials / 10)).sum(1), 9) > 1e-5)
    assert wrong <= binom.ppf(1 - 1e-5, trials, 0.01)


def test_a_weak_slope_that_chi_squared_misses_is_told_by_its_neighbours():
    """Light rising by 0.6 standard deviations to either side, fitted by a level: the residuals keep
    their sign.
    """
    told = {"chi_squared": 0, "structure": 0, "flags": 0}
    for trial in range(15):
        rng = np.random.default_rng(trial)
        place = np.linspace(-1.0, 1.0, 400)
        data = 10.0 + 0.6 * place + rng.standard_normal(400)
        level = data.mean() + rng.standard_normal(500) / 20.0
        check = predictive_check(
            data, np.tile(level[:, None], (1, 400)), np.ones(400), rng=rng, replicates=500
        )
        told["chi_squared"] += check.chi_squared < 0.01
        told["structure"] += min(check.runs, check.neighbours) < 0.01
        told["flags"] += check.flags == ("model-misfit",)
    assert told["structure"] >= 12
    assert told["flags"] >= 12
    assert told["chi_squared"] <= 12


def bloom(points, radius):
    """Gaussian core and halo disc: amplitude, width, halo level, halo radius."""
    amplitude, width, halo, edge = np.moveaxis(points[..., None], -2, 0)
    return amplitude * np.exp(-0.5 * (radius / width) ** 2) + halo / (
        1.0 + np.exp((radius - edge) / 0.5)
    )


@pytest.mark.parametrize(
    "censored", [False, True], ids=["saturated core as data", "saturation in the model"]
)
def test_a_saturated_bloom_fitted_as_data_converges_soundly_on_a_wrong_model(censored, seed):
    """Reference: section 5.3: amplitude 5000, width 2, halo 40, radius 24; full scale 255,
    noise 2.
    """
    rng = np.random.default_rng(seed)
    radius = np.sort(np.sqrt(rng.uniform(0.0, 40.0**2, 2000)))
    truth = np.array([5000.0, 2.0, 40.0, 24.0])
    sd = np.where(bloom(truth, radius) < 255.0, 2.0, 0.5)
    data = np.minimum(bloom(truth, radius), 255.0) + sd * rng.standard_normal(2000)

    def mean(points):
        full = bloom(points, radius)
        return np.minimum(full, 255.0) if censored else full

    def log_probability(points):
        inside = np.all((points > bounds[:, 0]) & (points < bounds[:, 1]), axis=1)
        residual = (data - mean(np.where(inside[:, None], points, truth))) / sd
        return np.where(inside, -0.5 * (residual**2).sum(1), -np.inf)

    bounds = np.array([[10.0, 20000.0], [0.2, 20.0], [1.0, 200.0], [5.0, 38.0]])
    start = truth if censored else np.array([259.0, 4.3, 34.0, 24.7])
    peak, covariance = find_maximum(log_probability, start, bounds)
    posterior = sample(
        log_probability,
        names=("amplitude", "width", "halo", "radius"),
        units=("DN", "px", "DN", "px"),
        start=peak,
        covariance=covariance,
        seed=1,
        bounds=bounds,
        draws=500,
    )
    assert posterior.flags == ()
    check = predictive_check(data, mean(posterior.draws), sd, rng=rng, replicates=500)
    off = abs(posterior["width"].mean() - 2.0) / posterior["width"].std()
    if censored:
        assert check.flags == ()
        assert off < 4.5
    else:
        assert check.flags == ("model-misfit",)
        assert off > 50


@pytest.mark.parametrize("gamma", [1.0, 0.45])
def test_an_edge_through_a_gamma_is_no_symmetric_edge(gamma, seed):
    """Reference: section 5.1: gamma 0.45 at contrast 0.02 to 1 moves MTF50 by -9 % and skews the
    edge.
    """
    rng = np.random.default_rng(seed)
    distance = np.linspace(-8.0, 8.0, 300)
    data = 200.0 * (0.02 + 0.98 * norm.cdf(distance)) ** gamma + 0.4 * rng.standard_normal(300)

    def mean(points):
        low, high, centre, width = np.moveaxis(points[..., None], -2, 0)
        return low + (high - low) * norm.cdf((distance - centre) / width)

    def log_probability(points):
        return -0.5 * (((data - mean(points)) / 0.4) ** 2).sum(1)

    low, high = 200.0 * 0.02**gamma, 200.0
    peak, covariance = find_maximum(
        log_probability, [low, high, 0.0, 1.1], [[-50, 150], [100, 300], [-4, 4], [0.3, 5]]
    )
    draws = rng.multivariate_normal(peak, covariance, 500)
    check = predictive_check(data, mean(draws), np.full(300, 0.4), rng=rng)
    assert check.flags == (() if gamma == 1.0 else ("model-misfit",))


@pytest.mark.parametrize(
    ("data", "predictions", "noise", "sentence"),
    [
        (np.zeros(5), np.zeros((10, 4)), np.ones(5), "predictions must be"),
        (np.zeros(5), np.zeros((10, 5)), np.zeros(5), "must be positive"),
        (np.zeros(5), np.zeros((10, 5)), -np.eye(5), "positive definite"),
        (np.zeros(5), np.full((10, 5), np.nan), np.ones(5), "finite"),
        (np.zeros(5), np.zeros((10, 5)), np.ones((2, 5)), "the noise must be"),
    ],
)
def test_what_does_not_fit_is_refused_in_a_sentence(data, predictions, noise, sentence):
    with pytest.raises(BadInput, match=sentence):
        predictive_check(data, predictions, noise, rng=np.random.default_rng(0))
