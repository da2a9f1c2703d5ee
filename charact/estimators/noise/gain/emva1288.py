"""EMVA 1288 Release 4 (linear model) for white noise: system gain, responsivity, sensitivity.

Mean and variance of the grey value are mu = mu_dark + K eta p and s^2 = s_dark^2 + K (mu - mu_dark)
for p photons on a pixel; K is the slope of the photon transfer curve and R = K eta that of the
responsivity, both fitted over 0-70 % of saturation, the level where the temporal variance peaks.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.gain.series import FlatSeries
from charact.estimators.noise.linear_fit import draw_posterior
from charact.estimators.noise.thresholds import GAIN
from charact.frames.rounding import QUANTISATION_DN2
from charact.inference import laplace, sample_posterior
from charact.method import Context
from charact.observables.photon_transfer import variance_errors
from labdata import Array, Conditions, Posterior, has_tube
from labdata.camera.chip import excess_noise_factor


@dataclass(frozen=True, kw_only=True)
class Excess:
    """Excess noise factor of a register."""

    factor: float = 1.0  # F^2; 1 without a register
    relative_sd: float = 0.0  # relative standard deviation of F^2
    note: str | None = None  # source of the value; None without a register

    def divide(self, slope: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
        """Return draws of the gain per electron: slope over F^2."""
        if self.note is None:
            return slope
        chance = np.random.default_rng([seed, 18]).standard_normal(len(slope))
        return slope / (self.factor * np.exp(self.relative_sd * chance))


def excess_of(conditions: Conditions, context: Context) -> Excess:
    """Return the excess noise factor of the register, from the stated gain or else the described
    one.
    """
    gain, camera = conditions.em_gain, context.camera
    register = camera.register if camera is not None and camera.multiplies else None
    if has_tube(camera) or (gain is None and register is None):
        return Excess()
    source = f"em_gain {gain:g} of the session" if gain is not None else ""
    if gain is None and register is not None:
        gain, source = (
            float(register.em_gain),
            f"em_gain {float(register.em_gain):g} of the description",
        )
    if gain is None or gain <= 1.0:
        return Excess()
    # Between many equal stages and exponential pulse heights, which differ by 1 or 2 %.
    stage_factor = excess_noise_factor(
        gain, GAIN.min_stages if register is None else register.stages
    )
    factor, half = 0.5 * (2.0 + stage_factor), 0.5 * (2.0 - stage_factor)
    if gain < GAIN.exponential_gain:
        factor, half = excess_noise_factor(gain), excess_noise_factor(gain) - stage_factor
    note = (
        "per electron before the multiplying register: variance over signal is K F2, and F2 = "
        f"{factor:.4g} ({source}; Robbins & Hadwen 2003) is divided out"
    )
    return Excess(factor=factor, relative_sd=half / factor, note=note)


@dataclass(frozen=True, kw_only=True)
class GainLine:
    """A straight line through the origin with its posterior."""

    posterior: Posterior  # draws of the slope and of the model departure beyond the noise
    slope: Array  # draws of the slope, shape (draw,)
    residual: Array  # residual of each stack, shape (stack,)


def line(
    x: Array,
    y: Array,
    sd: Array,
    *,
    names: tuple[str, str],
    units: tuple[str, str],
    seed: int,
    quick: bool,
    shared_sd: float = 0.0,
) -> GainLine:
    """Fit y = a x with an unknown model departure of equal standard deviation at all levels.

    `x`, `y`, `sd`: levels and standard errors of y, shape (level,); `names`, `units`: names and
    units of slope and departure; `shared_sd`: standard error of an offset common to all y.

    No camera is exactly linear. If the departure exceeds the noise, the result is the unweighted
    fit of the standard with an interval from the residuals, else the weighted fit. The prior of the
    departure is uniform in its logarithm from 1e-5 to 1 of the largest y.
    """
    all_levels = x, y
    x, y, sd = pool_equal_levels(x, y, sd)
    scale = float(np.abs(y).max())
    first = float((x @ y) / (x @ x))
    residual = y - first * x
    floor, ceiling = np.log(1e-5 * scale), np.log(scale)
    start = np.array(
        [
            first,
            np.clip(
                np.log(max(float(np.sqrt(np.mean(residual**2))), 1e-4 * scale)), floor, ceiling
            ),
        ]
    )
    bounds = np.array([[-np.inf, np.inf], [floor, ceiling]])

    def log_probability(points: Array) -> Array:
        variance = sd**2 + np.exp(2.0 * points[:, 1:2])
        residual = y - points[:, :1] * x
        value = -0.5 * (residual**2 / variance + np.log(variance)).sum(axis=1)
        if shared_sd:
            known = 1.0 / shared_sd**2 + (1.0 / variance).sum(axis=1)
            value += 0.5 * ((residual / variance).sum(axis=1) ** 2 / known - np.log(known))
        return value

    posterior = draw_posterior(
        log_probability,
        start,
        bounds,
        names=(names[0], f"log_{names[1]}"),
        units=units,
        seed=seed,
        method=laplace if quick else sample_posterior,
    )
    slope = posterior[names[0]]
    return GainLine(
        posterior=posterior,
        slope=slope,
        residual=all_levels[1] - float(np.median(slope)) * all_levels[0],
    )


def pool_equal_levels(x: Array, y: Array, sd: Array) -> tuple[Array, Array, Array]:
    """Return the weighted mean of the stacks at each level, which have their departure in
    common.
    """
    order = np.argsort(x)
    level = np.concatenate([[0], np.cumsum(np.diff(x[order]) > GAIN.same_level * x[order][1:])])
    weight = 1.0 / np.maximum(sd[order], 1e-12) ** 2
    total = np.bincount(level, weight)
    return (
        np.bincount(level, weight * x[order]) / total,
        np.bincount(level, weight * y[order]) / total,
        1.0 / np.sqrt(total),
    )


def gain_line(series: FlatSeries, *, context: Context, allowance: float = 0.0) -> GainLine:
    """Return the slope of the photon transfer curve, DN per electron, divided by F^2 behind a
    register.

    `allowance` is the relative standard deviation due to undetected effects.
    """
    chosen = series.fitted
    sd, shared = variance_errors(series.stacks)
    fitted = line(
        series.signal_dn[chosen],
        series.variance_dn2[chosen],
        sd[chosen],
        names=("system_gain", "departure"),
        units=("DN/e-", "log DN2"),
        seed=context.seed,
        quick=context.quick,
        shared_sd=shared,
    )
    excess = excess_of(series.flats[0].conditions, context)
    if not allowance and excess.note is None:
        return fitted
    posterior = fitted.posterior
    if allowance:
        posterior = with_relative_error(
            posterior, "system_gain", allowance, np.random.default_rng([context.seed, 5])
        )
    draws = posterior.draws.copy()
    draws[:, 0] = excess.divide(draws[:, 0], context.seed)
    posterior = replace(posterior, draws=draws)
    return replace(fitted, posterior=posterior, slope=posterior["system_gain"])


def with_relative_error(
    posterior: Posterior, name: str, relative_sd: float, rng: np.random.Generator
) -> Posterior:
    """Return the posterior with one more independent relative error of a parameter; its median is
    unchanged.
    """
    draws, column = posterior.draws.copy(), posterior.names.index(name)
    wider = draws[:, column] * np.exp(relative_sd * rng.standard_normal(len(draws)))
    middle = float(np.median(wider))
    draws[:, column] = wider * (float(np.median(draws[:, column])) / middle if middle else 1.0)
    return replace(posterior, draws=draws)


def photons_of(series: FlatSeries) -> Array | None:
    """Return the photons per pixel of every flat; None if one is unknown."""
    photons = [flat.conditions.photons_per_px for flat in series.flats]
    return None if any(value is None for value in photons) else np.array(photons, float)


def responsivity_line(series: FlatSeries, photons: Array, *, context: Context) -> GainLine:
    """Return the responsivity: slope of signal against photons per pixel, DN per photon."""
    chosen = series.fitted
    error = [np.sqrt(flat.variance_dn2 / (flat.pixels * flat.frames)) for flat in series.flats]
    return line(
        photons[chosen],
        series.signal_dn[chosen],
        np.array(error)[chosen],
        names=("responsivity", "departure"),
        units=("DN", "log DN"),
        seed=context.seed + 1,
        quick=context.quick,
    )


def dark_noise_dn(series: FlatSeries) -> tuple[float, float]:
    """Return temporal noise and standard error of the dark of the shortest exposure, DN."""
    dark = min(series.all_darks, key=lambda level: level.conditions.exposure_s or 0.0)
    return noise_of(dark.variance_dn2, dark.variance_sd_dn2)


def noise_of(variance_dn2: float, sd_dn2: float) -> tuple[float, float]:
    """Return a standard deviation and its standard error from those of the variance."""
    noise = float(np.sqrt(max(variance_dn2, 0.0)))
    return noise, sd_dn2 / (2.0 * noise) if noise > 0 else 0.0


def sensitivity_photons(
    efficiency: Array, dark_e2: Array, gain: Array, excess: float = 1.0
) -> Array:
    """Return the photons at SNR 1 (EMVA 1288 R4, eq. 26): (sqrt(s_d^2 + s_q^2/K^2 + F^4/4) + F^2/2)
    / eta.
    """
    return (
        np.sqrt(dark_e2 + QUANTISATION_DN2 / gain**2 + 0.25 * excess**2) + 0.5 * excess
    ) / efficiency
