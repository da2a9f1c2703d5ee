"""Quantities of a data sheet of EMVA 1288 Release 4.0 Linear besides gain and noise: saturation,
largest signal-to-noise ratio, dynamic range, linearity, and what frames the standard misses.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from charact.estimators.noise.gain import emva1288
from charact.estimators.noise.gain.checks import light_findings
from charact.estimators.noise.gain.series import FlatSeries, gain_of
from charact.estimators.noise.nonuniformity import nonuniformity
from charact.estimators.noise.thresholds import DATA_SHEET
from charact.frames.stack_statistics import StackStatistics
from charact.observables import Stacks
from charact.verdict import Finding, judge
from labdata import Array, Measurement, Result
from labdata.measurement import make_refusal, measurement_from_draws, measurement_from_sd

IN_RANGE = (("saturation_capacity", "e-"), ("snr_max", "1"), ("dynamic_range", "1"))


def ranges(
    series: FlatSeries,
    efficiency: Array | None,
    gain: Array,
    dark_e2: Array,
    excess: float,
    **fields: Any,
) -> Iterator[Measurement]:
    """Yield absolute sensitivity threshold, saturation, largest signal-to-noise ratio and dynamic
    range, with saturation by its two definitions.

        mu_e.min = (s_d^2 + s_q^2/K^2 + F^4/4)^(1/2) + F^2/2        (eq. 27; F^2 = 1)
        SNR_max = (mu_e.sat/F^2)^(1/2),  DR = mu_p.sat/mu_p.min     (eq. 55, 28)

    `efficiency`, `gain`, `dark_e2`: draws of electrons per photon, of K, DN per electron, and of
    the dark variance, squared electrons; `efficiency` is None without known photons. `excess`: F^2
    of a register.
    """
    photons = emva1288.photons_of(series)
    threshold = emva1288.sensitivity_photons(np.ones_like(gain), dark_e2, gain, excess)
    yield measurement_from_draws("sensitivity_threshold", "e-", threshold, **fields)
    light, per_light = series.signal_dn, 1.0 / gain
    if photons is not None and efficiency is not None:
        minimum = threshold / efficiency
        yield measurement_from_draws("sensitivity_threshold", "photons/px", minimum, **fields)
        if not light_findings(series):
            light, per_light = photons, efficiency
    for suffix, place, reason in (("", series.peak, _rises(series)), _full_scale(series)):
        if place is None:
            for name, unit in IN_RANGE:
                yield make_refusal(f"{name}{suffix}", unit, reason, refusal="missing", **fields)
            continue
        level = float(np.interp(place, np.arange(len(light)), light))
        capacity = level * per_light
        if photons is not None and efficiency is not None:
            # The level lies between its neighbours: triangular distribution.
            sd = np.interp(place, np.arange(len(light)), np.gradient(photons)) / np.sqrt(6.0)
            exposure = float(np.interp(place, np.arange(len(light)), photons))
            yield measurement_from_sd(
                f"saturation_exposure{suffix}", "photons/px", exposure, float(sd), **fields
            )
        draws = capacity, np.sqrt(capacity / excess), capacity / threshold
        for (name, unit), of_name in zip(IN_RANGE, draws, strict=True):
            yield measurement_from_draws(f"{name}{suffix}", unit, of_name, **fields)


def _rises(series: FlatSeries) -> str:
    """Return why a series without a peak of the variance has no saturation."""
    level = series.flats[-1].mean_dn
    return f"no flat reaches saturation: the variance still rises at {level:.4g} DN"


def _full_scale(series: FlatSeries) -> tuple[str, float | None, str]:
    """Return the ending of the names, and at which place in the series 0.1 % of the pixels show the
    largest value (6.6), None and why where there is none.

    The fraction of full pixels of normal noise s has a quantile that rises by 1 over s in level.
    """
    full = np.array([flat.high_fraction for flat in series.flats])
    reached = np.flatnonzero(full >= DATA_SHEET.full_fraction)
    if not len(reached) or not reached[0]:
        many = "less" if not len(reached) else "more"
        reason = (
            f"every flat has {many} than {100 * DATA_SHEET.full_fraction:g} % of its pixels at the "
            f"largest value; add flats of {'more' if many == 'less' else 'less'} light"
        )
        return "_full_scale", None, reason
    # From the level on either side whose quantile is nearer; all or no pixels full say nothing.
    last = int(reached[0])
    dimmer, signal = series.flats[last - 1], series.signal_dn[last - 1 : last + 1]
    quantiles = ndtri(full[last - 1 : last + 1])
    target = ndtri(DATA_SHEET.full_fraction)
    nearer = int(np.argmin(np.abs(quantiles - target)))
    step = 0.5
    if np.isfinite(quantiles[nearer]):
        sd_dn = np.sqrt(dimmer.variance_dn2 + max(dimmer.spatial_variance_dn2, 0.0))
        full_dn = signal[nearer] + (target - quantiles[nearer]) * sd_dn
        step = float(np.clip((full_dn - signal[0]) / np.ptp(signal), 0.0, 1.0))
    return "_full_scale", last - 1.0 + step, ""


def linearity(series: FlatSeries, photons: Array, seed: int, **fields: Any) -> Result:
    """Return the linearity error with the smallest and largest deviation, and their figure.

    y = a_0 + a_1 p, weights 1/y^2;  d = (y - a_0 - a_1 p)/(a_0 + a_1 p)   (eq. 58 to 62)
    LE = mean |d|, from 5 to 95 % of saturation                            (eq. 63)
    """
    signal = series.signal_dn
    top = signal.max() if series.peak is None else signal[series.peak]
    low, high = (part * top for part in DATA_SHEET.linear)
    chosen = (signal >= low) & (signal <= high) & _of_series(series)
    if len(np.unique(photons[chosen])) < 3:
        reason = "fewer than three levels lie between 5 and 95 % of saturation; add levels there"
        refusal = make_refusal("linearity_error", "%", reason, refusal="missing", **fields)
        return Result(measurements=(refusal,))
    p, y = photons[chosen], signal[chosen]
    noise = [np.hypot(f.mean_sd_dn, d.mean_sd_dn) for f, d in series.stacks.pairs]
    rng = np.random.default_rng([seed, 19])
    errors = rng.standard_normal((DATA_SHEET.draws, len(y))) * np.array(noise)[chosen]
    design = np.stack([np.ones_like(p), p], axis=1)
    solve = np.linalg.pinv(design / y[:, None])
    drawn = np.vstack([y, y + errors])
    lines = (drawn / y) @ solve.T @ design.T
    deviation = 100.0 * (drawn / lines - 1.0)
    out = [
        measurement_from_sd(name, "%", float(values[0]), float(values[1:].std()), **fields)
        for name, values in (
            ("linearity_error", np.abs(deviation).mean(axis=1)),
            ("linearity_error_min", deviation.min(axis=1)),
            ("linearity_error_max", deviation.max(axis=1)),
        )
    ]
    offset, slope = (solve @ np.ones_like(y)).tolist()
    figure = {
        "figure": "linearity",
        "photons": photons.tolist(),
        "signal_dn": signal.tolist(),
        "fitted_photons": p.tolist(),
        "line_dn": (offset + slope * p).tolist(),
        "deviation_percent": deviation[0].tolist(),
    }
    return Result(measurements=tuple(out), evidence={"linearity": figure})


def data_sheet(
    series: FlatSeries,
    stacks: Stacks[StackStatistics],
    gain: Array,
    findings: Sequence[Finding],
    seed: int,
    **fields: Any,
) -> Result:
    """Return linearity, DSNU and PRNU as the standard has them, with its figures.

    `stacks`: the darks, and the flat of the nonuniformity; without a flat there is none.
    `findings`: on the gain.
    """
    photons, result = emva1288.photons_of(series), Result()
    if photons is not None and (photons > 0.0).all():
        result = linearity(series, photons, seed, **fields)
        light = light_findings(series)
        judged = tuple(judge(m, light) for m in result.measurements)
        result = replace(result, measurements=judged)
    gain_setting = gain_of(series.flats[0].conditions)
    darks = [dark for dark in stacks.darks if gain_of(dark.conditions) == gain_setting]
    if stacks.flats and darks and min(darks[0].size) > 2:
        dark = max(darks, key=lambda level: level.frames)
        unbounded = [replace(entry, bound=None) for entry in findings]
        missing = _missing_frames(series, stacks, min(dark.frames, stacks.flat.frames))
        result += nonuniformity(
            dark, stacks.flat, gain, unbounded, missing=missing, seed=seed, **fields
        )
    return result


def missing_levels(series: FlatSeries) -> str:
    """Return which levels of light the standard has and the session has not; "" if none."""
    lit = [flat.conditions.photons_per_px or flat.mean_dn for flat in series.flats]
    levels = len(set(np.array(lit)[_of_series(series)]))
    more = DATA_SHEET.levels - levels
    return (
        f"{levels} levels of light instead of {DATA_SHEET.levels} (6.5); add flats of two frames "
        f"at {more} more levels, equally spaced up to saturation"
        if more > 0
        else ""
    )


def _of_series(series: FlatSeries) -> NDArray[np.bool_]:
    """Return the flats of the levels, shape (flat,): a longer stack of a flat, of which the others
    have fewer frames, is that of the nonuniformity.
    """
    frames = np.array([flat.frames for flat in series.flats])
    usual = frames == np.bincount(frames).argmax()
    return usual if 2 * usual.sum() > len(usual) else np.ones_like(usual)


def _missing_frames(series: FlatSeries, stacks: Stacks[StackStatistics], frames: int) -> str:
    """Return which frames of the nonuniformity the standard has and the session has not; "" if
    none.
    """
    top = series.signal_dn.max() if series.peak is None else series.signal_dn[series.peak]
    reached, (low, high) = float(stacks.signal_dn[-1] / top), DATA_SHEET.half
    if frames >= DATA_SHEET.frames and low <= reached <= high:
        return ""
    return (
        f"{frames} frames of the dark or of the flat, at {100 * reached:.0f} % of saturation "
        f"(8.2); add stacks of {DATA_SHEET.frames} frames or more, dark and at half of saturation"
    )
