"""Consistency of a point series: gain, dark level, source position and signal across stacks and
frames.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from charact.estimators.bloom.findings import finding, judge_region
from charact.estimators.bloom.over_time import (
    FrameSeries,
    drift_of,
    frame_series,
    frames_before_switch_off,
    recoveries,
)
from charact.estimators.bloom.point_stack import DETECTED, PointStack, has_same_settings
from charact.method import Context
from charact.verdict import Finding
from labdata import Array, Measurement, Session, make_refusal, measurement_from_sd

# Standard errors at which a fall of the background, or a dark mismatch, is significant.
SEEN = 4.0
BOUND = "glare of the source raises the background: the gain fell by at least this value"
DECIBEL = 20.0 / np.log(10.0)


@dataclass(frozen=True, kw_only=True)
class SeriesConsistency:
    """Inconsistencies of a series.

    `findings`: those of each stack's measurements, by label; `measurements`: background depression
    of every stack but the faintest, and recovery times; `evidence`: figure data.
    """

    findings: dict[str, list[Finding]]
    measurements: tuple[Measurement, ...]
    evidence: dict[str, dict[str, Any]]

    def judge(self, measurement: Measurement) -> Measurement:
        """Judge a measurement by the findings of its stack, or a common one by those of all; a
        refusal is none of theirs.
        """
        if measurement.value is None:
            return measurement
        if measurement.stack in self.findings:
            return judge_region(measurement, self.findings[measurement.stack])
        flags = {check.flag for checks in self.findings.values() for check in checks}
        return judge_region(measurement, map(finding, sorted(flags)))


def check_consistency(
    session: Session, spots: tuple[PointStack, ...], context: Context, **fields: Any
) -> SeriesConsistency:
    """Check a series from stack to stack and from frame to frame; `fields` are common to its
    measurements.

    `agc` where the background falls below that of the faintest stack at the same settings;
    `drift` where the source moves, or its signal or the background drifts; `lag` where the source
    is switched off and decays; `dark-mismatch` where noise contradicts the dark level, or the
    background lies below it. Decay of a constant source changes no mean and is not flagged.
    """
    shown = [
        spot for spot in spots if spot.significance >= DETECTED and min(spot.image.shape) >= 24
    ]
    watched = tuple(
        frame_series(spot, session.stack(spot.label).read(), context.pitch_ratio) for spot in shown
    )
    findings: dict[str, list[Finding]] = {spot.label: [] for spot in spots}
    findings |= {series.spot.label: _in_time(series) for series in watched}
    # A source that moves away has not been switched off.
    still = tuple(
        series
        for series in watched
        if any(check.flag == "lag" for check in findings[series.spot.label])
    )
    dark_variances = [
        float(stack.data.var(axis=0, ddof=1, dtype=np.float64).mean())
        for entry in session.of_kind("dark")
        if len(stack := entry.read()) > 1
    ]
    dark_variance = float(np.median(dark_variances)) if dark_variances else None
    for label, checks in _between(watched, findings, dark_variance).items():
        findings[label] += checks
    out = [*_depressions(watched, findings, **fields), *recoveries(still, context.seed, **fields)]
    evidence = {
        "figure": "bloom-constancy",
        "label": [series.spot.label for series in watched],
        "flags": [[check.flag for check in findings[series.spot.label]] for series in watched],
        "background_dn": [series.background_dn for series in watched],
        "background_sd_dn": [series.background_sd_dn for series in watched],
        "time_s": [series.time_s.tolist() for series in watched],
        "row_px": [_finite_or_none(series.centre_px[:, 0]) for series in watched],
        "col_px": [_finite_or_none(series.centre_px[:, 1]) for series in watched],
        "light": [_finite_or_none(series.light_by_frame) for series in watched],
    }
    return SeriesConsistency(
        findings=findings, measurements=tuple(out), evidence={"bloom-constancy": evidence}
    )


def _finite_or_none(values: Array) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]


def _in_time(watched: FrameSeries) -> list[Finding]:
    """Findings of one stack from its own frames.

    Where every frame of a source that moves by t is at or above a threshold, or below it, so is
    their mean. Between both lies an area of up to t d at a bloom of diameter d: d changes by up to
    2 t / pi.
    """
    travel_px, change = drift_of(watched)
    if travel_px == 0 and frames_before_switch_off(watched) is not None:
        return [finding("lag")]
    if change > 0:
        effect = f"light or background change by {100 * change:.2g} % through the stack"
        return [finding("drift", effect)]
    effect = f"the source moves by {travel_px:.2g} px through the stack"
    return [finding("drift", effect, 2.0 * travel_px / np.pi)] if travel_px > 0 else []


def _between(
    watched: tuple[FrameSeries, ...],
    findings: dict[str, list[Finding]],
    dark_variance: float | None,
) -> dict[str, list[Finding]]:
    """Findings of each stack by comparison with the others."""
    out: dict[str, list[Finding]] = {}
    # Motion in one stack may occur less clearly in others, and varies like noise.
    is_steady = not any(check.flag == "drift" for checks in findings.values() for check in checks)
    for stack in watched:
        reference = _faintest(watched, stack)
        # Stacks with the same dark level have the same error.
        same = tuple(
            other
            for other in watched
            if other.spot.dark_dn == stack.spot.dark_dn and not findings[other.spot.label]
        )
        misfit = (
            dark_level_error(same, dark_variance) if stack.spot.dark_known and is_steady else None
        )
        is_dark_wrong = stack.spot.dark_known and stack.background_dn < -max(
            4.0 * stack.background_sd_dn, 0.3
        )
        if misfit is not None:
            # A dark is wrong by more than its error, and by enough to move a contour.
            is_dark_wrong |= abs(misfit[0]) > max(
                SEEN * misfit[1], 0.3, 0.1 * abs(reference.background_dn)
            )
        checks = {
            "agc": _has_background_fallen(reference, stack),
            "dark-mismatch": is_dark_wrong,
        }
        out[stack.spot.label] = [finding(flag) for flag, is_raised in checks.items() if is_raised]
    return out


def _faintest(watched: tuple[FrameSeries, ...], stack: FrameSeries) -> FrameSeries:
    """The stack of least illuminance at the same settings."""
    same_settings = (
        series
        for series in watched
        if has_same_settings(series.spot.conditions, stack.spot.conditions)
    )
    return min(same_settings, key=lambda series: series.spot.conditions.illuminance_lux or 0.0)


def _has_background_fallen(reference: FrameSeries, stack: FrameSeries) -> bool:
    """Whether a stack's background lies below the reference's; independent of the dark level."""
    fall = (
        reference.background_dn + reference.spot.dark_dn - stack.background_dn - stack.spot.dark_dn
    )
    return fall > SEEN * np.hypot(reference.background_sd_dn, stack.background_sd_dn)


def _depressions(
    watched: tuple[FrameSeries, ...], findings: dict[str, list[Finding]], **fields: Any
) -> list[Measurement]:
    """Return the fall of each stack's background below that of the faintest stack at the same
    settings, dB.

    20 log10(B0 / B). Automatic gain lowers the background of a bright frame, glare of the source
    raises it: the value is a lower limit of the gain change. A background that rises is glare
    alone, and the value is refused.
    """
    out: list[Measurement] = []
    for stack in watched:
        reference = _faintest(watched, stack)
        common: dict[str, Any] = {"stack": stack.spot.label, **fields}
        if stack is reference:
            continue
        dim = [
            series
            for series in (reference, stack)
            if series.background_dn < max(10.0 * series.background_sd_dn, 0.2)
        ]
        reason = ""
        if dim:
            level = (
                f"the background of {dim[0].spot.label} is {dim[0].background_dn:.3g} DN above dark"
            )
            reason = f"{level}: too faint to detect a fall"
        elif _has_background_fallen(stack, reference):
            reason = (
                "the background is brighter than that of the faintest stack: it contains the "
                "source's own light"
            )
        if reason:
            out.append(
                make_refusal(
                    "background_depression", "dB", reason, refusal="not-applicable", **common
                )
            )
            continue
        value = DECIBEL * float(np.log(reference.background_dn / stack.background_dn))
        relative = [series.background_sd_dn / series.background_dn for series in (reference, stack)]
        sd = DECIBEL * float(np.hypot(relative[0], relative[1]))
        # This quantity measures the fall itself, which is no reason to flag it.
        checks = [check for check in findings[stack.spot.label] if check.flag != "agc"]
        if not stack.spot.dark_known:
            checks.append(finding("no-darks"))
        common["notes"] = (*common.get("notes", ()), BOUND)
        number = measurement_from_sd("background_depression", "dB", value, sd, **common)
        out.append(judge_region(number, checks))
    return out


def dark_level_error(
    stacks: tuple[FrameSeries, ...], dark_variance: float | None
) -> tuple[float, float] | None:
    """Return the black level above the dark frames' mean and its standard error, DN; None if not
    measurable.

    `stacks` have this dark and a stationary source; `dark_variance`: temporal variance of the dark
    frames, DN^2. Temporal variance grows with the signal from that of the dark frames. The signal
    at which the line through background and halo reaches the dark variance is the black level,
    independent of the dark frames' mean.
    """
    if dark_variance is None or dark_variance < 0.24:
        return None
    levels = []
    for light, variance, error in (stack.noise for stack in stacks if stack.noise.shape[1] > 1):
        sd = np.hypot(error, 0.03 * variance)
        design = np.stack([light, np.ones_like(light)], axis=1) / sd[:, None]
        covariance = np.linalg.inv(design.T @ design)
        slope, offset = covariance @ design.T @ ((variance - dark_variance) / sd)
        if slope > 5.0 * np.sqrt(covariance[0, 0]):
            gradient = np.array([offset / slope**2, -1.0 / slope])
            levels.append((-offset / slope, np.sqrt(gradient @ covariance @ gradient)))
    if not levels:
        return None
    level, sd = np.array(levels).T
    weight = 1.0 / sd**2
    mean = float(weight @ level / weight.sum())
    scatter = float(np.sqrt(weight @ (level - mean) ** 2 / max(len(level) - 1, 1)))
    return mean, float(max(scatter, 1.0) / np.sqrt(weight.sum()))
