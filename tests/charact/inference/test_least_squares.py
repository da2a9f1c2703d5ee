"""Least squares finds optima inside and on bounds; Laplace's evidence is that of the Gaussian
integral.
"""

import numpy as np
import pytest
from scipy.special import ndtr

from charact.inference import (
    covariance_at,
    least_squares,
    linearise_residual,
    ln_evidence,
    weigh_by_evidence,
)

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
