"""Weighted linear least squares, and draws of laws whose deviation is a parameter."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from charact.inference import find_maximum
from labdata import Array
from labdata.measurement import Posterior


class LinearFit(NamedTuple):
    """Parameters of a linear fit, their covariance, and the squared residuals over their
    variance.
    """

    best: Array
    covariance: Array
    chi2: float

    def stretch(self, data: int) -> float:
        """Return the factor of all errors that explains the scatter of the data, at least 1
        (Birge's ratio).
        """
        return float(np.sqrt(max(1.0, self.chi2 / max(1, data - len(self.best)))))


def linear_fit(columns: Sequence[Array], y: Array, sd: Array) -> LinearFit:
    """Fit y by a sum of columns: columns, data and their standard errors, shape (datum,) each."""
    return _fit(columns, y, np.diag(1.0 / np.maximum(sd, 1e-12) ** 2))


def generalised_fit(columns: Sequence[Array], y: Array, covariance: Array) -> LinearFit:
    """Fit y by a sum of columns, shape (datum,) each, with a covariance of the data, shape (datum,
    datum).
    """
    return _fit(columns, y, np.asarray(np.linalg.pinv(covariance), np.float64))


def _fit(columns: Sequence[Array], y: Array, weight: Array) -> LinearFit:
    """Return b = (X^T W X)^-1 X^T W y (Aitken 1935)."""
    design = np.stack(columns)
    covariance = np.asarray(np.linalg.pinv(design @ weight @ design.T), np.float64)
    best = covariance @ (design @ weight @ y)
    residual = y - best @ design
    return LinearFit(best, covariance, float(residual @ weight @ residual))


class Trend(NamedTuple):
    """Straight line through values against signal, and their mean, in the unit of the values."""

    first: float  # at zero signal
    first_sd: float  # standard error of its difference to the mean
    rise: float  # change up to the brightest level
    rise_sd: float
    mean: float


def trend_of(signal: Array, value: Array, covariance: Array, *, stretched: bool) -> Trend:
    """Fit a line to values, shape (level,), with a covariance; `stretched`: errors of the line
    explain their scatter.
    """
    ones = np.ones_like(signal)
    line, mean = (
        generalised_fit(columns, value, covariance)
        for columns in ([ones, signal / signal.max()], [ones])
    )
    scatter = line.stretch(len(signal)) if stretched else 1.0
    first_sd, rise_sd = scatter * np.sqrt(
        np.maximum(np.diag(line.covariance) - [mean.covariance[0, 0], 0.0], 0.0)
    )
    return Trend(line.best[0], float(first_sd), line.best[1], float(rise_sd), mean.best[0])


def weighted_mean(pairs: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return the mean of values weighted by their errors, and its standard error; 0 and inf without
    finite errors.
    """
    known = np.array([pair for pair in pairs if np.isfinite(pair[1])])
    if not len(known):
        return 0.0, np.inf
    fit = linear_fit([np.ones(len(known))], known[:, 0], np.maximum(known[:, 1], 1e-9))
    return float(fit.best[0]), float(np.sqrt(fit.covariance[0, 0]))


def draw_posterior(
    log_probability: Callable[[Array], Array],
    start: Array,
    bounds: Array,
    *,
    names: tuple[str, ...],
    units: tuple[str, ...],
    seed: int,
    method: Callable[..., Posterior],
) -> Posterior:
    """Draw from a posterior inside bounds by a method of `charact.inference`.

    The flag `prior-bound` is dropped: an undetectably small departure or fraction is harmless.
    """

    def inside_bounds(points: Array) -> Array:
        is_inside = np.all((points >= bounds[:, 0]) & (points <= bounds[:, 1]), axis=1)
        return np.where(
            is_inside, log_probability(np.where(is_inside[:, None], points, start)), -np.inf
        )

    point, covariance = find_maximum(inside_bounds, start, bounds)
    drawn = method(
        inside_bounds,
        names=names,
        units=units,
        start=point,
        covariance=covariance,
        seed=seed,
        bounds=bounds,
    )
    return replace(drawn, flags=tuple(flag for flag in drawn.flags if flag != "prior-bound"))
