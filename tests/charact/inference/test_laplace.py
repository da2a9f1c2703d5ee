"""The peak and its curvature, found without derivatives."""

import numpy as np
import pytest

from charact.inference import find_maximum, laplace


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
