"""The noise that is really in a picture: its variance on both sides of the edge and its correlation between pixels.

It is taken from what the pixels leave over after the profile, so it holds all of it: photons, gain, read-out, the
fixed pattern that frames share, and whatever blur ties neighbours together.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from charact.mtf.edge.pixels.bins import NARROWEST_PX, BinnedPixels
from charact.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.robust import median

Array = NDArray[np.float64]

# Lengths along columns and rows, and the exponent of exp(-(r/L)^p): a Gaussian blur leaves 2, tails of tubes less.
LENGTH_PX, EXPONENT = (0.35, 6.0), (0.7, 2.3)
EXPONENT_PRIOR = (1.8, 0.3)
STARTS_PX = (0.7, 1.2, 2.4)


def fit_correlation_model(
    correlation: Array, pairs: Array, across: Array, between: NDArray[np.bool_] | None = None
) -> tuple[Array, Array]:
    """Fit the form to a correlation and return it, and what the removal of bin means took from it.

    Parameters
    ----------
    correlation
        At lags of rows and columns, shape (2 R + 1, 2 C + 1), 1 in the middle.
    pairs
        Pairs of pixels behind each lag.
    across
        Distance across the edge that each lag makes, px.
    between
        Which lags lead from one field to the other, whose exposures share less of the noise or none; None: there are
        no fields.

    Returns
    -------
    form, taken
        Same shape; the form is 1 in the middle and 0 elsewhere where neighbours share nothing.

    Notes
    -----
    rho(l) = A exp(-(r(l))^p) - c t(l), c >= 0, for l other than 0: r^2 = (x/Lx)^2 + (y/Ly)^2, and t a triangle,
    because means of bins take along the same share of all pairs that lie in one bin. Gauss-Newton on Lx, Ly and p with
    A and c solved at each step.
    """
    rows, cols = (np.arange(size) - size // 2 for size in correlation.shape)
    y, x = np.meshgrid(rows, cols, indexing="ij")
    strip = np.maximum(1.0 - np.abs(across) / ACCURACY.strip_px, 0.0)
    # One of each pair of opposite lags, and not the pixel itself.
    half = (y > 0) | ((y == 0) & (x > 0))
    near = half & (np.abs(x) <= ACCURACY.correlation_fit_px) & (np.abs(y) <= ACCURACY.correlation_fit_px) & (pairs > 50)
    telling = near if between is None else near & ~between
    weight = np.sqrt(pairs[telling])
    lags = np.stack([x[telling], y[telling]]).astype(float)
    found = _fit(correlation[telling] * weight, lags, strip[telling], weight)
    middle = (x == 0) & (y == 0)
    if found is None:
        only = weight * strip[telling]
        taken = min(float(only @ (correlation[telling] * weight) / max(only @ only, 1e-300)), 0.0)
        return np.where(middle, 1.0, 0.0), np.where(middle, 0.0, taken * strip)
    theta, (share, taken) = found
    form = share * _shape(theta[None], np.stack([x.ravel(), y.ravel()]).astype(float)).reshape(x.shape)
    if between is not None:
        form = np.where(
            between, _fraction_across_fields(correlation - taken * strip, form, pairs, near & between) * form, form
        )
    return np.where(middle, 1.0, form), np.where(middle, 0.0, taken * strip)


def _fraction_across_fields(correlation: Array, form: Array, pairs: Array, lags: NDArray[np.bool_]) -> float:
    """Return how much of the form there is at some lags, from 0 to 1, by least squares."""
    weight = pairs[lags] * form[lags]
    return float(np.clip(weight @ correlation[lags] / max(weight @ form[lags], 1e-300), 0.0, 1.0))


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
def _solve(theta: Array, data: Array, lags: Array, strip: Array, weight: Array) -> tuple[Array, Array]:
    """Return share and loss, shape (n, 2), and what is left, shape (n, lag + 1), the prior of the exponent last."""
    found, left = np.empty((len(theta), 2)), np.empty((len(theta), data.size + 1))
    other, stripped = max(np.dot(strip, strip), 1e-300), np.dot(strip, data)
    shapes = _shape(theta, lags)
    for i in range(len(theta)):
        shape = shapes[i] * weight
        both = np.dot(shape, strip)
        own = max(np.dot(shape, shape) - both**2 / other, 1e-300)
        share = min(max((np.dot(shape, data) - both * stripped / other) / own, 0.0), 1.0)
        # Means take away and never add.
        loss = min((stripped - share * both) / other, 0.0)
        found[i] = share, loss
        left[i, :-1] = data - share * shape - loss * strip
        left[i, -1] = (theta[i, 2] - EXPONENT_PRIOR[0]) / EXPONENT_PRIOR[1]
    return found, left


def _fit(data: Array, lags: Array, strip: Array, weight: Array) -> tuple[Array, Array] | None:
    """Return ln lengths and exponent, share and what bins took; None where the correlation is not worth it."""
    strip = strip * weight
    starts = np.array([[np.log(length), np.log(length), EXPONENT_PRIOR[0]] for length in STARTS_PX])
    start = starts[np.argmin(np.sum(_solve(starts, data, lags, strip, weight)[1] ** 2, axis=1))]
    theta, amplitude, left = _optimise(start, data, lags, strip, weight)
    without = data - strip * (strip @ data / max(strip @ strip, 1e-300))
    worth = float(np.sum(without**2) - np.sum(left**2))
    return (theta, amplitude) if worth > THRESHOLDS.correlation_chi2 and amplitude[0] > 0 else None


def _optimise(theta: Array, data: Array, lags: Array, strip: Array, weight: Array) -> tuple[Array, Array, Array]:
    """Return the peak near a start by damped Gauss-Newton steps: lengths and exponent, share and loss, what is left."""
    low = np.array([np.log(LENGTH_PX[0]), np.log(LENGTH_PX[0]), EXPONENT[0]])
    high = np.array([np.log(LENGTH_PX[1]), np.log(LENGTH_PX[1]), EXPONENT[1]])
    little = np.concatenate([np.zeros((1, 3)), 1e-4 * np.eye(3)])
    here, damping = _solve(theta + little, data, lags, strip, weight), ACCURACY.correlation_min_damping
    for _ in range(ACCURACY.correlation_iterations):
        left = here[1]
        slopes = (left[1:] - left[0]) / 1e-4
        normal = slopes @ slopes.T
        step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal)) + 1e-12 * np.eye(3), slopes @ left[0])
        trial = np.clip(theta + np.clip(step, -0.5, 0.5), low, high)
        there = _solve(trial + little, data, lags, strip, weight)
        gain = np.sum(left[0] ** 2) - np.sum(there[1][0] ** 2)
        if gain > 0.0:
            theta, here, damping = (
                trial,
                there,
                max(damping / ACCURACY.correlation_damping_step, ACCURACY.correlation_min_damping),
            )
            if gain < ACCURACY.correlation_min_gain:
                break
        else:
            # Too far along a ridge of lengths and exponent: the next step is shorter and steeper.
            damping *= ACCURACY.correlation_damping_step
            if damping > ACCURACY.correlation_max_damping:
                break
    return theta, here[0][0], here[1][0]


MAX_LAG_PX = 14  # px; correlations beyond are taken as none
# Squared residuals count for no more than so many variances.
LARGEST_SQUARE = 50.0


@dataclass(frozen=True, kw_only=True)
class EdgeNoiseModel:
    """Noise of a picture along an edge.

    Parameters
    ----------
    dark_variance, bright_variance
        Variance of a pixel on both plateaus, DN^2; in between it is linear in the profile.
    correlation
        Correlation at lags of rows and columns, shape (2 REACH + 1, 2 REACH + 1), 1 in the middle.
    """

    dark_variance: float
    bright_variance: float
    correlation: Array

    @property
    def covariance_over_variance(self) -> float:
        """Sum of the correlation: by how much averages are noisier than those of independent pixels."""
        return float(max(self.correlation.sum(), 0.05))

    def variance(self, level: Array) -> Array:
        """Return the variance where the profile stands at a level between 0 (dark) and 1 (bright)."""
        share = np.clip(level, 0.0, 1.0)
        return self.dark_variance + (self.bright_variance - self.dark_variance) * share


def estimate_edge_noise(
    residual: Array, level: Array, gathered: BinnedPixels, floor: float, field_axis: int | None = None
) -> EdgeNoiseModel:
    """Estimate the noise from residuals.

    Parameters
    ----------
    residual
        Picture less its profile, shape (row, col), DN.
    level
        Profile from 0 to 1 at every pixel, shape (row, col).
    gathered
        The band along the edge.
    floor
        Least variance, DN^2.
    field_axis
        Along which axis of the picture two fields alternate; None: there are none.
    """
    used = gathered.used
    dark, bright = _variances(residual, level, used, floor)
    grain = EdgeNoiseModel(dark_variance=dark, bright_variance=bright, correlation=np.ones((1, 1)))
    if max(dark, bright) <= 1.01 * floor:
        # What is left over is rounding, in the data or in the bins, and ties no neighbours.
        return grain
    standard = np.where(used, residual / np.sqrt(grain.variance(level)), 0.0)
    slopes = float(np.diff(gathered.distance[0, :2])[0]), float(np.diff(gathered.distance[:2, 0])[0])
    correlation = correlation_of(standard, used, slopes, field_axis)
    return EdgeNoiseModel(dark_variance=dark, bright_variance=bright, correlation=correlation)


def _variances(residual: Array, level: Array, used: NDArray[np.bool_], floor: float) -> tuple[float, float]:
    """Return the variances at level 0 and 1 of a least-squares line through the squared residuals."""
    normal, pull, mean = _squares(residual, level, used, floor)
    dark, bright = np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(2), pull)
    mean = max(mean, floor)
    return max(float(dark), 0.02 * mean, floor), max(float(bright), 0.02 * mean, floor)


@njit(cache=True)
def _squares(residual: Array, level: Array, used: NDArray[np.bool_], floor: float) -> tuple[Array, Array, float]:
    """Return the normal equations of squared residuals, wild ones cut, linear in the level; and their mean."""
    count, total, squares = 0, 0.0, 0.0
    for row in range(residual.shape[0]):
        for col in range(residual.shape[1]):
            if used[row, col]:
                count += 1
                total += residual[row, col]
                squares += residual[row, col] ** 2
    count = max(count, 1)
    most = LARGEST_SQUARE * (squares / count - (total / count) ** 2) + floor
    normal, pull, mean = np.zeros((2, 2)), np.zeros(2), 0.0
    for row in range(residual.shape[0]):
        for col in range(residual.shape[1]):
            if used[row, col]:
                square, bright = min(residual[row, col] ** 2, most), level[row, col]
                dark = 1.0 - bright
                normal[0, 0] += dark * dark
                normal[0, 1] += dark * bright
                normal[1, 1] += bright * bright
                pull[0] += dark * square
                pull[1] += bright * square
                mean += square / count
    normal[1, 0] = normal[0, 1]
    return normal, pull, mean


def correlation_of(
    standard: Array, used: NDArray[np.bool_], slopes: tuple[float, float], field_axis: int | None = None
) -> Array:
    """Return the correlation of standardised residuals at lags up to REACH: a smooth form, and what departs from it.

    Parameters
    ----------
    standard, used
        Residuals in units of their deviation and which of them count, shape (row, col).
    slopes
        Change of the distance from the edge with one column and with one row, px.
    field_axis
        As of `estimate_edge_noise`.
    """
    rows, cols = standard.shape
    reach_row, reach_col = min(MAX_LAG_PX, rows - 1), min(MAX_LAG_PX, cols - 1)
    shape = (rows + reach_row, cols + reach_col)
    product = _autocorrelation(standard, shape)
    pairs = np.rint(_autocorrelation(used, shape))
    take_row, take_col = np.arange(-reach_row, reach_row + 1), np.arange(-reach_col, reach_col + 1)
    product, pairs = (part[np.ix_(take_row, take_col)] for part in (product, pairs))
    correlation = np.where(pairs > 50, product / np.maximum(pairs, 1), 0.0)
    if not correlation[reach_row, reach_col] > 0:
        return np.ones((1, 1))
    correlation = correlation / correlation[reach_row, reach_col]
    across = np.add.outer(take_row * slopes[1], take_col * slopes[0])
    odd = np.broadcast_to((take_row[:, None], take_col[None, :])[field_axis or 0] % 2 == 1, correlation.shape)
    form, taken = fit_correlation_model(correlation, pairs, across, None if field_axis is None else odd)
    left = correlation - form - taken
    # Bartlett: errors of a correlation are tied over lags as the noise itself is.
    error = np.sqrt(np.sum(form**2) / np.maximum(pairs, 1))
    near = np.maximum(np.abs(take_row)[:, None], np.abs(take_col)) <= ACCURACY.correlation_near_px
    tied = np.sqrt(np.sum(_running_mean(form) ** 2) / np.maximum(pairs, 1))
    formless = np.mean((left / error)[near] ** 2) > THRESHOLDS.correlation_misfit
    if formless:
        # No smooth form is that of this noise: what stands out counts as it is.
        keep = np.abs(_running_mean(correlation - taken)) > THRESHOLDS.correlation_sd * tied
    else:
        keep = np.abs(_running_mean(left)) > THRESHOLDS.correlation_departure_sd * tied
    keep[reach_row, reach_col] = False
    taper = np.outer(_taper(take_row, MAX_LAG_PX), _taper(take_col, MAX_LAG_PX))
    departure = np.where(keep, left, 0.0) * taper
    return form + (departure if formless or not keep.any() else _non_negative_part(departure))


def _non_negative_part(departure: Array) -> Array:
    """Return a departure from the form without what it takes from the noise at any frequency.

    Blur leaves little noise at high frequencies: one lag of chance would take all of it there, and a sharp edge would
    be known as if it had none.
    """
    spectrum = np.fft.fft2(np.fft.ifftshift(departure)).real
    return np.fft.fftshift(np.fft.ifft2(np.maximum(spectrum, 0.0)).real)


def _autocorrelation(field: NDArray, shape: tuple[int, int]) -> Array:
    """Return the sums of products at all lags; those up to what the shape adds to the field's are free of wrapping.

    In single precision: a correlation is known to a thousandth at best.
    """
    fast = tuple(_fast_length(size) for size in shape)
    spectrum = np.asarray(np.fft.rfft2(field.astype(np.float32), fast), np.complex64)
    return np.asarray(np.fft.irfft2(spectrum.real**2 + spectrum.imag**2, fast), np.float64)


def _fast_length(least: int) -> int:
    """Return the next length that is a product of powers of 2, 3 and 5, which transforms fast."""
    odd = (3**b * 5**c for b in range(12) for c in range(8))
    return min(factor << max(0, (-(-least // factor) - 1).bit_length()) for factor in odd)


@njit(cache=True)
def _running_mean(field: Array) -> Array:
    """Return the 3 x 3 running mean, nothing beyond the borders."""
    rows, cols = field.shape
    out = np.zeros((rows, cols))
    for row in range(rows):
        for col in range(cols):
            for i in range(max(row - 1, 0), min(row + 2, rows)):
                for j in range(max(col - 1, 0), min(col + 2, cols)):
                    out[row, col] += field[i, j] / 9.0
    return out


def _taper(lag: NDArray, reach: int) -> Array:
    """Return 1 up to half the reach, then a cosine down to 0."""
    share = np.clip((np.abs(lag) - reach / 2) / (reach / 2 + 1), 0.0, 1.0)
    return 0.5 * (1.0 + np.cos(np.pi * share))


def bin_covariance(
    grain: EdgeNoiseModel, gathered: BinnedPixels, level: Array, count: Array, keep: NDArray, slopes
) -> Array:
    """Return the covariance of the means of bins, shape (bin, bin).

    Parameters
    ----------
    level
        Profile at each kept bin, shape (bin,).
    count
        Pixels in each kept bin.
    keep
        Which bins of the band are meant.
    slopes
        Change of distance with one column and with one row, px.

    Notes
    -----
    Pixels a lag apart are the same distance delta apart along the normal wherever they are, so
    cov(b, b') = sqrt(v v') / (n n') sum over lags of rho times the pairs of b and b' shifted by delta: for an even
    filling the overlap of two boxes, a second difference of the ramp sum_lag rho max(0, x - delta).
    """
    rows, cols = (np.arange(size) - size // 2 for size in grain.correlation.shape)
    delta = np.add.outer(rows * slopes[1], cols * slopes[0]).ravel()
    order = np.argsort(delta)
    delta, mass = delta[order], grain.correlation.ravel()[order]
    total, moment = np.concatenate([[0.0], np.cumsum(mass)]), np.concatenate([[0.0], np.cumsum(mass * delta)])

    # Borders lie on a grid: few differences are different.
    place = np.rint(gathered.borders / NARROWEST_PX).astype(np.int64)
    reach = int(np.ptp(place))
    apart = np.arange(-reach, reach + 1) * NARROWEST_PX
    index = np.searchsorted(delta, apart)
    ramp = np.asarray(total[index] * apart - moment[index], np.float64)
    width, sd = np.diff(gathered.borders)[keep], np.sqrt(grain.variance(level))
    covariance = _overlaps(ramp, place, np.flatnonzero(keep), sd / np.sqrt(width * count))
    if not (np.diag(covariance) > 0).any():
        # Too few pixels to tell a correlation, and chance made it cancel the noise: pixels count as independent.
        return np.diag(sd**2 / count)
    return _positive(covariance)


@njit(cache=True)
def _overlaps(ramp: Array, place: NDArray[np.int64], kept: NDArray[np.int64], scale: Array) -> Array:
    """Return second differences of a ramp between the borders of kept bins, scaled, shape (bin, bin)."""
    out, middle = np.empty((kept.size, kept.size)), ramp.size // 2
    for i in range(kept.size):
        begin, end = place[kept[i]], place[kept[i] + 1]
        for j in range(i + 1):
            other, last = place[kept[j]], place[kept[j] + 1]
            one = ramp[middle + last - begin] - ramp[middle + last - end]
            one += ramp[middle + other - end] - ramp[middle + other - begin]
            two = ramp[middle + end - other] - ramp[middle + end - last]
            two += ramp[middle + begin - last] - ramp[middle + begin - other]
            out[i, j] = out[j, i] = 0.5 * (one + two) * scale[i] * scale[j]
    return out


def _positive(covariance: Array) -> Array:
    """Return the covariance, its eigenvalues raised to a small share of those of independent pixels where negative."""
    # A bin of one pixel whose noise the correlation estimate makes nothing of is as noisy as its neighbours.
    diagonal = np.diag(covariance)
    scale = np.sqrt(np.maximum(diagonal, 1e-3 * median(diagonal[diagonal > 0])))
    correlation = covariance / np.outer(scale, scale)
    try:
        np.linalg.cholesky(correlation - 1e-3 * np.eye(len(correlation)))
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(correlation)
    else:
        return covariance
    return (vectors * np.maximum(values, 0.02)) @ vectors.T * np.outer(scale, scale)
