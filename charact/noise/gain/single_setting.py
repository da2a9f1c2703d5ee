"""Covariance gain of the flats of one setting: pooled noise, fitted blur, findings."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.checks import QUANTISED_DN2, exposure_findings
from charact.noise.findings import Finding
from charact.noise.gain import emva1288
from charact.noise.gain.fit import Fit, fit_spectrum
from charact.noise.gain.model import blur_models
from charact.noise.gain.pooled_noise import PooledNoise, pool_noise, pooling
from charact.noise.gain.series import FlatSeries
from charact.noise.gain.white_floor import has_analogue_chain
from charact.noise.thresholds import GAIN
from charact.noise.undetected_correlation import (
    UndetectedEffect,
    spatially_correlated_fraction,
    temporally_correlated_fraction,
)
from labdata.measurement import Posterior

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class SingleSetting:
    """Noise of the flats of one setting."""

    series: FlatSeries  # the flats with their darks
    summary: PooledNoise  # their noise per DN of signal
    fit: Fit  # fitted blur and covariance gain; its posterior includes image lag that few frames cannot exclude
    # levels_dn, levels_sd_dn: covariance over signal of every flat with the common blur, and its standard error, shape
    # (flat,), DN
    levels_dn: Array
    levels_sd_dn: Array
    # neighbours, exposures: correlation between neighbouring pixels and between successive exposures
    neighbours: UndetectedEffect
    exposures: UndetectedEffect

    @property
    def white(self) -> bool:
        """Whether no correlation between neighbours is detected."""
        return not self.neighbours.is_detected

    @property
    def posterior(self) -> Posterior:
        """Draws of covariance gain, blur factor, lag factor and blur parameters."""
        return self.fit.posterior

    def at_low_signal(self, context: Context) -> "SingleSetting":
        """Return a copy with the covariance gain extrapolated to small signals."""
        posterior = _at_low_signal(self.posterior, self.series, self.levels_dn, self.levels_sd_dn, context)
        return replace(self, fit=replace(self.fit, posterior=posterior))

    def allowing(self, relative_sd: float, rng: np.random.Generator) -> "SingleSetting":
        """Return a copy with one more independent relative error of the covariance gain."""
        posterior = emva1288.with_relative_error(self.posterior, "covariance_gain", relative_sd, rng)
        return replace(self, fit=replace(self.fit, posterior=posterior))

    def level_share(self, index: int) -> float:
        """Return covariance over signal of a flat, by the line along the levels, over the pooled one."""
        if self.series.fitted.sum() < 3:
            return 1.0
        trend = _trend(self.series, self.levels_dn, self.levels_sd_dn)
        signal = self.series.signal_dn
        return float((trend.first + trend.rise * signal[index] / signal[self.series.fitted].max()) / trend.pooled)

    def findings(self) -> list[Finding]:
        """Return the findings of spectrum and image lag."""
        return _model_findings(self.summary, self.fit) + _lag_findings(self.summary, self.exposures)

    def departures(self) -> list[Finding]:
        """Return findings of levels whose covariance over signal deviates or rises."""
        levels = self.series, self.levels_dn, self.levels_sd_dn
        return _level_findings(*levels) + ([] if self.white else _rise_findings(*levels))


def fit_single_setting(series: FlatSeries, *, context: Context, quick: bool) -> SingleSetting:
    """Fit blur and covariance gain to a flat series.

    `series`: the flats of one setting.
    """
    neighbours = spatially_correlated_fraction(series)
    summary = pool_noise(series, context.sensor, floor=neighbours.is_detected and not has_analogue_chain(context))
    forms = blur_models(blur_exponent(context), blurred=neighbours.is_detected, floor=summary.beyond is not None)
    found = fit_spectrum(summary, seed=context.seed, quick=quick, forms=forms)
    if share := quantisation_fraction(series, summary):
        found = replace(found, posterior=_with_steps(found.posterior, share * summary.variance_dn, context))
    levels, spread = _level_gains(series, summary, found)
    exposures = temporally_correlated_fraction(series)
    pooled = SingleSetting(series=series, summary=summary, fit=found, levels_dn=levels, levels_sd_dn=spread,
                     neighbours=neighbours, exposures=exposures)  # fmt: skip
    # Image lag that too few frames cannot exclude.
    hidden = 0.0 if summary.lag.tested else exposures.allowance
    return pooled.allowing(hidden, np.random.default_rng([context.seed, 6])) if hidden else pooled


def quantisation_fraction(series: FlatSeries, summary: PooledNoise) -> float:
    """Return the possible fraction of quantisation noise in the pooled variance; 0 if negligible.

    Rounding adds 1/12 DN^2 to noise of half a step or more, and another amount to a quieter dark, which biases the
    difference; the relative bias is largest in the dimmest flats.
    """
    chosen, weight = pooling(series)
    levels = [level for i in chosen for level in (series.flats[i], series.darks[i])]
    if min(level.variance_dn2 for level in levels) >= QUANTISED_DN2:
        return 0.0
    return float(emva1288.QUANTISATION_DN2 * weight.sum() / max(summary.variance_dn, 1e-12))


def _with_steps(posterior: Posterior, power_dn: float, context: Context) -> Posterior:
    """Return the posterior with white noise of standard deviation `power_dn` added to variance and spectrum.

    Rounding errors of neighbours are independent, so they add to all frequencies.
    """
    draws, power = posterior.draws.copy(), posterior["power"]
    steps = np.maximum(power_dn * np.random.default_rng([context.seed, 17]).standard_normal(len(draws)), -0.9 * power)
    names = posterior.names.index
    draws[:, names("covariance_gain")] += steps
    draws[:, names("blur_factor")] = (posterior["blur_factor"] * power + steps) / (power + steps)
    return replace(posterior, draws=draws)


def _at_low_signal(posterior: Posterior, series: FlatSeries, levels, spread, context: Context) -> Posterior:
    """Return the posterior with the covariance gain extrapolated to small signals.

    Strip-current saturation of the MCP lowers the gain; quantities refer to small signals. The relative loss per DN is
    the slope of covariance over signal along the levels.
    """
    if series.fitted.sum() < 3:
        return posterior
    trend = _trend(series, levels, spread)
    rest_sd = trend.first_sd / trend.pooled
    rng = np.random.default_rng([context.seed, 4])
    factor = trend.first / trend.pooled + rest_sd * rng.standard_normal(len(posterior.draws))
    draws = posterior.draws.copy()
    draws[:, posterior.names.index("covariance_gain")] *= factor
    return replace(posterior, draws=draws)


@dataclass(frozen=True, kw_only=True)
class _Trend:
    """Covariance over signal along the levels, DN: at zero signal, pooled, and its rise up to the brightest.

    `first_sd` is that of the difference to the pooled value.
    """

    first: float
    first_sd: float
    pooled: float
    rise: float
    rise_sd: float


def _trend(series: FlatSeries, levels: Array, spread: Array) -> _Trend:
    """Fit a straight line through the fitted levels, at least three."""
    chosen = series.fitted
    signal, weight = series.signal_dn[chosen], 1.0 / spread[chosen] ** 2
    design = np.stack([np.ones_like(signal), signal / signal.max()])
    covariance = np.linalg.inv(design * weight @ design.T)
    first, rise = covariance @ (design * weight @ levels[chosen])
    excess = float(weight @ (levels[chosen] - first - rise * design[1]) ** 2) / max(1, chosen.sum() - 2)
    scatter = np.sqrt(max(1.0, excess))
    return _Trend(first=first, first_sd=scatter * np.sqrt(max(covariance[0, 0] - 1.0 / weight.sum(), 0.0)),
                  pooled=float(weight @ levels[chosen] / weight.sum()), rise=rise,
                  rise_sd=scatter * np.sqrt(covariance[1, 1]))  # fmt: skip


def blur_exponent(context: Context) -> tuple[float, float] | None:
    """Return the exponent of the described tube's blur and its standard deviation; None without a description."""
    if context.sensor is None:
        return None
    known = context.sensor.tube.mtf_exponent
    spread = 0.0 if known.low is None or known.high is None else (known.high - known.low) / 3.92
    return float(known), max(spread, 0.05)


def _level_gains(series: FlatSeries, summary: PooledNoise, fit: Fit):
    """Return covariance over signal of every flat with the common blur, and its standard error, DN."""
    shape = fit.model_dn / float(np.median(fit.posterior["power"]))
    name = "many" if summary.lag.is_detected else "few"
    use = fit.used
    gains, errors = [], []
    for flat, dark, signal in zip(series.flats, series.darks, series.signal_dn, strict=True):
        power = getattr(flat, name).power_dn2[use, 0] - getattr(dark, name).power_dn2[use, 0]
        modes = flat.bins.modes[use] * flat.bins.efficiency
        weight = modes / modes.sum()
        scaled = power / shape[use] / signal
        gains.append(float(weight @ scaled))
        own = np.sqrt(weight**2 @ (scaled - gains[-1]) ** 2)
        errors.append(float(np.hypot(own, gains[-1] * flat.variance_sd_dn2 / max(flat.variance_dn2, 1e-12))))
    return np.array(gains) * summary.lag.factor, np.array(errors) * summary.lag.factor


def _lag_findings(summary: PooledNoise, exposures: UndetectedEffect) -> list[Finding]:
    """Return findings of image lag that was detected and not summed completely."""
    if summary.lag.is_detected and summary.lag.open:
        return [("lag", f"image lag has not decayed after {summary.lag.lag[-1]} exposures, the end of the lag sum")]
    if summary.lag.is_detected:
        return []
    return exposure_findings(exposures)


def _model_findings(summary: PooledNoise, fit: Fit) -> list[Finding]:
    """Return the findings of the fit."""
    found: list[Finding] = []
    if fit.chance < 1e-4:
        found.append(("model-misfit", f"residuals of the noise spectrum have chi2 {fit.chi2:.0f} of {fit.freedom}"))
    blur = float(np.median(fit.posterior["blur_factor"]))
    if blur < 0.9:
        found.append((None, f"noise is correlated between pixels (blur factor {blur:.3g}); accounted for"))
    if summary.lag.is_detected:
        found.append((None, f"image lag (lag factor {summary.lag.factor:.3g}); all lags were summed"))
    low, middle, high = np.quantile(fit.posterior["covariance_gain"], [0.16, 0.5, 0.84])
    if 0.5 * (high - low) > GAIN.max_relative_sd * middle:
        found.append(
            (
                "too-few-frames",
                "the relative uncertainty of the power at frequency 0 exceeds a third; take more frames or pixels",
            )
        )
    found += [(flag, "see the posterior") for flag in fit.posterior.flags]
    return found


def _level_findings(series: FlatSeries, levels, spread) -> list[Finding]:
    """Return findings of levels whose covariance over signal deviates from the others."""
    chosen = np.flatnonzero(series.fitted)
    middle = float(np.median(levels[chosen]))
    return [
        (
            "model-misfit",
            f"covariance over signal of {series.flats[i].label} is {levels[i]:.3g} DN, not {middle:.3g} DN",
        )
        for i in chosen
        if abs(levels[i] - middle) > max(GAIN.level_fraction * middle, GAIN.level_sd * spread[i])
    ]


def _rise_findings(series: FlatSeries, levels, spread) -> list[Finding]:
    """Return the finding of covariance over signal that rises; MCP saturation and charge effects lower it."""
    if series.fitted.sum() < 3:
        return []
    trend = _trend(series, levels, spread)
    if trend.rise <= GAIN.rise_sd * trend.rise_sd:
        return []
    share = 100.0 * trend.rise / trend.pooled
    sentence = f"covariance gain rises by {share:.2g} % up to the brightest flat; MCP saturation would make it fall"
    return [("nonlinear", f"{sentence}: check for gamma or a wrong dark")]
