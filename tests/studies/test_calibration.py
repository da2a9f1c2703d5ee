"""Ranks of truths are uniform where posteriors are right, and told where they are too sure, too shy
or off.
"""

import numpy as np

from benchmarks.studies.edge_ranks import Calibration, calibrate
from charact.inference import sample

DATA = 5


def calibration(*, spread=1.0, shift=0.0, trials=400, seed=1) -> Calibration:
    """Mean of five normal data under a normal prior: the posterior is normal with precision 1 +
    5.
    """

    def posterior(data, seed):
        rng = np.random.default_rng(seed)
        mean, sd = data.sum(axis=0) / (DATA + 1), 1.0 / np.sqrt(DATA + 1)
        return mean + shift * sd + spread * sd * rng.standard_normal((119, 2))

    return calibrate(
        lambda rng: rng.standard_normal(2),
        lambda truth, rng: truth + rng.standard_normal((DATA, 2)),
        posterior,
        names=("first", "second"),
        trials=trials,
        seed=seed,
    )


def test_the_conjugate_posterior_of_a_normal_mean_is_calibrated(seed):
    right = calibration(seed=seed)
    assert right.probability > 1e-4
    assert right.flagged == 0
    for level in (0.68, 0.95):
        assert np.all(
            np.abs(right.coverage(level) - level)
            < 4.5 * np.sqrt(level * (1 - level) / 400) + 1 / 120
        )


def test_draws_too_narrow_put_truths_at_the_ends_and_too_wide_ones_in_the_middle(seed):
    sure, shy = calibration(spread=0.6, seed=seed), calibration(spread=1.7, seed=seed)
    assert sure.probability < 1e-6
    assert shy.probability < 1e-6
    for name in sure.names:
        narrow, wide = sure.histogram(name), shy.histogram(name)
        assert narrow[[0, -1]].min() > sure.band()[1]
        assert wide[[0, -1]].max() < shy.band()[0]
    assert np.all(sure.coverage(0.68) < 0.6)


def test_the_engine_is_calibrated_for_a_mean_and_a_scale_from_twelve_numbers(seed):
    low, high = np.array([-3.0, -1.0]), np.array([3.0, 1.0])

    def posterior(data, seed):
        def log_probability(points):
            mean, log_sd = points[:, :1], points[:, 1:]
            inside = np.all((points > low) & (points < high), axis=1)
            value = (-0.5 * ((data - mean) / np.exp(log_sd)) ** 2 - log_sd).sum(1)
            return np.where(inside, value, -np.inf)

        start = np.clip([data.mean(), np.log(data.std())], 0.95 * low, 0.95 * high)
        found = sample(
            log_probability,
            names=("mean", "log sd"),
            units=("1", "1"),
            start=start,
            covariance=0.05 * np.eye(2),
            seed=seed,
            bounds=np.stack([low, high], axis=1),
            draws=119,
        )
        assert "not-converged" not in found.flags
        return found.draws

    result = calibrate(
        lambda rng: rng.uniform(low, high),
        lambda truth, rng: rng.normal(truth[0], np.exp(truth[1]), 12),
        posterior,
        names=("mean", "log sd"),
        trials=20,
        seed=seed,
    )
    assert result.probability > 1e-4
    # A uniform rank has mean 1/2 and variance 1/12.
    place = (result.ranks + 0.5) / 120
    assert np.all(np.abs(place.mean(0) - 0.5) < 4.5 / np.sqrt(12 * 20))
    assert np.all(np.abs(((place - 0.5) ** 2).mean(0) - 1 / 12) < 4.5 * np.sqrt(1 / 180 / 20))
