"""The chain draws known posteriors rightly; how chains deceive is in test_failures.py."""

import numpy as np

from charact.inference import sample


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


def test_kept_draws_scatter_as_independent_ones_do():
    """Their spread errs by 1/sqrt(2 N) from seed to seed, not by that of a few walkers followed
    step by step.
    """
    errors = []
    for seed in range(5):
        posterior = draw(lambda points: -0.5 * (points**2).sum(1), 10, seed=seed, draws=1000)
        errors.append((posterior.draws.std(0) - 1.0) * np.sqrt(2000))
    # 50 errors of variance 1, and of 1/5 more since the chains hold five times as many independent
    # draws.
    assert np.mean(np.square(errors)) < 1.2 * (1.0 + 4.5 * np.sqrt(2 / 50))
