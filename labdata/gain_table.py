"""The gain of a tube by calibration: luminous gain against the voltage across its microchannel plate, and back."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput


@dataclass(frozen=True, kw_only=True)
class GainTable:
    """A calibration of one tube.

    Parameters
    ----------
    source
        Who measured it, how and when, in words.
    tube
        Name of the tube; None: not said.
    mcp_v
        Voltages across the plate, V, rising.
    luminous_gain
        Luminous gain at each, lm/lm or whatever the calibration counts, rising.
    relative_sd
        Relative standard uncertainty of each gain, dimensionless.

    Raises
    ------
    BadInput
        If the table is no monotone calibration of at least two points, or does not say where it comes from.

    Notes
    -----
    Between points the logarithm of the gain is linear in the logarithm of the voltage: the gain of a plate goes as a
    power of its voltage (J. L. Wiza, Nucl. Instrum. Methods 162 (1979) 587). How far the power changes from one
    interval to the next is the uncertainty of that, added to the calibration's own in quadrature.
    """

    source: str
    tube: str | None = None
    mcp_v: tuple[float, ...]
    luminous_gain: tuple[float, ...]
    relative_sd: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.source.strip():
            raise BadInput("a gain table must say its source, got none")
        columns = (self.mcp_v, self.luminous_gain, self.relative_sd)
        if len({len(column) for column in columns}) != 1 or len(self.mcp_v) < 2:
            raise BadInput(f"a gain table must have at least two whole rows, got {[len(each) for each in columns]}")
        if not all(np.isfinite(column).all() for column in columns) or not min(self.relative_sd) >= 0:
            raise BadInput("a gain table must hold finite numbers and uncertainties of at least 0, got others")
        for name, column in (("mcp_v", self.mcp_v), ("luminous_gain", self.luminous_gain)):
            if not (column[0] > 0 and all(after > before for before, after in pairwise(column))):
                raise BadInput(f"{name} of a gain table must rise from above 0, got {column}")

    @property
    def provenance(self) -> str:
        """Where a luminous gain by this table comes from, in a sentence."""
        of = f" of tube {self.tube}" if self.tube else ""
        span = f"{self.mcp_v[0]:g} to {self.mcp_v[-1]:g} V"
        return f"Luminous gain by calibration{of}: {self.source}; {len(self.mcp_v)} points, {span}."

    def gain_at(self, mcp_v: float, *, beyond_v: float = 0.0) -> tuple[float, float]:
        """Return the luminous gain at a voltage, V, and its relative standard uncertainty.

        Parameters
        ----------
        mcp_v
            Voltage across the plate, V.
        beyond_v
            How far it may lie outside the table, V: a supply set to the table's end reads back a little more or less.

        Raises
        ------
        BadInput
            If the voltage lies further outside.
        """
        nearest_v = min(max(mcp_v, self.mcp_v[0]), self.mcp_v[-1])
        if not abs(mcp_v - nearest_v) <= beyond_v:
            _check_within("mcp_v", mcp_v, self.mcp_v)
        place = np.log(nearest_v)
        gain = float(np.exp(np.interp(place, np.log(self.mcp_v), np.log(self.luminous_gain))))
        relative_sd = float(np.hypot(np.interp(place, np.log(self.mcp_v), self.relative_sd), self._bend(place)))
        return gain * (mcp_v / nearest_v) ** self._power(place), relative_sd

    def volts_for(self, luminous_gain: float) -> float:
        """Return the voltage, V, at which the tube has a luminous gain; outside the table is BadInput."""
        _check_within("luminous_gain", luminous_gain, self.luminous_gain)
        return float(np.exp(np.interp(np.log(luminous_gain), np.log(self.luminous_gain), np.log(self.mcp_v))))

    def _bend(self, place: float) -> float:
        """What a bend of the curve between two points may make, relative: none at a point, most in the middle."""
        volts, powers, interval = np.log(self.mcp_v), self._powers(), self._interval(place)
        others = (other for other in (interval - 1, interval + 1) if 0 <= other < len(powers))
        beside = [abs(powers[other] - powers[interval]) for other in others]
        width = volts[interval + 1] - volts[interval]
        share = (place - volts[interval]) / width
        return max(beside, default=0.0) * width * share * (1.0 - share)

    def _power(self, place: float) -> float:
        """Power of the voltage with which the gain goes, at a logarithm of the voltage."""
        return float(self._powers()[self._interval(place)])

    def _powers(self) -> NDArray[np.float64]:
        """That power, interval by interval."""
        return np.diff(np.log(self.luminous_gain)) / np.diff(np.log(self.mcp_v))

    def _interval(self, place: float) -> int:
        return int(np.clip(np.searchsorted(np.log(self.mcp_v), place) - 1, 0, len(self.mcp_v) - 2))


def _check_within(name: str, value: float, column: tuple[float, ...]) -> None:
    if not column[0] <= value <= column[-1]:
        raise BadInput(f"{name} must lie within the gain table, {column[0]:g} to {column[-1]:g}, got {value:g}")
