"""Contrast of the mean profile times pi/4, as read by eye."""

from collections.abc import Mapping
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
from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.measurement import Provenance, Result, make_refusal, measurement_from_sd

Array = NDArray[np.float64]

CONTRAST = "bars-contrast"


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
    where = region or (0, 0, *used.shape[1:])
    common: dict[str, Any] = {
        "method": CONTRAST,
        "region": where,
        "frequency_cy_per_px": frequency_cy_per_px,
        "provenance": Provenance(version=charact.__version__, seed=context.seed, settings={"bars": bars}),
    }
    mean = used.data.mean(axis=0, dtype=np.float64)
    seen = target_in(mean, bars=bars, frequency=frequency_cy_per_px, pitch_ratio=context.pitch_ratio)
    read = None if seen is None else _profile_contrast(seen.target.sign * mean, seen.target)
    if seen is None or read is None or read[0] < LIMITS.min_contrast_sd * read[1]:
        reason = "no target: no significant bar contrast; state --bars and --frequency"
        return Result(measurements=(make_refusal("mtf", "1", reason, flags=("no-target",), **common),))
    (value, sd), target = read, seen.target
    common["frequency_cy_per_px"] = target.frequency
    flags = ("model-misfit", *clipping_flags(used.data[:, target.box(mean.shape, 1.0)], context.full_scale_dn))
    one = measurement_from_sd(
        "mtf", "1", value, sd, flags=flags, notes=("Contrast reading, for comparison only.",),
        orientation_deg=float(np.rad2deg(target.angle_rad)) % 180.0, **common,
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


COLTMAN = "bars-coltman"


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
    common: dict[str, Any] = {
        "method": COLTMAN,
        "region": region or (0, 0, *used.shape[1:]),
        "frequency_cy_per_px": frequency_cy_per_px,
        "provenance": Provenance(version=charact.__version__, seed=context.seed, settings={"bars": bars}),
    }
    mean = used.data.mean(axis=0, dtype=np.float64)
    seen = target_in(mean, bars=bars, frequency=frequency_cy_per_px, pitch_ratio=context.pitch_ratio)
    read = None if seen is None else _modulation(seen.target.sign * mean, seen)
    if read is None or not read[0] > LIMITS.min_modulation_sd * read[1]:
        reason = "no target: no significant bar modulation; state --bars and --frequency"
        return Result(measurements=(make_refusal("mtf", "1", reason, flags=("no-target",), **common),))
    common["frequency_cy_per_px"] = read[2].frequency
    value, sd, target = read
    near = target.box((mean.shape[0], mean.shape[1]), 1.0)
    clipped = clipping_flags(used.data[:, near], context.full_scale_dn or used.full_scale_dn)
    one = measurement_from_sd(
        "mtf", "1", value, sd, flags=("model-misfit", *clipped),
        notes=("First term of Coltman's series, for comparison only.",),
        orientation_deg=float(np.rad2deg(target.angle_rad)) % 180.0, **common,
    )  # fmt: skip
    return Result(measurements=(one,))


def _modulation(mean: Array, seen: LocatedBars) -> tuple[float, float, BarTarget] | None:
    """Return modulation, standard uncertainty and target, for bars that are bright."""
    target, through = seen.target, seen.through
    bars, frequency = target.bars, target.frequency
    across, along = target.coordinates((mean.shape[0], mean.shape[1]))
    inner = np.ones(mean.shape, bool) if through else np.abs(along) < ACCURACY.inner_length * target.length_px
    reach = target.width_px / 2.0 + min(12.0, 1.5 / frequency)
    if not through:
        reach = target.width_px / 2.0 + fitting_margin(target, (mean.shape[0], mean.shape[1]), 1.5 / frequency)[0]
    ground = inner & (np.abs(across) > reach - 1.0)
    patch = inner & (np.abs(across) < reach)
    fundamental = np.sum((mean[patch] - mean[ground].mean()) * np.exp(-2j * np.pi * frequency * across[patch]))
    ahead = float(np.angle(fundamental * np.exp(1j * np.pi * (bars - 1)))) / (2.0 * np.pi)
    phase = (across * frequency + ahead + (bars - 1) / 2.0) % 1.0
    near = np.minimum(phase, 1.0 - phase)
    within = inner & (np.abs(across) < ((bars - 1) / 2.0 + ACCURACY.extremum_periods) / frequency)
    on, between = (
        mean[within & (near < ACCURACY.extremum_periods)],
        mean[within & (near > 0.5 - ACCURACY.extremum_periods)],
    )
    if min(on.size, between.size) < 3 or np.count_nonzero(ground) < 3:
        return None
    pedestal = float(mean[ground].mean())
    light = float((mean[patch] - pedestal).mean()) * 2.0 * reach
    step = light / (bars * 0.5 / frequency)
    if not step > 0:
        return None
    # The mean of a fundamental over pixels near its extrema is lower than the extremum by a known factor.
    value = np.pi / 4.0 * (on.mean() - between.mean()) / step / np.sinc(2.0 * ACCURACY.extremum_periods)
    error = np.pi / 4.0 * np.hypot(on.std() / np.sqrt(on.size), between.std() / np.sqrt(between.size)) / step
    return float(value), float(error), target


def series(modulations: Mapping[float, float]) -> dict[float, float]:
    """Return the MTF at the frequencies of bar groups from Coltman's series over their modulations.

    Parameters
    ----------
    modulations
        (max - min)/step of each group by its frequency, cycles per pixel; taken as zero above the highest.

    Returns
    -------
    dict
        MTF by frequency, dimensionless. A group is free of harmonics only if its third harmonic lies within the highest
        group, or has negligible modulation.

    Raises
    ------
    BadInput
        If there is no group, or a frequency is not positive.

    Notes
    -----
    M(f) = (pi/4) (C(f) + C(3f)/3 - C(5f)/5 + C(7f)/7 + C(11f)/11 - ...), exact for infinite square waves. C is
    interpolated linearly between groups.
    """
    if not modulations or min(modulations) <= 0:
        raise BadInput(f"the frequencies of bar groups must be positive, got {sorted(modulations)}")
    known = np.array(sorted(modulations))
    contrast = np.array([modulations[frequency] for frequency in known])
    orders = np.arange(1, ACCURACY.series_order + 1, 2)
    weight = np.array([_sign(int(order)) / order for order in orders])
    return {
        float(frequency): float(np.pi / 4.0 * weight @ np.interp(orders * frequency, known, contrast, right=0.0))
        for frequency in known
    }


def _sign(order: int) -> int:
    """Return the sign of a term, 0 where the order has a square factor.

    The square wave's harmonics carry (-1)^((k-1)/2), which is multiplicative, so that the Moebius function inverts
    them.
    """
    sign = (-1) ** ((order - 1) // 2)
    for prime in range(3, order + 1, 2):
        if order % prime == 0:
            order //= prime
            sign = -sign
            if order % prime == 0:
                return 0
    return sign
