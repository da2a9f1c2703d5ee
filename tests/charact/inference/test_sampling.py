"""Draws by importance where they are enough, by Markov chain where they are not: the same posterior
either way.
"""

import numpy as np
import pytest

from charact.inference import importance, sample_posterior, sampling


def banana(points):
    """A normal of unit variance bent along a parabola: y - x^2 has the deviation 0.1."""
    return -0.5 * points[:, 0] ** 2 - 0.5 * ((points[:, 1] - points[:, 0] ** 2) / 0.1) ** 2


def two_peaks(points):
    """Two normals of unit variance, 7 apart, of which the second holds a third."""
    off = points - np.array([7.0, 0.0])
    return np.logaddexp(
        -0.5 * np.sum(points**2, axis=1), np.log(0.5) - 0.5 * np.sum(off**2, axis=1)
    )


def drawn(log_probability, seed, **options):
    return sample_posterior(
        log_probability,
        names=("x", "y"),
        units=("1", "1"),
        start=np.zeros(2),
        covariance=np.eye(2),
        seed=seed,
        bounds=np.tile([-np.inf, np.inf], (2, 1)),
        draws=4000,
        **options,
    )


def test_a_bent_ridge_is_drawn_by_importance_alone(seed, monkeypatch):
    monkeypatch.setattr(sampling, "sample", None)
    found = drawn(banana, seed)
    assert found.sampler == "importance"
    assert found.effective_sample_size.min() >= sampling.ENOUGH
    assert found.flags == ()
    count = float(found.effective_sample_size.min())
    for values in (found["x"], (found["y"] - found["x"] ** 2) / 0.1):
        assert values.mean() == pytest.approx(0.0, abs=4.5 / np.sqrt(count))
        assert values.var() == pytest.approx(1.0, abs=4.5 * np.sqrt(2.0 / count))


def test_where_weighted_draws_are_too_few_a_markov_chain_takes_over(seed, monkeypatch):
    """A normal of a twentieth of the width that it was said to have, of a mixture that may not grow
    to fit it.
    """
    monkeypatch.setattr(importance, "MOST_ADDED", 0)
    found = drawn(lambda points: -0.5 * np.sum((points / 0.05) ** 2, axis=1), seed)
    assert found.sampler == "emcee"
    assert "not-converged" not in found.flags
    count = min(float(found.effective_sample_size.min()), len(found.draws))
    assert np.allclose(found.draws.mean(axis=0) / 0.05, 0.0, atol=4.5 / np.sqrt(count))
    assert np.allclose(found.draws.var(axis=0) / 0.05**2, 1.0, atol=4.5 * np.sqrt(2.0 / count))


def test_two_peaks_are_drawn_by_their_weight_and_told(seed):
    found = drawn(two_peaks, seed)
    assert found.sampler == "importance"
    assert found.flags == ("several-modes",)
    share, count = float(np.mean(found["x"] > 3.5)), float(found.effective_sample_size.min())
    assert share == pytest.approx(1.0 / 3.0, abs=4.5 * np.sqrt(2.0 / 9.0 / count))


def test_a_chain_may_be_given_up_after_so_many_steps(seed, monkeypatch):
    monkeypatch.setattr(sampling, "ENOUGH", np.inf)
    assert "not-converged" in drawn(banana, seed, max_steps=20).flags
