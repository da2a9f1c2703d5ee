"""Intervals widened by the uncertainty of the described video filter."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from labdata.measurement import Measurement

Array = NDArray[np.float64]

LEVELS = {"mtf50": 0.5, "mtf10": 0.1}


def flag_filter_uncertainty(
    found: Measurement, doubt: Callable[[Array], Array] | None, crossing: Callable[[float], float]
) -> Measurement:
    """Return a measurement whose intervals include the systematic uncertainty of the known transfer.

    Parameters
    ----------
    found
        An MTF at a frequency, MTF50 or MTF10; other quantities are returned unchanged.
    doubt
        Relative standard uncertainty of the known transfer at frequencies, cy/px, shape (f,) -> (f,); None: exact.
    crossing
        From a level to the frequency at which the measured MTF falls to it, cy/px.
    """
    if doubt is None or found.value is None or found.interval68 is None or found.quantity not in (*LEVELS, "mtf"):
        return found
    frequency = found.value if found.frequency_cy_per_px is None else found.frequency_cy_per_px
    share = float(doubt(np.array([frequency]))[0])
    if share == 0.0:
        return found
    level = LEVELS.get(found.quantity)
    moved = share * found.value if level is None else crossing(level * np.exp(-share)) - found.value
    return found.with_(
        interval68=_widen(found.value, found.interval68, 0.994458 * moved),
        interval95=_widen(found.value, found.interval95, 1.959964 * moved),
    )


def _widen(value: float, interval: tuple[float, float] | None, by: float) -> tuple[float, float] | None:
    if interval is None:
        return None
    low, high = interval
    return max(value - float(np.hypot(value - low, by)), 0.0), value + float(np.hypot(high - value, by))
