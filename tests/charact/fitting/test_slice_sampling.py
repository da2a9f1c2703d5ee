"""Slice sampling finds the moments of known posteriors, curved ones included."""

import numpy as np
import pytest

from charact.fitting import slice_sample


def test_a_curved_ridge_keeps_its_width(seed: int) -> None:
    """x normal, y = x^2 + 0.05 of noise in six dimensions: mean of y is 1, its variance 2."""

    def log_probability(points):
        ridge = (points[:, 1] - points[:, 0] ** 2) / 0.05
        return -0.5 * (points[:, 0] ** 2 + ridge**2 + (points[:, 2:] ** 2).sum(axis=1))

    found = slice_sample(
        log_probability,
        names=tuple("abcdef"),
        point=np.zeros(6),
        covariance=np.diag([1.0, 2.0, 1, 1, 1, 1]),
        bounds=np.tile([-np.inf, np.inf], (6, 1)),
        seed=seed,
    )
    x, y = found.draws[:, 0], found.draws[:, 1]
    assert abs(x.mean()) < 4.5 / np.sqrt(x.size)
    assert (y - x**2).std() == pytest.approx(0.05, rel=4.5 / np.sqrt(2.0 * y.size))


def test_many_parameters_at_their_bounds_are_drawn(seed: int) -> None:
    """Of twenty half-normal coordinates one draw in a million about the peak has all inside;
    variances are 1 - 2/pi.
    """
    count = 20

    def log_probability(points):
        return np.where((points >= 0.0).all(axis=1), -0.5 * (points**2).sum(axis=1), -np.inf)

    found = slice_sample(
        log_probability,
        names=tuple("abcdefghijklmnopqrst"),
        point=np.zeros(count),
        covariance=np.eye(count),
        bounds=np.tile([0.0, np.inf], (count, 1)),
        seed=seed,
    )
    sd = np.sqrt(1.0 - 2.0 / np.pi)
    away = (found.draws.mean(axis=0) - np.sqrt(2.0 / np.pi)) / sd * np.sqrt(len(found.draws))
    assert np.abs(away).max() < 4.5
    assert abs(float(np.mean(found.draws.var(axis=0))) / sd**2 - 1.0) < 4.5 * np.sqrt(
        2.869 / found.draws.size
    )
