"""Background of the stacks of one series held against each other, and against the dark frames they are taken with."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.bloom.over_time import FrameSeries
from labdata.measurement import Measurement, make_refusal, measurement_from_sd

Array = NDArray[np.float64]

# Standard errors at which a fall of the background, or a dark that does not fit, is seen.
SEEN = 4.0
# Background over dark, in its standard errors and in DN, below which its fall has no decibels.
LEAST_ERRORS, LEAST_DN = 10.0, 0.2
# Least misfit of a dark that does harm, DN and share of the background.
HARM_DN, HARM_SHARE = 0.3, 0.1
# Relative error of a variance beyond its scatter: the gain of a plate falls a little with the light.
VARIANCE_SHARE = 0.03
# Variance below which rounding makes noise no straight line of the light (EMVA 1288), DN^2.
QUANTISED = 0.24
SETTINGS = ("mcp_v", "camera_gain_db", "gate_ns", "exposure_s", "em_gain", "gain_control")
BOUND = "glare of the source raises the background: the gain fell by at least so much"
DECIBEL = 20.0 / np.log(10.0)


def alike(one: FrameSeries, other: FrameSeries) -> bool:
    """Whether two stacks were taken at the same settings, so that their backgrounds should agree."""
    return all(getattr(one.conditions, name) == getattr(other.conditions, name) for name in SETTINGS)


def faintest(watched: tuple[FrameSeries, ...], stack: FrameSeries) -> FrameSeries:
    """The faintest stack at the same settings."""
    return min((one for one in watched if alike(one, stack)), key=lambda one: one.conditions.illuminance_lux or 0.0)


def has_background_fallen(reference: FrameSeries, stack: FrameSeries) -> bool:
    """Whether a stack's background lies below that of the reference; the dark level is in neither."""
    fall = reference.background_dn + reference.dark_dn - stack.background_dn - stack.dark_dn
    return fall > SEEN * np.hypot(reference.background_sd_dn, stack.background_sd_dn)


def depressions(
    watched: tuple[FrameSeries, ...], flags: dict[str, tuple[str, ...]], **fields: Any
) -> list[Measurement]:
    """Return how far each stack's background lies below that of the faintest at the same settings, dB.

    Notes
    -----
    20 log10(B0 / B). An automatic gain lowers the background of a bright frame, glare of the source raises it: the gain
    fell by at least so much. Where the background rises there is nothing but glare to be told, and it is refused.
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
        # A fall is what this number measures: it is no reason to distrust it.
        told = tuple(flag for flag in flags.get(one.label, ()) if flag != "agc")
        told += () if one.dark_known else ("no-darks",)
        common["notes"] = (*common.get("notes", ()), BOUND)
        out.append(measurement_from_sd("background_depression", "dB", value, sd, flags=told, **common))
    return out


def _reason(reference: FrameSeries, stack: FrameSeries) -> str | None:
    for one in (reference, stack):
        if one.background_dn < max(LEAST_ERRORS * one.background_sd_dn, LEAST_DN):
            return f"the background of {one.label} is {one.background_dn:.3g} DN over dark: too faint to see it fall"
    if has_background_fallen(stack, reference):
        return "the background is brighter than that of the faintest stack: the source's own light lies on it"
    return None


def dark_level_error(stacks: tuple[FrameSeries, ...], dark_variance: float | None) -> tuple[float, float] | None:
    """Return by how much the level without light lies above the dark frames' mean and its standard error, DN, or None.

    Parameters
    ----------
    stacks
        Those that the dark belongs to, their source at rest.
    dark_variance
        Variance of the dark frames in time, DN^2.

    Notes
    -----
    Noise in time grows with the light from that of darkness on. The level at which its line, drawn through background
    and halo, comes down to the noise of the dark frames is the level without light, whatever the dark frames' mean.
    """
    if dark_variance is None or dark_variance < QUANTISED:
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
    """Level over dark at which one stack's line of noise meets that of the dark frames, and its standard error."""
    if len(stack.noise_level_dn) < 2:
        return None
    level, variance = stack.noise_level_dn, stack.noise_variance - dark_variance
    sd = np.hypot(stack.noise_variance_sd, VARIANCE_SHARE * stack.noise_variance)
    design = np.stack([level, np.ones_like(level)], axis=1) / sd[:, None]
    covariance = np.linalg.inv(design.T @ design)
    slope, offset = covariance @ design.T @ (variance / sd)
    if not slope > 5.0 * np.sqrt(covariance[0, 0]):
        return None
    gradient = np.array([offset / slope**2, -1.0 / slope])
    return float(-offset / slope), float(np.sqrt(gradient @ covariance @ gradient))


def is_dark_inconsistent(misfit: tuple[float, float] | None, background_dn: float) -> bool:
    """Whether a dark is off by more than its error, and by enough to move a contour."""
    if misfit is None:
        return False
    off, sd = misfit
    return abs(off) > max(SEEN * sd, HARM_DN, HARM_SHARE * abs(background_dn))
