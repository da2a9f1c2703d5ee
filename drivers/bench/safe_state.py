"""Making the tube safe: gate shut, high voltage off, lamp out at once, every step recorded, the decay followed."""

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from drivers.errors import InstrumentDisconnected
from drivers.instruments.voltage_limits import DISCHARGED_V, FALL_S
from drivers.roles import Gate, LightSource, Supply

Record = Callable[..., None]
"""Called as record(step, **details) for each thing that was done."""

FOLLOW_S = 0.2
DEAF_S = 3.0
"""A supply that answered nothing for this time is no longer asked, s."""


@dataclass(frozen=True, kw_only=True)
class SafeStateReport:
    """What making safe achieved.

    Parameters
    ----------
    gate_shut
        The gate read back that it makes no pulses and idles shut.
    off_ordered
        The order to switch the high voltage off went out.
    residual_v
        Last voltage measured at the output, V; None if none could be measured.
    light_dark
        Whether every lamp of the bench read back that it is out; a bench without one has none that burns.
    failures
        One sentence for each step that failed.
    """

    gate_shut: bool
    off_ordered: bool
    residual_v: float | None
    light_dark: bool = True
    failures: tuple[str, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether everything was verified: gate shut, output discharged, lamp out."""
        discharged = self.residual_v is not None and self.residual_v <= DISCHARGED_V
        return self.gate_shut and discharged and self.light_dark

    def sentence(self) -> str:
        """One sentence on the state the tube was left in."""
        gate = "the gate is shut" if self.gate_shut else "the gate may be open"
        if self.residual_v is not None and self.residual_v <= DISCHARGED_V:
            gain = f"the high voltage is off and down to {self.residual_v:g} V"
        elif self.residual_v is not None:
            gain = f"{self.residual_v:g} V were last measured at the output"
        else:
            gain = "the high voltage was ordered off but not verified" if self.off_ordered else "the high voltage is on"
        return f"{gate}, {gain}" if self.light_dark else f"{gate}, {gain}, the lamp may burn"


def make_safe(
    *, gate: Gate | None, supply: Supply | None, lamps: Sequence[LightSource | None] = (), record: Record
) -> SafeStateReport:
    """Shut the gate, order the high voltage off and the lamps out, all at once, then follow the decay of the output.

    None waits for another, so that a silent line does not hold up the safe action of the other ones.

    Parameters
    ----------
    gate, supply
        Gate and supply of the tube; None if the line to one could not be opened.
    lamps
        Light sources of the bench, if it has any; None as above.
    record
        Told each step.

    Returns
    -------
    SafeStateReport
        What was achieved; this function raises nothing, because the next step must be tried all the same.
    """
    shut, fall, dark = _Shutting(gate, record), _Falling(supply, record), [_Darkening(one, record) for one in lamps]
    helpers = [threading.Thread(target=task.run, daemon=True) for task in (shut, fall, *dark)]
    for helper in helpers:
        helper.start()
    for helper in helpers:
        helper.join()
    return SafeStateReport(
        gate_shut=shut.verified,
        off_ordered=fall.ordered,
        residual_v=fall.residual_v,
        light_dark=all(one.verified for one in dark),
        failures=(*shut.failures, *fall.failures, *(failure for one in dark for failure in one.failures)),
    )


class _Task:
    """Steps on one line, each tried whatever became of the one before."""

    def __init__(self, record: Record) -> None:
        self._record = record
        self.failures: list[str] = []

    def attempt(self, step: str, action: Callable[[], object]) -> tuple[bool, object]:
        try:
            result = action()
        except Exception as error:  # the next step must be tried whatever this one did
            self._record(step, ok=False, error=str(error))
            self.failures.append(str(error))
            return False, error
        self._record(step, ok=True, **({"result": result} if result is not None else {}))
        return True, result


class _Shutting(_Task):
    """The gate's half."""

    verified = False

    def __init__(self, gate: Gate | None, record: Record) -> None:
        super().__init__(record)
        self._gate = gate

    def run(self) -> None:
        if (gate := self._gate) is None:
            self.failures.append("the delay generator could not be reached")
            return
        for command in gate.shut_commands:
            self.attempt(f"gate: {command}", lambda command=command: gate.line.order(command))
        self.verified = self.attempt("gate: shut and read back", gate.shut)[0]


class _Darkening(_Task):
    """A lamp's part."""

    verified = False

    def __init__(self, lamp: LightSource | None, record: Record) -> None:
        super().__init__(record)
        self._lamp = lamp

    def run(self) -> None:
        if (lamp := self._lamp) is None:
            self.failures.append("the light source could not be reached")
            return
        for command in lamp.dark_commands:
            self.attempt(f"light: {command}", lambda command=command: lamp.line.order(command))
        self.verified = self.attempt("light: out and read back", lamp.darken)[0]


class _Falling(_Task):
    """The supply's half."""

    ordered = False
    residual_v: float | None = None

    def __init__(self, supply: Supply | None, record: Record) -> None:
        super().__init__(record)
        self._supply = supply

    def run(self) -> None:
        if (supply := self._supply) is None:
            self.failures.append("the high-voltage supply could not be reached")
            return
        deadline_s = time.monotonic() + FALL_S
        went_out, error = self._order(supply)
        give_up_s = time.monotonic() + DEAF_S
        while time.monotonic() < min(deadline_s, give_up_s) and not isinstance(error, InstrumentDisconnected):
            answered, reading = self.attempt(f"high voltage: {supply.reading}", supply.measured_v)
            if answered and isinstance(reading, float):
                self.residual_v = reading
                give_up_s = deadline_s
                if reading <= DISCHARGED_V:
                    return
            if not (answered and went_out):
                went_out, error = self._order(supply)
            time.sleep(FOLLOW_S)

    def _order(self, supply: Supply) -> tuple[bool, object]:
        """Send every order, whatever becomes of the one before; whether all went out, and the last error."""
        went_out, error = True, None
        for command in supply.off_commands:
            done, result = self.attempt(f"high voltage: {command}", lambda command=command: supply.line.order(command))
            went_out, error = went_out and done, error if done else result
        self.ordered = self.ordered or went_out
        return went_out, error
