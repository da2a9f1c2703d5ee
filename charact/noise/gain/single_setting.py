"""The covariance gain of the flats of one gain: pooled noise, the blur fitted to it, and what is wrong with either."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.checks import QUANTISED_DN2, exposure_findings
from charact.noise.findings import Finding
from charact.noise.gain import emva1288
from charact.noise.gain.fit import Fit, fit_spectrum
from charact.noise.gain.forms import blur_models
from charact.noise.gain.pooled_noise import PooledNoise, pool_noise, pooling
from charact.noise.gain.series import FlatSeries
from charact.noise.gain.white_floor import has_analogue_chain
from charact.noise.undetected_correlation import (
    UndetectedEffect,
    spatially_correlated_fraction,
    temporally_correlated_fraction,
)
from labdata.measurement import Posterior

Array = NDArray[np.float64]

# Levels whose covariance over signal departs by more than this share and this many standard errors lie on no line.
LEVEL_SHARE = 0.06
LEVEL_ERRORS = 5.0
# Standard errors beyond which covariance over signal is seen to rise with the signal.
RISING_ERRORS = 3.0
# Relative standard error beyond which the posterior is too skewed for its interval to hold what it promises.
WIDEST_SHARE = 0.35
# Bins of spatial frequency that the blur's five parameters need.
LEAST_BINS = 24


@dataclass(frozen=True, kw_only=True)
class SingleSetting:
    """Noise of the flats of one gain.

    Parameters
    ----------
    series
        The flats with their darks.
    summary
        Their noise per DN of signal.
    fit
        Blur and covariance gain fitted to it; `posterior` holds what few frames cannot exclude of lag.
    levels_dn, levels_sd_dn
        Covariance over signal of every flat under the common blur, and its standard error, shape (flat,), DN.
    neighbours, exposures
        Noise shared by neighbouring pixels and by successive exposures.
    """

    series: FlatSeries
    summary: PooledNoise
    fit: Fit
    levels_dn: Array
    levels_sd_dn: Array
    neighbours: UndetectedEffect
    exposures: UndetectedEffect

    @property
    def white(self) -> bool:
        """Whether no noise is seen to be shared by neighbours."""
        return not self.neighbours.seen

    @property
    def posterior(self) -> Posterior:
        """Draws of covariance gain, blur factor and lag factor, and of the blur."""
        return self.fit.posterior

    def at_low_signal(self, context: Context) -> "SingleSetting":
        """Return the same with the covariance gain carried to small signals."""
        posterior = _at_low_signal(self.posterior, self.series, self.levels_dn, self.levels_sd_dn, context)
        return replace(self, fit=replace(self.fit, posterior=posterior))

    def allowing(self, relative_sd: float, rng: np.random.Generator) -> "SingleSetting":
        """Return the same with one more independent error on the covariance gain."""
        posterior = emva1288.with_relative_error(self.posterior, "covariance_gain", relative_sd, rng)
        return replace(self, fit=replace(self.fit, posterior=posterior))

    def level_share(self, index: int) -> float:
        """Covariance over signal of a flat, by the straight line along the levels, over that of all."""
        if self.series.fitted.sum() < 3:
            return 1.0
        trend = _trend(self.series, self.levels_dn, self.levels_sd_dn)
        signal = self.series.signal_dn
        return float((trend.first + trend.rise * signal[index] / signal[self.series.fitted].max()) / trend.pooled)

    def findings(self) -> list[Finding]:
        """What spectrum and lag say against or about the covariance gain."""
        return _model_findings(self.summary, self.fit) + _lag_findings(self.summary, self.exposures)

    def departures(self) -> list[Finding]:
        """Levels whose covariance over signal is far from that of the others, or rises along them."""
        told = self.series, self.levels_dn, self.levels_sd_dn
        return _level_findings(*told) + ([] if self.white else _rise_findings(*told))


def fit_single_setting(series: FlatSeries, *, context: Context, quick: bool) -> SingleSetting:
    """Fit blur and covariance gain to a series.

    Parameters
    ----------
    series
        The flats of one gain.
    context
        Seed, and the sensor for the prior of the blur.
    quick
        Without a Markov chain.
    """
    neighbours = spatially_correlated_fraction(series)
    summary = pool_noise(series, context.sensor, floor=neighbours.seen and not has_analogue_chain(context))
    forms = blur_models(blur_exponent(context), blurred=neighbours.seen, floor=summary.beyond is not None)
    found = fit_spectrum(summary, seed=context.seed, quick=quick, forms=forms)
    if share := quantisation_fraction(series, summary):
        found = replace(found, posterior=_with_steps(found.posterior, share * summary.variance_dn, context))
    levels, spread = _level_gains(series, summary, found)
    exposures = temporally_correlated_fraction(series)
    pooled = SingleSetting(series=series, summary=summary, fit=found, levels_dn=levels, levels_sd_dn=spread,
                     neighbours=neighbours, exposures=exposures)  # fmt: skip
    # What too few frames cannot exclude of lag.
    hidden = 0.0 if summary.lag.tested else exposures.allowance
    return pooled.allowing(hidden, np.random.default_rng([context.seed, 6])) if hidden else pooled


def quantisation_fraction(series: FlatSeries, summary: PooledNoise) -> float:
    """Share of the pooled variance that the steps of the digitiser may have added, relative; 0 where they cannot.

    Notes
    -----
    Rounding adds 1/12 DN^2 to noise of half a step and more. A quieter dark shows another amount, or none, so that
    what is left above it is too much by as much; over the signal it weighs most in the dimmest flats.
    """
    chosen, weight = pooling(series)
    levels = [level for i in chosen for level in (series.flats[i], series.darks[i])]
    if min(level.variance_dn2 for level in levels) >= QUANTISED_DN2:
        return 0.0
    return float(emva1288.QUANTISATION_DN2 * weight.sum() / max(summary.variance_dn, 1e-12))


def _with_steps(posterior: Posterior, power_dn: float, context: Context) -> Posterior:
    """Return the posterior with white noise of unknown height, of a standard deviation, in variance and spectrum alike.

    Neighbours share none of the error of rounding: it stands at every frequency, also at none.
    """
    draws, power = posterior.draws.copy(), posterior["power"]
    steps = np.maximum(power_dn * np.random.default_rng([context.seed, 17]).standard_normal(len(draws)), -0.9 * power)
    names = posterior.names.index
    draws[:, names("covariance_gain")] += steps
    draws[:, names("blur_factor")] = (posterior["blur_factor"] * power + steps) / (power + steps)
    return replace(posterior, draws=draws)


def _at_low_signal(posterior: Posterior, series: FlatSeries, levels, spread, context: Context) -> Posterior:
    """Return the posterior with the covariance gain carried to small signals.

    A microchannel plate tires as its current rises and takes gain and covariance gain along; both are stated for
    small signals. The share lost per DN of signal is the slope of the levels' covariance over signal.
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
    """Covariance over signal along the levels, DN: at no signal, pooled, and its change up to the brightest.

    The first standard error is of the difference to the pooled one.
    """

    first: float
    first_sd: float
    pooled: float
    rise: float
    rise_sd: float


def _trend(series: FlatSeries, levels: Array, spread: Array) -> _Trend:
    """A straight line through the fitted levels, three at least."""
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
    """Return the exponent of the described tube's blur and its standard deviation; None where none is described."""
    if context.sensor is None:
        return None
    known = context.sensor.tube.mtf_exponent
    spread = 0.0 if known.low is None or known.high is None else (known.high - known.low) / 3.92
    return float(known), max(spread, 0.05)


def _level_gains(series: FlatSeries, summary: PooledNoise, fit: Fit):
    """Return the covariance over signal of every flat under the common blur, and its standard error, DN."""
    shape = fit.model_dn / float(np.median(fit.posterior["power"]))
    name = "many" if summary.lag.seen else "few"
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
    """Light of earlier exposures that is there and was not summed to its end."""
    if summary.lag.seen and summary.lag.open:
        return [("lag", f"earlier exposures still glow after {summary.lag.lag[-1]} more, where the sum over lags ends")]
    if summary.lag.seen:
        return []
    return exposure_findings(exposures)


def _model_findings(summary: PooledNoise, fit: Fit) -> list[Finding]:
    """What the fit itself says against or about its numbers."""
    found: list[Finding] = []
    if fit.chance < 1e-4:
        found.append(("model-misfit", f"residuals of the noise spectrum have chi2 {fit.chi2:.0f} of {fit.freedom}"))
    blur = float(np.median(fit.posterior["blur_factor"]))
    if blur < 0.9:
        found.append((None, f"noise is correlated between pixels (blur factor {blur:.3g}) and was treated as such"))
    if summary.lag.seen:
        found.append((None, f"earlier exposures glow on (lag factor {summary.lag.factor:.3g}); all lags were summed"))
    low, middle, high = np.quantile(fit.posterior["covariance_gain"], [0.16, 0.5, 0.84])
    if 0.5 * (high - low) > WIDEST_SHARE * middle:
        found.append(
            ("too-few-frames", "the power at frequency 0 is known to worse than a third: more frames or pixels")
        )
    found += [(flag, "see the posterior") for flag in fit.posterior.flags]
    return found


def _level_findings(series: FlatSeries, levels, spread) -> list[Finding]:
    """Levels whose covariance over signal is far from that of the others."""
    chosen = np.flatnonzero(series.fitted)
    middle = float(np.median(levels[chosen]))
    return [
        (
            "model-misfit",
            f"covariance over signal of {series.flats[i].label} is {levels[i]:.3g} DN, not {middle:.3g} DN",
        )
        for i in chosen
        if abs(levels[i] - middle) > max(LEVEL_SHARE * middle, LEVEL_ERRORS * spread[i])
    ]


def _rise_findings(series: FlatSeries, levels, spread) -> list[Finding]:
    """Covariance over signal that rises with the signal: a plate and charge that tire only ever lower it."""
    if series.fitted.sum() < 3:
        return []
    trend = _trend(series, levels, spread)
    if trend.rise <= RISING_ERRORS * trend.rise_sd:
        return []
    share = 100.0 * trend.rise / trend.pooled
    sentence = f"covariance over signal rises by {share:.2g} % up to the brightest flat, which no tiring plate does"
    return [("nonlinear", f"{sentence}: a gamma curve, or levels counted from a wrong dark")]
