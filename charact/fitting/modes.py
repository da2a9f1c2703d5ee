"""Modes of a posterior whose logarithm is a sum of squares, by Gauss-Newton steps from several
starts.

    -2 ln p(x) = sum_i r_i(x)^2,  covariance about a mode (J'J)^-1,  J = dr/dx
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from charact.fitting.thresholds import MODES
from charact.inference.gauss_newton import (
    Linearisation,
    covariance_at,
    least_squares,
    linearise_residual,
    ln_evidence,
)
from labdata import Array

Residuals = Callable[[Array], Array]


@dataclass(frozen=True, kw_only=True)
class Mode:
    """A maximum of a posterior."""

    point: Array  # shape (parameter,)
    covariance: Array  # inverse curvature there, shape (parameter, parameter)
    log_evidence: float  # ln of the posterior's volume about it by Laplace's approximation

    def is_close(self, other: "Mode") -> bool:
        """Whether another mode lies within the width of this one or has it within its own."""
        departure = other.point - self.point
        distances = (
            departure @ np.linalg.pinv(mode.covariance) @ departure for mode in (self, other)
        )
        return bool(min(distances) < MODES.distinct_sd**2)


@dataclass(frozen=True, kw_only=True)
class Slope:
    """Residuals made linear by finite differences."""

    residuals: Residuals  # points (n, parameter) -> (n, k), independent, of unit variance
    bounds: Array  # shape (parameter, 2); equal bounds hold a parameter
    # scale of each parameter, of which finite differences are a fraction, shape (parameter,)
    width: Array

    def at(self, point: Array) -> Linearisation:
        """Return the linear residuals at a point."""
        (low, high), step = self.bounds.T, MODES.difference * self.width
        before, after = np.maximum(point - step, low), np.minimum(point + step, high)
        stencil = np.tile(point, (2, point.size, 1))
        for side, ends in zip(stencil, (before, after), strict=True):
            np.fill_diagonal(side, ends)
        numbers = self.residuals(np.concatenate([point[None], *stencil]))
        earlier, later = numbers[1:].reshape(2, point.size, -1)
        span = np.where(after > before, after - before, np.inf)
        return linearise_residual(-numbers[0], (later - earlier) / span[:, None])

    def covariance(self, point: Array) -> Array:
        """Return the inverse curvature at a point, shape (parameter, parameter)."""
        return covariance_at(self.at(point).normal, self.bounds)

    def ascend(self, start: Array, iterations: int = MODES.iterations) -> Mode:
        """Return the mode that Gauss-Newton steps from a start reach."""
        optimum = least_squares(self.at, start, self.bounds, iterations=iterations)
        covariance = covariance_at(optimum.at.normal, self.bounds)
        return Mode(
            point=optimum.point,
            covariance=covariance,
            log_evidence=ln_evidence(
                -0.5 * optimum.at.cost,
                covariance,
                optimum.point,
                self.bounds,
                optimum.at.gradient,
            ),
        )

    def modes(self, starts: Iterable[Array]) -> tuple[Mode, ...]:
        """Return the distinct modes that starts lead to and that hold more than a fraction
        `MODES.least_weight` of the posterior, the one that holds most first. Of starts that lead to
        the same place only the highest goes on to the end.
        """
        approached = _distinct(self.ascend(start, MODES.first_iterations) for start in starts)
        distinct = _distinct(self.ascend(mode.point) for mode in approached)
        least_evidence = distinct[0].log_evidence + np.log(MODES.least_weight)
        return tuple(mode for mode in distinct if mode.log_evidence > least_evidence)


def _distinct(modes: Iterable[Mode]) -> list[Mode]:
    """Return the modes that are not close to one of more evidence, that of most evidence first."""
    distinct: list[Mode] = []
    for mode in sorted(modes, key=lambda mode: -mode.log_evidence):
        if not any(mode.is_close(known) for known in distinct):
            distinct.append(mode)
    return distinct
