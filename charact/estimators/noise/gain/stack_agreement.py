"""Agreement of the stacks of a session with each other: averaged frames under single ones, darks
with the flats at no light, and levels that change within a stack.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import isclose

import numpy as np

from charact.estimators.noise.findings import finding, judged, scaled
from charact.estimators.noise.gain.series import FlatSeries
from charact.estimators.noise.linear_fit import linear_fit
from charact.estimators.noise.thresholds import AGREEMENT, CHECKS, SURVEY
from charact.frames.rounding import QUANTISED_DN2, rounding_step
from charact.frames.stack_statistics import StackStatistics
from charact.frames.temporal import LevelChange, level_change
from charact.observables.photon_transfer import variance_errors
from charact.verdict import Finding
from labdata import Measurement, open_lazy_stack


def as_single_frames(
    darks: Sequence[StackStatistics], flats: Sequence[StackStatistics]
) -> tuple[list[StackStatistics], list[StackStatistics]]:
    """Return the statistics that single frames have, of stacks whose frames are means of several.

    A mean of n frames of a digitiser has steps of 1/n and the variance of one over n, so that the
    ratio of the steps of two stacks is n. Its noise of rows, columns and frames is not known.
    """
    levels = [*darks, *flats]
    stacks = [open_lazy_stack(level.entry) for level in levels if level.entry is not None]
    if len(stacks) < len(levels) or not any(stack.dtype.kind == "f" for stack in stacks):
        return list(darks), list(flats)
    steps = [
        rounding_step([stack.frames(0, 1).ravel()[: SURVEY.sample]]) or 0.0 for stack in stacks
    ]
    ratios = [max(steps) / step if step else 1.0 for step in steps]
    singles = [
        _of_single_frames(level, round(ratio))
        if 1.5 < ratio < AGREEMENT.max_averaged and isclose(ratio, round(ratio), rel_tol=1e-3)
        else level
        for level, ratio in zip(levels, ratios, strict=True)
    ]
    return singles[: len(darks)], singles[len(darks) :]


def _of_single_frames(level: StackStatistics, n: int) -> StackStatistics:
    """Return the statistics of single frames from those of means of n."""
    few_lags, many_lags = (
        replace(spectrum, power_dn2=n * spectrum.power_dn2, variance_dn2=n * spectrum.variance_dn2)
        for spectrum in (level.few_lags, level.many_lags)
    )
    return replace(
        level,
        averaged=n,
        variance_dn2=n * level.variance_dn2,
        variance_sd_dn2=n * level.variance_sd_dn2,
        few_lags=few_lags,
        many_lags=many_lags,
        cube=None,
    )


def averaging_notes(levels: Sequence[StackStatistics]) -> list[str]:
    """Return a note on each stack whose frames are means of several."""
    return [
        f"the steps of {level.label} say that each of its frames is the mean of {level.averaged}: "
        f"its noise is given for single frames, {level.variance_dn2**0.5:.3g} DN"
        for level in levels
        if level.averaged > 1
    ]


def variance_at_no_light(series: FlatSeries) -> tuple[float, float] | None:
    """Return the variance of the flats at no light above the darks', and its standard error, DN^2.

    s^2 - s_d^2 = b + K mu (1 + c mu / mu_max), where c has a normal prior about 0 whose standard
    deviation is the accepted curvature. b is 0 where flats and darks are read alike. None of fewer
    than three levels.
    """
    chosen = np.flatnonzero(series.fitted & (series.variance_dn2 > 0.0))
    if len(chosen) < CHECKS.min_levels or series.reference != "dark":
        return None
    variance_sd, shared = variance_errors(series.stacks)
    signal, variance = series.signal_dn[chosen], series.variance_dn2[chosen]
    x = signal / signal.max()
    slope = float(np.median(variance / x))
    columns = [np.append(column, end) for column, end in ((x**0, 0.0), (x, 0.0), (x**2, 1.0))]
    known_sd = np.append(variance_sd[chosen], CHECKS.curvature * slope)
    fit = linear_fit(columns, np.append(variance, 0.0), known_sd)
    b_sd = fit.stretch(len(known_sd)) * float(np.sqrt(fit.covariance[0, 0]))
    return float(fit.best[0]), float(np.hypot(b_sd, shared))


def dark_noise_findings(series: FlatSeries) -> list[Finding]:
    """Return the finding of darks whose noise is not that of the flats at no light."""
    intercept = variance_at_no_light(series)
    darks = list({dark.label: dark for dark in series.darks}.values())
    if intercept is None or any(dark.low_fraction > CHECKS.max_clipped_fraction for dark in darks):
        return []
    if any(dark.variance_dn2 < QUANTISED_DN2 and dark.is_digitised for dark in darks):
        return []  # steps add to little noise what they do not to the flats
    excess, sd = intercept
    of_darks = float(np.mean([dark.variance_dn2 for dark in darks]))
    if abs(excess) <= max(
        AGREEMENT.significant_sd * sd, AGREEMENT.dark_variance_fraction * max(of_darks, 0.0)
    ):
        return []
    quieter, noisier = ("darks", "flats at no light")[:: 1 if excess > 0.0 else -1]
    effect = (
        f"{quieter} are quieter than {noisier}, as means of several frames are: the darks have "
        f"{of_darks:.3g} DN2, the flats at no light {of_darks + excess:.3g} ± {1.96 * sd:.2g} DN2 "
        f"({max(of_darks + excess, 0.0) ** 0.5:.3g} DN)"
    )
    return [finding("dark-mismatch", effect, "single frames, darks as flats")]


def level_change_of(level: StackStatistics) -> LevelChange | None:
    """Return the step or drift of the level of a stack that matters against a pixel's noise."""
    noise_dn = max(level.variance_dn2, 0.0) ** 0.5
    change = level_change(level.frame_mean_dn, noise_dn / level.pixels**0.5)
    matters = change is not None and change.departure_dn > AGREEMENT.min_change * noise_dn
    return change if matters else None


def dark_level_findings(level: StackStatistics) -> list[Finding]:
    """Return the finding of a dark whose level changes, with the bound of its mean, DN."""
    change = level_change_of(level)
    if change is None:
        return []
    effect = f"the level of {level.label} {change}"
    return [finding("drift", effect, _remedy(level, change), bound=change.departure_dn)]


def _remedy(level: StackStatistics, change: LevelChange) -> str:
    """Return what settles a level that changes."""
    if change.after is None:
        return f"frames of {level.label} taken when the black level has settled, or fewer of them"
    parts = f"the frames up to {change.after} and those after it as two stacks"
    return f"{parts}, of which that at the flats' black level is kept; or darks taken anew"


def drift_of_darks(series: FlatSeries, index: int | None = None) -> list[Finding]:
    """Return findings of darks whose level changes, with bounds relative to the slope, or to the
    signal of the flat of an index.

    Of y = K x through the origin, weighted by w = 1 / sd^2, an error d of all signals x changes K
    by the fraction d sum(w x) / sum(w x^2).
    """
    findings, fitted = [], series.fitted
    x = series.signal_dn[fitted]
    weight = np.maximum(series.variance_sd_dn2[fitted], 1e-12) ** -2.0
    signal_dn = float(weight @ x**2 / (weight @ x)) if index is None else series.signal_dn[index]
    for dark in {level.label: level for level in series.darks}.values():
        change = level_change_of(dark)
        of_dark = fitted & np.array([level.label == dark.label for level in series.darks])
        dimmest_dn = float(np.min(series.signal_dn[of_dark], initial=np.inf))
        if change is not None and change.departure_dn > CHECKS.drift_fraction * dimmest_dn:
            effect = (
                f"the level of {dark.label} {change}, under a signal of {dimmest_dn:.3g} DN of the "
                "dimmest flat"
            )
            bound = change.departure_dn / abs(float(signal_dn))
            findings.append(finding("drift", effect, _remedy(dark, change), bound=bound))
    return findings


def with_drift_of_darks(
    measurement: Measurement, series: FlatSeries, index: int | None = None
) -> Measurement:
    """Return a number proportional to the slope or its inverse, or to the signal of a flat, judged
    by the bounds of darks whose level changes.
    """
    return judged(measurement, scaled(drift_of_darks(series, index), measurement.value or 0.0))
