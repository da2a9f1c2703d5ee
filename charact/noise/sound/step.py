"""Quantisation step of values, which may be integers, fractions of one, or volts."""

import numpy as np
from numpy.typing import NDArray

from charact.noise.thresholds import SURVEY


def step_of(values: NDArray[np.float64]) -> float | None:
    """Return the greatest common difference of values; 0 for continuous ones, None if all are equal.

    Notes
    -----
    For non-integers the smallest spacing is the step if all others are multiples of it.
    """
    distinct = np.unique(values)
    if len(distinct) < 2:
        return None
    gaps = np.diff(distinct)
    if np.all(distinct == np.rint(distinct)):
        return float(np.gcd.reduce(gaps.astype(np.int64)))
    if len(distinct) > SURVEY.distinct_fraction * values.size:
        return 0.0
    noise = 4.0 * float(np.finfo(np.float32).eps) * float(np.abs(distinct).max())
    real = gaps[gaps > noise]
    if not len(real):
        return None
    least = float(real.min())
    step = float(np.mean(real[real < 1.5 * least]))
    whole = gaps / step
    return step if np.all(np.abs(whole - np.rint(whole)) < SURVEY.step_tolerance + noise / step) else 0.0


def common_step(steps: list[float | None]) -> float | None:
    """Return the common step of all stacks: the smallest that divides all; 0 if one is continuous; None if unknown."""
    known = [step for step in steps if step is not None]
    if not known:
        return None
    if min(known) == 0.0:
        return 0.0
    if all(step.is_integer() for step in known):
        return float(np.gcd.reduce(np.array(known, np.int64)))
    return min(known)
