"""Noise around a point source: surroundings, quiet pixels and correlated pulses."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.point.thresholds import ACCURACY, LIMITS
from charact.frames.noise_law import NoiseLaw, masked_covariance
from labdata import Array, Mask

# Lags of a pixel's neighbours, half of them, as opposite ones are equal.
REACH_PX = 2
LAGS = np.array(
    [
        (row, col)
        for row in range(REACH_PX + 1)
        for col in range(-REACH_PX, REACH_PX + 1)
        if (row, col) > (0, 0)
    ]
)
WIDTHS_PX = np.array([0.01, *np.geomspace(0.3, 3.0, 24)])
# Pulse widths over that of the complete blur.
WIDTHS = np.geomspace(0.2, 1.0, 24)
GAINS = np.exp(np.linspace(np.log(1e-4), np.log(1e5), 240))
# Prior of a dark pixel's noise, ln of photoelectrons and its standard deviation: 0.7 to 35, from
# counting to ordinary cameras under a sky. It matters for the few lit pixels of a single frame.
DARK_LN = (float(np.log(5.0)), 1.0)
RADII_PX = np.linspace(0.0, 16.0, 80)


def measure_surroundings_noise(
    data: NDArray, row: int, col: int, neighbours: Mask | bool = False, *, spot: Mask | bool = False
) -> NoiseLaw:
    """Return the noise far from a source, from frame differences, or in one frame from its own
    scatter.

    `neighbours` marks pixels of other sources, and `spot` those of a wide one, shape (row, col).
    The correlation, where it is significant, is common exp(-x^2 / 4 w^2) in either direction.
    """
    rows, cols = data.shape[1:]
    distance = np.hypot(*np.ogrid[-row : rows - row, -col : cols - col])
    surroundings = ~np.asarray(neighbours) & ~np.asarray(spot)
    if not np.any(spot):
        surroundings = (
            (distance > min(ACCURACY.noise_distance_px, 0.6 * float(distance.max())))
            & (distance < 4.0 * ACCURACY.noise_distance_px)
            & surroundings
        )
    frames = data[:16].astype(float)
    if len(frames) > 1:
        off, freedom = frames - frames.mean(axis=0), 1.0 - 1.0 / len(frames)
    else:
        y, x = np.nonzero(surroundings)
        plane = np.stack([np.ones(y.size), y, x], axis=1)
        fitted = np.linalg.lstsq(plane, frames[0][surroundings], rcond=None)[0]
        every = fitted[0] + fitted[1] * np.arange(rows)[:, None] + fitted[2] * np.arange(cols)
        off, freedom = frames - every, 1.0
    rounding = (
        1e-3 if data.dtype.kind in "ui" else 1e-12 * max(float(np.abs(frames).max()), 1e-6) ** 2
    )
    if len(frames) == 1 and np.any(neighbours):
        # Light of neighbours would resemble correlated noise: use the lower quantiles.
        low, high = np.quantile(off[0, surroundings], ACCURACY.background_quantiles)
        variance = float((high - low) / ACCURACY.background_quantile_sd) ** 2
        return NoiseLaw(gain_dn=0.0, read_dn=max(variance, rounding) ** 0.5)
    # Exclude single bright events such as ion feedback.
    centre = np.clip(off, *np.quantile(off[:, surroundings], (1e-4, 1.0 - 1e-4)))
    variance = float((centre[:, surroundings] ** 2).mean()) / freedom
    law = NoiseLaw(gain_dn=0.0, read_dn=max(variance, rounding) ** 0.5)
    if variance <= rounding:
        return law
    return _fit_correlation(law, np.where(surroundings, centre, 0.0), surroundings, freedom)


def _fit_correlation(law: NoiseLaw, off: Array, surroundings: Mask, freedom: float) -> NoiseLaw:
    """Return the surroundings' noise with the correlation of neighbours, if significant."""
    products, pairs = (
        of_lags[tuple((LAGS + REACH_PX).T)]
        for of_lags in masked_covariance(off, surroundings, REACH_PX)
    )
    correlation = products / (law.read_dn**2 * freedom)
    error = 1.0 / np.sqrt(np.maximum(pairs, 1.0) * max(len(off) - 1, 1))
    if np.abs(correlation / error).max() < LIMITS.max_correlation_sd:
        return law
    down, along = (np.exp(-0.25 * (lag / WIDTHS_PX[:, None]) ** 2) for lag in LAGS.T)
    shapes = (down[:, None] * along[None]).reshape(-1, len(LAGS))
    common = np.clip(shapes @ correlation / np.maximum(np.sum(shapes**2, axis=1), 1e-12), 0.0, 1.0)
    best = int(np.argmin(np.sum((correlation - common[:, None] * shapes) ** 2, axis=1)))
    widths = WIDTHS_PX[list(np.unravel_index(best, (WIDTHS_PX.size, WIDTHS_PX.size)))]
    # At all lags within the core.
    down, along = (
        np.exp(-0.25 * (np.arange(-2 * half, 2 * half + 1) / width) ** 2)
        for half, width in zip((ACCURACY.half_rows, ACCURACY.half_cols), widths, strict=True)
    )
    rho = common[best] * np.outer(down, along)
    rho[2 * ACCURACY.half_rows, 2 * ACCURACY.half_cols] = 1.0
    return law.correlated(rho)


@dataclass(frozen=True, kw_only=True)
class Pulses:
    """Noise of the light."""

    gain: float  # Variance over light, DN
    unit: Array  # Covariance of one frame at unit gain, shape (pixel, pixel), DN

    @property
    def covariance(self) -> Array:
        """Covariance of one frame, DN^2."""
        return self.gain * self.unit


def pulse_covariances(radial: tuple[Array, Array], mean: Array, x: Array, y: Array) -> list[Array]:
    """Return candidate covariances at unit gain of light with correlated pulses, shape (pixel,
    pixel) each, DN.

    `radial`: frequencies, cycles per column pitch, and the blur's transfer there averaged over
    directions; `mean`: light in every pixel, DN; `x`, `y`: positions of columns and rows from the
    source, column pitches.

    Notes
    -----
    Pulses are Gaussians. Either they have a fraction of the blur's logarithm and the blur before
    the gain has the same model, or they have a fixed width and the blur before the gain is the
    remainder, which keeps long tails.
    """
    frequency, transfer = radial
    log = np.log(np.clip(transfer, 1e-12, 1.0))
    pulse_width = _width(frequency, log)
    laws = [
        ((1.0 - fraction) * log, _width(frequency, fraction * log))
        for fraction in (0.15, 0.3, 0.45, 0.6, 0.8, 1.0)
    ]
    laws += [
        (
            np.minimum.accumulate(np.minimum(log + 2.0 * (np.pi * frequency * width) ** 2, 0.0)),
            width,
        )
        for width in pulse_width * WIDTHS
    ]
    return [
        np.diag(np.maximum(mean, 0.0)),
        *(_covariance(frequency, *law, mean, x, y) for law in laws),
    ]


def _width(frequency: Array, log: Array) -> float:
    """Return the standard deviation of a Gaussian of equal half frequency, px."""
    return float(np.sqrt(np.log(2.0) / 2.0) / np.pi / np.interp(np.log(2.0), -log, frequency))


def _covariance(
    frequency: Array, log_before: Array, width_px: float, mean: Array, x: Array, y: Array
) -> Array:
    """Return the covariance at unit gain of pulses of a width, shape (pixel, pixel), DN.

    `log_before`: ln transfer before the gain.

    Notes
    -----
    Photoelectrons of density d(u) with pulses p have the covariance sum_u d(u) p(x - u) p(y - u),
    which is positive. It is scaled to an overall variance over mean of 1.
    """
    from scipy.special import j0

    step = np.gradient(frequency)
    landed = (j0(2.0 * np.pi * RADII_PX[:, None] * frequency)) @ (
        2.0
        * np.pi
        * frequency
        * step
        * np.exp(log_before - 0.5 * (np.pi * frequency * ACCURACY.pulse_step_px) ** 2 / 3.0)
    )
    positions = np.arange(
        -ACCURACY.pulse_extent_px, ACCURACY.pulse_extent_px + 1e-9, ACCURACY.pulse_step_px
    )
    density = (
        np.interp(np.hypot(positions[:, None], positions), RADII_PX, np.maximum(landed, 0.0))
        * ACCURACY.pulse_step_px**2
    )
    along, down = (_pulse(at, positions, width_px) for at in (x, y))
    columns = (along[:, :, None] * along[:, None, :]).reshape(positions.size, -1)
    rows = (down[:, :, None] * down[:, None, :]).reshape(positions.size, -1)
    products = (rows.T @ density @ columns).reshape(y.size, y.size, x.size, x.size)
    unit = products.transpose(0, 2, 1, 3).reshape(x.size * y.size, -1)
    return unit * (float(np.maximum(mean, 0.0).sum()) / max(float(np.trace(unit)), 1e-300))


def _pulse(at: Array, positions: Array, sigma: float) -> Array:
    """Return a Gaussian pulse integrated over pixels, shape (position, pixel)."""
    from scipy.special import ndtr

    half = 0.5 * float(np.diff(at[:2])[0])
    off = at - positions[:, None]
    return ndtr((off + half) / sigma) - ndtr((off - half) / sigma)


def fit_pulses(
    samples: Array,
    dark: Array,
    units: Sequence[Array],
    factor: Array,
    pixels: NDArray[np.int64],
    fitted: Array | None = None,
    ln_odds: float = 0.0,
) -> Pulses:
    """Return the pulses that make independent samples of the noise most probable.

    `samples`: deviations, each of the noise of one frame, shape (sample, pixel), DN; `dark`:
    covariance of the dark noise, shape (pixel, pixel); `units`: candidate covariances at unit gain;
    `factor`: image lag of each pair of pixels, shape (pixel, pixel); `pixels`: pixels used;
    `fitted`: directions in which a fit absorbed noise, shape (pixel, direction); None: none;
    `ln_odds`: ln of further prior odds for the first candidate.

    Notes
    -----
    The first candidate has half of the prior probability. The gain is its posterior median; if n
    values constrain it (2 / n is the variance of its ln), the noise is Student's t, whose variance
    is n / (n - 2) times larger.
    """
    pixel_pairs, quiet_dn = np.ix_(pixels, pixels), float(np.sqrt(dark[pixels[0], pixels[0]]))
    root = np.linalg.inv(np.linalg.cholesky(dark[pixel_pairs]))
    if fitted is not None:
        # Restricted likelihood: only directions orthogonal to the fit have the noise's variance.
        basis = np.linalg.qr(root @ fitted[pixels], mode="complete")[0]
        root = basis[:, fitted.shape[1] :].T @ root
    white = samples[:, pixels] @ root.T
    fits = []
    for number, unit in enumerate(units):
        values, vectors = np.linalg.eigh(root @ (unit * factor)[pixel_pairs] @ root.T)
        values = np.maximum(values, 0.0)
        gains = GAINS / max(float(values.mean()), 1e-300)
        power = ((white @ vectors) ** 2).sum(axis=0)
        variance = gains[:, None] * values + 1.0
        fit = -0.5 * (len(white) * np.log(variance) + power / variance).sum(axis=1)
        fit = fit - 0.5 * ((np.log(quiet_dn / gains) - DARK_LN[0]) / DARK_LN[1]) ** 2
        weight = np.exp(fit - fit.max())
        weight /= weight.sum()
        ln = np.log(gains)
        spread = float(weight @ (ln - weight @ ln) ** 2)
        # Student's t of fewer than six values has hardly a variance.
        n_values = max(2.0 / max(spread, 1e-9), 6.0)
        median = float(np.exp(np.interp(0.5, np.cumsum(weight), ln)))
        odds = np.log(len(units) - 1.0) + ln_odds if number and len(units) > 1 else 0.0
        fits.append((float(fit.max()) - odds, median * n_values / (n_values - 2.0)))
    best = int(np.argmax([fit for fit, _ in fits]))
    return Pulses(gain=fits[best][1], unit=units[best])


def dark_sd_from_histogram(codes: NDArray[np.integer]) -> float:
    """Return the standard deviation of a pixel without light, DN; a default where quantisation
    hides it.

    `codes`: values around a source, any shape.

    Notes
    -----
    For normal noise the fractions of values below two grey values lie z(fraction) standard
    deviations below the mean: the difference of the grey values over that of z is one standard
    deviation. Light pulses raise values and hardly change the lower tail.
    """
    from scipy.special import ndtri

    code, number = np.unique(codes, return_counts=True)
    number_below = np.cumsum(number) - number
    commonest, lower = int(np.argmax(number)), int(np.searchsorted(number_below, 16))
    if lower >= commonest:
        return ACCURACY.hidden_sd_dn
    z_common, z_lower = (
        float(ndtri(number_below[index] / codes.size)) for index in (commonest, lower)
    )
    return float(code[commonest] - code[lower]) / max(z_common - z_lower, 1e-9)
