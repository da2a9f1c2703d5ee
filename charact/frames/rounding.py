"""Bias of mean and variance by rounding: noise smaller than the quantisation step, and a step of
several DN.
"""

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from charact.frames.thresholds import CLIPPING

Array = NDArray[np.float64]

# Variance of rounding, DN^2.
QUANTISATION_DN2 = 1.0 / 12.0
# Above this variance rounding adds 1/12 DN^2 within 0.001 DN^2.
EVEN_DN2 = 0.45
# Below this variance rounding is not independent noise: at the 0.24 DN^2 of EMVA 1288, 6.6, the
# noise is wrong by up to 7 %, here by 1.5 %.
QUANTISED_DN2 = 0.32
# Fewest differences of successive grey values whose common divisor is the step of the digitiser: of
# 8 arbitrary ones all are even with a chance of 2^-8, and within the noise of a finer digitiser
# most are 1.
FEWEST_DIFFERENCES = 8


def rounding_sd(variance_dn2: float) -> tuple[float, float]:
    """Return the standard deviations of the rounding bias of mean, DN, and variance, DN^2."""
    analogue = max(variance_dn2 - QUANTISATION_DN2, 0.0)
    fade = float(np.exp(-2.0 * np.pi**2 * analogue)) / np.sqrt(2.0)
    return fade / np.pi, (4.0 * analogue + 1.0 / np.pi**2) * fade


def variance_range_before_rounding(variance_dn2: float) -> tuple[float, float]:
    """Return the smallest and largest variance of normal noise that has this variance after
    rounding, DN^2.

    Rounding hides most noise about a grey value, and least midway between two, where zero noise has
    variance 1/4.
    """
    if variance_dn2 > EVEN_DN2:
        return variance_dn2 - QUANTISATION_DN2, variance_dn2 - QUANTISATION_DN2
    return _variance_before_rounding(variance_dn2, 0.5), _variance_before_rounding(
        variance_dn2, 0.0
    )


def _variance_before_rounding(variance_dn2: float, position_dn: float) -> float:
    """Return the variance of normal noise about a position between two grey values, given that
    after rounding.
    """
    from scipy.optimize import root_scalar
    from scipy.special import ndtr

    codes = np.arange(-8.0, 9.0)

    def excess(sd: float) -> float:
        chance = np.diff(ndtr((np.append(codes - 0.5, codes[-1] + 0.5) - position_dn) / sd))
        return float(chance @ codes**2 - (chance @ codes) ** 2) - variance_dn2

    return 0.0 if excess(1e-4) >= 0.0 else root_scalar(excess, bracket=(1e-4, 1.0)).root ** 2


def rounding_step(frames: Sequence[NDArray], least_differences: int = 1) -> float | None:
    """Return the largest number of which the differences of each frame's values are multiples, DN.

    0 of continuous values; None where fewer differences than asked for tell it. For values that are
    not whole the smallest spacing is the step if all others are multiples of it.
    """
    distinct = [np.unique(frame) for frame in frames]
    gaps = np.concatenate([np.diff(values.astype(np.float64)) for values in distinct] or [[]])
    if len(gaps) < least_differences:
        return None
    if all(np.all(values == np.rint(values)) for values in distinct):
        return float(np.gcd.reduce(gaps.astype(np.int64)))
    if len(gaps) > CLIPPING.distinct_fraction * sum(frame.size for frame in frames):
        return 0.0
    largest = max(float(np.abs(values).max()) for values in distinct)
    noise = 4.0 * float(np.finfo(np.float32).eps) * largest
    real = gaps[gaps > noise]
    if not len(real):
        return None
    step = float(np.mean(real[real < 1.5 * float(real.min())]))
    off = np.abs(real / step - np.rint(real / step))
    return step if np.all(off < CLIPPING.step_tolerance + noise / step) else 0.0


def rounding_shifts(level_dn: Array, variance_dn2: Array) -> Array:
    """Return the possible shifts of mean values by quantisation, shape (offset, pixel), DN; no rows
    if negligible.

    Parameters
    ----------
    level_dn
        Means without quantisation, shape (pixel,).
    variance_dn2
        Variances of single quantised values, shape (pixel,).

    Notes
    -----
    The mean of a value x with normal noise of standard deviation s is shifted by sum_k (-1)^k sin(2
    pi k x) exp(-2 (pi k s)^2) / (pi k), the Fourier series of the sawtooth (Widrow & Kollar,
    Quantization Noise, 2008). The fractional part of x is unknown: the black level is placed at
    several equally likely offsets between two steps. The noise is the smallest that is consistent
    with the variance.
    """
    min_noise = np.interp(variance_dn2, *_least_noise())
    noise = np.where(variance_dn2 > EVEN_DN2, variance_dn2 - QUANTISATION_DN2, min_noise)
    if np.exp(-2.0 * np.pi**2 * float(noise.min())) / np.pi < CLIPPING.min_rounding_shift_dn:
        return np.empty((0, level_dn.size))
    out = np.zeros((CLIPPING.rounding_offsets, level_dn.size))
    for term in range(1, CLIPPING.sawtooth_terms + 1):
        size = (-1.0) ** term * np.exp(-2.0 * (np.pi * term) ** 2 * noise) / (np.pi * term)
        turns = term * (
            level_dn + np.arange(CLIPPING.rounding_offsets)[:, None] / CLIPPING.rounding_offsets
        )
        out += size * np.sin(2.0 * np.pi * turns)
    return out


@cache
def _least_noise() -> tuple[Array, Array]:
    """Return variances after quantisation and the smallest variances before it, DN^2."""
    rounded = np.linspace(0.0, EVEN_DN2, 91)
    return rounded, np.array(
        [variance_range_before_rounding(float(variance))[0] for variance in rounded]
    )
