"""Contrast methods for bar targets: contrast of the mean profile, Coltman's first term."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

import charact
from charact.estimators.mtf.bars.detection import LocatedBars, target_in
from charact.estimators.mtf.bars.target import fitting_margin
from charact.estimators.mtf.bars.thresholds import ACCURACY, LIMITS
from charact.estimators.mtf.mean_frame import Region
from charact.estimators.mtf.quantisation_checks import clipping_flags
from charact.method import Context, register
from labdata.frames import FrameStack
from labdata.measurement import Provenance, Result, make_refusal, measurement_from_sd

Array = NDArray[np.float64]

CONTRAST, COLTMAN = "bars-contrast", "bars-coltman"


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
    used = stack if region is None else stack.region(*region)
    common: dict[str, Any] = {
        "method": method,
        "region": region or (0, 0, *used.shape[1:]),
        "provenance": Provenance(
            version=charact.__version__, seed=context.seed, settings={"bars": bars}
        ),
    }
    mean = used.data.mean(axis=0, dtype=np.float64)
    seen = target_in(
        mean, bars=bars, frequency=frequency_cy_per_px, pitch_ratio=context.pitch_ratio
    )
    found = None if seen is None else read(seen.target.sign * mean, seen)
    if seen is None or found is None or not found[0] > min_sd * found[1]:
        one = make_refusal(
            "mtf",
            "1",
            reason,
            flags=("no-target",),
            frequency_cy_per_px=frequency_cy_per_px,
            **common,
        )
        return Result(measurements=(one,))
    target, full_scale_dn = seen.target, context.full_scale_dn or used.full_scale_dn
    clipped = clipping_flags(used.data[:, target.box(mean.shape, 1.0)], full_scale_dn)
    one = measurement_from_sd(
        "mtf",
        "1",
        *found,
        flags=("model-misfit", *clipped),
        notes=(note,),
        frequency_cy_per_px=target.frequency,
        orientation_deg=float(np.rad2deg(target.angle_rad)) % 180.0,
        **common,
    )
    return Result(measurements=(one,))


def _bars_and_gaps(
    mean: Array, seen: LocatedBars, periods: float, *, inner: NDArray[np.bool_], ahead: float = 0.0
) -> tuple[Array, Array]:
    """Return the pixels within some periods of the centres of bars and of gaps; `ahead` is their
    phase, periods.
    """
    target = seen.target
    across, _ = target.coordinates(mean.shape)
    phase = (across * target.frequency + ahead + (target.bars - 1) / 2.0) % 1.0
    near = np.minimum(phase, 1.0 - phase)
    within = inner & (
        np.abs(across) < ((target.bars - 1) / 2.0 + min(periods, 0.1)) / target.frequency
    )
    return mean[within & (near < periods)], mean[within & (near > 0.5 - periods)]


def _profile_contrast(mean: Array, seen: LocatedBars) -> tuple[float, float] | None:
    """Return pi/4 (max - min)/(max + min) above the pedestal and its standard uncertainty."""
    target = seen.target
    margin, _ = fitting_margin(target, mean.shape, 1.5 / target.frequency)
    pedestal = float(np.median(mean[~target.box(mean.shape, margin)]))
    inner = np.abs(target.coordinates(mean.shape)[1]) < ACCURACY.inner_length * target.length_px
    on, between = _bars_and_gaps(mean, seen, 2.0 * ACCURACY.extremum_periods, inner=inner)
    if min(on.size, between.size) < 3:
        return None
    high, low = on.mean() - pedestal, between.mean() - pedestal
    if not high + low > 0:
        return None
    error = np.sqrt(3.0) * np.hypot(
        on.std() / np.sqrt(on.size), between.std() / np.sqrt(between.size)
    )
    return float(np.pi / 4.0 * (high - low) / (high + low)), float(
        np.pi / 4.0 * error / (high + low)
    )


def _modulation(mean: Array, seen: LocatedBars) -> tuple[float, float] | None:
    """Return pi/4 (max - min)/step and its standard uncertainty, the step that of a large area.

    The step is the light of the target over the area of its bars, N w per unit length.
    """
    target, through = seen.target, seen.through
    across, along = target.coordinates(mean.shape)
    inner = (
        np.ones(mean.shape, bool)
        if through
        else np.abs(along) < ACCURACY.inner_length * target.length_px
    )
    margin = 1.5 / target.frequency
    reach = target.width_px / 2.0 + (
        min(12.0, margin) if through else fitting_margin(target, mean.shape, margin)[0]
    )
    background, patch = inner & (np.abs(across) > reach - 1.0), inner & (np.abs(across) < reach)
    wave = np.exp(-2j * np.pi * target.frequency * across[patch])
    fundamental = np.sum((mean[patch] - mean[background].mean()) * wave)
    ahead = float(np.angle(fundamental * np.exp(1j * np.pi * (target.bars - 1)))) / (2.0 * np.pi)
    on, between = _bars_and_gaps(mean, seen, ACCURACY.extremum_periods, inner=inner, ahead=ahead)
    if min(on.size, between.size) < 3 or np.count_nonzero(background) < 3:
        return None
    light = float((mean[patch] - mean[background].mean()).mean()) * 2.0 * reach
    step = light / (target.bars * 0.5 / target.frequency)
    if not step > 0:
        return None
    # The mean of a fundamental over pixels near its extrema is lower than the extremum by a known
    # factor.
    value = (
        np.pi / 4.0 * (on.mean() - between.mean()) / step / np.sinc(2.0 * ACCURACY.extremum_periods)
    )
    error = (
        np.pi
        / 4.0
        * np.hypot(on.std() / np.sqrt(on.size), between.std() / np.sqrt(between.size))
        / step
    )
    return float(value), float(error)


bars_contrast = register("bars", CONTRAST)(
    partial(
        measure_contrast,
        method=CONTRAST,
        read=_profile_contrast,
        min_sd=LIMITS.min_contrast_sd,
        reason="no target: no significant bar contrast; state --bars and --frequency",
        note="Contrast reading, for comparison only.",
    )
)

bars_coltman = register("bars", COLTMAN)(
    partial(
        measure_contrast,
        method=COLTMAN,
        read=_modulation,
        min_sd=LIMITS.min_modulation_sd,
        reason="no target: no significant bar modulation; state --bars and --frequency",
        note="First term of Coltman's series, for comparison only.",
    )
)
