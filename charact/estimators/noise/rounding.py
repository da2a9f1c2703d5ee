"""Bias of mean and variance by rounding: noise smaller than the quantisation step, and a step of
several DN.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.findings import COARSE
from charact.estimators.noise.thresholds import SWEEP
from labdata.flags import Finding
from labdata.lazy_stack import open_lazy_stack
from labdata.session import Session

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


def flags_of_rounding(variance_dn2: float) -> tuple[str, ...]:
    """Return the flag of noise smaller than the quantisation step."""
    return ("quantised",) if variance_dn2 < QUANTISED_DN2 else ()


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


def step_of_codes(frames: Sequence[NDArray]) -> int:
    """Return the largest number of which the differences of each frame's grey values are multiples,
    DN.

    1 where there are too few values, or other than whole ones.
    """
    if any(frame.dtype.kind not in "iu" for frame in frames):
        return 1
    gaps = np.concatenate(
        [np.diff(np.unique(frame).astype(np.int64)) for frame in frames] or [np.zeros(0, np.int64)]
    )
    return int(np.gcd.reduce(gaps)) if gaps.size >= FEWEST_DIFFERENCES else 1


def step_finding(session: Session) -> Finding | None:
    """Return the finding of darks and flats whose grey values are multiples of a step that adds to
    their noise.

    A digitiser of fewer bits than its frames rounds to steps of s DN, whose variance is s^2/12
    where 1/12 is counted. The finding is raised where the difference exceeds
    `SWEEP.max_quantisation` of the least variance.
    """
    stacks = [open_lazy_stack(entry) for entry in session.of_kind("dark", "flat")]
    step = step_of_codes([stack.frames(0, 1)[0] for stack in stacks])
    pairs = (
        [stack.frames(0, 2).astype(float) for stack in stacks if len(stack) > 1] if step > 1 else []
    )
    if not pairs:
        return None
    variance_dn2 = min(float(np.var(pair[1] - pair[0])) / 2.0 for pair in pairs)
    added = (step**2 - 1.0) * QUANTISATION_DN2
    if added <= SWEEP.max_quantisation * variance_dn2:
        return None
    return COARSE.finding(
        "quantised",
        f"all grey values are multiples of {step} DN: rounding adds {added:.3g} DN2 to a least "
        f"variance of {variance_dn2:.3g} DN2, and levels of a digitiser that cuts off are "
        f"{(step - 1.0) / 2.0:g} DN low",
    )
