"""Mean squares of contrasts, and their degrees of freedom."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from charact.noise.thresholds import CUBE

Array = NDArray[np.float64]

# Axes of a contrast array (field, time, row, col) along which components vary.
TIME, ROW, COL = 1, 2, 3


@dataclass(frozen=True, kw_only=True)
class MeanSquare:
    """A mean of squares with a scaled chi-squared distribution.

    Parameters
    ----------
    value_dn2
        The mean of squares, DN^2.
    freedom
        Degrees of freedom, reduced for correlated or non-normal values.
    """

    value_dn2: float
    freedom: float

    def draws(self, rng: np.random.Generator, count: int) -> Array:
        """Return posterior draws of the expected mean square, shape (count,), DN^2."""
        return self.value_dn2 * self.freedom / rng.chisquare(self.freedom, count)


def subtract_means(part: NDArray, own: tuple[int, ...], *, fixed: bool) -> NDArray:
    """Return contrasts without their means along the given axes, and without smooth shading of a fixed pattern."""
    for axis in own:
        part = part - part.mean(axis=axis, keepdims=True)
    if not fixed:
        return part
    smooth = part
    bases = {axis: shading(part.shape[axis]) for axis in own}
    for axis, base in bases.items():
        smooth = np.moveaxis(np.moveaxis(smooth, axis, -1) @ base, -1, axis)
    for axis, base in bases.items():
        smooth = np.moveaxis(np.moveaxis(smooth, axis, -1) @ base.T, -1, axis)
    return part - smooth


def shading(length: int) -> Array:
    """Return orthonormal polynomials along an axis without the constant, shape (length, order)."""
    place = np.linspace(-1.0, 1.0, length)
    order = min(CUBE.shading_order, length // CUBE.pixels_per_order)
    return np.linalg.qr(np.polynomial.legendre.legvander(place, order))[0][:, 1:]


def mean_square(rest: NDArray, own: tuple[int, ...], *, fixed: bool) -> MeanSquare:
    """Return the mean square of centred contrasts.

    Notes
    -----
    For a stationary normal process with mode powers P the sum of n squares is approximately chi-squared with (sum P)^2
    / sum P^2 degrees of freedom (Satterthwaite, Biometrics Bulletin 2, 110 (1946)). A fourth cumulant g adds g / n to
    its relative variance; two fields of correlation r count 2 / (1 + r^2) times. Each of the three is measured and
    corrected for its own error.
    """
    count = degrees_of_freedom(rest.shape, own, fixed=fixed)
    total = float(np.sum(rest**2))
    if total <= 0:
        return MeanSquare(value_dn2=0.0, freedom=count)
    unit = rest / np.sqrt(total / rest.size)
    spread = correlation_factor(unit, own, count) + 0.5 * excess_kurtosis(unit, count)
    return MeanSquare(
        value_dn2=total / count, freedom=max(1.0, count / spread / (1.0 + squared_field_correlation(unit, count)))
    )


def degrees_of_freedom(shape: tuple[int, ...], own: tuple[int, ...], *, fixed: bool) -> float:
    """Return the degrees of freedom of white noise in contrasts of a shape."""
    averaged = np.prod([length for axis, length in enumerate(shape) if axis not in own])
    free = np.prod([shape[axis] - 1 for axis in own])
    taken = np.prod([shading(shape[axis]).shape[1] for axis in own]) if fixed else 0
    return float(averaged * (free - taken))


def correlation_factor(unit: NDArray, own: tuple[int, ...], count: float) -> float:
    """Return the number of values per independent value, from the spread of power over modes."""
    from scipy import fft

    modes = np.asarray(fft.rfftn(unit, axes=own))
    power = np.abs(modes[np.ix_(*(np.arange(axis in own, length) for axis, length in enumerate(modes.shape)))]) ** 2
    mean = float(np.mean(power))
    # Powers of single modes are exponential, with a mean square of twice the squared mean.
    return max(1.0, 0.5 * float(np.mean(power**2)) / mean**2 - np.sqrt(10.0 / count)) if mean > 0 else 1.0


def excess_kurtosis(unit: NDArray, count: float) -> float:
    """Return the excess kurtosis of values of mean square one, less its error."""
    square = unit * unit
    return max(0.0, float(np.mean(square * square)) - 3.0 - np.sqrt(24.0 / count))


def squared_field_correlation(unit: NDArray, count: float) -> float:
    """Return the squared correlation of the two fields; 0 for one field."""
    if len(unit) < 2:
        return 0.0
    first, second = unit
    norm = float(np.sum(first**2) * np.sum(second**2))
    return max(0.0, float(np.sum(first * second)) ** 2 / norm - 2.0 / count) if norm > 0 else 0.0


def strata(values: Array, own: tuple[int, ...]) -> list[tuple[int, list[int], Array]]:
    """Return the parts of the contrasts of a component, each with its sign and its axes of waves.

    Along every other axis the mean (index 0) is compared with the slowest waves (all others), which contain the same
    noise without the component: sign -1 for each axis of waves.
    """
    others = [axis for axis in (TIME, ROW, COL) if axis not in own]
    out = []
    for choice in product((0, 1), repeat=len(others)):
        index = [slice(None)] * values.ndim
        for axis, slow in zip(others, choice, strict=True):
            index[axis] = slice(1, None) if slow else slice(0, 1)
        waving = [axis for axis, slow in zip(others, choice, strict=True) if slow]
        out.append(((-1) ** len(waving), waving, values[tuple(index)]))
    return out
