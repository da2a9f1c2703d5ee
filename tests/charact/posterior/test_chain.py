"""A chain must prove itself; these are the ways in which chains are known to deceive."""

import numpy as np
import pytest

from charact.posterior import sample


def draw(log_probability, dimensions, *, seed, start=None, covariance=None, **options):
    return sample(
        log_probability,
        names=tuple(f"p{index}" for index in range(dimensions)),
        units=("1",) * dimensions,
        start=np.zeros(dimensions) if start is None else start,
        covariance=np.eye(dimensions) if covariance is None else covariance,
        seed=seed,
        **options,
    )


def test_a_gaussian_of_known_covariance_is_recovered(seed):
    covariance = np.array([[4.0, 1.5, 0.0], [1.5, 1.0, 0.2], [0.0, 0.2, 0.25]])
    mean, inverse = np.array([1.0, -2.0, 5.0]), np.linalg.inv(covariance)

    def gaussian(points):
        return -0.5 * np.einsum("ni,ij,nj->n", points - mean, inverse, points - mean)

    posterior = draw(gaussian, 3, seed=seed, start=mean, covariance=covariance, draws=2000)
    assert posterior.flags == ()
    assert posterior.sampler == "emcee"
    assert np.all(posterior.effective_sample_size > 3000)
    assert np.all(posterior.r_hat < 1.01)
    sd, count = np.sqrt(np.diag(covariance)), len(posterior.draws)
    assert np.all(np.abs(posterior.draws.mean(0) - mean) < 4.5 * sd / np.sqrt(count))
    # The standard error of a covariance of N draws is sqrt((s_ii s_jj + s_ij^2) / N).
    error = np.sqrt((np.outer(sd**2, sd**2) + covariance**2) / count)
    assert np.all(np.abs(np.cov(posterior.draws.T) - covariance) < 4.5 * error)


def test_same_seed_gives_the_same_draws_and_leaves_global_randomness_alone():
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    one, two, other = (draw(lambda p: -0.5 * (p**2).sum(1), 2, seed=s).draws for s in (5, 5, 6))
    assert np.array_equal(one, two)
    assert not np.array_equal(one, other)
    assert np.array_equal(before, np.random.get_state()[1])  # noqa: NPY002


def test_two_equal_modes_far_apart_are_both_found_in_their_true_shares():
    """Reference: section 5.4, modes 3 apart with a standard deviation of 0.1; healthy looking tau and acceptance."""

    def modes(points):
        return np.logaddexp(-0.5 * (points[:, 0] / 0.1) ** 2, -0.5 * ((points[:, 0] - 3.0) / 0.1) ** 2)

    for seed in range(5):
        posterior = draw(modes, 1, seed=seed, covariance=[[0.01]], bounds=[[-5.0, 5.0]], draws=2000)
        assert posterior.flags == ("several-modes",)
        assert (posterior["p0"] > 1.5).mean() == pytest.approx(0.5, abs=4.5 * 0.5 / np.sqrt(1000))


def test_walkers_that_never_leave_their_mode_are_no_converged_chain():
    def modes(points):
        return np.logaddexp(-0.5 * (points[:, 0] / 0.1) ** 2, -0.5 * ((points[:, 0] - 300.0) / 0.1) ** 2)

    posterior = draw(modes, 1, seed=1, covariance=[[5000.0]], max_steps=600)
    assert "not-converged" in posterior.flags


def test_ten_dimensions_of_scales_one_to_a_hundred_from_a_tight_start_are_given_up_while_unconverged():
    """Reference: section 5.4, where the estimated tau still grows with the chain and the spread is a quarter."""
    scales = np.logspace(0, 2, 10)

    def gaussian(points):
        return -0.5 * ((points / scales) ** 2).sum(1)

    posterior = draw(gaussian, 10, seed=1, covariance=1e-4 * np.eye(10), max_steps=500)
    assert posterior.sampler == "laplace"
    assert "not-converged" in posterior.flags
    proper = draw(gaussian, 10, seed=1, covariance=np.diag(scales**2), draws=1000)
    assert proper.flags == ()
    assert np.allclose(proper.draws.std(0) / scales, 1.0, atol=4.5 / np.sqrt(2000))


def test_a_wall_is_reported_where_the_peak_lies_beyond_it():
    """Reference: section 5.4, peak at -0.5 and wall at 0: mean .63, standard deviation .51."""

    def walled(points):
        return np.where(points[:, 0] < 0, -np.inf, -0.5 * (points[:, 0] + 0.5) ** 2)

    posterior = draw(walled, 1, seed=2, start=[0.05], bounds=[[0.0, 8.0]], draws=2000)
    assert posterior.flags == ("prior-bound",)
    assert posterior["p0"].mean() == pytest.approx(0.641, abs=0.05)
    free = draw(lambda points: -0.5 * (points[:, 0] - 4.0) ** 2, 1, seed=2, start=[4.0], bounds=[[0.0, 8.0]])
    assert free.flags == ()


def test_ranks_of_the_truth_among_its_draws_are_uniform(seed):
    """Simulation-based calibration of a mean and a scale from 12 numbers (Talts et al. 2018)."""
    rng = np.random.default_rng(seed)
    ranks = []
    for trial in range(30):
        truth = np.array([rng.uniform(-3, 3), rng.uniform(-1, 1)])
        data = rng.normal(truth[0], np.exp(truth[1]), 12)

        def log_probability(points, data=data):
            mean, scale = points[:, :1], points[:, 1:]
            inside = np.all((points > [-3, -1]) & (points < [3, 1]), axis=1)
            value = (-0.5 * ((data - mean) / np.exp(scale)) ** 2 - scale).sum(1)
            return np.where(inside, value, -np.inf)

        start = np.clip([data.mean(), np.log(data.std())], [-2.9, -0.9], [2.9, 0.9])
        posterior = draw(
            log_probability,
            2,
            seed=trial,
            start=start,
            covariance=0.05 * np.eye(2),
            bounds=[[-3, 3], [-1, 1]],
            draws=400,
        )
        ranks.append((posterior.draws < truth).mean(0))
    ranks = np.array(ranks)
    # A uniform rank has mean 1/2 and variance 1/12.
    assert np.all(np.abs(ranks.mean(0) - 0.5) < 4.5 / np.sqrt(12 * 30))
    assert np.all(np.abs(((ranks - 0.5) ** 2).mean(0) - 1 / 12) < 4.5 * np.sqrt(1 / 180 / 30))
