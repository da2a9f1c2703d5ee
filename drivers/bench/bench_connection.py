"""How the bench reaches its instruments, a watchdog process or lines of this one, and makes them safe by either way."""

import contextlib
import json
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drivers.bench.safe_state import SafeStateReport, make_safe
from drivers.bench.watchdog_client import Guard
from drivers.errors import BenchError, BenchServerLost
from drivers.instruments.models import InstrumentModel, model_of
from drivers.serial_lines.line import InstrumentLine
from labdata.errors import BadInput
from labdata.wires import PORT_KEYS, Reached, Role, Wires

DANGEROUS: tuple[Role, ...] = ("gate", "supply", "light-source")
"""What must be made safe."""


class Reach:
    """The lines of one bench.

    Parameters
    ----------
    wires
        Models, ports and addresses of the instruments.
    lines
        Ready-made lines by role, where there are no serial ports; None: a watchdog process opens the ports.
    log
        File of the safety steps.

    Raises
    ------
    BadInput
        If an instrument has neither a port nor a line.
    """

    def __init__(self, wires: Wires, lines: Mapping[Role, InstrumentLine] | None, *, log: Path) -> None:
        if lines is None and (without := [PORT_KEYS[one.role] for one in wires.instruments if not one.port]):
            raise BadInput(f"every instrument must have its serial port, got none for {' and '.join(without)}")
        self._wires, self._lines, self._log = wires, lines, log
        self._models: dict[Role, InstrumentModel] = {one.role: model_of(one) for one in wires.instruments}
        self.guard: Guard | None = None
        """The watchdog, between `open` and `leave`."""
        self._taking_over = threading.Lock()
        self._taken_over: SafeStateReport | None = None

    @property
    def left_out(self) -> tuple[str, ...]:
        """What is not on real wires here, one phrase each."""
        if self._lines is None:
            return ()
        return ("serial lines: the instruments answer inside this process", "watchdog: no process guards the bench")

    def open(self) -> dict[Role, Any]:
        """Start the watchdog, if ports are to be opened, and return a driver for each instrument."""
        if self._lines is None:
            _check_writable(self._log)
            self.guard = Guard(wires=self._wires, log=self._log, on_lost=self._safe_without_watchdog)
        return self._drivers()

    def watch(self, role: Role, on: bool) -> None:
        """Have the watchdog look after an instrument, or leave it alone."""
        if self.guard is not None:
            self.guard.lines[role].watch(on)

    def safe(self) -> SafeStateReport:
        """Make the instruments safe now and keep the lines."""
        return self.guard.safe() if self.guard is not None else self._safe_here(self._drivers())

    def leave(self) -> SafeStateReport | None:
        """Make the instruments safe and let go of them; None where nothing was ever reached."""
        if self._lines is not None:
            return self._safe_here(self._drivers())
        if self.guard is None:
            return None
        guard, self.guard = self.guard, None
        try:
            return guard.leave()
        except BenchServerLost:
            return self._safe_without_watchdog()

    def _drivers(self) -> dict[Role, Any]:
        lines = self.guard.lines if self.guard is not None else self._lines or {}
        return {role: kind.driver(lines[role]) for role, kind in self._models.items()}

    def _safe_here(self, drivers: Mapping[Role, Any]) -> SafeStateReport:
        """Make safe over lines of this process, as far as there are drivers."""
        lamps = [drivers.get("light-source")] if self._wires.light else []
        return make_safe(gate=drivers.get("gate"), supply=drivers.get("supply"), lamps=lamps, record=self._record)

    def _safe_without_watchdog(self) -> SafeStateReport:
        """The watchdog is gone: make the bench safe ourselves, at once, whatever the client waits for meanwhile."""
        with self._taking_over:
            if self._taken_over is None or not self._taken_over.whole:
                self._taken_over = self._ports_taken()
            return self._taken_over

    def _ports_taken(self) -> SafeStateReport:
        """Take the ports, which are free now, and make safe."""
        self._record("the watchdog is gone; its client makes the bench safe")
        needed = [one for one in self._wires.instruments if one.role in DANGEROUS]
        lines: dict[Role, InstrumentLine] = {
            one.role: line for one in needed if (line := self._opened(one)) is not None
        }
        try:
            return self._safe_here({role: self._models[role].driver(line) for role, line in lines.items()})
        finally:
            for line in lines.values():
                line.close()

    def _opened(self, reached: Reached) -> InstrumentLine | None:
        with contextlib.suppress(BenchError):
            return self._models[reached.role].open_line(str(reached.port), reached.address)

    def _record(self, event: str, **details: object) -> None:
        now = time.time()
        with self._log.open("a") as log:
            log.write(json.dumps({"time": now, "monotonic_s": time.monotonic(), "event": event, **details}) + "\n")


def _check_writable(log: Path) -> None:
    """A watchdog that cannot log would end at once, out of sight."""
    try:
        with log.open("a"):
            pass
    except OSError as error:
        raise BadInput(f"the log of the safety steps must be a file that can be written, got: {error}") from None
