"""Contrast of the mean profile times pi/4, as read by eye."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

import charact
from charact.method import Context, register
from charact.mtf.bars.sight import target_in
from charact.mtf.bars.target import BarTarget
from charact.mtf.bars.window import fitting_margin
from charact.mtf.quantisation_checks import clipping_flags
from charact.mtf.region import Region
from labdata.frames import FrameStack
from labdata.measurement import Provenance, Result, make_refusal, measurement_from_sd

Array = NDArray[np.float64]

METHOD = "bars-contrast"
# Three bars' worth of contrast in standard errors; below it peaks are peaks of noise.
MIN_CONTRAST_SD = 12.0


@register(
    "bars",
    METHOD,
    quantities=("mtf",),
    scope=(
        "For comparison with readings by eye, always suspect: harmonics make it read up to a fifth low below a third "
        "of the cut-off, outer bars low near it, and it is normalised to the light of the bars, not to all."
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
    where = region or (0, 0, *used.shape[1:])
    common: dict[str, Any] = {
        "method": METHOD,
        "region": where,
        "frequency_cy_per_px": frequency_cy_per_px,
        "provenance": Provenance(version=charact.__version__, seed=context.seed, settings={"bars": bars}),
    }
    mean = used.data.mean(axis=0, dtype=np.float64)
    seen = target_in(mean, bars=bars, frequency=frequency_cy_per_px, pitch_ratio=context.pitch_ratio)
    read = None if seen is None else _read(seen.target.sign * mean, seen.target)
    if seen is None or read is None or read[0] < MIN_CONTRAST_SD * read[1]:
        reason = "no target: no contrast of bars stands out of the noise; --bars and --frequency say what to look for"
        return Result(measurements=(make_refusal("mtf", "1", reason, flags=("no-target",), **common),))
    (value, sd), target = read, seen.target
    common["frequency_cy_per_px"] = target.frequency
    flags = ("model-misfit", *clipping_flags(used.data[:, target.box(mean.shape, 1.0)], context.full_scale_dn))
    one = measurement_from_sd(
        "mtf", "1", value, sd, flags=flags, notes=("Contrast reading, for comparison only.",),
        orientation_deg=float(np.rad2deg(target.angle_rad)) % 180.0, **common,
    )  # fmt: skip
    return Result(measurements=(one,))


def _read(mean: Array, target: BarTarget) -> tuple[float, float] | None:
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
