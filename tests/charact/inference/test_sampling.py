"""Draws picked by their weight are those of the posterior, however bent it is; where they are too
few a Markov chain takes over.
"""

import numpy as np
import pytest

from charact.inference import importance, importance_sample, sample_posterior


def banana(points):
    """A normal of unit variance bent along a parabola: y - x^2 has the deviation 0.1."""
    return -0.5 * points[:, 0] ** 2 - 0.5 * ((points[:, 1] - points[:, 0] ** 2) / 0.1) ** 2


def two_peaks(points):
    """Two normals of unit variance, 7 apart, of which the second holds a third."""
    off = points - np.array([7.0, 0.0])
    return np.logaddexp(
        -0.5 * np.sum(points**2, axis=1), np.log(0.5) - 0.5 * np.sum(off**2, axis=1)
    )


def drawn(log_probability, seed, count=2, *, draw=sample_posterior, start=0.0, sd2=1.0, **options):
    given = {"bounds": np.tile([-np.inf, np.inf], (count, 1)), "draws": 4000} | options
    return draw(
        log_probability,
        names=("x", "y", *(f"p{index}" for index in range(2, count))),
        units=("1",) * count,
        start=np.full(count, start),
        covariance=sd2 * np.eye(count),
        seed=seed,
        **given,
    )


WEIGHTED = {"draw": importance_sample, "start": 0.1, "sd2": 0.2}


def test_a_bent_ridge_is_drawn_by_importance_alone(seed, monkeypatch):
    monkeypatch.setattr(importance, "sample", None)
    found = drawn(banana, seed)
    assert found.sampler == "importance"
    assert found.effective_sample_size.min() >= importance.LEAST_EFFECTIVE
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
    monkeypatch.setattr(importance, "LEAST_EFFECTIVE", np.inf)
    assert "not-converged" in drawn(banana, seed, max_steps=20).flags


def test_mass_at_walls_is_that_of_the_cut_density(seed):
    """exp(-x) between 0 and 2: mean 1 - 2/(e^2 - 1); the flag says that it leans on the wall."""
    bounds = np.array([[0.0, 2.0], [0.0, 2.0]])
    found = drawn(lambda points: -points.sum(axis=1), seed, bounds=bounds, **WEIGHTED)
    sd = np.sqrt(1.0 - 4.0 * np.exp(2.0) / (np.exp(2.0) - 1.0) ** 2)
    error = 4.5 * sd / np.sqrt(found.effective_sample_size[0])
    assert np.allclose(found.draws.mean(axis=0), 1.0 - 2.0 / (np.exp(2.0) - 1.0), atol=error)
    assert found.flags == ("prior-bound",)


def test_a_mixture_that_may_not_grow_admits_how_few_draws_it_is_worth(monkeypatch):
    monkeypatch.setattr(importance, "MOST_ADDED", 0)
    found = drawn(lambda points: banana(points * [0.1, 1.0]), 1, **WEIGHTED)
    assert found.effective_sample_size[0] < 1000


def test_draws_are_picked_as_often_as_they_weigh_but_for_one_and_in_random_order(seed):
    rng = np.random.default_rng(seed)
    weight = rng.exponential(size=300)
    weight /= weight.sum()
    picked = importance._pick_draws(np.random.default_rng(seed), weight, 1000)
    assert np.abs(np.bincount(picked, minlength=300) - 1000 * weight).max() < 1
    # A first part is like the whole: its mean place is the whole's, within four standard errors.
    assert picked[:200].mean() == pytest.approx(picked.mean(), abs=4 * picked.std() / np.sqrt(200))


def test_few_draws_to_begin_with_do_as_well(seed):
    found = drawn(banana, seed, first_draws=100, **WEIGHTED)
    independent = found.effective_sample_size[0]
    assert independent >= 3000
    assert found["x"].mean() == pytest.approx(0.0, abs=4.5 / np.sqrt(independent))


def test_a_posterior_that_no_draw_comes_near_ends_with_few_effective_draws():
    """A peak ten million times narrower than the curvature says, in 15 directions; it ended in a
    NaN.
    """

    def far(points):
        return -0.5e15 * np.sum((points - 3.0) ** 2, axis=1)

    found = drawn(far, 1, 15, draws=500, enough=300.0, first_draws=1000, **WEIGHTED)
    assert np.isfinite(found.draws).all()
    assert found.effective_sample_size[0] < 100.0
