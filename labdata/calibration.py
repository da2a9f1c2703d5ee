"""Calibrations of a bench: luminous gain against voltage, illuminance against lamp current."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from labdata.conditions import Conditions
from labdata.errors import BadInput, check


@dataclass(frozen=True, kw_only=True)
class RisingTable:
    """Pairs of two positive numbers that increase together; anything else, or fewer than two pairs,
    is BadInput.

    Interpolation is linear in the logarithms. The change of the power from one interval to the next
    gives the uncertainty of the interpolation, which is added to that of the calibration in
    quadrature.
    """

    of: str  #: Name of the table in messages, such as "gain table"
    names: tuple[str, str]  #: Names of the two columns, with their units
    first: tuple[float, ...]  #: The columns
    second: tuple[float, ...]  #: The columns
    relative_sd: tuple[
        float, ...
    ]  #: Relative standard uncertainty of the second column, dimensionless

    def __post_init__(self) -> None:
        columns = (self.first, self.second, self.relative_sd)
        if len({len(column) for column in columns}) != 1 or len(self.first) < 2:
            raise BadInput(
                f"a {self.of} must have at least two whole rows, got "
                f"{[len(each) for each in columns]}"
            )
        if (
            not all(np.isfinite(column).all() for column in columns)
            or not min(self.relative_sd) >= 0
        ):
            raise BadInput(
                f"a {self.of} must hold finite numbers and uncertainties of at least 0, got others"
            )
        for name, column in zip(self.names, (self.first, self.second), strict=True):
            if not (column[0] > 0 and all(after > before for before, after in pairwise(column))):
                raise BadInput(f"{name} of a {self.of} must rise from above 0, got {column}")

    def second_at(self, first: float, *, beyond: float = 0.0) -> tuple[float, float]:
        """Return the second column at a value of the first, and its relative standard uncertainty.

        A value outside the table by more than `beyond`, the resolution of a read-back, is BadInput.
        """
        nearest = min(max(first, self.first[0]), self.first[-1])
        if not abs(first - nearest) <= beyond:
            self._check_within(self.names[0], first, self.first)
        log_first = np.log(nearest)
        second = float(np.exp(np.interp(log_first, np.log(self.first), np.log(self.second))))
        relative_sd = float(
            np.hypot(
                np.interp(log_first, np.log(self.first), self.relative_sd), self._bend(log_first)
            )
        )
        return second * (first / nearest) ** float(
            self._powers()[self._interval(log_first)]
        ), relative_sd

    def first_for(self, second: float) -> float:
        """Return the first column at a value of the second; a value outside the table is
        BadInput.
        """
        self._check_within(self.names[1], second, self.second)
        return float(np.exp(np.interp(np.log(second), np.log(self.second), np.log(self.first))))

    def _bend(self, log_first: float) -> float:
        """Return the relative interpolation error: zero at the points, largest in the centre of an
        interval.
        """
        log_firsts, powers, interval = np.log(self.first), self._powers(), self._interval(log_first)
        neighbours = (other for other in (interval - 1, interval + 1) if 0 <= other < len(powers))
        changes = [abs(powers[other] - powers[interval]) for other in neighbours]
        width = log_firsts[interval + 1] - log_firsts[interval]
        fraction = (log_first - log_firsts[interval]) / width
        return max(changes, default=0.0) * width * fraction * (1.0 - fraction)

    def _powers(self) -> NDArray[np.float64]:
        """Return the exponent of the power law of each interval."""
        return np.diff(np.log(self.second)) / np.diff(np.log(self.first))

    def _interval(self, log_first: float) -> int:
        return int(
            np.clip(np.searchsorted(np.log(self.first), log_first) - 1, 0, len(self.first) - 2)
        )

    def _check_within(self, name: str, value: float, column: tuple[float, ...]) -> None:
        if not column[0] <= value <= column[-1]:
            raise BadInput(
                f"{name} must lie within the {self.of}, {column[0]:g} to {column[-1]:g}, got "
                f"{value:g}"
            )


SETTABLE_A = 1e-3  # Current step that every LED driver can set, A


@dataclass(frozen=True, kw_only=True)
class LampSetting:
    """Lamp and filter setting of one illuminance."""

    current_a: float  #: Current through the lamp, A
    position: int  #: Position of the filter wheel, counted from 1
    read: Conditions  #: Resulting light: illuminance with uncertainty, filter and current


@dataclass(frozen=True, kw_only=True)
class LampCalibration:
    """Calibration of the lamp and its filters, E = E0(I) 10^-D; a table that does not rise is
    BadInput.
    """

    source: str  #: Origin of the calibration: who measured it, how and when
    current_a: tuple[float, ...]  #: Currents through the lamp, A, increasing
    illuminance_lux: tuple[
        float, ...
    ]  #: Illuminance on the photocathode at each, without filter, lux, increasing
    relative_sd: tuple[
        float, ...
    ]  #: Relative standard uncertainty of each illuminance, dimensionless
    #: Optical densities of the filters by wheel position; a bench without a wheel has the single
    #: density of its fixed filter
    filter_density: tuple[float, ...] = (0.0,)
    filter_density_sd: float = 0.0  #: Standard uncertainty of a density that is not 0

    def __post_init__(self) -> None:
        if not self.source.strip():
            raise BadInput("the calibration of a lamp must say its source, got none")
        if not self.filter_density or not all(
            0.0 <= density < math.inf for density in self.filter_density
        ):
            raise BadInput(
                f"filter densities must be numbers of at least 0, got {self.filter_density}"
            )
        if len(set(self.filter_density)) < len(self.filter_density):
            raise BadInput(
                f"every filter of a wheel must have a density of its own, got {self.filter_density}"
            )
        check(self, not_negative="filter_density_sd")
        self._table()

    @property
    def provenance(self) -> str:
        """One sentence on the origin of the illuminances of this calibration."""
        span = f"{self.current_a[0]:g} to {self.current_a[-1]:g} A"
        return (
            f"Illuminance by calibration of the lamp: {self.source}; {len(self.current_a)} "
            f"points, {span}."
        )

    @property
    def limit_a(self) -> float:
        """Current that the lamp's driver must itself refuse to exceed, A."""
        # Margin of the driver's own limit above the end of the calibration, A: a driver at its
        # limit reports an error
        return math.ceil(round(self.current_a[-1] / SETTABLE_A, 6)) * SETTABLE_A + 1e-3

    def setting(self, illuminance_lux: float, filter_density: float | None = None) -> LampSetting:
        """Return how to make an illuminance, lux; one that the lamp cannot reach is BadInput.

        Without `filter_density` the densest filter through which the lamp is bright enough; its
        current is set most finely.
        """
        for position in self._positions(illuminance_lux, filter_density):
            bare_lux = illuminance_lux * 10.0 ** self.filter_density[position - 1]
            current_a = round(self._table().first_for(bare_lux) / SETTABLE_A) * SETTABLE_A
            if self.current_a[0] <= current_a <= self.current_a[-1]:
                return LampSetting(
                    current_a=current_a, position=position, read=self.light_at(current_a, position)
                )
        densities = self.filter_density if filter_density is None else (filter_density,)
        dimmest = self.illuminance_lux[0] * 10.0 ** -max(densities)
        brightest = self.illuminance_lux[-1] * 10.0 ** -min(densities)
        raise BadInput(
            f"illuminance_lux must lie within the range of the lamp, {dimmest:.3g} to "
            f"{brightest:.3g}, got {illuminance_lux:g}"
        )

    def light_at(
        self, current_a: float, position: int, *, beyond_a: float = SETTABLE_A
    ) -> Conditions:
        """Return the light at a lamp current, A, behind a filter; BadInput beyond `beyond_a`
        outside the table.
        """
        density = self.filter_density[position - 1]
        bare_lux, relative_sd = self._table().second_at(current_a, beyond=beyond_a)
        filter_sd = math.log(10.0) * self.filter_density_sd if density else 0.0
        return Conditions(
            illuminance_lux=bare_lux * 10.0**-density,
            illuminance_relative_sd=math.hypot(relative_sd, filter_sd),
            filter_density=density,
            lamp_a=current_a,
        )

    def position_of(self, filter_density: float) -> int:
        """Return the position of a filter, counted from 1; an unknown density is BadInput."""
        for position, density in enumerate(self.filter_density, 1):
            if abs(density - filter_density) < 1e-3:
                return position
        densities = ", ".join(f"{density:g}" for density in self.filter_density)
        raise BadInput(
            f"filter_density must be one of the wheel's {densities}, got {filter_density:g}"
        )

    def _positions(self, illuminance_lux: float, filter_density: float | None) -> list[int]:
        """Return the positions that allow an illuminance, the densest filter first."""
        if filter_density is not None:
            fitting = [self.position_of(filter_density)]
        else:
            densest_first = sorted(
                range(len(self.filter_density)), key=lambda index: -self.filter_density[index]
            )
            fitting = [index + 1 for index in densest_first]
        low, high = self.illuminance_lux[0], self.illuminance_lux[-1]
        return [
            position
            for position in fitting
            if low <= illuminance_lux * 10.0 ** self.filter_density[position - 1] <= high
        ]

    def _table(self) -> RisingTable:
        return RisingTable(
            of="calibration of the lamp",
            names=("current_a", "illuminance_lux"),
            first=self.current_a,
            second=self.illuminance_lux,
            relative_sd=self.relative_sd,
        )


@dataclass(frozen=True, kw_only=True)
class GainTable:
    """A calibration of one tube: at least two rising points, and a source; anything else is
    BadInput.

    MCP gain is a power of the voltage (J. L. Wiza, Nucl. Instrum. Methods 162 (1979) 587); for the
    interpolation see `RisingTable`.
    """

    source: str  #: Origin of the calibration: who measured it, how and when
    tube: str | None = None  #: Name of the tube; None: not stated
    mcp_v: tuple[float, ...]  #: Voltages across the MCP, V, increasing
    luminous_gain: tuple[
        float, ...
    ]  #: Luminous gain at each, lm/lm or in the unit of the calibration, increasing
    relative_sd: tuple[float, ...]  #: Relative standard uncertainty of each gain, dimensionless

    def __post_init__(self) -> None:
        if not self.source.strip():
            raise BadInput("a gain table must say its source, got none")
        self._table()

    @property
    def provenance(self) -> str:
        """One sentence on the origin of the gains of this table."""
        of = f" of tube {self.tube}" if self.tube else ""
        span = f"{self.mcp_v[0]:g} to {self.mcp_v[-1]:g} V"
        return f"Luminous gain by calibration{of}: {self.source}; {len(self.mcp_v)} points, {span}."

    def gain_at(self, mcp_v: float, *, beyond_v: float = 0.0) -> tuple[float, float]:
        """Return the luminous gain at a voltage, V, and its relative standard uncertainty.

        A voltage outside the table by more than `beyond_v`, for the read-back of a supply set to
        its end, is BadInput.
        """
        return self._table().second_at(mcp_v, beyond=beyond_v)

    def volts_for(self, luminous_gain: float) -> float:
        """Return the voltage of a luminous gain, V; a gain outside the table is BadInput."""
        return self._table().first_for(luminous_gain)

    def _table(self) -> RisingTable:
        return RisingTable(
            of="gain table",
            names=("mcp_v", "luminous_gain"),
            first=self.mcp_v,
            second=self.luminous_gain,
            relative_sd=self.relative_sd,
        )
