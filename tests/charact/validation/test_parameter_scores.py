"""Errors of parameters are estimated without bias, with the error that they have, and found as
often as stated.
"""

import numpy as np
import pytest
from numpy.typing import NDArray

from charact.validation.parameter_scores import ParameterScores, parameter_scores

SIZE, SETS = 40, 24
# Numbers of correlated noise; two parameters, of which the second moves few numbers.
ROOT = np.linalg.cholesky(0.5 * np.eye(SIZE) + 0.5) * np.linspace(0.2, 5.0, SIZE)[:, None]
CHANGES = np.stack([np.linspace(-10.0, 20.0, SIZE), np.where(np.arange(SIZE) < 4, 8.0, 0.0)])


def _scores(rng: np.random.Generator) -> ParameterScores:
    return parameter_scores(("first", "second"), CHANGES, _sets(rng, SETS), np.zeros(SIZE))


def _sets(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    return rng.standard_normal((count, SIZE)) @ ROOT.T


def test_an_error_of_a_parameter_is_estimated_without_bias_and_with_its_standard_deviation(
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    found, pulls = [], []
    for _ in range(200):
        scores = _scores(rng)
        found.append(scores.estimates(_sets(rng, 1)[0] + 0.3 * CHANGES[0])[0])
        pulls.append((found[-1] - 0.3) / scores.sd[0])
    assert np.mean(found) == pytest.approx(0.3, abs=4.5 * np.std(found) / np.sqrt(200))
    # A deviation over an estimated one of 23 degrees of freedom varies by 23 / 21.
    assert np.var(pulls) == pytest.approx(23.0 / 21.0, rel=4.5 * np.sqrt(2.4 / 200) + 0.1)


def test_the_estimate_of_white_numbers_is_that_of_least_squares(seed: int) -> None:
    """Of uncorrelated numbers the weights are d / s^2 over d^T d / s^2."""
    rng = np.random.default_rng(seed)
    spread = np.linspace(0.5, 2.0, SIZE)
    scores = parameter_scores(
        ("first", "second"), CHANGES, spread * rng.standard_normal((300, SIZE)), np.zeros(SIZE)
    )
    expected = CHANGES / spread**2 / np.sum(CHANGES**2 / spread**2, axis=1, keepdims=True)
    # Variances of 300 sets are known to 8 %, weights so too, and the standard deviation to 4 %.
    assert scores.weights == pytest.approx(expected, abs=4.5 * 0.08 * np.abs(expected).max())
    assert scores.sd == pytest.approx(
        np.sum(CHANGES**2 / spread**2, axis=1) ** -0.5, rel=4.5 * 0.041 + 0.05
    )


def test_p_values_of_right_simulations_are_no_smaller_than_stated(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p_values = np.array([_scores(rng).p_value(_sets(rng, 1)[0]) for _ in range(200)])
    for at in (0.01, 0.05, 0.2):
        assert np.mean(p_values < at) < at + 4.5 * np.sqrt(at * (1.0 - at) / 200)
    # Two estimates share one level: little of it is lost.
    assert np.mean(p_values < 0.5) > 0.3


def test_power_is_the_fraction_of_moved_sets_that_fail(seed: int) -> None:
    rng = np.random.default_rng(seed)
    level, fractions, expected = 0.01, [], []
    for _ in range(40):
        scores = _scores(rng)
        shift = 4.5 * scores.sd[1] * CHANGES[1]
        expected.append(scores.detects(shift, level))
        fractions.append(np.mean([scores.p_value(one + shift) < level for one in _sets(rng, 20)]))
    assert np.mean(fractions) == pytest.approx(
        np.mean(expected), abs=4.5 * np.std(fractions) / np.sqrt(40) + 0.03
    )
    assert np.mean(expected) > 0.5
    assert scores.detects(np.zeros(SIZE), level) < 2.0 * level
