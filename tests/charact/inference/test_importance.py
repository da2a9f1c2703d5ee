"""Draws picked by their weight are those of the posterior, however bent it is; a mixture too thin
says so.
"""

import numpy as np
import pytest

from charact.inference import importance, importance_sample


def drawn(log_probability, count, *, seed, bounds=None, draws=4000, **options):
    return importance_sample(
        log_probability,
        names=tuple(f"p{index}" for index in range(count)),
        units=("1",) * count,
        start=np.full(count, 0.1),
        covariance=0.2 * np.eye(count),
        seed=seed,
        bounds=np.tile([-np.inf, np.inf], (count, 1)) if bounds is None else bounds,
        draws=draws,
        **options,
    )


def banana(points):
    """A normal of unit variance bent along a parabola: y - x^2 has the deviation 0.1."""
    return -0.5 * points[:, 0] ** 2 - 0.5 * ((points[:, 1] - points[:, 0] ** 2) / 0.1) ** 2


def test_a_bent_ridge_has_its_moments(seed):
    found = drawn(banana, 2, seed=seed)
    assert found.sampler == "importance"
    independent = found.effective_sample_size[0]
    assert independent >= 3000
    across = (found["p1"] - found["p0"] ** 2) / 0.1
    for values in (found["p0"], across):
        assert values.mean() == pytest.approx(0.0, abs=4.5 / np.sqrt(independent))
        assert values.var() == pytest.approx(1.0, abs=4.5 * np.sqrt(2.0 / independent))


def test_mass_at_walls_is_that_of_the_cut_density(seed):
    """exp(-x) between 0 and 2: mean 1 - 2/(e^2 - 1); the flag says that it leans on the wall."""
    bounds = np.array([[0.0, 2.0], [0.0, 2.0]])
    found = drawn(lambda points: -points.sum(axis=1), 2, seed=seed, bounds=bounds)
    sd = np.sqrt(1.0 - 4.0 * np.exp(2.0) / (np.exp(2.0) - 1.0) ** 2)
    error = 4.5 * sd / np.sqrt(found.effective_sample_size[0])
    assert np.allclose(found.draws.mean(axis=0), 1.0 - 2.0 / (np.exp(2.0) - 1.0), atol=error)
    assert found.flags == ("prior-bound",)


def test_a_mixture_that_may_not_grow_admits_how_few_draws_it_is_worth(monkeypatch):
    monkeypatch.setattr(importance, "MOST_ADDED", 0)
    assert (
        drawn(lambda points: banana(points * [0.1, 1.0]), 2, seed=1).effective_sample_size[0] < 1000
    )


def test_draws_are_picked_as_often_as_they_weigh_but_for_one_and_in_random_order(seed):
    rng = np.random.default_rng(seed)
    weight = rng.exponential(size=300)
    weight /= weight.sum()
    picked = importance._pick_draws(np.random.default_rng(seed), weight, 1000)
    assert np.abs(np.bincount(picked, minlength=300) - 1000 * weight).max() < 1
    # A first part is like the whole: its mean place is the whole's, within four standard errors.
    assert picked[:200].mean() == pytest.approx(picked.mean(), abs=4 * picked.std() / np.sqrt(200))


def test_few_draws_to_begin_with_do_as_well(seed):
    found = drawn(banana, 2, seed=seed, first_draws=100)
    independent = found.effective_sample_size[0]
    assert independent >= 3000
    assert found["p0"].mean() == pytest.approx(0.0, abs=4.5 / np.sqrt(independent))


def test_a_posterior_that_no_draw_comes_near_ends_with_few_effective_draws():
    """A peak ten million times narrower than the curvature says, in 15 directions; it ended in a
    NaN.
    """

    def far(points):
        return -0.5e15 * np.sum((points - 3.0) ** 2, axis=1)

    found = drawn(far, 15, seed=1, draws=500, enough=300.0, first_draws=1000)
    assert np.isfinite(found.draws).all()
    assert found.effective_sample_size[0] < 100.0
