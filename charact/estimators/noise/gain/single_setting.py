"""Covariance gain of the flats of one setting: pooled noise, fitted blur, findings."""

from dataclasses import dataclass, replace

import numpy as np

from charact.estimators.noise.findings import Remarks, bounded, finding, posterior_findings
from charact.estimators.noise.gain import emva1288
from charact.estimators.noise.gain.checks import exposure_findings
from charact.estimators.noise.gain.fit import Fit, GainSpectrumOptimum, fit_spectrum
from charact.estimators.noise.gain.model import WHITE, blur_models
from charact.estimators.noise.gain.pooled_noise import PooledNoise, pool_noise, pooling
from charact.estimators.noise.gain.series import FlatSeries, has_intensifier
from charact.estimators.noise.gain.undetected_correlation import (
    UndetectedEffect,
    spatially_correlated_fraction,
    temporally_correlated_fraction,
)
from charact.estimators.noise.gain.white_floor import has_analogue_chain
from charact.estimators.noise.linear_fit import Trend, trend_of
from charact.estimators.noise.thresholds import GAIN
from charact.frames.rounding import QUANTISATION_DN2, QUANTISED_DN2
from charact.method import Context
from charact.verdict import Finding
from labdata import Array, Posterior, has_tube


@dataclass(frozen=True, kw_only=True)
class SingleSetting:
    """Noise of the flats of one setting."""

    series: FlatSeries
    summary: PooledNoise  # noise per DN of signal
    # fitted blur and covariance gain; its posterior includes image lag that few frames cannot
    # exclude
    fit: Fit
    # Covariance over signal of every flat with the common blur, and its standard error, shape
    # (flat,), DN.
    levels_dn: Array
    levels_sd_dn: Array
    neighbours: UndetectedEffect  # correlation between neighbouring pixels
    exposures: UndetectedEffect  # correlation between successive exposures

    @property
    def white(self) -> bool:
        """Whether no correlation between neighbours is detected."""
        return not self.neighbours.is_detected

    @property
    def posterior(self) -> Posterior:
        """Draws of covariance gain, blur factor, lag factor and blur parameters."""
        return self.fit.posterior

    def _with_posterior(self, posterior: Posterior) -> "SingleSetting":
        return replace(self, fit=replace(self.fit, posterior=posterior))

    def at_low_signal(self, context: Context) -> "SingleSetting":
        """Return a copy with the covariance gain extrapolated to small signals.

        Strip-current saturation of the MCP lowers the gain; quantities refer to small signals. The
        relative loss per DN is the slope of covariance over signal along the levels.
        """
        trend = self._trend()
        if trend is None:
            return self
        rng, draws = np.random.default_rng([context.seed, 4]), self.posterior.draws.copy()
        factor = trend.first / trend.mean + trend.first_sd / trend.mean * rng.standard_normal(
            len(draws)
        )
        draws[:, self.posterior.names.index("covariance_gain")] *= factor
        return self._with_posterior(replace(self.posterior, draws=draws))

    def allowing(self, relative_sd: float, rng: np.random.Generator) -> "SingleSetting":
        """Return a copy with one more independent relative error of the covariance gain."""
        return self._with_posterior(
            emva1288.with_relative_error(self.posterior, "covariance_gain", relative_sd, rng)
        )

    def level_share(self, index: int) -> float:
        """Return covariance over signal of a flat, by the line along the levels, over the pooled
        one.
        """
        trend, signal = self._trend(), self.series.signal_dn
        if trend is None:
            return 1.0
        return float(
            (trend.first + trend.rise * signal[index] / signal[self.series.fitted].max())
            / trend.mean
        )

    def _trend(self) -> Trend | None:
        """Fit a straight line through the fitted levels; None for fewer than three."""
        chosen = self.series.fitted
        if chosen.sum() < 3:
            return None
        variance = np.diag(self.levels_sd_dn[chosen] ** 2)
        signal, levels = self.series.signal_dn[chosen], self.levels_dn[chosen]
        return trend_of(signal, levels, variance, stretched=True)

    def remarks(self) -> Remarks:
        """Return what was seen of spectrum and image lag."""
        lag, posterior = self.summary.lag, self.posterior
        remarks: Remarks = [*misfit_findings(self.fit.best)]
        blur = float(np.median(posterior["blur_factor"]))
        if blur < 0.9:
            remarks.append(
                f"noise is correlated between pixels (blur factor {blur:.3g}); accounted for"
            )
        if lag.is_detected:
            remarks.append(f"image lag (lag factor {lag.factor:.3g}); all lags were summed")
        low, middle, high = np.quantile(posterior["covariance_gain"], [0.16, 0.5, 0.84])
        if 0.5 * (high - low) > GAIN.max_relative_sd * middle:
            effect = "the relative uncertainty of the power at frequency 0 exceeds a third"
            remarks.append(finding("too-few-frames", effect, "more frames or pixels"))
        remarks += posterior_findings(posterior)
        if not lag.is_detected:
            return remarks + bounded(exposure_findings(self.exposures))
        if lag.open:
            effect = (
                f"image lag has not decayed after {lag.lag[-1]} exposures, the end of the lag sum"
            )
            remarks.append(finding("lag", effect))
        return remarks

    def departures(self) -> list[Finding]:
        """Return findings of levels whose covariance over signal deviates or rises.

        MCP saturation and charge effects lower it along the levels.
        """
        levels, chosen = self.levels_dn, np.flatnonzero(self.series.fitted)
        middle = float(np.median(levels[chosen]))
        findings = [
            finding(
                "model-misfit",
                f"covariance over signal of {self.series.flats[i].label} is {levels[i]:.3g} DN, "
                f"not {middle:.3g} DN",
            )
            for i in chosen
            if abs(levels[i] - middle)
            > max(GAIN.level_fraction * middle, GAIN.level_sd * self.levels_sd_dn[i])
        ]
        trend = None if self.white else self._trend()
        if trend is not None and trend.rise > GAIN.rise_sd * trend.rise_sd:
            effect = (
                f"covariance gain rises by {100.0 * trend.rise / trend.mean:.2g} % up to the "
                "brightest flat; MCP saturation would make it fall"
            )
            findings.append(finding("nonlinear", effect, "frames without gamma, and their darks"))
        return findings


def misfit_findings(fit: GainSpectrumOptimum) -> list[Finding]:
    """Return the finding of a spectrum that no blur model fits."""
    if fit.chance >= GAIN.misfit_p_value:
        return []
    effect = f"residuals of the noise spectrum have chi2 {fit.chi2:.0f} of {fit.freedom}"
    return [finding("model-misfit", effect)]


def fit_single_setting(series: FlatSeries, *, context: Context, quick: bool) -> SingleSetting:
    """Fit blur and covariance gain to the flats of one setting.

    Without a tube and without correlation of neighbours the spectrum is white where it says so;
    every form of blur would extrapolate it to frequency 0 with the error of its own strength.
    """
    tube = has_intensifier([level.conditions for level in (*series.flats, *series.darks)], context)
    neighbours = spatially_correlated_fraction(series)
    summary = pool_noise(
        series, context.camera, floor=neighbours.is_detected and not has_analogue_chain(context)
    )
    if not (tube or summary.lag.is_detected):
        # Only a phosphor is expected to hand light to later exposures.
        summary = replace(summary, lag=replace(summary.lag, factor=1.0, factor_sd=0.0))
    fit = fit_spectrum(summary, seed=context.seed, quick=quick, forms=(WHITE,))
    if tube or neighbours.is_detected or fit.best.chance < GAIN.min_p_value:
        forms = blur_models(
            blur_exponent(context), blurred=neighbours.is_detected, floor=summary.outer is not None
        )
        fit = fit_spectrum(summary, seed=context.seed, quick=quick, forms=forms)
    if rounding_fraction := quantisation_fraction(series, summary):
        fit = replace(
            fit,
            posterior=_with_steps(fit.posterior, rounding_fraction * summary.variance_dn, context),
        )
    levels, spread = _level_gains(series, summary, fit)
    exposures = temporally_correlated_fraction(series)
    pooled = SingleSetting(
        series=series,
        summary=summary,
        fit=fit,
        levels_dn=levels,
        levels_sd_dn=spread,
        neighbours=neighbours,
        exposures=exposures,
    )
    # Image lag of a tube that too few frames cannot exclude.
    hidden = exposures.allowance if tube and not summary.lag.tested else 0.0
    return pooled.allowing(hidden, np.random.default_rng([context.seed, 6])) if hidden else pooled


def quantisation_fraction(series: FlatSeries, summary: PooledNoise) -> float:
    """Return the possible fraction of quantisation noise in the pooled variance; 0 if negligible.

    Rounding adds 1/12 DN^2 to noise of half a step or more, and another amount to a quieter dark,
    which biases the difference; the relative bias is largest in the dimmest flats.
    """
    chosen, weight = pooling(series)
    levels = [level for i in chosen for level in (series.flats[i], series.darks[i])]
    if min(level.variance_dn2 for level in levels) >= QUANTISED_DN2:
        return 0.0
    return float(QUANTISATION_DN2 * weight.sum() / max(summary.variance_dn, 1e-12))


def _with_steps(posterior: Posterior, power_dn: float, context: Context) -> Posterior:
    """Return the posterior with white noise of standard deviation `power_dn` added to variance and
    spectrum.

    Rounding errors of neighbours are independent, so they add to all frequencies.
    """
    draws, power = posterior.draws.copy(), posterior["power"]
    steps = np.maximum(
        power_dn * np.random.default_rng([context.seed, 17]).standard_normal(len(draws)),
        -0.9 * power,
    )
    names = posterior.names.index
    draws[:, names("covariance_gain")] += steps
    draws[:, names("blur_factor")] = (posterior["blur_factor"] * power + steps) / (power + steps)
    return replace(posterior, draws=draws)


def blur_exponent(context: Context) -> tuple[float, float] | None:
    """Return the exponent of the described tube's blur and its standard deviation; None without a
    description.
    """
    if not has_tube(context.camera):
        return None
    known = context.camera.tube.mtf_exponent
    spread = 0.0 if known.low is None or known.high is None else (known.high - known.low) / 3.92
    return float(known), max(spread, 0.05)


def _level_gains(series: FlatSeries, summary: PooledNoise, fit: Fit) -> tuple[Array, Array]:
    """Return covariance over signal of every flat with the common blur, and its standard error,
    DN.
    """
    shape = fit.model_dn / float(np.median(fit.posterior["power"]))
    name, use = "many_lags" if summary.lag.is_detected else "few_lags", fit.in_band
    gains, errors = [], []
    for flat, dark, signal in zip(series.flats, series.darks, series.signal_dn, strict=True):
        power = getattr(flat, name).power_dn2[use, 0] - getattr(dark, name).power_dn2[use, 0]
        modes = flat.bins.modes[use] * flat.bins.efficiency
        weight, scaled = modes / modes.sum(), power / shape[use] / signal
        gain = float(weight @ scaled)
        scatter_sd = np.sqrt(weight**2 @ (scaled - gain) ** 2)
        gains.append(gain)
        errors.append(
            float(np.hypot(scatter_sd, gain * flat.variance_sd_dn2 / max(flat.variance_dn2, 1e-12)))
        )
    return np.array(gains) * summary.lag.factor, np.array(errors) * summary.lag.factor
