"""Consistency of a point series: gain, dark level, source position and signal across stacks and frames."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.bloom.over_time import (
    FrameSeries,
    frame_series,
    frames_before_switch_off,
    recoveries,
    relative_drift,
    travel_px,
)
from charact.bloom.point_stack import DETECTED, PointStack, has_same_settings
from charact.method import Context
from labdata.measurement import Measurement, make_refusal, measurement_from_sd
from labdata.session import Session

Array = NDArray[np.float64]

# Standard errors at which a fall of the background, or a dark mismatch, is significant.
SEEN = 4.0
BOUND = "glare of the source raises the background: the gain fell by at least this value"
DECIBEL = 20.0 / np.log(10.0)


def faintest(watched: tuple[FrameSeries, ...], stack: FrameSeries) -> FrameSeries:
    """The stack of least illuminance at the same settings."""
    return min(
        (one for one in watched if has_same_settings(one.conditions, stack.conditions)),
        key=lambda one: one.conditions.illuminance_lux or 0.0,
    )


def has_background_fallen(reference: FrameSeries, stack: FrameSeries) -> bool:
    """Whether a stack's background lies below the reference's; independent of the dark level."""
    fall = reference.background_dn + reference.dark_dn - stack.background_dn - stack.dark_dn
    return fall > SEEN * np.hypot(reference.background_sd_dn, stack.background_sd_dn)


def depressions(
    watched: tuple[FrameSeries, ...], flags: dict[str, tuple[str, ...]], **fields: Any
) -> list[Measurement]:
    """Return the fall of each stack's background below that of the faintest stack at the same settings, dB.

    20 log10(B0 / B). Automatic gain lowers the background of a bright frame, glare of the source raises it: the value
    is a lower limit of the gain change. A background that rises is glare alone, and the value is refused.
    """
    out: list[Measurement] = []
    for one in watched:
        reference = faintest(watched, one)
        common: dict[str, Any] = {"stack": one.label, **fields}
        if one is reference:
            continue
        reason = _reason(reference, one)
        if reason is not None:
            out.append(make_refusal("background_depression", "dB", reason, **common))
            continue
        value = DECIBEL * float(np.log(reference.background_dn / one.background_dn))
        parts = [each.background_sd_dn / each.background_dn for each in (reference, one)]
        sd = DECIBEL * float(np.hypot(parts[0], parts[1]))
        # This quantity measures the fall itself, which is no reason to flag it.
        own_flags = tuple(flag for flag in flags.get(one.label, ()) if flag != "agc")
        own_flags += () if one.dark_known else ("no-darks",)
        common["notes"] = (*common.get("notes", ()), BOUND)
        out.append(measurement_from_sd("background_depression", "dB", value, sd, flags=own_flags, **common))
    return out


def _reason(reference: FrameSeries, stack: FrameSeries) -> str | None:
    for one in (reference, stack):
        if one.background_dn < max(10.0 * one.background_sd_dn, 0.2):
            return f"the background of {one.label} is {one.background_dn:.3g} DN above dark: too faint to detect a fall"
    if has_background_fallen(stack, reference):
        return "the background is brighter than that of the faintest stack: it contains the source's own light"
    return None


def dark_level_error(stacks: tuple[FrameSeries, ...], dark_variance: float | None) -> tuple[float, float] | None:
    """Return the black level above the dark frames' mean and its standard error, DN; None if not measurable.

    `stacks`: stacks with this dark and a stationary source; `dark_variance`: temporal variance of the dark frames,
    DN^2. Temporal variance grows with the signal from that of the dark frames. The signal at which the line through
    background and halo reaches the dark variance is the black level, independent of the dark frames' mean.
    """
    if dark_variance is None or dark_variance < 0.24:
        return None
    found = [one for one in (_without_light(stack, dark_variance) for stack in stacks) if one is not None]
    if not found:
        return None
    level, sd = np.array(found).T
    weight = 1.0 / sd**2
    mean = float(weight @ level / weight.sum())
    scatter = float(np.sqrt(weight @ (level - mean) ** 2 / max(len(level) - 1, 1)))
    return mean, float(max(scatter, 1.0) / np.sqrt(weight.sum()))


def _without_light(stack: FrameSeries, dark_variance: float) -> tuple[float, float] | None:
    """Signal above dark at which a stack's variance equals that of the dark frames, and its standard error."""
    if len(stack.noise_level_dn) < 2:
        return None
    level, variance = stack.noise_level_dn, stack.noise_variance - dark_variance
    sd = np.hypot(stack.noise_variance_sd, 0.03 * stack.noise_variance)
    design = np.stack([level, np.ones_like(level)], axis=1) / sd[:, None]
    covariance = np.linalg.inv(design.T @ design)
    slope, offset = covariance @ design.T @ (variance / sd)
    if not slope > 5.0 * np.sqrt(covariance[0, 0]):
        return None
    gradient = np.array([offset / slope**2, -1.0 / slope])
    return float(-offset / slope), float(np.sqrt(gradient @ covariance @ gradient))


def is_dark_inconsistent(misfit: tuple[float, float] | None, background_dn: float) -> bool:
    """Whether a dark is wrong by more than its error, and by enough to move a contour."""
    if misfit is None:
        return False
    off, sd = misfit
    return abs(off) > max(SEEN * sd, 0.3, 0.1 * abs(background_dn))


@dataclass(frozen=True, kw_only=True)
class SeriesConsistency:
    """Inconsistencies of a series.

    `flags`: flags of each stack's measurements, by label; empty without an inconsistency; `measurements`: background
    depression of every stack but the faintest, and recovery times; `evidence`: figure data.
    """

    flags: dict[str, tuple[str, ...]]
    measurements: tuple[Measurement, ...]
    evidence: dict[str, dict[str, Any]]

    @property
    def halo_flags(self) -> tuple[str, ...]:
        """Flags of the quantities common to all stacks."""
        return tuple(sorted({flag for flags in self.flags.values() for flag in flags}))


def check_consistency(
    session: Session, spots: tuple[PointStack, ...], context: Context, **fields: Any
) -> SeriesConsistency:
    """Check a series from stack to stack and from frame to frame.

    `session`: session with the frames of the point stacks, each read once more, and the darks; `spots`: point stacks;
    `context`: seed and pitches; `fields`: method and provenance of the measurements. Flags: `agc` where the background
    falls below that of the faintest stack at the same settings; `drift` where the source moves, or its signal or the
    background drifts; `lag` where the source is switched off and decays; `dark-mismatch` where noise contradicts the
    dark level, or the background lies below it. Decay of a constant source changes no mean and is not flagged.
    """
    ratio = context.pitch_ratio
    shown = [spot for spot in spots if spot.significance >= DETECTED and min(spot.image.shape) >= 24]
    watched = tuple(frame_series(spot, session.stack(spot.label).read(), ratio) for spot in shown)
    flags: dict[str, tuple[str, ...]] = {spot.label: () for spot in spots}
    flags |= {one.label: _in_time(one) for one in watched}
    for label, own_flags in _between(watched, flags, _dark_variance(session)).items():
        flags[label] += own_flags
    # A source that moves away has not been switched off.
    still = tuple(one for one in watched if "lag" in flags[one.label])
    out = [*depressions(watched, flags, **fields), *recoveries(still, context.seed, **fields)]
    return SeriesConsistency(
        flags=flags, measurements=tuple(out), evidence={"bloom-constancy": _evidence(watched, flags)}
    )


def _in_time(watched: FrameSeries) -> tuple[str, ...]:
    """Flags of one stack from its own frames."""
    if travel_px(watched) > 0:
        return ("drift",)
    if frames_before_switch_off(watched) is not None:
        return ("lag",)
    return ("drift",) if relative_drift(watched) > 0 else ()


def _between(
    watched: tuple[FrameSeries, ...], flags: dict[str, tuple[str, ...]], dark_variance: float | None
) -> dict[str, tuple[str, ...]]:
    """Flags of each stack by comparison with the others."""
    out: dict[str, tuple[str, ...]] = {}
    # Motion in one stack may occur less clearly in others, and varies like noise.
    rest = not any("drift" in own_flags for own_flags in flags.values())
    for one in watched:
        fallen = has_background_fallen(faintest(watched, one), one)
        # Stacks with the same dark level have the same error.
        same = tuple(other for other in watched if other.dark_dn == one.dark_dn and not flags[other.label])
        misfit = dark_level_error(same, dark_variance) if one.dark_known and rest else None
        below = one.dark_known and one.background_dn < -max(4.0 * one.background_sd_dn, 0.3)
        wrong = below or is_dark_inconsistent(misfit, faintest(watched, one).background_dn)
        out[one.label] = (("agc",) if fallen else ()) + (("dark-mismatch",) if wrong else ())
    return out


def _dark_variance(session: Session) -> float | None:
    """Temporal variance of the dark frames, DN^2; None with fewer than two frames."""
    variances = [
        float(stack.data.var(axis=0, ddof=1, dtype=np.float64).mean())
        for entry in session.of_kind("dark")
        if len(stack := entry.read()) > 1
    ]
    return float(np.median(variances)) if variances else None


def _evidence(watched: tuple[FrameSeries, ...], flags: dict[str, tuple[str, ...]]) -> dict[str, Any]:
    """Background of each stack, and place and light of its frames."""
    return {
        "figure": "bloom-constancy",
        "label": [one.label for one in watched],
        "flags": [list(flags[one.label]) for one in watched],
        "background_dn": [one.background_dn for one in watched],
        "background_sd_dn": [one.background_sd_dn for one in watched],
        "time_s": [one.time_s.tolist() for one in watched],
        "row_px": [_finite_or_none(one.centre_px[:, 0]) for one in watched],
        "col_px": [_finite_or_none(one.centre_px[:, 1]) for one in watched],
        "light": [_finite_or_none(one.light_by_frame) for one in watched],
    }


def _finite_or_none(values: np.ndarray) -> list[float | None]:
    """Return values as floats, None where not finite."""
    return [float(value) if np.isfinite(value) else None for value in values]
