"""Contrast methods for bar targets: Coltman's first term, contrast of the mean profile, and the series."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

import charact
from charact.method import Context, register
from charact.mtf.bars.sight import LocatedBars, target_in
from charact.mtf.bars.target import BarTarget
from charact.mtf.bars.window import fitting_margin
from charact.mtf.quantisation_checks import clipping_flags
from charact.mtf.region import Region
from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.measurement import Provenance, Result, make_refusal, measurement_from_sd

Array = NDArray[np.float64]

METHOD = "bars-coltman"
# Terms of the series go up to this order.
HIGHEST_ORDER = 201
MIN_MODULATION_SD = 6.0
# Pixels this near the middle of a bar or gap, periods, and within this share of the bars' length.
NEAR, INNER = 0.06, 0.3


@register(
    "bars",
    METHOD,
    quantities=("mtf",),
    scope=(
        "For comparison, always suspect: first term of Coltman's series, (pi/4)(max - min)/step of the inner bars. Up "
        "to a fifth low below a third of the cut-off, where harmonics enter; the step of a lone patch is low by its "
        "tails, and by several percent for tube tails (n near 1.1); high by its own noise where that nears the "
        "modulation; phase-dependent untilted above half the sampling limit."
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
        "method": METHOD,
        "region": region or (0, 0, *used.shape[1:]),
        "frequency_cy_per_px": frequency_cy_per_px,
        "provenance": Provenance(version=charact.__version__, seed=context.seed, settings={"bars": bars}),
    }
    mean = used.data.mean(axis=0, dtype=np.float64)
    seen = target_in(mean, bars=bars, frequency=frequency_cy_per_px, pitch_ratio=context.pitch_ratio)
    read = None if seen is None else _read(seen.target.sign * mean, seen)
    if read is None or not read[0] > MIN_MODULATION_SD * read[1]:
        reason = "no target: no modulation by bars stands out of the noise; --bars and --frequency say what to look for"
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


def _read(mean: Array, seen: LocatedBars) -> tuple[float, float, BarTarget] | None:
    """Return modulation, standard uncertainty and target, for bars that are bright."""
    target, through = seen.target, seen.through
    bars, frequency = target.bars, target.frequency
    across, along = target.coordinates((mean.shape[0], mean.shape[1]))
    inner = np.ones(mean.shape, bool) if through else np.abs(along) < INNER * target.length_px
    reach = target.width_px / 2.0 + min(12.0, 1.5 / frequency)
    if not through:
        reach = target.width_px / 2.0 + fitting_margin(target, (mean.shape[0], mean.shape[1]), 1.5 / frequency)[0]
    ground = inner & (np.abs(across) > reach - 1.0)
    patch = inner & (np.abs(across) < reach)
    fundamental = np.sum((mean[patch] - mean[ground].mean()) * np.exp(-2j * np.pi * frequency * across[patch]))
    ahead = float(np.angle(fundamental * np.exp(1j * np.pi * (bars - 1)))) / (2.0 * np.pi)
    phase = (across * frequency + ahead + (bars - 1) / 2.0) % 1.0
    near = np.minimum(phase, 1.0 - phase)
    within = inner & (np.abs(across) < ((bars - 1) / 2.0 + NEAR) / frequency)
    on, between = mean[within & (near < NEAR)], mean[within & (near > 0.5 - NEAR)]
    if min(on.size, between.size) < 3 or np.count_nonzero(ground) < 3:
        return None
    pedestal = float(mean[ground].mean())
    light = float((mean[patch] - pedestal).mean()) * 2.0 * reach
    step = light / (bars * 0.5 / frequency)
    if not step > 0:
        return None
    # The mean of a fundamental over pixels near its extrema is lower than the extremum by a known factor.
    value = np.pi / 4.0 * (on.mean() - between.mean()) / step / np.sinc(2.0 * NEAR)
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
    orders = np.arange(1, HIGHEST_ORDER + 1, 2)
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
