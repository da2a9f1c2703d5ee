"""The noise spectrum of a camera that blurs after its gain, and the posterior of the covariance gain under it.

Photoelectrons arrive independently and everything after the gain blurs them; the electrons of the CCD that each of them
makes are counted at random once more, which no blur touches. The power of the noise is (k F^2 |H(f)|^2 + K) mu: at
f -> 0 it is the covariance summed over all lags, whatever the blur. Blur of image tubes
has long wings (transfer exp(-(f/fc)^n) with n near 1), so that no window of lags holds all of the sum; the spectrum is
extrapolated instead with the form that such transfers have, and the extrapolation's uncertainty is in the interval.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.noise.gain.reading import Reading
from charact.noise.gain.summary import Summary
from charact.posterior import laplace, maximum, weighed
from labdata.measurement import Posterior

Array = NDArray[np.float64]

NAMES = ("power", "fall_columns", "fall_rows", "strength", "exponent", "electron_share")
UNITS = ("DN", "1", "1", "1", "1", "1")
DERIVED = ("covariance_gain", "blur_factor", "lag_factor")
DERIVED_UNITS = ("DN", "1", "1")
# Frequency at which the fall of the logarithm is stated, cycles per column pitch.
REFERENCE_CY_PER_PX = 0.1
# Flat priors but for the last two. Falls, strength and share may go below zero, else a camera without blur would be
# pushed to one side.
BOUNDS = np.array([[0.0, np.inf], [-1.0, 6.0], [-1.0, 6.0], [-1.5, 6.0], [0.7, 2.5], [-0.5, 0.5]])
# Normal prior of the exponent where no sensor states it: image tubes lie between 1.1 and 1.7, Gaussian blur is left
# to the widths that falls and strength leave. Mean and standard deviation.
EXPONENT = (1.3, 0.2)
# Normal prior of the electrons' share of the noise, K / (K + k F^2): a photoelectron makes some hundred electrons in
# the CCD. It matters only where blur leaves little else at the highest frequency fitted.
ELECTRON_SHARE = (0.003, 0.01)
# The spectrum is fitted up to one of these radii, the widest that the model describes.
REACHES_CY_PER_PX = (0.25, 0.21, 0.18, 0.15, 0.12, 0.1)
# Least probability of the residuals by chance for the model to pass.
LEAST_CHANCE = 0.05
# Effective number of weighted draws below which a posterior is not trusted.
LEAST_EFFECTIVE = 1000.0


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Posterior of the noise model with what it was fitted to.

    Parameters
    ----------
    posterior
        Draws of `NAMES`.
    used
        Bins fitted, shape (bin,).
    model_dn
        Power of the best fit in every bin, shape (bin,), DN.
    chi2, freedom, chance
        Squared residuals over their variance, degrees of freedom, and the probability of more by chance.
    """

    posterior: Posterior
    used: NDArray[np.bool_]
    model_dn: Array
    chi2: float
    freedom: int
    chance: float


def transfer(parameters: Array, column: Array, row: Array, reading: Reading) -> Array:
    """Return |H|^2 of the blur after the gain as it is read, shape (draw, bin).

    exp(-b r^n - cx x^2 - cy y^2), frequencies in units of the reference: the tube's form times the leading term of
    every other aperture and filter, of which those that read are put in as they are. The parameters are the falls
    b + cx and b + cy at the reference with all of them, b and n.
    """
    columns, rows, strength, exponent = (parameters[:, i, None] for i in range(1, 5))
    known_columns, known_rows = (REFERENCE_CY_PER_PX**2 * fall for fall in reading.falls)

    def before(column: Array, row: Array) -> Array:
        x, y = column / REFERENCE_CY_PER_PX, row / REFERENCE_CY_PER_PX
        gauss = (columns - strength - known_columns) * x**2 + (rows - strength - known_rows) * y**2
        return -strength * np.hypot(x, y) ** exponent - gauss

    return reading.shown(before, column, row)


def spectrum_at(parameters: Array, column: Array, row: Array, reading: Reading) -> Array:
    """Return the power per DN of signal at one time lag 0, shape (draw, bin), DN."""
    share = parameters[:, 5:]
    return parameters[:, :1] * ((1.0 - share) * transfer(parameters, column, row, reading) + share)


def leaked(point: Array, column: Array, row: Array, reading: Reading, leak_cy2_per_px2: tuple[float, float]) -> Array:
    """Return the power that the modes of faded images have over that of `spectrum_at`, shape (bin,), dimensionless.

    Each mode is a mean over frequencies nearby, which to second order is the mean of two on either side.
    """
    across, down = np.sqrt(leak_cy2_per_px2)
    around = [
        spectrum_at(point[None], column + i * across, row + j * down, reading)[0] for i in (-1, 1) for j in (-1, 1)
    ]
    return np.mean(around, axis=0) / spectrum_at(point[None], column, row, reading)[0]


def fit(summary: Summary, *, seed: int, quick: bool, exponent: tuple[float, float] = EXPONENT) -> Fit:
    """Fit the model to the pooled spectrum, the variance and the correlation in time.

    Parameters
    ----------
    summary
        The statistics.
    seed, quick
        Seed of the draws; draws from the curvature at the peak.
    exponent
        Mean and standard deviation of the prior of the exponent n.
    """
    radius = np.hypot(summary.column_cy_per_px, summary.row_cy_per_px)
    for reach in REACHES_CY_PER_PX:
        used = radius <= reach
        peak = _climb(summary, used, exponent)
        if peak.chance > LEAST_CHANCE or used.sum() < 24:
            break
    drawn = (laplace if quick else _weighed)(
        peak.log_probability, names=NAMES, units=UNITS, start=peak.point, covariance=peak.covariance, seed=seed,
        bounds=BOUNDS,
    )  # fmt: skip
    posterior = _with_gain(drawn, summary, np.random.default_rng([seed, 1]))
    everywhere = summary.column_cy_per_px, summary.row_cy_per_px, summary.reading
    model = spectrum_at(peak.point[None], *everywhere)[0] * leaked(peak.point, *everywhere, summary.leak_cy2_per_px2)
    return Fit(posterior=posterior, used=used, model_dn=model, chi2=peak.chi2, freedom=peak.freedom, chance=peak.chance)


def _weighed(log_probability: Callable[[Array], Array], **of: Any) -> Posterior:
    """Draw by importance: strength, falls and exponent lie on a curved ridge along which a chain is slow."""
    drawn = weighed(log_probability, **of)
    if drawn.effective_sample_size[0] >= LEAST_EFFECTIVE:
        return drawn
    return replace(drawn, flags=(*drawn.flags, "not-converged"))


@dataclass(frozen=True, kw_only=True)
class _Peak:
    """The best fit over a range of frequency."""

    log_probability: Callable[[Array], Array]
    point: Array
    covariance: Array
    chi2: float
    freedom: int
    chance: float


def _climb(summary: Summary, used: NDArray[np.bool_], exponent: tuple[float, float]) -> _Peak:
    """Find the peak; the errors of the bins are those of the fitted power, not of the scattered one."""
    from scipy.stats import chi2 as chi_squared

    column, row, power = summary.column_cy_per_px[used], summary.row_cy_per_px[used], summary.power_dn[used]
    point = _start(summary, used, exponent[0])
    for _ in range(2):
        leak = leaked(point, column, row, summary.reading, summary.leak_cy2_per_px2)
        model = spectrum_at(point[None], column, row, summary.reading)[0] * leak
        own = summary.power_sd_dn[used] * model / np.maximum(power, 0.2 * model)
        log_probability = _log_probability(summary, used, model, leak, own, exponent)
        point, covariance = maximum(log_probability, point, BOUNDS)
    model = spectrum_at(point[None], column, row, summary.reading)[0] * leak
    chi2, freedom = float(np.sum(((power - model) / own) ** 2)), int(used.sum()) - len(NAMES)
    return _Peak(log_probability=log_probability, point=point, covariance=covariance, chi2=chi2, freedom=freedom,
                 chance=float(chi_squared.sf(chi2, freedom)))  # fmt: skip


def _with_gain(drawn: Posterior, summary: Summary, rng: np.random.Generator) -> Posterior:
    """Put the gain, the blur factor and the lag factor before the draws of the spectrum.

    The variance and the correlation in time are measured apart from the spectrum's height: their errors are drawn
    independently.
    """
    power, count = drawn["power"], len(drawn.draws)
    few = rng.standard_normal(count) if np.isinf(summary.lag.freedom) else rng.standard_t(summary.lag.freedom, count)
    factor = summary.lag.factor + summary.lag.factor_sd * few
    variance = summary.variance_dn + summary.variance_sd_dn * rng.standard_normal(count)
    derived = np.stack([power * factor, variance / power, factor], axis=1)

    def first_thrice(of: Array) -> Array:
        return np.concatenate([np.repeat(of[:1], len(DERIVED)), of])

    return replace(
        drawn,
        names=(*DERIVED, *NAMES),
        units=(*DERIVED_UNITS, *UNITS),
        draws=np.concatenate([derived, drawn.draws], axis=1),
        autocorrelation_time=first_thrice(drawn.autocorrelation_time),
        r_hat=first_thrice(drawn.r_hat),
        effective_sample_size=first_thrice(drawn.effective_sample_size),
    )


def _start(summary: Summary, used: NDArray[np.bool_], exponent: float) -> Array:
    """A linear fit of the logarithm, good enough to climb from."""
    x = summary.column_cy_per_px[used] / REFERENCE_CY_PER_PX
    y = summary.row_cy_per_px[used] / REFERENCE_CY_PER_PX
    power = np.maximum(summary.power_dn[used], 1e-3 * summary.power_dn[used].max())
    design = np.stack([np.ones_like(x), -(np.hypot(x, y) ** exponent), -(x**2), -(y**2)])
    root = np.sqrt(summary.modes[used])
    level, strength, columns, rows = np.linalg.lstsq((design * root).T, np.log(power) * root, rcond=None)[0]
    falls = np.clip([columns + strength, rows + strength, strength], -0.8, 5.0)
    return np.array([np.exp(level), *falls, exponent, ELECTRON_SHARE[0]])


def _log_probability(summary: Summary, used: NDArray[np.bool_], model: Array, leak: Array, own: Array, exponent):
    """Gaussian likelihood of the spectrum; the bins share the error that pulse heights give them all."""
    column, row, power = summary.column_cy_per_px[used], summary.row_cy_per_px[used], summary.power_dn[used]
    shared = model * summary.height_sd
    # The inverse root of diag(own^2) + shared shared^T, whatever the ratio of the two.
    scaled = shared / own
    size = max(float(scaled @ scaled), 1e-12)
    root = (np.eye(len(own)) - (1.0 - 1.0 / np.sqrt(1.0 + size)) / size * np.outer(scaled, scaled)) / own[:, None]

    def log_probability(points: Array) -> Array:
        inside = np.all((points >= BOUNDS[:, 0]) & (points <= BOUNDS[:, 1]), axis=1)
        safe = np.where(inside[:, None], points, BOUNDS.mean(axis=1, where=np.isfinite(BOUNDS)))
        residual = (power - leak * spectrum_at(safe, column, row, summary.reading)) @ root
        known = np.array([exponent, ELECTRON_SHARE])
        prior = (((safe[:, 4:] - known[:, 0]) / known[:, 1]) ** 2).sum(axis=1)
        return np.where(inside, -0.5 * ((residual**2).sum(axis=1) + prior), -np.inf)

    return log_probability
