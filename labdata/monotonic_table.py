"""A calibration of two numbers that rise together: between its points one goes as a power of the other."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput


@dataclass(frozen=True, kw_only=True)
class RisingTable:
    """Pairs of two numbers, both rising from above zero.

    Parameters
    ----------
    of
        What it is a table of, such as "gain table".
    names
        Names of the two numbers, with their units.
    first, second
        The numbers.
    relative_sd
        Relative standard uncertainty of each second number, dimensionless.

    Raises
    ------
    BadInput
        If there are fewer than two whole rows, or they do not rise.

    Notes
    -----
    Between points the logarithm of one is linear in the logarithm of the other. How far the power changes from one
    interval to the next is the uncertainty of that, added to the calibration's own in quadrature.
    """

    of: str
    names: tuple[str, str]
    first: tuple[float, ...]
    second: tuple[float, ...]
    relative_sd: tuple[float, ...]

    def __post_init__(self) -> None:
        columns = (self.first, self.second, self.relative_sd)
        if len({len(column) for column in columns}) != 1 or len(self.first) < 2:
            raise BadInput(f"a {self.of} must have at least two whole rows, got {[len(each) for each in columns]}")
        if not all(np.isfinite(column).all() for column in columns) or not min(self.relative_sd) >= 0:
            raise BadInput(f"a {self.of} must hold finite numbers and uncertainties of at least 0, got others")
        for name, column in zip(self.names, (self.first, self.second), strict=True):
            if not (column[0] > 0 and all(after > before for before, after in pairwise(column))):
                raise BadInput(f"{name} of a {self.of} must rise from above 0, got {column}")

    def second_at(self, first: float, *, beyond: float = 0.0) -> tuple[float, float]:
        """Return the second number at a first one, and its relative standard uncertainty.

        Parameters
        ----------
        first
            The first number.
        beyond
            How far it may lie outside the table, for the resolution of what reads it.

        Raises
        ------
        BadInput
            If it lies further outside.
        """
        nearest = min(max(first, self.first[0]), self.first[-1])
        if not abs(first - nearest) <= beyond:
            self._check_within(self.names[0], first, self.first)
        place = np.log(nearest)
        second = float(np.exp(np.interp(place, np.log(self.first), np.log(self.second))))
        relative_sd = float(np.hypot(np.interp(place, np.log(self.first), self.relative_sd), self._bend(place)))
        return second * (first / nearest) ** float(self._powers()[self._interval(place)]), relative_sd

    def first_for(self, second: float) -> float:
        """Return the first number at which the second has a value; outside the table is BadInput."""
        self._check_within(self.names[1], second, self.second)
        return float(np.exp(np.interp(np.log(second), np.log(self.second), np.log(self.first))))

    def _bend(self, place: float) -> float:
        """What a bend of the curve between two points may make, relative: none at a point, most in the middle."""
        places, powers, interval = np.log(self.first), self._powers(), self._interval(place)
        others = (other for other in (interval - 1, interval + 1) if 0 <= other < len(powers))
        beside = [abs(powers[other] - powers[interval]) for other in others]
        width = places[interval + 1] - places[interval]
        share = (place - places[interval]) / width
        return max(beside, default=0.0) * width * share * (1.0 - share)

    def _powers(self) -> NDArray[np.float64]:
        """The power with which the second number goes, interval by interval."""
        return np.diff(np.log(self.second)) / np.diff(np.log(self.first))

    def _interval(self, place: float) -> int:
        return int(np.clip(np.searchsorted(np.log(self.first), place) - 1, 0, len(self.first) - 2))

    def _check_within(self, name: str, value: float, column: tuple[float, ...]) -> None:
        if not column[0] <= value <= column[-1]:
            raise BadInput(f"{name} must lie within the {self.of}, {column[0]:g} to {column[-1]:g}, got {value:g}")
