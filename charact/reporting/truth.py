"""Comparison of measurements with a known truth: z-scores."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from labdata.measurement import Measurement, Result
from labdata.number_format import plus_minus, quantity_title, round_to_spread, spread_of

# True values, or functions of frequency (cy/px) and direction (degrees).
Truth = Mapping[str, float | Callable[..., Any]]


@dataclass(frozen=True, kw_only=True)
class TruthComparison:
    """A measurement compared with its true value, in its unit.

    `z`: (value - truth) over the standard uncertainty, which is the half of the 95 % interval on
    the truth's side over 1.96; infinite for an empty interval.
    """

    measurement: Measurement
    truth: float
    z: float

    @property
    def title(self) -> str:
        """Title of the quantity."""
        return quantity_title(self.measurement)

    @property
    def truth_text(self) -> str:
        """The true value with the digits of the measurement."""
        return round_to_spread(self.truth, spread_of(self.measurement))

    @property
    def value_text(self) -> str:
        """The value ± its 95 % interval."""
        return plus_minus(self.measurement)


def compare_with_truth(result: Result, truth: Truth) -> tuple[TruthComparison, ...]:
    """Return the comparison of every measured value with a known truth.

    Parameters
    ----------
    result
        The measurements.
    truth
        True values by quantity, in the unit of the measurements. A function is called with the
        measurement's frequency (cy/px) and direction (degrees).
    """
    known_values = [
        (m, truth[m.quantity])
        for m in result.measurements
        if m.value is not None and m.quantity in truth
    ]
    return tuple(_comparison(m, _at(known, m)) for m, known in known_values)


def _at(known: float | Callable[..., Any], measurement: Measurement) -> float:
    if callable(known):
        return float(known(measurement.frequency_cy_per_px, measurement.orientation_deg))
    return float(known)


def _comparison(measurement: Measurement, truth: float) -> TruthComparison:
    value, interval = float(measurement.value or 0.0), measurement.interval95
    low, high = interval if interval is not None else (value, value)
    # Half a 95 % interval in standard uncertainties.
    sd = ((high - value) if truth > value else (value - low)) / 1.959964
    off = value - truth
    z = off / sd if sd > 0 else float(np.copysign(np.inf, off)) if off else 0.0
    return TruthComparison(measurement=measurement, truth=truth, z=z)
