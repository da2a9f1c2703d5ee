"""Light and targets behind the interlock: whoever places them, nothing is placed or lit without leave."""

from collections.abc import Callable

from drivers.interface import Operator
from drivers.tube.interlock import Interlock
from drivers.tube.state import LightRead, SetLight
from labdata.conditions import Conditions
from labdata.session import Kind
from labdata.target import Target

METER_ZERO = 1e-3
"""A meter that reads less than this share of the largest light allowed reads its own zero once the light is blocked."""


class GuardedLight:
    """An operator whose hands the interlock holds.

    Parameters
    ----------
    operator
        Places targets and sets the light.
    interlock
        Asked before each placement, told what the meter reads after it.
    check
        Raises what went wrong at the bench; called before and after each placement.
    """

    def __init__(self, operator: Operator, *, interlock: Interlock, check: Callable[[], None]) -> None:
        self._operator, self._interlock, self._check = operator, interlock, check

    def darken(self) -> None:
        """Block the light, which needs no leave."""
        self._operator.darken()
        self._interlock.tell(LightRead(illuminance_lux=0.0))

    def place(self, *, kind: Kind, target: Target, illuminance_lux: float) -> Conditions:
        """Put a target before the camera and set the light, if no rule forbids it; return what the meter reads.

        Raises
        ------
        InterlockRefused
            If a rule forbids it; nothing was moved then.
        BenchError
            If the meter reads a light that the tube must be saved from.
        """
        self._check()
        self._interlock.permit(SetLight(illuminance_lux=illuminance_lux, point=kind == "point", target=target))
        read = self._operator.place(kind=kind, target=target, illuminance_lux=illuminance_lux)
        self._interlock.tell(LightRead(illuminance_lux=self._known_lux(read, illuminance_lux, kind)))
        self._check()
        return read

    def _known_lux(self, read: Conditions, asked_lux: float, kind: Kind) -> float:
        if read.illuminance_lux is None:
            return asked_lux
        zero_lux = METER_ZERO * self._interlock.limits.largest_lux(point=kind == "point")
        return 0.0 if not asked_lux and read.illuminance_lux <= zero_lux else read.illuminance_lux
