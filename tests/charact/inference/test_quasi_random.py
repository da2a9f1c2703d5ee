"""Even normal numbers are normal, independent of each other, the same from the same seed, and tell
quantiles better.
"""

import numpy as np
import pytest
from scipy import stats

from charact.inference import draw_truncated_gaussian, quasi_random_normals
from charact.inference.laplace_approximation import BASES, LONGEST

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
