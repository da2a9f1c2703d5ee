"""Contrast methods for bar targets: contrast of the mean profile, Coltman's first term."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

import charact
from charact.estimators.mtf.bars.checks import CLIPPED, finding
from charact.estimators.mtf.bars.detection import LocatedBars, target_in
from charact.estimators.mtf.bars.target import fitting_margin
from charact.estimators.mtf.bars.thresholds import ACCURACY, LIMITS
from charact.estimators.mtf.mean_frame import Region
from charact.frames.stack import Stack
from charact.method import Context, register
from charact.verdict import judge
from labdata import Array, FrameStack, Provenance, Result, make_refusal, measurement_from_sd

CONTRAST, COLTMAN = "bars-contrast", "bars-coltman"
BIASED_BY = "harmonics, the outer bars, noise and the phase of the pixels bias maxima and minima"


def measure_contrast(
    stack: FrameStack,
    *,
    method: str,
    read: Callable[[Array, LocatedBars], tuple[float, float] | None],
    min_sd: float,
    reason: str,
    note: str,
    region: Region | None = None,
    bars: int | None = None,
    frequency_cy_per_px: float | None = None,
    context: Context,
) -> Result:
    """Measure pi/4 of the contrast of one group of bars: `mtf` at the bar frequency, always
    suspect.

    `read` gives value and standard uncertainty of a mean frame with bright bars; the other options
    are those of "bars-forward". First term of Coltman's series (J. Opt. Soc. Am. 44, 468, 1954):
    valid for infinite square waves above a third of the cut-off.
    """
    cut_stack = Stack.of(stack if region is None else stack.region(*region), context)
    common: dict[str, Any] = {
        "method": method,
        "region": region or (0, 0, *cut_stack.data.shape[1:]),
        "provenance": Provenance(
            version=charact.__version__, seed=context.seed, settings={"bars": bars}
        ),
    }
    mean = cut_stack.mean_frame_dn
    located = target_in(
        mean, bars=bars, frequency=frequency_cy_per_px, pitch_ratio=context.pitch_ratio
    )
    contrast = None if located is None else read(located.target.sign * mean, located)
    if located is None or contrast is None or not contrast[0] > min_sd * contrast[1]:
        measurement = make_refusal(
            "mtf",
            "1",
            reason,
            flags=("no-target",),
            frequency_cy_per_px=frequency_cy_per_px,
            **common,
        )
        return Result(measurements=(measurement,))
    target = located.target
    clipped = cut_stack.is_clipped(target.box(mean.shape, 1.0))
    findings = [finding("model-misfit", BIASED_BY, "`method` bars-forward")]
    findings += [finding("clipped", CLIPPED)] if clipped else []
    number = measurement_from_sd(
        "mtf",
        "1",
        *contrast,
        notes=(note,),
        frequency_cy_per_px=target.frequency,
        orientation_deg=float(np.rad2deg(target.angle_rad)) % 180.0,
        **common,
    )
    return Result(measurements=(judge(number, findings),))


def _bars_and_gaps(
    mean: Array,
    located: LocatedBars,
    periods: float,
    *,
    inner: NDArray[np.bool_],
    ahead: float = 0.0,
) -> tuple[Array, Array]:
    """Return the pixels within some periods of the centres of bars and of gaps; `ahead` is their
    phase, periods.
    """
    target = located.target
    across, _ = target.coordinates(mean.shape)
    phase = (across * target.frequency + ahead + (target.bars - 1) / 2.0) % 1.0
    bar_distance = np.minimum(phase, 1.0 - phase)
    interior = inner & (
        np.abs(across) < ((target.bars - 1) / 2.0 + min(periods, 0.1)) / target.frequency
    )
    return mean[interior & (bar_distance < periods)], mean[
        interior & (bar_distance > 0.5 - periods)
    ]


def _profile_contrast(mean: Array, located: LocatedBars) -> tuple[float, float] | None:
    """Return pi/4 (max - min)/(max + min) above the pedestal and its standard uncertainty."""
    target = located.target
    margin, _ = fitting_margin(target, mean.shape, 1.5 / target.frequency)
    pedestal = float(np.median(mean[~target.box(mean.shape, margin)]))
    inner = np.abs(target.coordinates(mean.shape)[1]) < ACCURACY.inner_length * target.length_px
    bars, gaps = _bars_and_gaps(mean, located, 2.0 * ACCURACY.extremum_periods, inner=inner)
    if min(bars.size, gaps.size) < 3:
        return None
    high, low = bars.mean() - pedestal, gaps.mean() - pedestal
    if not high + low > 0:
        return None
    error = np.sqrt(3.0) * np.hypot(
        bars.std() / np.sqrt(bars.size), gaps.std() / np.sqrt(gaps.size)
    )
    return float(np.pi / 4.0 * (high - low) / (high + low)), float(
        np.pi / 4.0 * error / (high + low)
    )


def _modulation(mean: Array, located: LocatedBars) -> tuple[float, float] | None:
    """Return pi/4 (max - min)/step and its standard uncertainty, the step that of a large area.

    The step is the light of the target over the area of its bars, N w per unit length.
    """
    target, through = located.target, located.through
    across, along = target.coordinates(mean.shape)
    inner = (
        np.ones(mean.shape, bool)
        if through
        else np.abs(along) < ACCURACY.inner_length * target.length_px
    )
    margin = 1.5 / target.frequency
    half_width_px = target.width_px / 2.0 + (
        min(12.0, margin) if through else fitting_margin(target, mean.shape, margin)[0]
    )
    background, patch = (
        inner & (np.abs(across) > half_width_px - 1.0),
        inner & (np.abs(across) < half_width_px),
    )
    wave = np.exp(-2j * np.pi * target.frequency * across[patch])
    fundamental = np.sum((mean[patch] - mean[background].mean()) * wave)
    ahead = float(np.angle(fundamental * np.exp(1j * np.pi * (target.bars - 1)))) / (2.0 * np.pi)
    bars, gaps = _bars_and_gaps(mean, located, ACCURACY.extremum_periods, inner=inner, ahead=ahead)
    if min(bars.size, gaps.size) < 3 or np.count_nonzero(background) < 3:
        return None
    light = float((mean[patch] - mean[background].mean()).mean()) * 2.0 * half_width_px
    step = light / (target.bars * 0.5 / target.frequency)
    if not step > 0:
        return None
    # The mean of a fundamental over pixels near its extrema is lower than the extremum by a known
    # factor.
    value = (
        np.pi / 4.0 * (bars.mean() - gaps.mean()) / step / np.sinc(2.0 * ACCURACY.extremum_periods)
    )
    error = (
        np.pi
        / 4.0
        * np.hypot(bars.std() / np.sqrt(bars.size), gaps.std() / np.sqrt(gaps.size))
        / step
    )
    return float(value), float(error)


bars_contrast = register("bars", CONTRAST)(
    partial(
        measure_contrast,
        method=CONTRAST,
        read=_profile_contrast,
        min_sd=LIMITS.min_contrast_sd,
        reason="no target: no significant bar contrast; state `bars` and `frequency_cy_per_px`",
        note="Contrast reading, for comparison only.",
    )
)

bars_coltman = register("bars", COLTMAN)(
    partial(
        measure_contrast,
        method=COLTMAN,
        read=_modulation,
        min_sd=LIMITS.min_modulation_sd,
        reason="no target: no significant bar modulation; state `bars` and `frequency_cy_per_px`",
        note="First term of Coltman's series, for comparison only.",
    )
)
