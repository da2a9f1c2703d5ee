"""Light and targets behind the interlock: whoever places them, nothing is placed or lit without leave."""

from collections.abc import Callable

from drivers.bench.calibrated_lamp import CalibratedLampControl
from drivers.bench.interlock import Interlock
from drivers.bench.state import LightRead, SetLight
from drivers.interface import Operator
from labdata.conditions import Conditions
from labdata.session import Kind
from labdata.target import Target

METER_ZERO = 1e-3
"""A meter that reads less than this share of the largest light allowed reads its own zero once the light is blocked."""


class GuardedLight:
    """An operator whose hands the interlock holds, and the lamp of the bench, if it has one.

    Parameters
    ----------
    operator
        Places targets; sets the light where there is no lamp.
    lamp
        The lamp; None: the operator sets the light.
    interlock
        Asked before each placement, told what the meter reads after it.
    check
        Raises what went wrong at the bench; called before and after each placement.
    """

    def __init__(
        self, operator: Operator, *, lamp: CalibratedLampControl | None, interlock: Interlock, check: Callable[[], None]
    ) -> None:
        self._operator, self._lamp = operator, lamp
        self._interlock, self._check = interlock, check

    def darken(self) -> None:
        """Block the light, which needs no leave."""
        self._operator.darken()
        if self._lamp is not None:
            self._lamp.darken()
        self._interlock.tell(LightRead(illuminance_lux=0.0))

    def block_by_hand(self) -> None:
        """Ask the operator to block the light, with the lamp seen to by others."""
        self._operator.darken()

    def place(
        self, *, kind: Kind, target: Target, illuminance_lux: float, filter_density: float | None = None
    ) -> Conditions:
        """Put a target before the camera and set the light, if no rule forbids it; return what is read.

        Raises
        ------
        InterlockRefused
            If a rule forbids it; nothing was moved then.
        BenchError
            If the meter reads a light that the tube must be saved from.
        """
        self._check()
        if self._lamp is None:
            read = self._placed(kind, target, illuminance_lux, filter_density)
        elif illuminance_lux == 0.0:
            self._lamp.darken()
            self._placed(kind, target, 0.0, None)
            read = Conditions(illuminance_lux=0.0, lamp_a=0.0)
        else:
            read = self._lit(self._lamp, kind, target, illuminance_lux, filter_density)
        self._check()
        return read

    def _placed(self, kind: Kind, target: Target, lux: float, filter_density: float | None) -> Conditions:
        """Have the operator do all of it."""
        self._interlock.permit(SetLight(illuminance_lux=lux, point=kind == "point", target=target))
        read = self._operator.place(kind=kind, target=target, illuminance_lux=lux, filter_density=filter_density)
        self._interlock.tell(LightRead(illuminance_lux=self._known_lux(read, lux, kind)))
        return read

    def _lit(
        self, lamp: CalibratedLampControl, kind: Kind, target: Target, lux: float, density: float | None
    ) -> Conditions:
        """Turn the filter in the dark, then light the lamp; the target stands where it was placed in the dark."""
        setting = lamp.setting(lux, density)
        lamp.darken()
        self._interlock.tell(LightRead(illuminance_lux=0.0))
        lamp.turn(setting.position)
        self._check()  # a wheel takes its time
        ordered_lux = setting.read.illuminance_lux or 0.0
        self._interlock.permit(SetLight(illuminance_lux=ordered_lux, point=kind == "point", target=target))
        read = lamp.shine(setting.current_a)
        self._interlock.tell(LightRead(illuminance_lux=read.illuminance_lux or ordered_lux))
        return read

    def _known_lux(self, read: Conditions, asked_lux: float, kind: Kind) -> float:
        if read.illuminance_lux is None:
            return asked_lux
        zero_lux = METER_ZERO * self._interlock.limits.largest_lux(point=kind == "point")
        return 0.0 if not asked_lux and read.illuminance_lux <= zero_lux else read.illuminance_lux
