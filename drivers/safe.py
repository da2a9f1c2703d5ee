"""Making the tube safe: gate shut and high voltage off at once, every step tried and recorded, the decay followed."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from drivers.delay_generator import SHUT_COMMANDS, DelayGenerator
from drivers.errors import InstrumentLost
from drivers.high_voltage import DISCHARGED_V, FALL_S, OFF_COMMAND, HighVoltage
from drivers.line import Line

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
        The delay generator read back that it makes no pulses and idles at 0 V.
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


def make_safe(*, gate: Line | None, supply: Line | None, record: Record) -> Safety:
    """Shut the gate and order the high voltage off, both at once, then follow the decay of the output.

    Neither waits for the other, so that a silent line does not hold up the safe action of the other one.

    Parameters
    ----------
    gate, supply
        Lines to the delay generator and the supply; None if one could not be opened.
    record
        Told each step.

    Returns
    -------
    Safety
        What was achieved; this function raises nothing, because the next step must be tried all the same.
    """
    shut, fall = _Shutting(record), _Falling(record)
    helpers = [
        threading.Thread(target=task.run, args=(line,), daemon=True)
        for task, line in ((shut, gate), (fall, supply))
        if line is not None
    ]
    for helper in helpers:
        helper.start()
    for helper in helpers:
        helper.join()
    missing = tuple(
        f"the {name} could not be reached"
        for name, line in (("delay generator", gate), ("high-voltage supply", supply))
        if line is None
    )
    return Safety(
        gate_shut=shut.verified,
        off_ordered=fall.ordered,
        residual_v=fall.residual_v,
        failures=(*missing, *shut.failures, *fall.failures),
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

    def run(self, line: Line) -> None:
        for command in SHUT_COMMANDS:
            self.attempt(f"gate: {command}", lambda command=command: line.write(command))
        self.verified = self.attempt("gate: shut and read back", DelayGenerator(line).shut)[0]


class _Falling(_Task):
    """The supply's half."""

    ordered = False
    residual_v: float | None = None

    def run(self, line: Line) -> None:
        supply, deadline_s = HighVoltage(line), time.monotonic() + FALL_S
        went_out, error = self._order(line)
        give_up_s = time.monotonic() + DEAF_S
        while time.monotonic() < min(deadline_s, give_up_s) and not isinstance(error, InstrumentLost):
            answered, reading = self.attempt("high voltage: VOUT?", supply.measured_v)
            if answered and isinstance(reading, float):
                self.residual_v = reading
                give_up_s = deadline_s
                if reading <= DISCHARGED_V:
                    return
            if not (answered and went_out):
                went_out, error = self._order(line)
            time.sleep(FOLLOW_S)

    def _order(self, line: Line) -> tuple[bool, object]:
        went_out, error = self.attempt(f"high voltage: {OFF_COMMAND}", lambda: line.write(OFF_COMMAND))
        self.ordered = self.ordered or went_out
        return went_out, error
