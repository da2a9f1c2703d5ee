"""Making the tube safe: gate shut and high voltage off at once, every step tried and recorded, the decay followed."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from drivers.errors import InstrumentLost
from drivers.instruments.voltage import DISCHARGED_V, FALL_S
from drivers.roles import Gate, Supply

Record = Callable[..., None]
"""Called as record(step, **details) for each thing that was done."""

FOLLOW_S = 0.2
DEAF_S = 3.0
"""A supply that answered nothing for this time is no longer asked, s."""


@dataclass(frozen=True, kw_only=True)
class Safety:
    """What making safe achieved.

    Parameters
    ----------
    gate_shut
        The gate read back that it makes no pulses and idles shut.
    off_ordered
        The order to switch the high voltage off went out.
    residual_v
        Last voltage measured at the output, V; None if none could be measured.
    failures
        One sentence for each step that failed.
    """

    gate_shut: bool
    off_ordered: bool
    residual_v: float | None
    failures: tuple[str, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether everything was verified: gate shut, output discharged."""
        return self.gate_shut and self.residual_v is not None and self.residual_v <= DISCHARGED_V

    def sentence(self) -> str:
        """One sentence on the state the tube was left in."""
        gate = "the gate is shut" if self.gate_shut else "the gate may be open"
        if self.residual_v is not None and self.residual_v <= DISCHARGED_V:
            gain = f"the high voltage is off and down to {self.residual_v:g} V"
        elif self.residual_v is not None:
            gain = f"{self.residual_v:g} V were last measured at the output"
        else:
            gain = "the high voltage was ordered off but not verified" if self.off_ordered else "the high voltage is on"
        return f"{gate}, {gain}"


def make_safe(*, gate: Gate | None, supply: Supply | None, record: Record) -> Safety:
    """Shut the gate and order the high voltage off, both at once, then follow the decay of the output.

    Neither waits for the other, so that a silent line does not hold up the safe action of the other one.

    Parameters
    ----------
    gate, supply
        Gate and supply of the tube; None if the line to one could not be opened.
    record
        Told each step.

    Returns
    -------
    Safety
        What was achieved; this function raises nothing, because the next step must be tried all the same.
    """
    shut, fall = _Shutting(gate, record), _Falling(supply, record)
    helpers = [threading.Thread(target=task.run, daemon=True) for task in (shut, fall)]
    for helper in helpers:
        helper.start()
    for helper in helpers:
        helper.join()
    return Safety(
        gate_shut=shut.verified,
        off_ordered=fall.ordered,
        residual_v=fall.residual_v,
        failures=(*shut.failures, *fall.failures),
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
        while time.monotonic() < min(deadline_s, give_up_s) and not isinstance(error, InstrumentLost):
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
