"""Contrast methods for bar targets: contrast of the mean profile, Coltman's first term."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import charact
from charact.method import Context, register
from charact.mtf.bars.detection import LocatedBars, target_in
from charact.mtf.bars.target import BarTarget, fitting_margin
from charact.mtf.bars.thresholds import ACCURACY, LIMITS
from charact.mtf.mean_frame import Region
from charact.mtf.quantisation_checks import clipping_flags
from labdata.frames import FrameStack
from labdata.measurement import Provenance, Result, make_refusal, measurement_from_sd

Array = NDArray[np.float64]

CONTRAST, COLTMAN = "bars-contrast", "bars-coltman"


@register(
    "bars",
    CONTRAST,
    quantities=("mtf",),
    scope=(
        "For comparison with visual readings, always suspect: up to a fifth low below a third of the cut-off by "
        "harmonics, low near it by the outer bars; normalised to the light of the bars, not to all light."
    ),
)
def bars_contrast(
    stack: FrameStack,
    *,
    region: Region | None = None,
    bars: int | None = None,
    frequency_cy_per_px: float | None = None,
    context: Context,
) -> Result:
    """Measure pi/4 (max - min)/(max + min) above the pedestal from the profile across the bars.

    Parameters
    ----------
    stack, region, bars, frequency_cy_per_px, context
        As for "bars-forward".

    Returns
    -------
    Result
        `mtf` at the bar frequency, always suspect.

    Notes
    -----
    First term of Coltman's series (J. Opt. Soc. Am. 44, 468, 1954): valid for infinite square waves above a third of
    the cut-off.
    """
    used = stack if region is None else stack.region(*region)
    return _measure(
        CONTRAST, used, lambda mean, seen: _profile_contrast(mean, seen.target), LIMITS.min_contrast_sd,
        reason="no target: no significant bar contrast; state --bars and --frequency",
        note="Contrast reading, for comparison only.", full_scale_dn=context.full_scale_dn,
        region=region or (0, 0, *used.shape[1:]), bars=bars, frequency=frequency_cy_per_px, context=context,
    )  # fmt: skip


def _measure(
    method: str,
    used: FrameStack,
    read: Callable[[Array, LocatedBars], tuple[float, float] | None],
    min_sd: float,
    *,
    reason: str,
    note: str,
    full_scale_dn: float | None,
    region: Region,
    bars: int | None,
    frequency: float | None,
    context: Context,
) -> Result:
    """Return the measurement of a reading, value and standard uncertainty, of the mean frame with bright bars."""
    provenance = Provenance(version=charact.__version__, seed=context.seed, settings={"bars": bars})
    common: dict[str, Any] = {"method": method, "region": region, "provenance": provenance}
    mean = used.data.mean(axis=0, dtype=np.float64)
    seen = target_in(mean, bars=bars, frequency=frequency, pitch_ratio=context.pitch_ratio)
    found = None if seen is None else read(seen.target.sign * mean, seen)
    if seen is None or found is None or not found[0] > min_sd * found[1]:
        one = make_refusal("mtf", "1", reason, flags=("no-target",), frequency_cy_per_px=frequency, **common)
        return Result(measurements=(one,))
    target = seen.target
    near = target.box((mean.shape[0], mean.shape[1]), 1.0)
    one = measurement_from_sd(
        "mtf", "1", *found, flags=("model-misfit", *clipping_flags(used.data[:, near], full_scale_dn)), notes=(note,),
        frequency_cy_per_px=target.frequency, orientation_deg=float(np.rad2deg(target.angle_rad)) % 180.0, **common,
    )  # fmt: skip
    return Result(measurements=(one,))


def _profile_contrast(mean: Array, target: BarTarget) -> tuple[float, float] | None:
    """Return contrast and standard uncertainty from the pixels at the centres of bars and gaps."""
    across, along = target.coordinates(mean.shape)
    margin, _ = fitting_margin(target, (mean.shape[0], mean.shape[1]), 1.5 / target.frequency)
    pedestal = float(np.median(mean[~target.box(mean.shape, margin)]))
    inner = np.abs(along) < 0.3 * target.length_px
    phase = (across * target.frequency + (target.bars - 1) / 2.0) % 1.0
    within = inner & (np.abs(across) < (target.bars - 1) / 2.0 / target.frequency + 0.1 / target.frequency)
    near = np.minimum(phase, 1.0 - phase)
    on, between = mean[within & (near < 0.12)], mean[within & (near > 0.38)]
    if min(on.size, between.size) < 3:
        return None
    high, low = on.mean() - pedestal, between.mean() - pedestal
    if not high + low > 0:
        return None
    value = np.pi / 4.0 * (high - low) / (high + low)
    error = np.hypot(on.std() / np.sqrt(on.size / 3.0), between.std() / np.sqrt(between.size / 3.0))
    return float(value), float(np.pi / 4.0 * error / (high + low))


@register(
    "bars",
    COLTMAN,
    quantities=("mtf",),
    scope=(
        "For comparison, always suspect: first term of Coltman's series, (pi/4)(max - min)/step of the inner bars. Up "
        "to a fifth low below a third of the cut-off by harmonics; the step of a single patch is low by its tails, by "
        "several percent for tubes (n near 1.1); high where the noise approaches the modulation; phase-dependent "
        "for untilted bars above half the sampling limit."
    ),
)
def bars_coltman(
    stack: FrameStack,
    *,
    region: Region | None = None,
    bars: int | None = None,
    frequency_cy_per_px: float | None = None,
    context: Context,
) -> Result:
    """Measure (pi/4)(max - min)/step at the inner bars of one group, the step being that of a large area.

    Parameters
    ----------
    stack, region, bars, frequency_cy_per_px, context
        As for "bars-forward".

    Returns
    -------
    Result
        `mtf` at the bar frequency, always suspect.

    Notes
    -----
    Coltman, J. Opt. Soc. Am. 44, 468 (1954). The step of a large area is the light of the target over the area of its
    bars, N w per unit length.
    """
    used = stack if region is None else stack.region(*region)
    return _measure(
        COLTMAN, used, _modulation, LIMITS.min_modulation_sd,
        reason="no target: no significant bar modulation; state --bars and --frequency",
        note="First term of Coltman's series, for comparison only.",
        full_scale_dn=context.full_scale_dn or used.full_scale_dn,
        region=region or (0, 0, *used.shape[1:]), bars=bars, frequency=frequency_cy_per_px, context=context,
    )  # fmt: skip


def _modulation(mean: Array, seen: LocatedBars) -> tuple[float, float] | None:
    """Return modulation and standard uncertainty, for bars that are bright."""
    target, through = seen.target, seen.through
    bars, frequency = target.bars, target.frequency
    across, along = target.coordinates((mean.shape[0], mean.shape[1]))
    inner = np.ones(mean.shape, bool) if through else np.abs(along) < ACCURACY.inner_length * target.length_px
    reach = target.width_px / 2.0 + min(12.0, 1.5 / frequency)
    if not through:
        reach = target.width_px / 2.0 + fitting_margin(target, (mean.shape[0], mean.shape[1]), 1.5 / frequency)[0]
    background = inner & (np.abs(across) > reach - 1.0)
    patch = inner & (np.abs(across) < reach)
    fundamental = np.sum((mean[patch] - mean[background].mean()) * np.exp(-2j * np.pi * frequency * across[patch]))
    ahead = float(np.angle(fundamental * np.exp(1j * np.pi * (bars - 1)))) / (2.0 * np.pi)
    phase = (across * frequency + ahead + (bars - 1) / 2.0) % 1.0
    near = np.minimum(phase, 1.0 - phase)
    within = inner & (np.abs(across) < ((bars - 1) / 2.0 + ACCURACY.extremum_periods) / frequency)
    on, between = (
        mean[within & (near < ACCURACY.extremum_periods)],
        mean[within & (near > 0.5 - ACCURACY.extremum_periods)],
    )
    if min(on.size, between.size) < 3 or np.count_nonzero(background) < 3:
        return None
    pedestal = float(mean[background].mean())
    light = float((mean[patch] - pedestal).mean()) * 2.0 * reach
    step = light / (bars * 0.5 / frequency)
    if not step > 0:
        return None
    # The mean of a fundamental over pixels near its extrema is lower than the extremum by a known factor.
    value = np.pi / 4.0 * (on.mean() - between.mean()) / step / np.sinc(2.0 * ACCURACY.extremum_periods)
    error = np.pi / 4.0 * np.hypot(on.std() / np.sqrt(on.size), between.std() / np.sqrt(between.size)) / step
    return float(value), float(error)
