"""The bench: gate and gain set in the order that spares the tube, and made safe by leaving through any door."""

import contextlib
import json
import math
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import FrameType, TracebackType

from numpy.typing import NDArray

from drivers.errors import BenchError, WatchdogLost
from drivers.instruments.models import model
from drivers.interface import Operator
from drivers.roles import Gate, Supply
from drivers.tube.dark_check import must_be_dark
from drivers.tube.dose_meter import DoseMeter
from drivers.tube.guarded_light import GuardedLight
from drivers.tube.guarded_tube import GuardedTube
from drivers.tube.interlock import Interlock
from drivers.tube.safe import Safety, make_safe
from drivers.tube.state import DarkSeen, Failed, GainRead, GateRead, Heard, LightRead, SafeOrdered
from drivers.tube.watched import Guard
from drivers.wire.line import Line
from labdata.conditions import Conditions
from labdata.dose_ledger import DoseLedger
from labdata.errors import BadInput
from labdata.limits import Limits, LimitsInForce, limits_in_force
from labdata.plan import Wires

FIELD_RATE_HZ = 60.0 / 1.001
"""Fields a second of 525-line video, Hz: the gate opens once in each."""

_SIGNALS = (signal.SIGTERM, signal.SIGHUP)


class Bench:
    """Gate and gain of the tube, between `with` and the end of its block.

    Nothing reaches gate, supply or light but through its interlock, whose rules stand in `drivers.tube.rules`.
    Opening shuts the gate and switches the high voltage off before anything else. Leaving, by whatever door
    (an exception, Ctrl-C, SIGTERM), does the same and follows the voltage down; a killed process is seen to by the
    watchdog process, which owns the serial ports.

    Parameters
    ----------
    wires
        Models and serial ports of the gate and of the supply.
    limits
        What may never be exceeded; the voltage is also set in the supply itself. A plan's bare limits are completed
        by those of a tube that nobody described.
    log
        File to which every safety step is appended as a line of JSON.
    lines
        Lines to gate and supply that are ready-made, where there are no serial ports; then no watchdog
        guards the bench, and `wires_left_out` says so.
    gate_hz
        Openings of the gate a second, Hz: one for each exposure of the camera.
    dose
        Ledger of the tube, to which is added what it goes through; None: nobody keeps count.
    session
        Name of the session, for readers of the ledger.

    Raises
    ------
    BadInput
        If a port is not named, or conditions break a limit.
    BenchError
        If an instrument fails; the bench is safe by then, or the sentence says what is not.
    """

    def __init__(
        self,
        wires: Wires,
        limits: Limits | LimitsInForce,
        *,
        log: Path,
        lines: tuple[Line, Line] | None = None,
        gate_hz: float = FIELD_RATE_HZ,
        dose: DoseLedger | None = None,
        session: str = "",
    ) -> None:
        if lines is None and not (wires.gate_port and wires.supply_port):
            raise BadInput(
                f"gate_port and supply_port must name serial ports, got {wires.gate_port!r} and {wires.supply_port!r}"
            )
        self._wires, self._log, self._lines = wires, Path(log), lines
        self._gate_hz = gate_hz
        self._gate_model, self._supply_model = model(wires.gate, "gate"), model(wires.supply, "supply")
        self.interlock = Interlock(limits if isinstance(limits, LimitsInForce) else limits_in_force(limits))
        self._dose = None if dose is None else DoseMeter(dose, self.interlock.limits, session=session)
        if self._dose is not None:
            self.interlock.watch(self._dose.watch)
        self._guard: Guard | None = None
        self._taking_over = threading.Lock()
        self._taken_over: Safety | None = None
        self._light: Operator | None = None
        self._before: dict[signal.Signals, Callable | int | None] = {}

    @property
    def wires_left_out(self) -> tuple[str, ...]:
        """What is not on real wires here, one phrase each."""
        if self._lines is None:
            return ()
        return ("serial lines: the instruments answer inside this process", "watchdog: no process guards the bench")

    def __enter__(self) -> "Bench":
        self._catch_signals()
        try:
            if self._lines is None:
                self._guard = self._started_guard()
            self._gate, self._supply = self._drivers()
            self._gate.identify()
            self._gate.shut()
            self._supply.identify()
            self._supply.prepare(limit_v=self.interlock.limits.mcp_v)
            if self._guard is not None:
                self._guard.gate.watch(True)
            self._tube = GuardedTube(
                gate=self._gate,
                supply=self._supply,
                interlock=self.interlock,
                gate_hz=self._gate_hz,
                check=self.check,
                watch_supply=self._watch_supply,
            )
            self._tube.read_anew()
            # Until `guard` is called there is no light that anybody here could switch on.
            self.interlock.tell(LightRead(illuminance_lux=0.0))
        except BaseException as error:
            self._leave(error)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._leave(error)

    def set_conditions(self, conditions: Conditions) -> Conditions:
        """Set gate and gain: gate shut first, then the gain, verified, then the gate.

        Parameters
        ----------
        conditions
            What is asked. `mcp_v` None or 0: high voltage off. `gate_ns` None or 0: gate shut.

        Returns
        -------
        Conditions
            The same, with `mcp_v` and `gate_ns` as read back.

        Raises
        ------
        BadInput
            If a limit is exceeded or an instrument could not do it; nothing was changed then.
        """
        read_v, read_ns = self._tube.set(mcp_v=conditions.mcp_v or 0.0, gate_ns=conditions.gate_ns or 0.0)
        self.check()
        return replace(conditions, mcp_v=read_v, gate_ns=read_ns)

    def guard(self, operator: Operator) -> Operator:
        """Put whoever places targets and light behind the interlock; use only what is returned from then on."""
        self.interlock.tell(LightRead(illuminance_lux=math.inf))
        self._light = GuardedLight(operator, interlock=self.interlock, check=self.check)
        return self._light

    @property
    def dark_seen(self) -> bool:
        """Whether a dark frame was seen through the open gate since the bench was opened; no light before."""
        return self.interlock.state.dark_seen

    def saw_without_light(self, pixels: NDArray, full_scale_dn: float) -> None:
        """Look at a frame, shape (row, col), taken without light; one that is not dark is a BenchError."""
        try:
            must_be_dark(pixels, full_scale_dn)
        except BenchError as error:
            self.interlock.tell(Failed(sentence=str(error)))
            raise
        self.interlock.tell(DarkSeen())

    def check(self) -> None:
        """Raise what went wrong at the bench since the last look: a trip, a silent line, a lost port, too much light.

        A failure is remembered: nothing makes the tube hotter before the bench is opened anew.
        """
        try:
            if self._guard is not None:
                self._guard.check()
            elif self._supply.is_on:
                self._supply.check_on()
        except BenchError as error:
            self.interlock.tell(Failed(sentence=str(error)))
            raise
        if self._dose is not None and self._dose.failure:
            self.interlock.tell(Failed(sentence=self._dose.failure))
        self.interlock.tell(Heard(now_s=time.monotonic()))
        if why := self.interlock.alarm():
            self.safe()
            raise BenchError(f"the tube was made safe: {why}")

    def safe(self) -> None:
        """Shut the gate, switch the high voltage off and block the light now; a BenchError if that is not verified."""
        self.interlock.tell(SafeOrdered())
        if self._guard is not None:
            safety = self._guard.safe()
        else:
            safety = make_safe(gate=self._gate, supply=self._supply, record=self._record)
        self._supply.is_on = False
        if self._light is not None:
            self._light.darken()
        _raise_unless_whole(safety)
        self.interlock.tell(GateRead(width_ns=0.0, rate_hz=0.0))
        self.interlock.tell(GainRead(mcp_v=0.0))

    def _watch_supply(self, on: bool) -> None:
        if self._guard is not None:
            self._guard.supply.watch(on)

    def _drivers(self) -> tuple[Gate, Supply]:
        if self._guard is not None:
            gate, supply = self._guard.gate, self._guard.supply
        else:
            assert self._lines is not None
            gate, supply = self._lines
        return self._gate_model.driver(gate), self._supply_model.driver(supply)

    def _started_guard(self) -> Guard:
        _check_writable(self._log)
        return Guard(wires=self._wires, log=self._log, on_lost=self._safe_without_watchdog)

    # Leaving

    def _leave(self, error: BaseException | None) -> None:
        try:
            safety = self._left_safe()
        except BenchError as failure:
            if error is None:
                raise
            error.add_note(str(failure))
            return
        finally:
            self._restore_signals()
            unwritten = self._last_dose()
        if unwritten and error is None:
            raise BenchError(unwritten)
        if safety is None or safety.whole:
            return
        if error is None:
            _raise_unless_whole(safety)
        else:
            error.add_note(_left_unsafe(safety))

    def _last_dose(self) -> str | None:
        """Write down what the tube went through to the end; return why that failed, if it did."""
        if self._dose is None:
            return None
        self.interlock.tell(SafeOrdered())
        self._dose.write()
        return self._dose.failure

    def _left_safe(self) -> Safety | None:
        if self._lines is not None:
            gate, supply = self._drivers()
            return make_safe(gate=gate, supply=supply, record=self._record)
        if self._guard is None:
            return None
        guard, self._guard = self._guard, None
        try:
            return guard.leave()
        except WatchdogLost:
            return self._safe_without_watchdog()

    def _safe_without_watchdog(self) -> Safety:
        """The watchdog is gone: make the bench safe ourselves, at once, whatever the client waits for meanwhile."""
        with self._taking_over:
            if self._taken_over is None or not self._taken_over.whole:
                self._taken_over = self._ports_taken()
            return self._taken_over

    def _ports_taken(self) -> Safety:
        """Take the ports, which are free now, and make safe."""
        self._record("the watchdog is gone; its client makes the bench safe")
        gate = _opened(lambda: self._gate_model.open_line(str(self._wires.gate_port), self._wires.gate_address))
        supply = _opened(lambda: self._supply_model.open_line(str(self._wires.supply_port), self._wires.supply_address))
        try:
            return make_safe(
                gate=None if gate is None else self._gate_model.driver(gate),
                supply=None if supply is None else self._supply_model.driver(supply),
                record=self._record,
            )
        finally:
            for line in (gate, supply):
                if line is not None:
                    line.close()

    def _record(self, event: str, **details: object) -> None:
        now = time.time()
        with self._log.open("a") as log:
            log.write(json.dumps({"time": now, "monotonic_s": time.monotonic(), "event": event, **details}) + "\n")

    def _catch_signals(self) -> None:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, _end) for number in _SIGNALS}

    def _restore_signals(self) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler if handler is not None else signal.SIG_DFL)
        self._before = {}


def _end(number: int, _frame: FrameType | None) -> None:
    """Let a signal unwind the stack like Ctrl-C, so that every `with` is left properly."""
    raise SystemExit(128 + number)


def _check_writable(log: Path) -> None:
    """A watchdog that cannot log would end at once, out of sight."""
    try:
        with log.open("a"):
            pass
    except OSError as error:
        raise BadInput(f"the log of the safety steps must be a file that can be written, got: {error}") from None


def _opened(opener: Callable[[], Line]) -> Line | None:
    with contextlib.suppress(BenchError):
        return opener()


def _raise_unless_whole(safety: Safety) -> None:
    if not safety.whole:
        raise BenchError(_left_unsafe(safety))


def _left_unsafe(safety: Safety) -> str:
    why = f" ({safety.failures[0]})" if safety.failures else ""
    return f"the bench must be left with gate shut and high voltage off, got: {safety.sentence()}{why}"
