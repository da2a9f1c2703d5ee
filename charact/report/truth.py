"""Truth beside measured: on a bench whose truth is known, how many standard errors each number is off."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from charact.report.number_format import plus_minus, quantity_title, round_to_spread, spread_of
from labdata.measurement import Measurement, Result

# Half the width of a 95 % interval in standard errors.
HALF_95 = 1.959964
# A true number; or a function of frequency (cycles per pixel) and direction (degrees), for the quantity "mtf".
Truth = Mapping[str, float | Callable[..., Any]]


@dataclass(frozen=True, kw_only=True)
class TruthComparison:
    """One measured number beside its truth.

    Parameters
    ----------
    measurement
        The measurement, one that carries a number.
    truth
        The true value, in the unit of the measurement.
    z
        (value - truth) over the standard error, which is the arm of the 95 % interval on the truth's side over 1.96;
        infinite where that arm is empty.
    """

    measurement: Measurement
    truth: float
    z: float

    @property
    def title(self) -> str:
        """The quantity in words, and where it was measured."""
        return quantity_title(self.measurement)

    @property
    def truth_text(self) -> str:
        """The truth with the digits of the measurement."""
        return round_to_spread(self.truth, spread_of(self.measurement))

    @property
    def value_text(self) -> str:
        """The value with the arms of its 95 % interval."""
        return plus_minus(self.measurement)


def compare_with_truth(result: Result, truth: Truth) -> tuple[TruthComparison, ...]:
    """Return every measured number whose truth is known, beside it.

    Parameters
    ----------
    result
        What was measured.
    truth
        True values by quantity, in the unit of the quantity's measurements. A function is called with the
        measurement's frequency (cycles per pixel) and direction (degrees), for the MTF at one frequency.
    """
    found = [(m, truth[m.quantity]) for m in result.measurements if m.value is not None and m.quantity in truth]
    return tuple(_comparison(m, _at(known, m)) for m, known in found)


def _at(known: float | Callable[..., Any], measurement: Measurement) -> float:
    if callable(known):
        return float(known(measurement.frequency_cy_per_px, measurement.orientation_deg))
    return float(known)


def _comparison(measurement: Measurement, truth: float) -> TruthComparison:
    value, interval = float(measurement.value or 0.0), measurement.interval95
    low, high = interval if interval is not None else (value, value)
    sd = ((high - value) if truth > value else (value - low)) / HALF_95
    off = value - truth
    z = off / sd if sd > 0 else float(np.copysign(np.inf, off)) if off else 0.0
    return TruthComparison(measurement=measurement, truth=truth, z=z)
