"""Light and targets behind the interlock: whoever places them, nothing is placed or lit without leave."""

from typing import TYPE_CHECKING

from drivers.errors import BenchError
from labdata.conditions import Conditions
from labdata.session import Kind
from labdata.target import Target

if TYPE_CHECKING:
    from drivers.bench.client import BenchClient
    from drivers.bench.local_bench import LocalBench
    from drivers.interface import Operator


class GuardedLight:
    """An operator behind the interlock, and the lamp of the bench, if it has one.

    Parameters
    ----------
    operator
        Places targets; sets the light where there is no lamp.
    bench
        Asked before each placement, given what the meter reads after it.
    """

    def __init__(self, operator: "Operator", bench: "BenchClient | LocalBench") -> None:
        self._operator, self._bench = operator, bench
        self._has_lamp = bench.light_unknown()
        operator.while_waiting = self.while_waiting = bench.check

    @property
    def is_by_hand(self) -> bool:
        """Whether a person sets the light, for whom the gate is shut meanwhile."""
        return self._operator.is_by_hand and not self._has_lamp

    def darken(self) -> None:
        """Block the light, which needs no leave."""
        self._operator.darken()
        self._bench.darken()
        if not self._has_lamp:
            self._bench.light_read(0.0)

    def place(
        self, *, kind: Kind, target: Target, illuminance_lux: float, filter_density: float | None = None
    ) -> Conditions:
        """Put a target before the camera and set the light, if no rule forbids it; return what is read.

        Raises
        ------
        InterlockRefused
            If a rule forbids it; nothing was moved then.
        BenchError
            If the meter reads a light that the tube must be made safe for.
        """
        self._bench.check()
        point = kind == "point"
        if self._has_lamp and illuminance_lux:
            return self._bench.shine(illuminance_lux, point=point, target=target, filter_density=filter_density)
        if self._has_lamp:
            self._bench.darken()
        elif self.is_by_hand:
            self._bench.shut_gate()
        self._bench.permit_light(illuminance_lux, point=point, target=target)
        read = self._operator.place(
            kind=kind, target=target, illuminance_lux=illuminance_lux, filter_density=filter_density
        )
        if self._has_lamp:
            read = Conditions(illuminance_lux=0.0, lamp_a=0.0)
        lux = illuminance_lux if read.illuminance_lux is None else read.illuminance_lux
        try:
            self._bench.light_read(lux, zero=not illuminance_lux)
        except BenchError:
            self._operator.darken()
            raise
        return read
