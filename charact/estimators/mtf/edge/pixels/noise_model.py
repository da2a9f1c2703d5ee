"""Correlation of the noise along an edge, and the covariance of bin means.

The noise is that of the residuals of the profile and so includes photons, gain, read-out, the fixed
pattern that frames share, and the correlation by blur.
"""

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.frames.noise_law import NoiseLaw, masked_covariance
from charact.frames.robust import median
from charact.inference.gauss_newton import Linearisation, least_squares, linearise_residual

Array = NDArray[np.float64]

# Width of the narrowest bins, px: all borders lie on its multiples.
NARROWEST_PX = 0.125
# Lengths along columns and rows, px, and exponent of exp(-(r/L)^p): a Gaussian blur leaves 2, tails
# of tubes less.
LENGTH_PX, EXPONENT, EXPONENT_PRIOR = (0.35, 6.0), (0.7, 2.3), (1.8, 0.3)
# Largest lag, px; correlations beyond are taken as none.
MAX_LAG_PX = 14


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


def _shape(theta: Array, lags: Array) -> Array:
    """Return exp(-r^p), shape (n, 3) and (2, lag) -> (n, lag)."""
    square = np.exp(-2.0 * theta[:, :2]) @ lags**2
    return np.exp(-(square ** (0.5 * theta[:, 2:])))


def _solve_amplitudes(
    theta: Array, data: Array, lags: Array, strip: Array, weight: Array
) -> tuple[Array, Array]:
    """Return amplitude and loss, shape (n, 2), and residuals, shape (n, lag + 1), the prior of the
    exponent last.
    """
    other, stripped = max(strip @ strip, 1e-300), strip @ data
    shape = _shape(theta, lags) * weight
    overlap = shape @ strip
    power = np.maximum(np.sum(shape**2, axis=1) - overlap**2 / other, 1e-300)
    amplitude = np.clip((shape @ data - overlap * stripped / other) / power, 0.0, 1.0)
    # Means take away and never add.
    loss = np.minimum((stripped - amplitude * overlap) / other, 0.0)
    amplitudes = np.stack([amplitude, loss], axis=1)
    exponent = (theta[:, 2:] - EXPONENT_PRIOR[0]) / EXPONENT_PRIOR[1]
    residual = data - amplitude[:, None] * shape - loss[:, None] * strip
    return amplitudes, np.concatenate([residual, exponent], axis=1)


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
    # In single precision: a correlation is known to a thousandth at best.
    product, pairs = masked_covariance(standard[None].astype(np.float32), valid, MAX_LAG_PX)
    correlation = np.where(pairs > 50, product, 0.0)
    if not correlation[MAX_LAG_PX, MAX_LAG_PX] > 0:
        return np.ones((1, 1))
    correlation = correlation / correlation[MAX_LAG_PX, MAX_LAG_PX]
    lag = np.arange(-MAX_LAG_PX, MAX_LAG_PX + 1)
    across = np.add.outer(lag * slopes[1], lag * slopes[0])
    odd = np.broadcast_to((lag[:, None], lag)[field_axis or 0] % 2 == 1, correlation.shape)
    form, loss = fit_correlation_model(
        correlation, pairs, across, None if field_axis is None else odd
    )
    residual = correlation - form - loss
    # Bartlett: errors of a correlation are tied over lags as the noise itself is.
    error = np.sqrt(np.sum(form**2) / np.maximum(pairs, 1))
    short = np.maximum.outer(np.abs(lag), np.abs(lag)) <= ACCURACY.correlation_near_px
    tied_error = np.sqrt(np.sum(_mean_of_nine(form) ** 2) / np.maximum(pairs, 1))
    formless = np.mean((residual / error)[short] ** 2) > THRESHOLDS.correlation_misfit
    # Where the model is not that of this noise, what is significant counts as it is.
    tested = correlation - loss if formless else residual
    min_significance = (
        THRESHOLDS.correlation_sd if formless else THRESHOLDS.correlation_departure_sd
    )
    keep = np.abs(_mean_of_nine(tested)) > min_significance * tied_error
    keep[MAX_LAG_PX, MAX_LAG_PX] = False
    # 1 up to half the largest lag, then a cosine down to 0.
    falloff = np.clip((np.abs(lag) - MAX_LAG_PX / 2) / (MAX_LAG_PX / 2 + 1), 0.0, 1.0)
    taper = 0.5 * (1.0 + np.cos(np.pi * falloff))
    departure = np.where(keep, residual, 0.0) * np.outer(taper, taper)
    if formless or not keep.any():
        return form + departure
    # Without what it takes from the noise at any frequency: blur leaves little noise at high
    # frequencies, and one lag of chance would take all of it there.
    spectrum = np.fft.fft2(np.fft.ifftshift(departure)).real
    return form + np.fft.fftshift(np.fft.ifft2(np.maximum(spectrum, 0.0)).real)


def _mean_of_nine(value: Array) -> Array:
    """Return the mean of each value and its eight neighbours, beyond the border 0."""
    rows = np.pad(value, 1)[:-2] + np.pad(value, 1)[1:-1] + np.pad(value, 1)[2:]
    return (rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]) / 9.0


def bin_covariance(
    noise: NoiseLaw,
    borders: Array,
    height: Array,
    count: Array,
    keep: NDArray[np.bool_],
    slopes: tuple[float, float],
) -> Array:
    """Return the covariance of the means of bins, shape (bin, bin).

    Parameters
    ----------
    noise
        With its correlation.
    borders
        Borders of all bins of the band, px.
    height, count
        Profile above the dark side at each kept bin, DN, and its number of pixels, shape (bin,).
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
    sd = np.sqrt(noise.variance(height))
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
