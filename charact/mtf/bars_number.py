"""How many bars a picture shows: a fit of too few or too many leaves over what one more or one less explains."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from charact.mtf.bars_fit import ROUGHLY, Fit, fitted
from charact.mtf.bars_picture import START_CORE, START_EXPONENT, Picture, Problem, start_of

Array = NDArray[np.float64]

# Where other bars may lie beside those fitted, periods.
BESIDE = (-0.5, 0.0, 0.5)
# Chi squared that another number must save, over the sum of the noise's correlation, or its share of all.
WORTH_CHI2, WORTH_SHARE = 25.0, 1.0 / 3.0


def other_number(fit: Fit, problem: Problem) -> int | None:
    """Return the number of bars, one less or one more, that describes the pixels better than the one fitted, if any."""
    own = fit.target.bars
    left = {n: _misfit(_refitted(fit, problem, n), problem) for n in (own - 1, own + 1) if n > 1}
    best, asked = min(left, key=left.__getitem__), _misfit(fit, problem)
    shared = max(float(np.abs(fit.noise.correlation).sum()), 1.0)
    # A wrong number leaves patterns over that pass for correlated noise, of which no number saves a third.
    return best if asked - left[best] > min(WORTH_CHI2 * shared, WORTH_SHARE * asked) else None


def _misfit(fit: Fit, problem: Problem) -> float:
    """Return chi squared and what the priors add to it."""
    return float(np.sum(fit.residual_dn**2 / problem.variance) + fit.precision @ (fit.value - fit.prior_mean) ** 2)


def _refitted(fit: Fit, problem: Problem, bars: int) -> Fit:
    """Return a rough fit of another number of bars, begun where they lie best under the fitted transfer."""
    ground = _ground(fit, problem)
    shift = min(BESIDE, key=lambda periods: _left(fit, problem, ground, bars, periods))
    start = start_of(problem, fit.target, START_EXPONENT, START_CORE)
    start |= {"angle_rad": fit["angle_rad"], "across_px": shift / fit.target.frequency}
    return fitted(problem, replace(fit.target, bars=bars), start, fit.noise, tolerance=ROUGHLY)


def _left(fit: Fit, problem: Problem, ground: Array, bars: int, shift_periods: float) -> float:
    """Return chi squared of so many bars, shifted across by a part of a period."""
    picture = Picture(problem, replace(fit.target, bars=bars))
    shift = {"across_px": shift_periods / fit.target.frequency, "along_px": 0.0}
    dark = {"level_dn": 1.0, "pedestal_dn": 0.0, "slope_across": 0.0, "slope_along": 0.0}
    shape, _ = picture({**fit.values, **shift, **dark})
    weight = 1.0 / np.sqrt(problem.variance)
    design, data = np.stack([shape, *ground]) * weight, problem.image[problem.window] * weight
    amplitude = np.linalg.lstsq(design @ design.T, design @ data, rcond=1e-12)[0]
    return float(np.sum((data - amplitude @ design) ** 2))


def _ground(fit: Fit, problem: Problem) -> Array:
    """Return even light and its two slopes at the window's pixels, shape (3, pixel)."""
    picture = Picture(problem, fit.target)
    ground = [np.ones_like(picture.x), picture.x / picture.reach[0], picture.y / picture.reach[1]]
    return np.asarray(np.stack(ground), np.float64)
