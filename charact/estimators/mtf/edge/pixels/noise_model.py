"""Noise of a frame along an edge: its variance on both sides, its correlation, and the covariance
of bin means.

It is estimated from the residuals of the profile and so includes photons, gain, read-out, the fixed
pattern that frames share, and the correlation by blur.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from charact.estimators.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.frames.robust import median
from charact.inference.least_squares import Linearisation, least_squares, linearise_residual

Array = NDArray[np.float64]

# Width of the narrowest bins, px: all borders lie on its multiples.
NARROWEST_PX = 0.125
# Lengths along columns and rows, px, and exponent of exp(-(r/L)^p): a Gaussian blur leaves 2, tails
# of tubes less.
LENGTH_PX, EXPONENT, EXPONENT_PRIOR = (0.35, 6.0), (0.7, 2.3), (1.8, 0.3)
# Largest lag, px; correlations beyond are taken as none.
MAX_LAG_PX = 14


@dataclass(frozen=True, kw_only=True)
class EdgeNoiseModel:
    """Noise of a frame along an edge; its correlation is estimated where it is first asked for.

    Parameters
    ----------
    dark_variance, bright_variance
        Variance of a pixel on both plateaus, DN^2; in between it is linear in the profile.
    residual, level, valid
        Frame less its profile, DN, the profile from 0 to 1, and the pixels that count, shape (row,
        col).
    slopes
        Change of the distance from the edge with one column and with one row, px.
    is_quantisation
        Whether the residual is quantisation, in the data or in the bins, which does not correlate
        neighbours.
    field_axis
        Axis of the frame along which two fields alternate; None: there are none.
    """

    dark_variance: float
    bright_variance: float
    residual: Array
    level: Array
    valid: NDArray[np.bool_]
    slopes: tuple[float, float]
    is_quantisation: bool
    field_axis: int | None = None

    @cached_property
    def correlation(self) -> Array:
        """Correlation at lags of rows and columns, shape (2 R + 1, 2 C + 1), 1 in the middle."""
        if self.is_quantisation:
            return np.ones((1, 1))
        standard = np.where(self.valid, self.residual / np.sqrt(self.variance(self.level)), 0.0)
        return correlation_of(standard, self.valid, self.slopes, self.field_axis)

    @cached_property
    def covariance_over_variance(self) -> float:
        """Sum of the correlation: by how much averages are noisier than those of independent
        pixels.
        """
        return float(max(self.correlation.sum(), 0.05))

    @property
    def mean_sd(self) -> float:
        """Noise of a pixel, the root mean square of both sides, DN."""
        return float(np.sqrt(0.5 * (self.dark_variance + self.bright_variance)))

    @property
    def max_sd(self) -> float:
        """Noise of a pixel on the noisier side, DN."""
        return float(np.sqrt(max(self.dark_variance, self.bright_variance)))

    def variance(self, level: Array) -> Array:
        """Return the variance where the profile stands at a level between 0 (dark) and 1
        (bright).
        """
        return self.dark_variance + (self.bright_variance - self.dark_variance) * np.clip(
            level, 0.0, 1.0
        )


def estimate_edge_noise(
    residual: Array,
    level: Array,
    valid: NDArray[np.bool_],
    distance: Array,
    floor: float,
    field_axis: int | None = None,
) -> EdgeNoiseModel:
    """Estimate the noise from residuals r: r^2 = (1 - u) dark_variance + u bright_variance, u the
    level.

    Parameters
    ----------
    residual, level
        Frame less its profile, DN, and the profile from 0 to 1, shape (row, col).
    valid, distance
        Pixels that count, and their distance from the edge, px, shape (row, col).
    floor
        Least variance, DN^2.
    field_axis
        Axis of the frame along which two fields alternate; None: there are none.
    """
    # Least-squares line through the squared residuals against the level; outliers count as 50
    # variances at most.
    residuals, bright = residual[valid], level[valid]
    square = np.minimum(
        residuals**2, 50.0 * (float(residuals.var()) if residuals.size else 0.0) + floor
    )
    sides = np.stack([1.0 - bright, bright])
    normal = sides @ sides.T
    variances = np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(2), sides @ square)
    min_variance = max(0.02 * max(float(square.mean()) if square.size else 0.0, floor), floor)
    dark, bright = (max(float(variance), min_variance) for variance in variances)
    return EdgeNoiseModel(
        dark_variance=dark,
        bright_variance=bright,
        residual=residual,
        level=level,
        valid=valid,
        slopes=(float(np.diff(distance[0, :2])[0]), float(np.diff(distance[:2, 0])[0])),
        is_quantisation=max(dark, bright) <= 1.01 * floor,
        field_axis=field_axis,
    )


def fit_correlation_model(
    correlation: Array, pairs: Array, across: Array, between_fields: NDArray[np.bool_] | None = None
) -> tuple[Array, Array]:
    """Fit a smooth model to a correlation and return it, and what the removal of bin means took
    from it.

    Parameters
    ----------
    correlation
        At lags of rows and columns, shape (2 R + 1, 2 C + 1), 1 in the middle.
    pairs
        Number of pairs of pixels at each lag.
    across
        Distance across the edge that each lag makes, px.
    between_fields
        Which lags lead from one field to the other, whose exposures share less of the noise or
        none; None: there are no fields.

    Returns
    -------
    form, loss
        Same shape; the form is 1 in the middle and 0 elsewhere where neighbours are independent.

    Notes
    -----
    rho(l) = A exp(-(r(l))^p) - c t(l), c >= 0, for l other than 0: r^2 = (x/Lx)^2 + (y/Ly)^2, and t
    a triangle, because means of bins take the same fraction of all pairs that lie in one bin. Least
    squares on ln Lx, ln Ly and p with A and c solved at each step.
    """
    y, x = np.meshgrid(*(np.arange(size) - size // 2 for size in correlation.shape), indexing="ij")
    strip = np.maximum(1.0 - np.abs(across) / ACCURACY.strip_px, 0.0)
    # One of each pair of opposite lags, and not the pixel itself.
    half = (y > 0) | ((y == 0) & (x > 0))
    short = half & (np.maximum(np.abs(x), np.abs(y)) <= ACCURACY.correlation_fit_px) & (pairs > 50)
    telling = short if between_fields is None else short & ~between_fields
    weight = np.sqrt(pairs[telling])
    data, own_strip = correlation[telling] * weight, strip[telling] * weight
    lags = np.stack([x[telling], y[telling]]).astype(float)
    bounds = np.array([np.log(LENGTH_PX), np.log(LENGTH_PX), EXPONENT])
    step = 1e-4

    def linearise(theta: Array) -> Linearisation:
        points = theta + np.concatenate([np.zeros((1, 3)), step * np.eye(3)])
        amplitude, residual = _solve_amplitudes(points, data, lags, own_strip, weight)
        return linearise_residual(
            residual[0], (residual[0] - residual[1:]) / step, model=amplitude[0]
        )

    starts = np.array(
        [[np.log(length), np.log(length), EXPONENT_PRIOR[0]] for length in (0.7, 1.2, 2.4)]
    )
    costs = np.sum(_solve_amplitudes(starts, data, lags, own_strip, weight)[1] ** 2, axis=1)
    limits = {"min_damping": 1e-3, "max_damping": 100.0, "max_step": 0.5 / np.diff(bounds)[:, 0]}
    theta, at = least_squares(
        linearise, starts[np.argmin(costs)], bounds, iterations=30, tolerance=0.1, **limits
    )
    fitted_amplitude, loss = at.model
    none = float(own_strip @ data / max(own_strip @ own_strip, 1e-300))
    form = np.zeros(x.shape)
    if (
        float(np.sum((data - none * own_strip) ** 2)) - at.cost > THRESHOLDS.correlation_chi2
        and fitted_amplitude > 0
    ):
        form = fitted_amplitude * _shape(
            theta[None], np.stack([x.ravel(), y.ravel()]).astype(float)
        ).reshape(x.shape)
    else:
        # The model is not worth its parameters.
        loss = min(none, 0.0)
    if between_fields is not None and form.any():
        weighted = pairs * form * (short & between_fields)
        across_fields = np.sum(weighted * (correlation - loss * strip)) / max(
            np.sum(weighted * form), 1e-300
        )
        form = np.where(between_fields, float(np.clip(across_fields, 0.0, 1.0)) * form, form)
    middle = (x == 0) & (y == 0)
    return np.where(middle, 1.0, form), np.where(middle, 0.0, loss * strip)


@njit(cache=True)
def _shape(theta: Array, lags: Array) -> Array:
    """Return exp(-r^p), shape (n, 3) and (2, lag) -> (n, lag)."""
    out = np.empty((len(theta), lags.shape[1]))
    for i in range(len(theta)):
        across, along = np.exp(-2.0 * theta[i, 0]), np.exp(-2.0 * theta[i, 1])
        for k in range(lags.shape[1]):
            square = lags[0, k] ** 2 * across + lags[1, k] ** 2 * along
            out[i, k] = np.exp(-(square ** (0.5 * theta[i, 2])))
    return out


@njit(cache=True)
def _solve_amplitudes(
    theta: Array, data: Array, lags: Array, strip: Array, weight: Array
) -> tuple[Array, Array]:
    """Return amplitude and loss, shape (n, 2), and residuals, shape (n, lag + 1), the prior of the
    exponent last.
    """
    amplitudes, residual = np.empty((len(theta), 2)), np.empty((len(theta), data.size + 1))
    other, stripped = max(np.dot(strip, strip), 1e-300), np.dot(strip, data)
    shapes = _shape(theta, lags)
    for i in range(len(theta)):
        shape = shapes[i] * weight
        overlap = np.dot(shape, strip)
        power = max(np.dot(shape, shape) - overlap**2 / other, 1e-300)
        amplitude = min(max((np.dot(shape, data) - overlap * stripped / other) / power, 0.0), 1.0)
        # Means take away and never add.
        loss = min((stripped - amplitude * overlap) / other, 0.0)
        amplitudes[i] = amplitude, loss
        residual[i, :-1] = data - amplitude * shape - loss * strip
        residual[i, -1] = (theta[i, 2] - EXPONENT_PRIOR[0]) / EXPONENT_PRIOR[1]
    return amplitudes, residual


def correlation_of(
    standard: Array,
    valid: NDArray[np.bool_],
    slopes: tuple[float, float],
    field_axis: int | None = None,
) -> Array:
    """Return the correlation of standardised residuals: a smooth model, and significant departures
    from it.

    Parameters
    ----------
    standard, valid
        Residuals in standard deviations and which of them count, shape (row, col).
    slopes
        Change of the distance from the edge with one column and with one row, px.
    field_axis
        Axis along which two fields alternate; None: there are none.
    """
    from scipy.fft import next_fast_len
    from scipy.ndimage import uniform_filter

    rows, cols = standard.shape
    reach_row, reach_col = min(MAX_LAG_PX, rows - 1), min(MAX_LAG_PX, cols - 1)
    take_row, take_col = np.arange(-reach_row, reach_row + 1), np.arange(-reach_col, reach_col + 1)
    fast = [
        int(next_fast_len(size, real=True) or size) for size in (rows + reach_row, cols + reach_col)
    ]
    # In single precision: a correlation is known to a thousandth at best.
    spectra = np.stack(
        [np.fft.rfft2(field.astype(np.float32), fast) for field in (standard, valid)]
    ).astype(np.complex64)
    lagged = np.fft.irfft2(spectra.real**2 + spectra.imag**2, fast)[
        :, take_row[:, None], take_col
    ].astype(float)
    product, pairs = lagged[0], np.rint(lagged[1])
    correlation = np.where(pairs > 50, product / np.maximum(pairs, 1), 0.0)
    if not correlation[reach_row, reach_col] > 0:
        return np.ones((1, 1))
    correlation = correlation / correlation[reach_row, reach_col]
    across = np.add.outer(take_row * slopes[1], take_col * slopes[0])
    odd = np.broadcast_to(
        (take_row[:, None], take_col[None, :])[field_axis or 0] % 2 == 1, correlation.shape
    )
    form, loss = fit_correlation_model(
        correlation, pairs, across, None if field_axis is None else odd
    )
    residual = correlation - form - loss
    # Bartlett: errors of a correlation are tied over lags as the noise itself is.
    error = np.sqrt(np.sum(form**2) / np.maximum(pairs, 1))
    short = np.maximum(np.abs(take_row)[:, None], np.abs(take_col)) <= ACCURACY.correlation_near_px
    tied_error = np.sqrt(
        np.sum(uniform_filter(form, 3, mode="constant") ** 2) / np.maximum(pairs, 1)
    )
    formless = np.mean((residual / error)[short] ** 2) > THRESHOLDS.correlation_misfit
    # Where the model is not that of this noise, what is significant counts as it is.
    tested = correlation - loss if formless else residual
    min_significance = (
        THRESHOLDS.correlation_sd if formless else THRESHOLDS.correlation_departure_sd
    )
    keep = np.abs(uniform_filter(tested, 3, mode="constant")) > min_significance * tied_error
    keep[reach_row, reach_col] = False
    # 1 up to half the largest lag, then a cosine down to 0.
    falloff = [
        np.clip((np.abs(lag) - MAX_LAG_PX / 2) / (MAX_LAG_PX / 2 + 1), 0.0, 1.0)
        for lag in (take_row, take_col)
    ]
    departure = np.where(keep, residual, 0.0) * np.outer(
        *(0.5 * (1.0 + np.cos(np.pi * field)) for field in falloff)
    )
    if formless or not keep.any():
        return form + departure
    # Without what it takes from the noise at any frequency: blur leaves little noise at high
    # frequencies, and one lag of chance would take all of it there.
    spectrum = np.fft.fft2(np.fft.ifftshift(departure)).real
    return form + np.fft.fftshift(np.fft.ifft2(np.maximum(spectrum, 0.0)).real)


def bin_covariance(
    noise: EdgeNoiseModel,
    borders: Array,
    level: Array,
    count: Array,
    keep: NDArray[np.bool_],
    slopes: tuple[float, float],
) -> Array:
    """Return the covariance of the means of bins, shape (bin, bin).

    Parameters
    ----------
    borders
        Borders of all bins of the band, px.
    level, count
        Profile at each kept bin and its number of pixels, shape (bin,).
    keep
        Which bins of the band are kept.
    slopes
        Change of distance with one column and with one row, px.

    Notes
    -----
    Pixels a lag apart are the same distance delta apart along the normal wherever they are, so
    cov(b, b') = sqrt(v v') / (n n') sum over lags of rho times the pairs of b and b' shifted by
    delta: for an even filling the overlap of two boxes, a second difference of the ramp sum_lag rho
    max(0, x - delta).
    """
    rows, cols = (np.arange(size) - size // 2 for size in noise.correlation.shape)
    delta = np.add.outer(rows * slopes[1], cols * slopes[0]).ravel()
    order = np.argsort(delta)
    delta, mass = delta[order], noise.correlation.ravel()[order]
    total, moment = (
        np.concatenate([[0.0], np.cumsum(mass)]),
        np.concatenate([[0.0], np.cumsum(mass * delta)]),
    )
    cell = np.rint(borders / NARROWEST_PX).astype(np.int64)
    max_cells = int(np.ptp(cell))
    lag_px = np.arange(-max_cells, max_cells + 1) * NARROWEST_PX
    index = np.searchsorted(delta, lag_px)
    ramp = np.asarray(total[index] * lag_px - moment[index], np.float64)
    sd = np.sqrt(noise.variance(level))
    scale = sd / np.sqrt(np.diff(borders)[keep] * count)
    ramp = ramp[max_cells + cell - cell[:, None]]
    overlap = (ramp[:-1, 1:] - ramp[1:, 1:] + ramp[1:, :-1] - ramp[:-1, :-1])[np.ix_(keep, keep)]
    covariance = 0.5 * (overlap + overlap.T) * np.outer(scale, scale)
    diagonal = np.diag(covariance)
    if not (diagonal > 0).any():
        # Too few pixels to estimate a correlation, and chance made it cancel the noise: pixels
        # count as independent.
        return np.diag(sd**2 / count)
    # A bin of one pixel whose noise the correlation cancels is as noisy as its neighbours; negative
    # eigenvalues are raised to a small fraction of those of independent pixels.
    scale = np.sqrt(np.maximum(diagonal, 1e-3 * median(diagonal[diagonal > 0])))
    correlation = covariance / np.outer(scale, scale)
    try:
        np.linalg.cholesky(correlation - 1e-3 * np.eye(len(correlation)))
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(correlation)
        return (vectors * np.maximum(values, 0.02)) @ vectors.T * np.outer(scale, scale)
    return covariance
