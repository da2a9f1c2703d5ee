"""Seven components of 3-D noise from orthonormal contrasts, without bias by the finite cube."""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from charact.frames.contrasts import Contrasts, waves
from charact.frames.thresholds import CUBE

Array = NDArray[np.float64]


# Axes of a contrast array (field, time, row, col) along which components vary.
TIME, ROW, COL = 1, 2, 3


@dataclass(frozen=True, kw_only=True)
class MeanSquare:
    """A mean of squares with a scaled chi-squared distribution."""

    value_dn2: float  # the mean of squares, DN^2
    freedom: float  # degrees of freedom, reduced for correlated or non-normal values

    def draws(self, rng: np.random.Generator, count: int) -> Array:
        """Return posterior draws of the expected mean square, shape (count,), DN^2."""
        return self.value_dn2 * self.freedom / rng.chisquare(self.freedom, count)


def subtract_means(part: NDArray, axes: tuple[int, ...], *, fixed: bool) -> NDArray:
    """Return contrasts without their means along the given axes, and without smooth shading of a
    fixed pattern.
    """
    for axis in axes:
        part = part - part.mean(axis=axis, keepdims=True)
    if not fixed:
        return part
    smooth = part
    bases = {axis: shading(part.shape[axis]) for axis in axes}
    for axis, base in bases.items():
        smooth = np.moveaxis(np.moveaxis(smooth, axis, -1) @ base, -1, axis)
    for axis, base in bases.items():
        smooth = np.moveaxis(np.moveaxis(smooth, axis, -1) @ base.T, -1, axis)
    return part - smooth


def shading(length: int) -> Array:
    """Return orthonormal polynomials along an axis without the constant, shape (length, order)."""
    position = np.linspace(-1.0, 1.0, length)
    order = min(CUBE.shading_order, length // CUBE.pixels_per_order)
    return np.linalg.qr(np.polynomial.legendre.legvander(position, order))[0][:, 1:]


def mean_square(centred: NDArray, axes: tuple[int, ...], *, fixed: bool) -> MeanSquare:
    """Return the mean square of centred contrasts.

    For a stationary normal process with mode powers P the sum of n squares is approximately
    chi-squared with (sum P)^2 / sum P^2 degrees of freedom (Satterthwaite, Biometrics Bulletin 2,
    110 (1946)). A fourth cumulant g adds g / n to its relative variance; k fields of correlation r
    count k / (1 + (k - 1) r^2) times. Each of the three is measured and corrected for its own
    error.
    """
    count = degrees_of_freedom(centred.shape, axes, fixed=fixed)
    total = float(np.sum(centred**2))
    if total <= 0:
        return MeanSquare(value_dn2=0.0, freedom=count)
    unit = centred / np.sqrt(total / centred.size)
    spread = correlation_factor(unit, axes, count) + 0.5 * excess_kurtosis(unit, count)
    return MeanSquare(
        value_dn2=total / count,
        freedom=max(1.0, count / spread / (1.0 + field_correlation_square(unit, count))),
    )


def degrees_of_freedom(shape: tuple[int, ...], axes: tuple[int, ...], *, fixed: bool) -> float:
    """Return the degrees of freedom of white noise in contrasts of a shape."""
    averaged = np.prod([length for axis, length in enumerate(shape) if axis not in axes])
    free = np.prod([shape[axis] - 1 for axis in axes])
    smooth = np.prod([shading(shape[axis]).shape[1] for axis in axes]) if fixed else 0
    return float(averaged * (free - smooth))


def correlation_factor(unit: NDArray, axes: tuple[int, ...], count: float) -> float:
    """Return the number of values per independent value, from the spread of power over modes."""
    from scipy import fft

    modes = np.asarray(fft.rfftn(unit, axes=axes))
    power = (
        np.abs(
            modes[
                np.ix_(
                    *(np.arange(axis in axes, length) for axis, length in enumerate(modes.shape))
                )
            ]
        )
        ** 2
    )
    mean = float(np.mean(power))
    # Powers of single modes are exponential, with a mean square of twice the squared mean.
    return (
        max(1.0, 0.5 * float(np.mean(power**2)) / mean**2 - np.sqrt(10.0 / count))
        if mean > 0
        else 1.0
    )


def excess_kurtosis(unit: NDArray, count: float) -> float:
    """Return the excess kurtosis of values of mean square one, less its error."""
    square = unit * unit
    return max(0.0, float(np.mean(square * square)) - 3.0 - np.sqrt(24.0 / count))


def field_correlation_square(unit: NDArray, count: float) -> float:
    """Return the sum of the squared correlations of a field with the others; 0 for one field."""
    fields = len(unit)
    product = unit.reshape(fields, -1) @ unit.reshape(fields, -1).T
    power = np.diag(product)
    if fields < 2 or not np.all(power > 0):
        return 0.0
    square = float(np.sum(product**2 / np.outer(power, power))) / fields - 1.0
    return max(0.0, square - (fields - 1) * fields / count)


def strata(values: Array, axes: tuple[int, ...]) -> list[tuple[int, list[int], Array]]:
    """Return the parts of the contrasts of a component, each with its sign and its axes of waves.

    Along every other axis the mean (index 0) is compared with the slowest waves (all others), which
    contain the same noise without the component: sign -1 for each axis of waves.
    """
    averaged = [axis for axis in (TIME, ROW, COL) if axis not in axes]
    out = []
    for choice in product((0, 1), repeat=len(averaged)):
        index = [slice(None)] * values.ndim
        for axis, slow in zip(averaged, choice, strict=True):
            index[axis] = slice(1, None) if slow else slice(0, 1)
        waving = [axis for axis, slow in zip(averaged, choice, strict=True) if slow]
        out.append(((-1) ** len(waving), waving, values[tuple(index)]))
    return out


# Axes along which each component varies.
OWN = {
    "t": (TIME,),
    "v": (ROW,),
    "h": (COL,),
    "tv": (TIME, ROW),
    "th": (TIME, COL),
    "vh": (ROW, COL),
}


@dataclass(frozen=True, kw_only=True)
class LowFrequencyExcess:
    """Excess power of correlated noise in its mean over its slowest waves along an axis."""

    # dn2, sd_dn2: the excess and its standard error, extrapolated from the waves of two periods and
    # of one, DN^2
    dn2: float
    sd_dn2: float
    relative: float  # the excess over the power of these waves, dimensionless
    drawn: bool = True  # whether the excess is shrunk towards zero (James and Stein)

    @property
    def estimate_dn2(self) -> float:
        """Shrinkage estimate of the excess, DN^2."""
        return self.dn2 * self._weight

    @property
    def estimate_sd_dn2(self) -> float:
        """Standard error of the estimate, DN^2."""
        return float(
            np.hypot(
                np.sqrt(max(self._weight, CUBE.shrunk_variance)) * self.sd_dn2,
                CUBE.extrapolation_sd * self.estimate_dn2,
            )
        )

    @property
    def min_fraction(self) -> float:
        """Lower limit of the relative excess by its error, dimensionless."""
        return (
            abs(self.relative) * max(0.0, 1.0 - CUBE.significant_sd * abs(self.sd_dn2 / self.dn2))
            if self.dn2
            else 0.0
        )

    @property
    def _weight(self) -> float:
        if not self.drawn:
            return 1.0
        return max(0.0, 1.0 - (self.sd_dn2 / self.dn2) ** 2) if self.dn2 else 0.0


@dataclass(frozen=True, kw_only=True)
class Component:
    """The variance of one component."""

    terms: tuple[
        tuple[float, MeanSquare], ...
    ]  # mean squares with their factors; the variance is their sum
    slopes: dict[
        int, LowFrequencyExcess
    ]  # excess to subtract for each axis (`TIME`, `ROW`, `COL`) of averaging

    @property
    def variance_dn2(self) -> float:
        """Unbiased estimate, which may be negative, DN^2."""
        noise = sum(slope.estimate_dn2 for slope in self.slopes.values())
        return sum(factor * term.value_dn2 for factor, term in self.terms) - noise

    def draws(self, rng: np.random.Generator, count: int) -> Array:
        """Return draws of the variance, shape (count,), DN^2; some are negative if the component is
        near zero.
        """
        out = sum((factor * term.draws(rng, count) for factor, term in self.terms), np.zeros(count))
        for slope in self.slopes.values():
            out -= slope.estimate_dn2 + slope.estimate_sd_dn2 * rng.standard_normal(count)
        return out


def components(measured: Contrasts) -> dict[str, Component]:
    """Return the seven variance components of a stack.

    U(t,v,h) = S + N_t + N_v + N_h + N_tv + N_th + N_vh + N_tvh. An orthonormal mean along an axis
    contains white noise of variance s^2 as s^2, and a component constant along the axis n-fold; the
    analysis of variance subtracts the one from the other. The subtracted term is not the mean
    square over all of N_tvh, as in the textbook, but over its slowest waves along the averaged
    axis. Both agree for white noise, and the estimate is unbiased for finite cubes. Correlated
    noise has more power in slow waves, which alone predict its part in a mean
    (`LowFrequencyExcess`). Bias identities for white noise: s_vh^2 = sigma_vh^2 + sigma_tvh^2 / T
    and cyclic, s_t^2 = sigma_t^2 + sigma_tv^2 / V + sigma_th^2 / H + sigma_tvh^2 / (VH) and cyclic
    (Appl. Opt. 54, 4907 (2015)). Mean squares are independent and chi-squared distributed for
    normal noise, each with its own degrees of freedom if it is not white (see `mean_square`). Draws
    of each give draws of their sum and the generalized confidence interval (Weerahandi, J. Am.
    Stat. Assoc. 88, 899 (1993)).
    """
    arrays = _arrays(measured)
    parts = {name: _component(arrays[name], OWN[name], measured.size) for name in OWN}
    return parts | {"tvh": _random_component(measured, parts)}


def _arrays(measured: Contrasts) -> dict[str, Array]:
    """Return the contrasts of each component, shape (field, time, row, col) with waves on the
    averaged axes.
    """
    frames, rows, _ = (waves(length) for length in measured.size)
    return {
        "t": np.einsum("wv,ftvx->ftwx", rows, measured.by_row),
        "v": np.einsum("wt,ftvx->fwvx", frames, measured.by_row),
        "h": np.einsum("wt,ftxh->fwxh", frames, measured.by_col),
        "tv": measured.by_row,
        "th": measured.by_col,
        "vh": measured.by_pixel,
    }


def _component(values: Array, axes: tuple[int, ...], size: tuple[int, int, int]) -> Component:
    """Return one component: mean squares of means less those of slow waves, over the number of
    averaged pixels.
    """
    fixed = TIME not in axes
    averaged = float(np.prod([size[axis - 1] for axis in (TIME, ROW, COL) if axis not in axes]))
    terms, excess = [], {axis: [] for axis in (TIME, ROW, COL) if axis not in axes}
    for sign, slow, part in strata(values, axes):
        centred = subtract_means(part, axes, fixed=fixed)
        square = mean_square(centred, axes, fixed=fixed)
        terms.append((sign / averaged, square))
        for axis in slow:
            excess[axis].append((-sign / averaged, square, _excess(centred, axis, square)))
    return Component(
        terms=tuple(terms),
        slopes={axis: _slope(terms_of_axis) for axis, terms_of_axis in excess.items()},
    )


def _excess(centred: Array, axis: int, square: MeanSquare) -> float:
    """Return the power at frequency 0 less that of the waves of one and two periods, by a
    parabola.
    """
    if centred.shape[axis] < 4 or square.value_dn2 <= 0:
        return 0.0
    slowest, second = (
        float(np.mean(np.take(centred, pair, axis=axis) ** 2)) for pair in ((0, 1), (2, 3))
    )
    return 5.0 / 6.0 * (slowest - second) / float(np.mean(centred**2)) * square.value_dn2


def _slope(terms: list[tuple[float, MeanSquare, float]]) -> LowFrequencyExcess:
    """Return the excess along an axis of all its terms: factor, mean square and excess of each."""
    value = sum(factor * excess for factor, _, excess in terms)
    sd = [
        factor * square.value_dn2 * 5.0 / 6.0 * np.sqrt(8.0 / square.freedom)
        for factor, square, _ in terms
    ]
    power = sum(abs(factor) * square.value_dn2 for factor, square, _ in terms)
    return LowFrequencyExcess(
        dn2=value, sd_dn2=float(np.linalg.norm(sd)), relative=value / power if power > 0 else 0.0
    )


def _random_component(measured: Contrasts, parts: dict[str, Component]) -> Component:
    """Return the component that varies along all axes: residual power, and its scatter from pairs
    of frames.
    """
    length = np.array(measured.size)
    count = len(measured.by_row) * float(np.prod(length - 1))
    means = (measured.by_row[..., 0], measured.by_col[:, :, 0], _arrays(measured)["t"][:, :, 0, 0])
    rows, cols, frames = (
        float(np.sum((mean - mean.mean(axis=1, keepdims=True)) ** 2)) for mean in means
    )
    power = max(float(measured.power_dn2.sum()) - rows - cols + frames, 0.0) / count
    # Correlated noise has a different power in the planes removed with the means.
    slow = np.array([parts[name].terms[1][1].value_dn2 for name in ("vh", "th", "tv")])
    factor = float(np.prod(1.0 + (slow / power - 1.0) / length)) if power > 0 else 1.0
    square = MeanSquare(value_dn2=power, freedom=_freedom(measured.pairs, power, count))
    slopes = {
        axis: parts[name].slopes[axis] for axis, name in ((TIME, "vh"), (ROW, "th"), (COL, "tv"))
    }
    # The correction is small relative to this component, so its error matters less than a bias.
    negative_slopes = {
        axis: replace(slope, dn2=-slope.dn2, relative=-slope.relative, drawn=False)
        for axis, slope in slopes.items()
    }
    return Component(terms=((factor, square),), slopes=negative_slopes)


def _freedom(pairs: NDArray[np.float32], power: float, count: float) -> float:
    """Return the degrees of freedom of the random component; correlations and pulses reduce
    them.
    """
    centred = subtract_means(pairs, (2, 3), fixed=False)
    square = float(np.mean(centred**2, dtype=np.float64))
    if power <= 0 or square <= 0:
        return count
    unit = centred / np.float32(np.sqrt(square))
    size = degrees_of_freedom(centred.shape, (2, 3), fixed=False)
    blocks = _blocks(unit**2)
    pixels = centred[0, 0].size / blocks.shape[2]
    normal = 2.0 * correlation_factor(unit[:, : CUBE.spectra], (2, 3), size) / pixels
    # A difference of two frames halves the fourth cumulant.
    pulses = 2.0 * max(_scatter(blocks) - normal, 0.5 * excess_kurtosis(unit, size) / pixels)
    lag = float(np.clip(1.0 - square / power, 0.0, 0.95))
    repetition = (1.0 + lag**2) / (1.0 - lag**2) * (1.0 + field_correlation_square(unit, size))
    return max(1.0, 2.0 * count / ((normal + pulses) * pixels * repetition))


def _scatter(blocks: Array) -> float:
    """Return the relative temporal variance of the block power, each block about its own mean."""
    pairs = blocks.shape[1]
    if pairs < 2:
        return 0.0
    variance = float(blocks.var(axis=1, ddof=1).mean())
    return variance / max(float(np.mean(blocks.mean(axis=1) ** 2)) - variance / pairs, 1e-3)


def _blocks(image: NDArray) -> Array:
    """Return means over blocks of the last two axes, shape (field, pair, block)."""
    rows, cols = (
        np.linspace(0, length, min(max_blocks, length // 2) + 1).astype(int)
        for length, max_blocks in zip(image.shape[2:], CUBE.blocks, strict=True)
    )
    total = np.add.reduceat(np.add.reduceat(image, rows[:-1], axis=2), cols[:-1], axis=3)
    return (total / np.outer(np.diff(rows), np.diff(cols))).reshape(*image.shape[:2], -1)
