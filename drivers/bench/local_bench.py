"""Opening of a bench: behind a server, or inside the own process for instruments without serial
ports.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

from drivers.bench.client import BenchClient
from drivers.bench.light_control import GuardedLight, stations_on
from drivers.bench.safe_state import say_on_stderr, tell_failures
from drivers.bench.setup import BenchSetup
from drivers.bench.tube_bench import DISPENSABLE, LOOK_EVERY_S, TubeBench
from drivers.interface import Operator
from drivers.serial_lines.line import InstrumentLine
from labdata import BadInput, EventLog
from labdata.instrument_config import PORT_KEYS, InstrumentConfig, Role
from labdata.limits import Limits, LimitsInForce, limits_in_force


class LocalBench(TubeBench):
    """A bench without a server: the caller also checks the instruments, by `check`."""

    # Differences from a bench on real ports, one phrase each
    wires_left_out = (
        "serial lines: the instruments answer inside this process",
        "bench server: no other process makes the tube safe",
    )

    def __init__(self, setup: BenchSetup, lines: Mapping[Role, InstrumentLine]) -> None:
        self._log = EventLog(setup.log)
        stations = stations_on(lines, setup.wires)
        super().__init__(
            setup,
            stations,
            record=self._log,
            on_failure=lambda error: self.make_safe(str(error)),
            warn=lambda report: self.say(report.warning()),
        )
        self.say: Callable[[str], None] = say_on_stderr
        self._looked_s = 0.0

    def __enter__(self) -> Self:
        self.record_heartbeat()
        try:
            self.open()
        except BaseException as error:
            self._leave(error)
            raise
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._leave(error)

    def guard(self, operator: Operator) -> Operator:
        """Return the operator and lamp behind the interlock; use only what is returned."""
        return GuardedLight(operator, self)

    def check(self) -> None:
        """Check the instruments, and raise an error of the bench."""
        self.record_heartbeat()
        self.look("supply")
        if self._clock() - self._looked_s > LOOK_EVERY_S:
            self._looked_s = self._clock()
            for role in self.stations.keys() - {"supply", *DISPENSABLE}:
                self.look(role)
        super().check()

    def slack_s(self) -> float:
        """Return 0: nobody measures the delay of this process."""
        return 0.0

    def safe(self) -> None:
        """Make the tube safe now; BenchError if not verified. The bench stays usable if nothing
        failed.
        """
        self.make_safe("asked for").require_whole()

    @property
    def last_words(self) -> str:
        """Final state of the tube, with manual steps if it may be hot; empty before the safe
        action.
        """
        return "" if self.report is None else self.report.last_words()

    @contextmanager
    def patience(self, seconds: float) -> Iterator[None]:
        """Suspend the heartbeat; without effect here."""
        yield

    def _leave(self, error: BaseException | None) -> None:
        report = self.make_safe("the bench is left")
        unwritten = self.close()
        self._crew.dismiss()
        self._log.close()
        tell_failures((None if report.whole else report.not_whole(), unwritten), error)


def open_bench(
    wires: InstrumentConfig,
    limits: Limits | LimitsInForce,
    *,
    log: str | Path,
    lines: Mapping[Role, InstrumentLine] | None = None,
    **details: Any,
) -> BenchClient | LocalBench:
    """Return a bench, to be used in a `with` block.

    Entering shuts the gate and switches the high voltage off first; so does leaving, also by an
    exception.
    A bench on serial ports lives in a server process, which makes the tube safe when this process
    ends or hangs; this process does the same when the server ends or hangs.

    Parameters
    ----------
    wires, log, details
        See `BenchSetup`; details are its other fields.
    limits
        Limits in force, or those of a plan, which are completed by the defaults of an unknown tube.
    lines
        Existing lines to the instruments by role, where there are no serial ports; the bench then
        lives in this process, and no other process makes the tube safe.
    """
    if lines is None and (
        without := [
            PORT_KEYS[connection.role] for connection in wires.instruments if not connection.port
        ]
    ):
        raise BadInput(
            f"every instrument must have its serial port, got none for {' and '.join(without)}"
        )
    in_force = limits if isinstance(limits, LimitsInForce) else limits_in_force(limits)
    setup = BenchSetup(wires=wires, limits=in_force, log=Path(log).absolute(), **details)
    return BenchClient(setup) if lines is None else LocalBench(setup, lines)
