"""The light of a bench by calibration: the illuminance that a lamp's current makes behind each filter of its wheel."""

import math
from dataclasses import dataclass

from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.monotonic_table import RisingTable

SETTABLE_A = 1e-3
"""Currents are rounded to what every driver of a diode can set, A."""

SPARE_A = 1e-3
"""The driver's own limit lies so much above the calibration's end, A: at its limit a driver complains."""

SAME_DENSITY = 1e-3


@dataclass(frozen=True, kw_only=True)
class LampSetting:
    """How a lamp makes one illuminance.

    Parameters
    ----------
    current_a
        Current through the lamp, A.
    position
        Position of the filter wheel, counted from 1.
    read
        The light that this makes: illuminance, its uncertainty, filter and current.
    """

    current_a: float
    position: int
    read: Conditions


@dataclass(frozen=True, kw_only=True)
class LampCalibration:
    """A calibration of the lamp at the bench.

    Parameters
    ----------
    source
        Who measured it, how and when, in words.
    current_a
        Currents through the lamp, A, rising.
    illuminance_lux
        Illuminance on the photocathode at each, without a filter, lux, rising.
    relative_sd
        Relative standard uncertainty of each illuminance, dimensionless.
    filter_density
        Optical densities of the filters in the wheel's positions, the first one's first; a bench without a wheel
        has the one density of whatever stands there for good.
    filter_density_sd
        Standard uncertainty of a density that is not 0.

    Raises
    ------
    BadInput
        If the table is no monotone calibration, or a density is negative or given twice.

    Notes
    -----
    E = E0(I) 10^-D.
    """

    source: str
    current_a: tuple[float, ...]
    illuminance_lux: tuple[float, ...]
    relative_sd: tuple[float, ...]
    filter_density: tuple[float, ...] = (0.0,)
    filter_density_sd: float = 0.0

    def __post_init__(self) -> None:
        if not self.source.strip():
            raise BadInput("the calibration of a lamp must say its source, got none")
        if not self.filter_density or not all(0.0 <= one < math.inf for one in self.filter_density):
            raise BadInput(f"filter densities must be numbers of at least 0, got {self.filter_density}")
        if len(set(self.filter_density)) < len(self.filter_density):
            raise BadInput(f"every filter of a wheel must have a density of its own, got {self.filter_density}")
        if not 0.0 <= self.filter_density_sd < math.inf:
            raise BadInput(f"filter_density_sd must be at least 0, got {self.filter_density_sd:g}")
        self._table()

    @property
    def provenance(self) -> str:
        """Where an illuminance by this calibration comes from, in a sentence."""
        span = f"{self.current_a[0]:g} to {self.current_a[-1]:g} A"
        return f"Illuminance by calibration of the lamp: {self.source}; {len(self.current_a)} points, {span}."

    @property
    def limit_a(self) -> float:
        """Current that the lamp's driver must itself refuse to exceed, A."""
        return math.ceil(round(self.current_a[-1] / SETTABLE_A, 6)) * SETTABLE_A + SPARE_A

    def setting(self, illuminance_lux: float, filter_density: float | None = None) -> LampSetting:
        """Return how to make an illuminance.

        Parameters
        ----------
        illuminance_lux
            On the photocathode, lux.
        filter_density
            The filter; None: the densest through which the lamp is bright enough, whose current is set most finely.

        Raises
        ------
        BadInput
            If there is no such filter, or the lamp cannot make that light behind it.
        """
        for position in self._positions(illuminance_lux, filter_density):
            bare_lux = illuminance_lux * 10.0 ** self.filter_density[position - 1]
            current_a = round(self._table().first_for(bare_lux) / SETTABLE_A) * SETTABLE_A
            if self.current_a[0] <= current_a <= self.current_a[-1]:
                return LampSetting(current_a=current_a, position=position, read=self.lit(current_a, position))
        dimmest, brightest = self._reach(filter_density)
        raise BadInput(
            f"illuminance_lux must lie within what the lamp makes, {dimmest:.3g} to {brightest:.3g}, "
            f"got {illuminance_lux:g}"
        )

    def lit(self, current_a: float, position: int, *, beyond_a: float = SETTABLE_A) -> Conditions:
        """Return the light that a current, A, makes behind the filter at a position.

        Raises
        ------
        BadInput
            If the current lies further outside the calibration than `beyond_a`, A.
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
        """Return the position of a filter, counted from 1; a filter that is not there is BadInput."""
        for position, density in enumerate(self.filter_density, 1):
            if abs(density - filter_density) < SAME_DENSITY:
                return position
        densities = ", ".join(f"{density:g}" for density in self.filter_density)
        raise BadInput(f"filter_density must be one of the wheel's {densities}, got {filter_density:g}")

    def _positions(self, illuminance_lux: float, filter_density: float | None) -> list[int]:
        """Positions through which the lamp is bright and dim enough, the densest first."""
        if filter_density is not None:
            fitting = [self.position_of(filter_density)]
        else:
            densest_first = sorted(range(len(self.filter_density)), key=lambda place: -self.filter_density[place])
            fitting = [place + 1 for place in densest_first]
        low, high = self.illuminance_lux[0], self.illuminance_lux[-1]
        return [one for one in fitting if low <= illuminance_lux * 10.0 ** self.filter_density[one - 1] <= high]

    def _reach(self, filter_density: float | None) -> tuple[float, float]:
        densities = self.filter_density if filter_density is None else (filter_density,)
        return self.illuminance_lux[0] * 10.0 ** -max(densities), self.illuminance_lux[-1] * 10.0 ** -min(densities)

    def _table(self) -> RisingTable:
        return RisingTable(
            of="calibration of the lamp",
            names=("current_a", "illuminance_lux"),
            first=self.current_a,
            second=self.illuminance_lux,
            relative_sd=self.relative_sd,
        )
