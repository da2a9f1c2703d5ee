"""The step of the digitiser, from the values in the data: frames may be whole numbers, shares of one, or volts."""

import numpy as np
from numpy.typing import NDArray

# Share of distinct values beyond which values are taken for continuous.
DISTINCT = 0.5
# Departure from whole steps that the rounding of single precision may leave, steps.
WHOLE = 0.02


def step_of(values: NDArray[np.float64]) -> float | None:
    """Return the spacing of values, their greatest common difference; 0 for continuous ones, None where all are equal.

    Notes
    -----
    Of numbers that are no whole ones the smallest spacing is the step if all others are multiples of it.
    """
    distinct = np.unique(values)
    if len(distinct) < 2:
        return None
    gaps = np.diff(distinct)
    if np.all(distinct == np.rint(distinct)):
        return float(np.gcd.reduce(gaps.astype(np.int64)))
    if len(distinct) > DISTINCT * values.size:
        return 0.0
    noise = 4.0 * float(np.finfo(np.float32).eps) * float(np.abs(distinct).max())
    real = gaps[gaps > noise]
    if not len(real):
        return None
    least = float(real.min())
    step = float(np.mean(real[real < 1.5 * least]))
    whole = gaps / step
    return step if np.all(np.abs(whole - np.rint(whole)) < WHOLE + noise / step) else 0.0


def common_step(steps: list[float | None]) -> float | None:
    """Return the step of all stacks: the smallest that divides all; 0 if one is continuous; None if none shows it."""
    known = [step for step in steps if step is not None]
    if not known:
        return None
    if min(known) == 0.0:
        return 0.0
    if all(step.is_integer() for step in known):
        return float(np.gcd.reduce(np.array(known, np.int64)))
    return min(known)
