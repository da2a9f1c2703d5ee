"""The lamp of the bench and the filters before it: an illuminance becomes a filter turned in the dark and a current."""

from collections.abc import Callable

from drivers.bench.interlock import Interlock
from drivers.bench.state import FilterRead, TurnFilter
from drivers.instruments.filter_wheel import FilterWheel
from drivers.instruments.light_source import LightSource
from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.lamp import Lamp, LampSetting
from labdata.wires import Role

Watch = Callable[[Role, bool], None]
"""Called as watch(role, on): whether an instrument should be looked after now."""


class CalibratedLampControl:
    """A lamp whose light is known by calibration.

    Parameters
    ----------
    source
        The light source.
    wheel
        The filter wheel before it, or None.
    calibration
        What light the lamp's currents make.
    interlock
        Asked before a filter turns, told where it stands.
    watch
        Told what must be looked after: a lamp that burns, a wheel that stands.
    """

    def __init__(
        self, source: LightSource, wheel: FilterWheel | None, calibration: Lamp, *, interlock: Interlock, watch: Watch
    ) -> None:
        self._source, self._wheel, self._calibration = source, wheel, calibration
        self._interlock, self._watch = interlock, watch
        self._position = 1

    def prepare(self) -> None:
        """Go dark, have the source itself refuse more than was calibrated, and read where the wheel stands.

        Raises
        ------
        BadInput
            If the wheel has fewer positions than the calibration has filters.
        """
        self._source.identify()
        self._source.prepare(limit_a=self._calibration.limit_a)
        filters = len(self._calibration.filter_density)
        if self._wheel is None:
            if filters > 1:
                raise BadInput(f"a lamp without a filter wheel must have one filter density, got {filters}")
            return
        self._wheel.identify()
        if (positions := self._wheel.positions) < filters:
            raise BadInput(f"the filter wheel must have a position for each filter, got {positions} for {filters}")
        self._stands_at(self._wheel.position())

    def darken(self) -> None:
        """Take the light out; read back."""
        self._watch("light-source", False)
        self._source.darken()

    def setting(self, illuminance_lux: float, filter_density: float | None) -> LampSetting:
        """Return how an illuminance is made, see `Lamp.setting`."""
        return self._calibration.setting(illuminance_lux, filter_density)

    def turn(self, position: int) -> None:
        """Have the wheel stand at a position, turned in the dark only.

        Raises
        ------
        InterlockRefused
            If the light may not be out.
        """
        if self._wheel is None:
            return
        self._watch("filter-wheel", False)
        if self._wheel.position() != position:
            self._interlock.permit(TurnFilter(position=position))
            self._wheel.turn_to(position)
        self._stands_at(position)

    def shine(self, current_a: float) -> Conditions:
        """Light the lamp and return the light that the current read back makes."""
        read_a = self._source.shine(current_a)
        self._watch("light-source", True)
        return self._calibration.lit(read_a, self._position)

    def _stands_at(self, position: int) -> None:
        if not 1 <= position <= len(self._calibration.filter_density):
            # Nobody calibrated what is there: it is left at the first turn, which the interlock sees to.
            return
        self._position = position
        self._interlock.tell(FilterRead(position=position))
        self._watch("filter-wheel", True)
