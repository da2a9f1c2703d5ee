"""The bench: gate, gain and light set in the order that spares the tube, made safe by leaving through any door."""

import math
import signal
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any

from numpy.typing import NDArray

from drivers.bench.auxiliary_meters import AuxiliaryMeters, Reading
from drivers.bench.bench_connection import Reach
from drivers.bench.calibrated_lamp import CalibratedLampControl
from drivers.bench.dark_check import require_dark
from drivers.bench.dose_meter import DoseMeter
from drivers.bench.guarded_light import METER_ZERO, GuardedLight
from drivers.bench.guarded_tube import GuardedTube
from drivers.bench.interlock import Interlock
from drivers.bench.safe_state import SafeStateReport
from drivers.bench.state import DarkSeen, Failed, FilterMoved, GainRead, GateRead, Heard, LightRead, SafeOrdered
from drivers.errors import BenchError
from drivers.interface import Operator
from drivers.serial_lines.line import InstrumentLine
from labdata.conditions import Conditions
from labdata.dose_ledger import DoseLedger
from labdata.errors import BadInput
from labdata.gating import Gating
from labdata.lamp import Lamp
from labdata.limits import Limits, LimitsInForce, limits_in_force
from labdata.meters import Meters
from labdata.wires import Role, Wires

METER_AGREES = 1.25
"""Light that a meter reads this much brighter than it was set is brighter, not a matter of calibration."""

FIELD_RATE_HZ = 60.0 / 1.001
"""Fields a second of 525-line video, Hz: the gate opens once in each."""

_SIGNALS = (signal.SIGTERM, signal.SIGHUP)


class TubeBench:
    """Gate and gain of the tube, between `with` and the end of its block.

    Nothing reaches gate, supply or light but through its interlock, whose rules stand in `drivers.bench.rules`.
    Opening shuts the gate and switches the high voltage off before anything else. Leaving, by whatever door
    (an exception, Ctrl-C, SIGTERM), does the same and follows the voltage down; a killed process is seen to by the
    watchdog process, which owns the serial ports.

    Parameters
    ----------
    wires
        Models and serial ports of the instruments.
    limits
        What may never be exceeded; the voltage is also set in the supply itself. A plan's bare limits are completed
        by those of a tube that nobody described.
    log
        File to which every safety step is appended as a line of JSON.
    lines
        Lines to the instruments by their role, ready-made, where there are no serial ports; then no watchdog guards
        the bench, and `wires_left_out` says so.
    lamp
        Calibration of the light source that the wires name; None: there is none, and a person sets the light.
    meters
        How the meters beside the tube are read.
    gate_hz
        Fields of the camera a second, Hz: the gate opens once in each.
    gating
        What triggers the gate.
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
        lines: Mapping[Role, InstrumentLine] | None = None,
        lamp: Lamp | None = None,
        meters: Meters | None = None,
        gate_hz: float = FIELD_RATE_HZ,
        gating: Gating | None = None,
        dose: DoseLedger | None = None,
        session: str = "",
    ) -> None:
        if (lamp is None) != (wires.light is None):
            raise BadInput(f"a light source must have its calibration, got {lamp} for {wires.light}")
        self._reach = Reach(wires, lines, log=Path(log))
        self._gate_hz, self._gating = gate_hz, gating or Gating()
        self._calibration, self._meters = lamp, meters or Meters()
        self.interlock = Interlock(limits if isinstance(limits, LimitsInForce) else limits_in_force(limits))
        self._dose = None if dose is None else DoseMeter(dose, self.interlock.limits, session=session)
        if self._dose is not None:
            self.interlock.watch(self._dose.watch)
        self._light: GuardedLight | None = None
        self._lamp: CalibratedLampControl | None = None
        self._before: dict[signal.Signals, Callable | int | None] = {}

    @property
    def wires_left_out(self) -> tuple[str, ...]:
        """What is not on real wires here, one phrase each."""
        return self._reach.left_out

    def __enter__(self) -> "TubeBench":
        self._catch_signals()
        try:
            drivers = self._reach.open()
            self._gate, self._supply = drivers["gate"], drivers["supply"]
            self._gate.identify()
            self._gate.shut()
            self._supply.identify()
            self._supply.prepare(limit_v=self.interlock.limits.mcp_v)
            self._reach.watch("gate", True)
            self._tube = GuardedTube(
                gate=self._gate,
                supply=self._supply,
                interlock=self.interlock,
                field_hz=self._gate_hz,
                gating=self._gating,
                check=self.check,
                watch_supply=lambda on: self._reach.watch("supply", on),
            )
            self._tube.read_anew()
            self._lamp = self._prepared_lamp(drivers)
            self._beside = AuxiliaryMeters(drivers, self._meters)
            self._beside.prepare()
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
        """Put the lamp, and whoever places targets and light, behind the interlock; use only what is returned."""
        self.interlock.tell(LightRead(illuminance_lux=math.inf))
        self._light = GuardedLight(operator, lamp=self._lamp, interlock=self.interlock, check=self.check)
        return self._light

    def read_beside(self) -> Reading:
        """Read light and temperature beside the tube, and say which meter did not answer.

        Raises
        ------
        BenchError
            If a meter that is needed does not answer, or reads a light that the tube must be saved from.
        """
        self.check()
        read, silent = self._beside.read()
        if read.metered_lux is not None:
            self._heed(read.metered_lux)
        self.check()
        return read, silent

    def _heed(self, metered_lux: float) -> None:
        """Let the interlock know of more light than it thinks there is; what is next to nothing is the meter's zero."""
        zero_lux = METER_ZERO * self.interlock.limits.illuminance_lux
        if metered_lux > max(zero_lux, METER_AGREES * self.interlock.state.light_lux):
            self.interlock.tell(LightRead(illuminance_lux=metered_lux))

    @property
    def dark_seen(self) -> bool:
        """Whether a dark frame was seen through the open gate since the bench was opened; no light before."""
        return self.interlock.state.dark_seen

    def saw_without_light(self, pixels: NDArray, full_scale_dn: float) -> None:
        """Look at a frame, shape (row, col), taken without light; one that is not dark is a BenchError."""
        try:
            require_dark(pixels, full_scale_dn)
        except BenchError as error:
            self.interlock.tell(Failed(sentence=str(error)))
            raise
        self.interlock.tell(DarkSeen())

    def check(self) -> None:
        """Raise what went wrong at the bench since the last look: a trip, a silent line, a lost port, too much light.

        A failure is remembered: nothing makes the tube hotter before the bench is opened anew.
        """
        try:
            if (guard := self._reach.guard) is not None:
                guard.check()
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
        safety = self._reach.safe()
        self._supply.is_on = False
        if self._light is not None:
            self._light.block_by_hand()
        _raise_unless_whole(safety)
        self.interlock.tell(LightRead(illuminance_lux=0.0))
        self.interlock.tell(GateRead(width_ns=0.0, rate_hz=0.0))
        self.interlock.tell(GainRead(mcp_v=0.0))

    def _prepared_lamp(self, drivers: dict[Role, Any]) -> CalibratedLampControl | None:
        if self._calibration is None:
            return None
        if "filter-wheel" in drivers:
            self.interlock.tell(FilterMoved())
        lamp = CalibratedLampControl(
            drivers["light-source"],
            drivers.get("filter-wheel"),
            self._calibration,
            interlock=self.interlock,
            watch=self._reach.watch,
        )
        lamp.prepare()
        return lamp

    # Leaving

    def _leave(self, error: BaseException | None) -> None:
        try:
            safety = self._reach.leave()
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


def _raise_unless_whole(safety: SafeStateReport) -> None:
    if not safety.whole:
        raise BenchError(_left_unsafe(safety))


def _left_unsafe(safety: SafeStateReport) -> str:
    why = f" ({safety.failures[0]})" if safety.failures else ""
    return f"the bench must be left with gate shut, high voltage off and light out, got: {safety.sentence()}{why}"
