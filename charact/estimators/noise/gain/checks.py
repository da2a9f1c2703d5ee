"""Checks of a flat series: linearity, stationarity, clipping, quantisation, conditions."""

from typing import NamedTuple

import numpy as np

from charact.estimators.noise.findings import Finding, with_remedy
from charact.estimators.noise.gain.series import CLIPPED_SHARE, GAINS, FlatSeries, without_noise
from charact.estimators.noise.gain.undetected_correlation import (
    UndetectedEffect,
    gamma_of_light,
    gamma_of_noise,
    processing_findings,
)
from charact.estimators.noise.linear_fit import generalised_fit
from charact.estimators.noise.thresholds import CHECKS
from charact.frames.stack_statistics import StackStatistics
from charact.observables.photon_transfer import PhotonTransfer
from labdata import Array
from labdata.conditions import Conditions

ALLOWED = "the interval includes what cannot be excluded"
# Conditions that must agree between flat and dark: largest relative and absolute difference.
ALIKE = {
    "mcp_v": (1e-3, 0.0),
    "gain_control": (0.0, 0.5),
    "em_gain": (0.01, 0.0),
    "camera_gain_db": (0.0, 0.05),
    "temperature_c": (0.0, 5.0),
}


def series_findings(series: FlatSeries) -> list[Finding]:
    """Return the findings that concern every quantity of the series."""
    findings: list[Finding] = []
    if series.reference != "dark":
        words = f"no darks of two frames or more: signals are measured from the {series.reference}"
        findings.append(Finding("no-darks", words))
    if series.left_out:
        findings.append(Finding(None, f"excluded (different gain): {', '.join(series.left_out)}"))
        conditions = series.flats[0].conditions
        known = [
            f"{name} {getattr(conditions, name):.4g}"
            for name in GAINS
            if getattr(conditions, name) is not None
        ]
        words = "the gain with most flats, or the brightest of equally many"
        findings += [Finding(None, f"measured at {', '.join(known)}: {words}")] if known else []
    if series.single:
        findings.append(Finding(None, without_noise(series.single)))
    findings += (
        _stationarity_findings(series)
        + _proportionality_findings(series)
        + _clipping_findings(series)
    )
    findings += _condition_findings(series) + processing_findings(series) + dark_findings(series)
    linear_levels = int(series.fitted.sum())
    if linear_levels < CHECKS.min_levels:
        word = "level" if linear_levels == 1 else "levels"
        findings.append(
            Finding(
                None,
                f"only {linear_levels} {word} inside the linear range: linearity not testable; "
                f"{ALLOWED}",
            )
        )
    return findings


def dark_findings(series: FlatSeries) -> list[Finding]:
    """Return the finding of a dark brighter than flats by more than the noise of a pixel."""
    noise = [max(dark.variance_dn2, 0.0) ** 0.5 for dark in series.darks]
    negative = [
        i for i, sd in enumerate(noise) if series.reference == "dark" and series.signal_dn[i] < -sd
    ]
    if not negative:
        return []
    lowest = min(negative, key=lambda i: series.signal_dn[i])
    flat, dark = series.flats[lowest], series.darks[lowest]
    high = noise[lowest] - max(flat.variance_dn2, 0.0) ** 0.5
    effect = (
        f"{flat.label} lies {-series.signal_dn[lowest]:.4g} DN below {dark.label}, whose "
        f"noise may be {high:.3g} DN"
    )
    remedy = "kind in session.toml: dark and flat may be exchanged"
    return [with_remedy("dark-mismatch", f"{effect} too high", remedy)]


def _condition_findings(series: FlatSeries) -> list[Finding]:
    """Return differences between flat and dark in conditions that set dark level or gain."""
    if series.reference != "dark":
        return []
    findings: list[Finding] = []
    for flat, dark in zip(series.flats, series.darks, strict=True):
        for name, (relative, absolute) in ALIKE.items():
            of_flat, of_dark = getattr(flat.conditions, name), getattr(dark.conditions, name)
            if (
                of_flat is None
                or of_dark is None
                or abs(of_flat - of_dark) <= max(absolute, relative * abs(of_flat))
            ):
                continue
            word = name.rsplit("_", 1)
            effect = (
                f"{flat.label} and its dark {dark.label} differ in {word[0]}: {of_flat:.4g} and "
                f"{of_dark:.4g} {word[1]}, so that level and noise of the dark may be others"
            )
            findings.append(with_remedy("unlike-conditions", effect, f"darks of the flats' {name}"))
    return findings


def light_findings(series: FlatSeries) -> list[Finding]:
    """Return findings against quantities that need the illumination: dark current, misstated light.

    Dark current missing from a shorter dark is Poisson-distributed like light, so it leaves the
    slope unbiased.
    """
    return [*_dark_current_findings(series), *_light_statement_findings(series)]


def _dark_current_findings(series: FlatSeries) -> list[Finding]:
    """Return the finding of flats exposed for longer than their darks."""
    times = [
        (f.conditions.exposure_s, d.conditions.exposure_s)
        for f, d in zip(series.flats, series.darks, strict=True)
    ]
    gaps = [
        (flat_s - dark_s, flat_s)
        for flat_s, dark_s in times
        if flat_s is not None and dark_s is not None
    ]
    unequal = [gap for gap, flat_s in gaps if flat_s and gap > CHECKS.exposure_tolerance * flat_s]
    if not unequal or series.reference != "dark":
        return []
    effect = f"signals include the dark current of up to {max(unequal):.3g} s"
    return [with_remedy("unlike-conditions", effect, "darks of the flats' exposure_s")]


def _light_of_conditions(series: FlatSeries) -> tuple[Array, Array] | None:
    """Return stated light and signal of the fitted flats; None if one is unknown, or there is one
    flat only.
    """
    chosen = np.flatnonzero(series.fitted)
    light = [light_of(series.flats[i].conditions) for i in chosen]
    if len(chosen) < 2 or any(value is None or value <= 0 for value in light):
        return None
    return np.array(light, float), series.signal_dn[chosen]


def _light_statement_findings(series: FlatSeries) -> list[Finding]:
    """Return the finding of different levels under the same stated light."""
    stated = _light_of_conditions(series)
    if stated is None:
        return []
    exposure, signal = stated
    ratio = signal / exposure
    levels, light = (values.max() / values.min() for values in (ratio, exposure))
    if light >= CHECKS.min_light_ratio or levels < CHECKS.min_light_ratio:
        return []
    effect = (
        f"levels differ {levels:.3g}-fold under light stated to differ {light:.3g}-fold, so that "
        "numbers per photon or lux may be off as much"
    )
    return [
        with_remedy(
            "agc", effect, "illuminance_lux, photons_per_px or exposure_s of each flat as it was"
        )
    ]


def is_quantisation_limited(dark: StackStatistics, signal_dn: float) -> bool:
    """Return whether rounding distorts pulses of few DN: signal and dark noise are both small."""
    return dark.variance_dn2 < CHECKS.coarse_variance_dn2 and signal_dn < CHECKS.coarse_signal_dn


def quantisation_findings(series: FlatSeries) -> list[Finding]:
    """Return the finding of flats so dim that rounding distorts every pulse."""
    fitted = np.flatnonzero(series.fitted)
    if not all(
        is_quantisation_limited(series.darks[i], float(series.signal_dn[i])) for i in fitted
    ):
        return []
    brightest = float(series.signal_dn[fitted].max())
    sentence = (
        f"at {brightest:.2g} DN of signal rounding removes the faint parts of pulses; take "
        f"brighter flats"
    )
    return [Finding("quantised", sentence)]


class _Trend(NamedTuple):
    """Straight line through variance over signal against signal, DN, and the errors of the data."""

    gain: Array
    sd: Array
    first: float  # at zero signal
    rise: float  # change up to the brightest level
    rise_sd: float
    middle: float  # mean over the levels


def _trend(series: FlatSeries) -> _Trend | None:
    """Fit the line; None for a single level."""
    stacks = series.fitted_stacks
    signal = stacks.signal_dn
    if len(np.unique(signal)) < 2:
        return None
    estimates = PhotonTransfer().measure(stacks)
    ones = np.ones_like(signal)
    line, mean = (
        generalised_fit(columns, estimates.value, estimates.covariance)
        for columns in ([ones, signal / signal.max()], [ones])
    )
    return _Trend(
        gain=estimates.value,
        sd=np.sqrt(np.diag(estimates.covariance)),
        first=line.best[0],
        rise=line.best[1],
        rise_sd=float(np.sqrt(line.covariance[1, 1])),
        middle=mean.best[0],
    )


def bend_allowance(series: FlatSeries) -> float:
    """Return the relative standard deviation of the gain due to a curvature that few levels leave
    open.

    The gain of EMVA 1288 is the slope of variance against signal up to 70 % of saturation. Of three
    or more levels it is the fitted slope, and curvature is another quantity (`gain_curvature`).
    One or two levels do not show the slope over the whole range: the accepted curvature and none
    are equally likely.
    """
    if series.fitted.sum() >= CHECKS.min_levels:
        return 0.0
    trend = _trend(series)
    curvature, sd = (
        (0.0, np.inf)
        if trend is None
        else (trend.rise / trend.middle, trend.rise_sd / trend.middle)
    )
    shrinkage = CHECKS.curvature**2 / (CHECKS.curvature**2 + sd**2)
    return UndetectedEffect(
        fraction=shrinkage * curvature, sd=CHECKS.curvature * float(np.sqrt(1.0 - shrinkage))
    ).posterior_rms


def gain_curvature(series: FlatSeries) -> tuple[float, float] | None:
    """Return the change of variance over signal from no signal to the brightest fitted flat over
    its mean, and its standard error, dimensionless; None for fewer than three levels.

    Of a response y = s (1 - c s) and shot noise it is -3 c times the signal of that flat, to first
    order.
    """
    trend = _trend(series)
    if trend is None or series.fitted.sum() < CHECKS.min_levels:
        return None
    return float(trend.rise / trend.middle), float(trend.rise_sd / abs(trend.middle))


def variance_ratio_changes(series: FlatSeries) -> list[Finding]:
    """Return findings of variance over signal that changes with the signal."""
    trend = _trend(series)
    if trend is None:
        return []
    middle, slope, error = trend.middle, trend.rise, trend.rise_sd
    # Behind a gamma curve variance over signal rises and falls again, which no straight line shows.
    limit = 2.0 * CHECKS.curvature * middle + CHECKS.significant_sd * trend.sd
    deviates = bool(np.any(np.abs(trend.gain - middle) > limit))
    if abs(slope) <= CHECKS.curvature_sd * error and not deviates:
        return []
    sentence = (
        f"variance over signal changes from {trend.first:.4g} to {trend.first + slope:.4g} "
        f"DN along the levels"
    )
    if not deviates and abs(slope) <= CHECKS.curvature * middle + CHECKS.curvature_sd * error:
        more = "the gain is the slope over all levels; see gain_curvature"
        return [Finding(None, f"{sentence}; {more}")]
    findings = [with_remedy("nonlinear", sentence, "flats of the linear range only")]
    signal = series.signal_dn[series.fitted]
    variance = np.array([flat.variance_dn2 for flat in series.flats])[series.fitted] / signal
    return findings + gamma_of_noise(signal, variance, trend.sd)


def exposure_findings(exposures: UndetectedEffect) -> list[Finding]:
    """Return findings of correlation between successive exposures, detected or untestable."""
    if exposures.is_detected:
        percent = 100 * exposures.fraction
        return [Finding("lag", f"noise of successive exposures is correlated ({percent:.3g} %)")]
    if exposures.is_untestable:
        return [Finding(None, f"too few frames to test temporal correlation; {ALLOWED}")]
    return []


def correlation_findings(
    neighbours: UndetectedEffect, exposures: UndetectedEffect
) -> list[Finding]:
    """Return findings of correlations that lower the variance."""
    findings = exposure_findings(exposures)
    if neighbours.is_detected:
        low = 100.0 * (1.0 - 1.0 / (1.0 + max(neighbours.fraction, 0.0)))
        effect = (
            f"noise of neighbouring pixels is correlated, so that the slope of EMVA 1288 is "
            f"{low:.2g} % low"
        )
        findings.append(with_remedy("correlated-noise", effect, "`method` covariance-sum"))
    elif neighbours.is_untestable:
        findings.append(
            Finding(
                None, f"too few pixels and frames to test the correlation of neighbours; {ALLOWED}"
            )
        )
    return findings


def _stationarity_findings(series: FlatSeries) -> list[Finding]:
    """Return findings of drift and flicker."""
    findings: list[Finding] = []
    for flat, signal in zip(series.flats, np.abs(series.signal_dn), strict=True):
        drift, flicker = drift_and_flicker(flat)
        if abs(drift) > CHECKS.drift_fraction * signal:
            findings.append(
                Finding("drift", f"{flat.label} drifts by {drift:.3g} DN from first to last frame")
            )
        if flicker > CHECKS.flicker_fraction * signal:
            findings.append(Finding("flicker", f"{flat.label} flickers by {flicker:.3g} DN rms"))
    return findings


def drift_and_flicker(level: StackStatistics) -> tuple[float, float]:
    """Return drift from first to last frame and rms flicker, DN; zero if within their noise.

    The noise of a frame mean follows from the covariance sum, which includes correlated noise.
    """
    means = level.frame_mean_dn
    if len(means) < 4:
        return 0.0, 0.0
    power = level.variance_dn2
    if len(level.bins.modes):
        # Noise power of the lowest frequency bins, summed over lags.
        low = np.argsort(np.hypot(level.bins.column_cy_per_px, level.bins.row_cy_per_px))[:8]
        lags = level.many_lags.power_dn2[low].mean(axis=0)
        power = float(lags[0] + 2.0 * np.clip(lags[1:], 0, None).sum())
    noise = np.sqrt(max(power, level.variance_dn2) / level.pixels)
    time = np.linspace(-0.5, 0.5, len(means))
    slope = float(time @ means / (time @ time))
    slope_sd = noise / np.sqrt(time @ time)
    residual = means - means.mean() - slope * time
    rms = float(np.sqrt(residual @ residual / (len(means) - 2)))
    significant = rms > noise * (1 + CHECKS.significant_sd / np.sqrt(2 * len(means)))
    # A step in the middle, as of automatic gain, leaves a residual of its own about a line.
    scatter = min([rms, *_scatter_about_steps(means)])
    drift = (
        slope
        if abs(slope) > CHECKS.significant_sd * max(slope_sd, scatter / np.sqrt(time @ time))
        else 0.0
    )
    return drift, rms if significant else 0.0


def _scatter_about_steps(means: Array) -> list[float]:
    """Return the rms of frame means about their means before and after a frame, of three frames or
    more each, DN.
    """
    parts = [(means[:at], means[at:]) for at in range(3, len(means) - 2)]
    return [
        float(np.sqrt(sum(len(part) * part.var() for part in halves) / (len(means) - 3)))
        for halves in parts
    ]


def light_of(conditions: Conditions) -> float | None:
    """Return the stated exposure in arbitrary units; None if the light is unknown."""
    if conditions.photons_per_px is not None:
        return conditions.photons_per_px
    if conditions.illuminance_lux is None:
        return None
    time = conditions.gate_ns if conditions.gate_ns is not None else conditions.exposure_s
    return conditions.illuminance_lux * (1.0 if time is None else time)


def _proportionality_findings(series: FlatSeries) -> list[Finding]:
    """Return findings of a signal that is not proportional to the stated light."""
    # A gain change common to all levels does not show in flats; the session must state it.
    if any(
        flat.conditions.automatic_gain or flat.conditions.brightness_control
        for flat in series.flats
    ):
        return [Finding("agc", "an automatic gain or brightness control was on")]
    stated = _light_of_conditions(series)
    if stated is None:
        return []
    exposure, signal = stated
    span = exposure.max() / exposure.min()
    if span < CHECKS.min_light_ratio:
        return []
    if gamma := gamma_of_light(exposure, signal):
        return gamma
    slope = float(
        np.polyfit(np.log(exposure), np.log(np.maximum(signal, 1e-3 * signal.max())), 1)[0]
    )
    if slope < CHECKS.min_light_exponent:
        return [
            Finding(
                "agc",
                f"the light changed {span:.3g}-fold and the mean as its power {slope:.2f} only",
            )
        ]
    ratio = signal / exposure
    reference = float(exposure @ signal / (exposure @ exposure))
    off = float(np.abs(ratio / reference - 1.0)[signal > 0.05 * signal.max()].max())
    if off > CHECKS.nonlinear_fraction:
        return [
            Finding("nonlinear", f"signal over light deviates by {100 * off:.1f} % from its mean")
        ]
    return []


def _clipping_findings(series: FlatSeries) -> list[Finding]:
    findings = [
        Finding(
            "clipped",
            f"{100 * level.low_fraction:.1f} % of the pixels of {level.label} are at 0 DN",
        )
        for level in (*series.all_darks, *series.flats)
        if level.low_fraction > 0.01
    ]
    over = [flat.label for flat in series.flats if flat.high_fraction > CLIPPED_SHARE]
    if over and not series.fitted.any():
        findings.append(Finding("saturated", f"pixels of {', '.join(over)} are at full scale"))
    return findings
