"""Checks of a flat series: linearity, stationarity, clipping, quantisation, conditions."""

import numpy as np

from charact.estimators.noise.findings import (
    Remarks,
    bounded,
    clipping_effects,
    finding,
    findings_in,
)
from charact.estimators.noise.gain.series import CLIPPED_SHARE, GAINS, FlatSeries, without_noise
from charact.estimators.noise.gain.stack_agreement import (
    averaging_notes,
    dark_noise_findings,
    drift_of_darks,
    level_change_of,
)
from charact.estimators.noise.gain.stated_light import (
    light_statement_findings,
    proportionality_findings,
)
from charact.estimators.noise.gain.undetected_correlation import (
    UndetectedEffect,
    gamma_of_noise,
    processing_findings,
)
from charact.estimators.noise.linear_fit import Trend, trend_of
from charact.estimators.noise.thresholds import CHECKS, CORRELATION
from charact.frames.stack_statistics import StackStatistics
from charact.observables import Estimates
from charact.observables.photon_transfer import PhotonTransfer
from charact.verdict import Finding
from labdata import Array

ALLOWED = "the interval includes what cannot be excluded"
UNTESTED = (
    "too few frames to test temporal correlation: frames averaged with earlier ones, or image lag, "
    "would lower the variance"
)
CORRELATED = (
    "noise of neighbouring pixels is correlated, so that the slope of EMVA 1288 is {:.2g} % low"
)
# Conditions that must agree between flat and dark: largest relative and absolute difference.
ALIKE = {
    "mcp_v": (1e-3, 0.0),
    "gain_control": (0.0, 0.5),
    "em_gain": (0.01, 0.0),
    "camera_gain_db": (0.0, 0.05),
    "temperature_c": (0.0, 5.0),
}


def series_findings(series: FlatSeries) -> Remarks:
    """Return what concerns every quantity of the series."""
    return bounded(slope_findings(series))


def slope_findings(series: FlatSeries) -> Remarks:
    """Return what concerns the series, with bounds relative to the slope of EMVA 1288.

    The slope through the origin is a mean of variance over signal of the levels with positive
    weights, so that its relative error is at most the largest of a level.
    """
    remarks: Remarks = []
    if series.reference != "dark":
        effect = f"no darks of two frames or more: signals are measured from the {series.reference}"
        remarks.append(finding("no-darks", effect))
    if series.left_out:
        remarks.append(f"excluded (different gain): {', '.join(series.left_out)}")
        conditions = series.flats[0].conditions
        known = [
            f"{name} {getattr(conditions, name):.4g}"
            for name in GAINS
            if getattr(conditions, name) is not None
        ]
        words = "the gain with most flats, or the brightest of equally many"
        remarks += [f"measured at {', '.join(known)}: {words}"] if known else []
    if series.single:
        remarks.append(without_noise(series.single))
    for part in (
        _stationarity_findings,
        proportionality_findings,
        _clipping_findings,
        _condition_findings,
        processing_findings,
        dark_findings,
        dark_noise_findings,
        drift_of_darks,
    ):
        remarks += part(series)
    remarks += averaging_notes((*series.all_darks, *series.flats))
    linear_levels = int(series.fitted.sum())
    if linear_levels < CHECKS.min_levels:
        word = "level" if linear_levels == 1 else "levels"
        remarks.append(
            f"only {linear_levels} {word} inside the linear range: linearity not testable; "
            f"{ALLOWED}"
        )
    return remarks


def findings_of_darks(series: FlatSeries) -> list[Finding]:
    """Return the findings that concern numbers of the darks alone, on which flats have no
    effect.
    """
    return [
        entry
        for entry in findings_in(series_findings(series))
        if entry.flag in ("agc", "dark-mismatch", "processed")
    ]


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
    effect = f"{flat.label} is {-series.signal_dn[lowest]:.4g} DN darker than {dark.label}"
    remedy = "darks of the same camera and settings; dark and flat exchanged in session.toml"
    return [finding("dark-mismatch", effect, remedy)]


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
            findings.append(finding("unlike-conditions", effect, f"darks of the flats' {name}"))
    return findings


def light_findings(series: FlatSeries) -> list[Finding]:
    """Return findings against quantities that need the illumination: dark current, misstated light.

    Dark current missing from a shorter dark is Poisson-distributed like light, so it leaves the
    slope unbiased.
    """
    return [*_dark_current_findings(series), *light_statement_findings(series)]


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
    return [finding("unlike-conditions", effect, "darks of the flats' exposure_s")]


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
    effect = f"at {brightest:.2g} DN of signal rounding removes the faint parts of pulses"
    return [finding("quantised", effect, "brighter flats")]


def _trend(series: FlatSeries) -> tuple[Trend, Estimates] | None:
    """Return the line through variance over signal, and the data; None for a single level."""
    stacks = series.fitted_stacks
    if len(np.unique(stacks.signal_dn)) < 2:
        return None
    ratio = PhotonTransfer().measure(stacks)
    return trend_of(stacks.signal_dn, ratio.value, ratio.covariance, stretched=False), ratio


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
        else (trend[0].rise / trend[0].mean, trend[0].rise_sd / trend[0].mean)
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
    known = _trend(series)
    if known is None or series.fitted.sum() < CHECKS.min_levels:
        return None
    trend, _ = known
    return float(trend.rise / trend.mean), float(trend.rise_sd / abs(trend.mean))


def variance_ratio_changes(series: FlatSeries) -> Remarks:
    """Return what was seen of variance over signal that changes with the signal."""
    known = _trend(series)
    if known is None:
        return []
    trend, ratio = known
    middle, slope, error, sd = (
        trend.mean,
        trend.rise,
        trend.rise_sd,
        np.sqrt(np.diag(ratio.covariance)),
    )
    # Behind a gamma curve variance over signal rises and falls again, which no straight line shows.
    limit = 2.0 * CHECKS.curvature * middle + CHECKS.significant_sd * sd
    deviates = bool(np.any(np.abs(ratio.value - middle) > limit))
    if abs(slope) <= CHECKS.curvature_sd * error and not deviates:
        return []
    sentence = (
        f"variance over signal changes from {trend.first:.4g} to {trend.first + slope:.4g} "
        f"DN along the levels"
    )
    if not deviates and abs(slope) <= CHECKS.curvature * middle + CHECKS.curvature_sd * error:
        more = "the gain is the slope over all levels; see gain_curvature"
        return [f"{sentence}; {more}"]
    signal = series.signal_dn[series.fitted]
    variance = np.array([flat.variance_dn2 for flat in series.flats])[series.fitted] / signal
    return [finding("nonlinear", sentence), *gamma_of_noise(signal, variance, sd)]


def exposure_findings(exposures: UndetectedEffect) -> Remarks:
    """Return what was seen of correlation between successive exposures, with the bound relative to
    the slope of EMVA 1288.

    Light of which the fraction r stays for the next exposure leaves (1 - r)/(1 + r) of the variance
    to a single one; 2 r is the loss by the neighbouring exposures alone.
    """
    if exposures.is_detected:
        effect = f"noise of successive exposures is correlated ({100 * exposures.fraction:.3g} %)"
        largest = abs(exposures.fraction) + CORRELATION.bound_sd * exposures.sd
        known = largest < CORRELATION.max_fraction
        return [
            finding(
                "lag",
                effect,
                bound=largest / (1.0 - 0.5 * largest) if known else None,
                sign=-int(np.sign(exposures.fraction)),
            )
        ]
    if exposures.is_untestable:
        return [UNTESTED]
    return []


def correlation_findings(neighbours: UndetectedEffect, exposures: UndetectedEffect) -> Remarks:
    """Return what was seen of correlations that lower the variance."""
    remarks = exposure_findings(exposures)
    if neighbours.is_detected:
        low = 100.0 * (1.0 - 1.0 / (1.0 + max(neighbours.fraction, 0.0)))
        remarks.append(finding("correlated-noise", CORRELATED.format(low)))
    elif neighbours.is_untestable:
        remarks.append(
            f"too few pixels and frames to test the correlation of neighbours; {ALLOWED}"
        )
    return remarks


def _stationarity_findings(series: FlatSeries) -> list[Finding]:
    """Return findings of drift and flicker.

    A level that changes by the relative variance q within the stack changes the variance of a pixel
    by q times that of its fixed pattern and shading, as frames' means are removed, and the mean
    gain, if that is what changes, by q. A drift of d from first to last frame has q = d^2/12.
    """
    findings: list[Finding] = []
    for flat, signal, variance_dn2 in zip(
        series.flats, np.abs(series.signal_dn), series.variance_dn2, strict=True
    ):
        drift, flicker = drift_and_flicker(flat)
        change = level_change_of(flat) or f"drifts by {drift:.3g} DN from first to last frame"
        pattern_dn2 = (
            np.inf
            if flat.cube is None
            else max(flat.spatial_variance_dn2, 0.0) + flat.cube.shading_dn**2
        )
        for flag, size, q, effect in (
            ("drift", abs(drift), drift**2 / 12.0, f"{flat.label} {change}"),
            (
                "flicker",
                flicker,
                flicker**2,
                f"{flat.label} flickers by {flicker:.3g} DN rms from frame to frame",
            ),
        ):
            if size > getattr(CHECKS, f"{flag}_fraction") * signal:
                bound = (
                    q / signal**2 * (1.0 + pattern_dn2 / variance_dn2)
                    if signal and variance_dn2 > 0.0
                    else np.inf
                )
                findings.append(
                    finding(
                        flag,
                        effect,
                        bound=float(bound) if np.isfinite(bound) else None,
                        sign=1,
                    )
                )
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


def _clipping_findings(series: FlatSeries) -> list[Finding]:
    """Return findings of values at either end of the scale.

    A dark cut off at 0 DN has too high a mean and too low a variance, which both raise variance
    over signal above the dark; see `clipping_effects`.
    """
    findings = []
    for level in (*series.all_darks, *series.flats):
        if level.low_fraction > CHECKS.max_clipped_fraction:
            percent = 100 * level.low_fraction
            effect = f"{percent:.1f} % of the pixels of {level.label} are at 0 DN"
            bound = _bound_of_cut_dark(series, level) if level.kind == "dark" else None
            findings.append(finding("clipped", effect, bound=bound, sign=1))
    over = [flat.label for flat in series.flats if flat.high_fraction > CLIPPED_SHARE]
    if over and not series.fitted.any():
        findings.append(finding("saturated", f"pixels of {', '.join(over)} are at full scale"))
    return findings


def _bound_of_cut_dark(series: FlatSeries, dark: StackStatistics) -> float | None:
    """Return the largest relative effect of a cut dark on variance over signal of a fitted flat."""
    noise_dn = max(dark.variance_dn2, 0.0) ** 0.5
    raised_dn, lowered_dn = clipping_effects(dark.low_fraction, noise_dn, dark.mean_dn)
    of_dark = [reference.label == dark.label for reference in series.darks] & series.fitted
    if raised_dn is None or lowered_dn is None or np.any(series.variance_dn2[of_dark] <= 0.0):
        return None
    lost_dn2 = (noise_dn + lowered_dn) ** 2 - dark.variance_dn2
    effect = raised_dn / series.signal_dn + lost_dn2 / series.variance_dn2
    return float(np.max(effect[of_dark], initial=0.0))
