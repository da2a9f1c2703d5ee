"""Least squares, its Laplace approximation, importance sampling and quasi-random points."""

import numpy as np
import pytest
from scipy import stats
from scipy.special import ndtr

from charact.inference import (
    covariance_at,
    draw_truncated_gaussian,
    find_maximum,
    importance,
    importance_sample,
    laplace,
    least_squares,
    linearise_residual,
    ln_evidence,
    quasi_random_normals,
    sample_posterior,
    weigh_by_evidence,
)
from charact.inference.laplace_approximation import BASES, LONGEST

# Least squares finds optima inside and on bounds; Laplace's evidence is that of the Gaussian
# integral.


TIMES = np.linspace(0.0, 4.0, 60)
BOUNDS = np.array([[-3.0, 3.0], [0.1, 10.0]])


def decay(data, mean=(0.0, 0.0), precision=(0.0, 0.0)):
    """A decay exp(p0) exp(-t / p1)."""

    def linearise(point):
        model = np.exp(point[0] - TIMES / point[1])
        jacobian = np.stack([model, model * TIMES / point[1] ** 2])
        return linearise_residual(
            data - model, jacobian, np.asarray(mean) - point, precision, model
        )

    return linearise


@pytest.mark.parametrize("start", [(-2.0, 9.0), (2.5, 0.2), (0.0, 1.0)])
def test_the_optimum_is_found_from_far(start):
    found = least_squares(decay(np.exp(0.7 - TIMES / 1.5)), start, BOUNDS, tolerance=1e-12)
    assert found.point == pytest.approx([0.7, 1.5], abs=1e-4)
    assert found.at.model == pytest.approx(np.exp(0.7 - TIMES / 1.5), abs=1e-4)


def test_a_parameter_stays_within_its_bounds_and_one_without_range_is_held():
    data = np.exp(0.7 - TIMES / 1.5)
    on_bound = least_squares(decay(data), (0.0, 1.0), [[-3.0, 0.2], [0.1, 10.0]])
    assert on_bound.point[0] == 0.2 and on_bound.at.gradient[0] > 0
    held = least_squares(decay(data), (0.5, 1.0), [[0.5, 0.5], [0.1, 10.0]])
    assert held.point[0] == 0.5 and held.at.gradient[1] == pytest.approx(0.0, abs=1e-3)


def test_priors_pull_and_undetermined_parameters_keep_their_range():
    found = least_squares(decay(np.zeros(60), (1.0, 2.0), (1e8, 1e8)), (0.0, 1.0), BOUNDS)
    assert found.point == pytest.approx([1.0, 2.0], abs=1e-3)
    covariance = covariance_at(np.diag([4.0, 0.0]), BOUNDS)
    assert np.diag(covariance) == pytest.approx([0.25, 9.9**2 / 12.0])


def test_amplitudes_after_the_parameters_are_marginalised():
    normal = np.array([[4.0, 1.0], [1.0, 2.0]])
    assert covariance_at(normal, BOUNDS[:1])[0, 0] == pytest.approx(np.linalg.inv(normal)[0, 0])


def test_the_evidence_of_a_gaussian_is_its_integral_between_the_bounds():
    covariance = np.array([[0.25]])
    whole = 0.5 * np.log(2.0 * np.pi * 0.25)
    assert ln_evidence(-3.0, covariance) == pytest.approx(-3.0 + whole)
    bounds = np.array([[-0.5, 9.0]])
    inside = ln_evidence(-3.0, covariance, np.zeros(1), bounds)
    assert inside == pytest.approx(-3.0 + whole + np.log(ndtr(1.0)))
    # On a bound, one standard deviation below which the optimum would lie: gradient 1 / sd.
    pressed = ln_evidence(-3.0, covariance, np.array([-0.5]), bounds, np.array([-2.0]))
    assert pressed == pytest.approx(-3.0 + whole + 0.5 + np.log(ndtr(-1.0)))


def test_models_weigh_as_their_evidence():
    assert weigh_by_evidence([0.0, np.log(3.0), -50.0], min_weight=1e-6) == [
        (1, pytest.approx(0.75)),
        (0, pytest.approx(0.25)),
    ]
    assert weigh_by_evidence([0.0, np.log(9.0)], power=0.5)[0][1] == pytest.approx(0.75)


# The peak and its curvature, found without derivatives.


def gaussian(mean, covariance):
    inverse = np.linalg.inv(covariance)
    return lambda points: -0.5 * np.einsum("ni,ij,nj->n", points - mean, inverse, points - mean)


def test_peak_and_covariance_of_a_gaussian_are_its_own():
    root = np.random.default_rng(1).normal(size=(5, 5)) * 10.0 ** np.arange(-2.0, 3.0)[:, None]
    covariance, mean = root @ root.T, np.arange(5.0)
    point, found = find_maximum(
        gaussian(mean, covariance), mean + 0.5 * np.sqrt(np.diag(covariance))
    )
    assert np.allclose(point, mean, atol=1e-4 * np.sqrt(np.diag(covariance)))
    assert np.allclose(found, covariance, rtol=1e-3, atol=1e-6 * np.abs(covariance).max())


def test_peak_of_the_banana_is_reached_around_its_bend():
    def banana(points):
        return -0.5 * ((1 - points[:, 0]) ** 2 + 100 * (points[:, 1] - points[:, 0] ** 2) ** 2)

    point, covariance = find_maximum(banana, [-1.5, 2.0])
    assert banana(point[None])[0] > -0.01
    # Inverse of the Hessian at (1, 1) of this function: [[1, 2], [2, 4.01]].
    assert np.allclose(covariance, [[1.0, 2.0], [2.0, 4.01]], rtol=0.2)


def test_peak_beyond_a_wall_is_found_at_the_wall():
    def walled(points):
        return np.where(
            points[:, 0] < 0, -np.inf, -0.5 * (points[:, 0] + 0.5) ** 2 - 0.5 * points[:, 1] ** 2
        )

    point, covariance = find_maximum(walled, [1.0, 1.0], [[0.0, 10.0], [-10.0, 10.0]])
    assert point[0] == 0.0
    assert abs(point[1]) < 1e-3
    assert np.allclose(covariance, np.eye(2), atol=1e-3)


def test_a_direction_without_curvature_spreads_over_its_bounds():
    _, covariance = find_maximum(
        lambda points: -0.5 * points[:, 0] ** 2, [0.1, 1.0], [[-5.0, 5.0], [0.0, 2.0]]
    )
    assert covariance[1, 1] == pytest.approx(4.0 / 12.0, rel=1e-6)


def test_a_direction_without_curvature_keeps_each_parameter_in_its_range():
    """Of two parameters that are seen through their sum alone, the bounded one holds back the
    other.
    """

    def of_the_sum(points):
        return -0.5 * ((points[:, 0] + 1e-3 * points[:, 1] - 1.0) / 1e-3) ** 2

    _, covariance = find_maximum(of_the_sum, [1.0, 0.2], [[0.0, np.inf], [-0.5, 1.0]])
    assert np.sqrt(covariance[1, 1]) < 1.01 * 1.5 / np.sqrt(12.0)
    assert np.sqrt(covariance[0, 0]) < 2e-3


def test_a_start_that_cannot_be_is_refused():
    with pytest.raises(ValueError, match="finite log-probability"):
        find_maximum(lambda points: np.full(len(points), -np.inf), [0.0])


def test_laplace_draws_stay_inside_the_bounds_and_say_that_they_lean_on_one():
    posterior = laplace(
        lambda points: -0.5 * points[:, 0] ** 2,
        names=("level",),
        units=("DN",),
        start=[0.0],
        seed=3,
        bounds=[[0.0, 9.0]],
    )
    assert posterior["level"].min() >= 0.0
    assert posterior.flags == ("prior-bound",)
    assert posterior.sampler == "laplace"
    # Half a normal distribution: mean sqrt(2 / pi), to 4.5 standard errors.
    assert posterior["level"].mean() == pytest.approx(
        np.sqrt(2 / np.pi), abs=4.5 * 0.603 / np.sqrt(1000)
    )


# Even normal numbers are normal, independent of each other, the same from the same seed, and tell
# quantiles better.


WIDE = np.tile([-np.inf, np.inf], (4, 1))


@pytest.mark.parametrize("count", [500, LONGEST + 700])
def test_every_column_is_normal_and_more_evenly_so_than_chance(count, seed):
    """Kolmogorov's distance, which random numbers pass at 1.36 / sqrt(n) once in twenty, stays
    below half of that.
    """
    drawn = quasi_random_normals(np.random.default_rng(seed), count, len(BASES))
    for column in drawn.T:
        assert stats.kstest(column, "norm").statistic < 0.5 * 1.36 / np.sqrt(count)


def test_columns_know_nothing_of_each_other(seed):
    """Neither they nor their squares go together, those beyond the sequence included."""
    drawn = quasi_random_normals(np.random.default_rng(seed), 4000, len(BASES) + 2)
    for power in (drawn, drawn**2):
        correlation = np.corrcoef(power.T) - np.eye(drawn.shape[1])
        assert np.abs(correlation).max() < 4.5 / np.sqrt(4000)


def test_columns_beyond_the_sequence_are_random_ones(seed):
    drawn = quasi_random_normals(np.random.default_rng(seed), 4000, len(BASES) + 1)[:, -1]
    assert stats.kstest(drawn, "norm").pvalue > 1e-4


def test_the_same_seed_draws_the_same():
    one, other, third = (quasi_random_normals(np.random.default_rng(s), 300, 3) for s in (4, 4, 5))
    assert np.array_equal(one, other)
    assert not np.isclose(one, third).any()


def test_quantiles_of_few_draws_scatter_half_as_much(seed):
    """The 97.5 % quantile of the second parameter of 500 draws, which all others go with, as an
    edge asks for it.
    """
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((4, 4))
    covariance = root @ root.T
    scatter = {}
    for even in (False, True):
        drawn = [
            draw_truncated_gaussian(
                np.random.default_rng([seed, i]),
                np.zeros(4),
                covariance,
                WIDE,
                500,
                quasi_random=even,
            )[:, 1]
            for i in range(200)
        ]
        ends = np.quantile(drawn, 0.975, axis=1) / np.sqrt(covariance[1, 1])
        assert ends.mean() == pytest.approx(1.96, abs=0.03)
        scatter[even] = ends.std()
    assert scatter[True] < 0.5 * scatter[False]


def test_even_draws_keep_to_the_covariance_and_to_the_walls(seed):
    covariance = np.array([[2.0, -0.9], [-0.9, 0.5]])
    drawn = draw_truncated_gaussian(
        np.random.default_rng(seed), np.zeros(2), covariance, WIDE[:2], 4000, quasi_random=True
    )
    assert np.cov(drawn.T) == pytest.approx(covariance, rel=0.02)
    walls = np.array([[0.0, np.inf], [-np.inf, np.inf]])
    half = draw_truncated_gaussian(
        np.random.default_rng(seed), np.zeros(2), covariance, walls, 4000, quasi_random=True
    )
    assert half.shape == (4000, 2)
    assert half[:, 0].min() >= 0
    # The mean of half a normal is sqrt(2 / pi) deviations; what goes with it follows.
    assert half.mean(axis=0) == pytest.approx(
        np.sqrt(2 / np.pi) * np.array([1.0, -0.45]) * np.sqrt(2.0), rel=0.02
    )


def test_a_singular_covariance_is_drawn_from_too(seed):
    along = np.array([1.0, -2.0, 0.5])
    drawn = draw_truncated_gaussian(
        np.random.default_rng(seed),
        np.zeros(3),
        np.outer(along, along),
        WIDE[:3],
        500,
        quasi_random=True,
    )
    assert drawn == pytest.approx(np.outer(drawn[:, 0], along), abs=1e-6)
    assert drawn[:, 0].std() == pytest.approx(1.0, rel=0.03)


# Draws picked by their weight are those of the posterior, however bent it is; where they are too
# few a Markov chain takes over.


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
