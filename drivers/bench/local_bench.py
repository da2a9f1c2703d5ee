"""A bench inside the client's own process: its instruments answer in process, and no other process makes it safe."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import TracebackType
from typing import Self

from drivers.bench.light_control import GuardedLight
from drivers.bench.setup import BenchSetup
from drivers.bench.tube_bench import DISPENSABLE, LOOK_EVERY_S, TubeBench, stations_on
from drivers.errors import BenchError
from drivers.interface import Operator
from drivers.serial_lines.line import InstrumentLine
from labdata.event_log import EventLog
from labdata.instrument_config import Role


class LocalBench(TubeBench):
    """A bench without a server: whoever gives orders looks after the instruments as well, by `check`."""

    wires_left_out = (
        "serial lines: the instruments answer inside this process",
        "bench server: no other process makes the tube safe",
    )
    """What is not on real wires here, one phrase each."""

    def __init__(self, setup: BenchSetup, lines: Mapping[Role, InstrumentLine]) -> None:
        self._log = EventLog(setup.log)
        stations = stations_on(lines, setup.wires)
        super().__init__(setup, stations, record=self._log, on_failure=lambda error: self.make_safe(str(error)))
        self._looked_s = 0.0

    def __enter__(self) -> Self:
        self.heard()
        try:
            self.open()
        except BaseException as error:
            self._leave(error)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._leave(error)

    def guard(self, operator: Operator) -> Operator:
        """Put the lamp, and whoever places targets and light, behind the interlock; use only what is returned."""
        return GuardedLight(operator, self)

    def check(self) -> None:
        """Look at the instruments, and raise what went wrong at the bench."""
        self.heard()
        self.look("supply")
        if self._clock() - self._looked_s > LOOK_EVERY_S:
            self._looked_s = self._clock()
            for role in self.stations.keys() - {"supply", *DISPENSABLE}:
                self.look(role)
        super().check()

    def safe(self) -> None:
        """Make the tube safe now; a BenchError where that is not verified. Work may go on if nothing has failed."""
        self.make_safe("asked for").require_whole()

    def safe_at_once(self) -> None:
        """Make the tube safe now, from any thread."""
        self.make_safe("asked for at once")

    @property
    def last_words(self) -> str:
        """How the tube was left, and what to do by hand where it may be hot; empty before it was made safe."""
        return "" if self.report is None else self.report.last_words()

    @contextmanager
    def patience(self, seconds: float) -> Iterator[None]:
        """Announce that no sign of life may come for some seconds; here nobody waits for one."""
        yield

    def _leave(self, error: BaseException | None) -> None:
        report = self.make_safe("the bench is left")
        unwritten = self.close()
        self._log.close()
        if error is not None:
            for sentence in filter(None, ("" if report.whole else report.not_whole(), unwritten)):
                error.add_note(sentence)
            return
        report.require_whole()
        if unwritten:
            raise BenchError(unwritten)
