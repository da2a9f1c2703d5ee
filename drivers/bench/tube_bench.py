"""Gate, gain and light of the tube, every command checked by the interlock."""

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any

from drivers.bench.interlock import Interlock
from drivers.bench.light_control import METER_ZERO, LightControl, Station
from drivers.bench.meters import AuxiliaryMeters, DoseMeter, Reading
from drivers.bench.safe_state import (
    DANGEROUS,
    Crew,
    Record,
    SafeStateReport,
    Warn,
    make_safe,
)
from drivers.bench.setup import BenchSetup
from drivers.bench.state import (
    Command,
    DarkSeen,
    Failed,
    FrameSeen,
    GainRead,
    GateRead,
    Heard,
    LightRead,
    LowerGain,
    OpenGate,
    RaiseGain,
    SafeOrdered,
)
from drivers.errors import BenchError, BenchStopped
from drivers.instruments.voltage_limits import DISCHARGED_V
from drivers.interface import FrameLevels
from labdata.conditions import Conditions
from labdata.instrument_config import Role

# Interval between checks of an instrument's settings, s; with the check itself below 0.5 s
LOOK_EVERY_S = 0.3

# Roles not needed for the tube: a failure is reported, and the bench continues
DISPENSABLE: tuple[Role, ...] = ("light-meter", "thermometer")

# Largest mean of a frame without light, fraction of full scale; black level, dark current and EBI
# are far below
BRIGHTEST_MEAN = 0.25

# Largest fraction of saturated pixels of a frame without light; room light at gain saturates the
# frame
MAX_SATURATED = 0.01


class NotDark(BenchError):
    """A frame with the light off is bright: find the source of the light before the gate is opened
    again.
    """


class TubeBench(LightControl):
    """Gate, gain and light of the tube; all commands pass the interlock, see
    `drivers.bench.interlock`.

    One thread gives commands; others may check the instruments and make the tube safe meanwhile.
    `record` is called with each safety step and must not block; `on_failure` from any thread after
    a failure that requires the safe state; `warn` with the report of a safe action that goes on, as
    by `make_safe`.
    """

    def __init__(
        self,
        setup: BenchSetup,
        stations: Mapping[Role, Station],
        *,
        record: Record,
        on_failure: Callable[[BenchError], object],
        warn: Warn = lambda report: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._setup, self._record, self._on_failure, self._clock = setup, record, on_failure, clock
        self._warn = warn
        self.stations = stations
        self.interlock = Interlock(setup.limits, clock=clock)
        self._dose = (
            None
            if setup.dose is None
            else DoseMeter(setup.dose, self.interlock.limits, session=setup.session)
        )
        if self._dose is not None:
            self.interlock.watch(self._dose.watch)
        self._crew, self._making_safe = Crew(), threading.Lock()
        self._gate_hz, self._most_hz = (
            setup.gating.rate_hz(setup.field_hz),
            setup.gating.most_hz(setup.field_hz),
        )
        # First failure since the bench was opened; no command increases the load of the tube until
        # it is reopened
        self.fault: BenchError | None = None
        self.report: SafeStateReport | None = None  # Report of the last safe action

    def open(self) -> None:
        """Shut the gate and switch the high voltage off, identify every instrument, and read what
        is left.

        No instrument waits for another: both are ordered before one is asked, and each is watched
        as soon as it was read back.
        """
        gate, supply = self.stations["gate"].driver, self.stations["supply"].driver
        orders: dict[Role, tuple[str, ...]] = {
            "gate": gate.shut_commands,
            "supply": supply.off_commands,
        }
        for role, commands in orders.items():
            with self._using(role):
                for command in commands:
                    self.stations[role].line.order(command)
        with self._using("gate"):
            gate.identify()
            self.shut_gate()
            self.stations["gate"].watched = True
        with self._using("supply"):
            supply.identify()
            supply.prepare(limit_v=self.interlock.limits.mcp_v)
            self.stations["supply"].watched = True
            self._read_gain(supply.read_voltage_v())
        with self._using("light-source", "filter-wheel"):
            self._prepare_lamp()
        drivers: dict[Role, Any] = {role: station.driver for role, station in self.stations.items()}
        self._meters = AuxiliaryMeters(drivers, self._setup.meters)
        self._meters.prepare()
        # Without a call of `light_unknown` there is no controllable light.
        self.interlock.tell(LightRead(illuminance_lux=0.0))

    # Gate and gain

    def set_conditions(self, conditions: Conditions) -> Conditions:
        """Set gate and gain: gate shut first, then the gain, verified, then the gate; return them
        as read back.

        `mcp_v` None or 0: high voltage off. `gate_ns` None or 0: gate shut. At BadInput nothing was
        changed.
        """
        volts, width_ns = conditions.mcp_v or 0.0, conditions.gate_ns or 0.0
        self._is_stopped = False
        self.check()
        move = self._gain_move(volts)
        self._foresee(move, volts, width_ns)
        self.shut_gate()
        with self._using("supply"):
            read_v = self._move_gain(move, volts)
        read_ns = self._open_gate(width_ns) if width_ns else 0.0
        self.check()
        return replace(conditions, mcp_v=read_v, gate_ns=read_ns)

    def shut_gate(self) -> None:
        """Shut the gate and read it back."""
        self.interlock.tell(SafeOrdered())
        with self._using("gate"):
            self.stations["gate"].driver.shut()
        self.interlock.tell(GateRead(width_ns=0.0, rate_hz=0.0))

    def _gain_move(self, volts: float) -> RaiseGain | LowerGain | None:
        """Return the command for a voltage; None if it is off or unchanged."""
        supply = self.stations["supply"].driver
        present_v = supply.read_voltage_v() if supply.is_on else 0.0
        if not volts or math.isclose(
            volts, present_v, abs_tol=0.5
        ):  # Tolerance of an unchanged voltage, V
            return None
        if volts < present_v:
            return LowerGain(goal_v=volts)
        return RaiseGain(goal_v=volts, rate_v_per_s=self.interlock.limits.ramp_v_per_s)

    def _foresee(self, move: RaiseGain | LowerGain | None, volts: float, width_ns: float) -> None:
        """Check the commands of a change before any is sent."""
        commands: list[Command] = [] if move is None else [move]
        if volts:
            self.stations["supply"].driver.check_voltage(volts)
        if width_ns:
            commands.append(OpenGate(width_ns=width_ns, rate_hz=self._most_hz))
            self.stations["gate"].driver.check_pulse(width_ns=width_ns, **self._pulse)
        self.interlock.foresee(*commands, state=replace(self.interlock.state, duty=0.0))

    @property
    def _pulse(self) -> dict[str, Any]:
        """Settings of a pulse except its width."""
        gating = self._setup.gating
        return {"rate_hz": self._gate_hz, "delay_ns": gating.delay_ns, "sync": gating.sync}

    def _move_gain(self, move: RaiseGain | LowerGain | None, volts: float) -> float:
        supply = self.stations["supply"].driver
        if not volts:
            self.interlock.tell(SafeOrdered())
            return self._read_gain(supply.off())
        if move is None:
            return self._read_gain(supply.read_voltage_v())
        self.check()
        self._permit(move)
        if isinstance(move, LowerGain):
            return self._read_gain(supply.lower_to(volts, check=self.check))
        if not supply.is_on:
            supply.switch_on()
        return self._read_gain(
            supply.raise_to(volts, rate_v_per_s=move.rate_v_per_s, check=self.check)
        )

    def _open_gate(self, width_ns: float) -> float:
        self.check()
        with self._using("gate"):
            self._permit(OpenGate(width_ns=width_ns, rate_hz=self._most_hz))
            read_ns = self.stations["gate"].driver.open(width_ns=width_ns, **self._pulse)
        self.interlock.tell(GateRead(width_ns=read_ns, rate_hz=self._most_hz))
        return read_ns

    def _read_gain(self, read_v: float) -> float:
        self.interlock.tell(GainRead(mcp_v=0.0 if read_v <= DISCHARGED_V else read_v))
        return read_v

    # Frames and meters

    @property
    def dark_seen(self) -> bool:
        """Whether a dark frame was verified through the open gate since the bench was opened."""
        return self.interlock.state.dark_seen

    def dark_frame_seen(self, levels: FrameLevels) -> bool:
        """Take the levels of a frame without light, and return `dark_seen`; NotDark if it is
        bright.
        """
        if levels.mean > BRIGHTEST_MEAN or levels.saturated > MAX_SATURATED:
            error = NotDark(
                f"a frame without light must have a mean below {BRIGHTEST_MEAN:.0%} of full scale "
                f"and at most {MAX_SATURATED:.0%} of its pixels full, got {levels.mean:.0%} and "
                f"{levels.saturated:.1%}: find the light before the gate is opened again",
                instrument="light",
            )
            self.fail(error)
            raise error
        self.interlock.tell(DarkSeen())
        return self.dark_seen

    def frame_seen(self, levels: FrameLevels) -> None:
        """Take the saturation of a frame."""
        self.interlock.tell(FrameSeen(excess_saturation=levels.saturated - levels.allowed))
        self.react()

    def read_meters(self) -> Reading:
        """Read light and temperature; return a sentence for each optional meter that does not
        answer.
        """
        self.check()
        with self._using("light-meter", "thermometer"):
            read, silent = self._meters.read()
        self._raise_light(read.metered_lux)
        self.check()
        return read, silent

    def look_at_light(self) -> None:
        """Read a calibrated light meter, if there is one, and make the tube safe if it is too
        bright.
        """
        station = self.stations.get("light-meter")
        if (
            station is None
            or self._setup.meters.lux_per_w is None
            or not station.procedure.acquire(blocking=False)
        ):
            return
        try:
            lux = self._meters.read_light(station.driver)["metered_lux"]
        except BenchError as error:
            if self._setup.meters.light_needed and not isinstance(error, BenchStopped):
                self.fail(error)
            return
        finally:
            station.procedure.release()
        self._raise_light(lux)

    def _raise_light(self, metered_lux: float | None) -> None:
        """Raise the light known to the interlock to a brighter reading; a reading near zero is the
        meter's zero.
        """
        zero_lux = METER_ZERO * self.interlock.limits.illuminance_lux
        # Factor between meter reading and set light above which the light is brighter, beyond
        # calibration errors
        if metered_lux is not None and metered_lux > max(
            zero_lux, 1.25 * self.interlock.state.light_lux
        ):
            self.interlock.tell(LightRead(illuminance_lux=metered_lux))

    # Checks

    def look(self, role: Role) -> None:
        """Compare an instrument with its settings, unless a procedure uses it."""
        station = self.stations[role]
        if (
            self.fault is not None
            or not station.watched
            or not station.procedure.acquire(blocking=False)
        ):
            return
        try:
            if station.watched:
                station.driver.look()
        except BenchStopped:
            pass
        except BenchError as error:
            self.fail(error)
        finally:
            station.procedure.release()

    def verify(self) -> None:
        """Compare gate and supply with their settings; a difference is raised and makes the tube
        safe.
        """
        for role in ("gate", "supply"):
            with self._using(role):
                self.look(role)
        self.check()

    def record_heartbeat(self, slack_s: float = 0.0) -> None:
        """Record a heartbeat of the client; the next may come by a slack later, s."""
        self.interlock.tell(Heard(now_s=self._clock() + slack_s))

    def check(self) -> None:
        """Raise an error of the bench: a trip, a silent line, a changed setting, too much light."""
        self.react()
        if self.fault is not None:
            raise self.fault

    def react(self) -> None:
        """Make the tube safe if a rule of the interlock requires it."""
        if self.fault is not None:
            return
        if why := (self._dose and self._dose.failure) or self.interlock.alarm():
            self.fail(BenchError(f"the tube was made safe: {why}"))

    def fail(self, error: BenchError) -> None:
        """Record a failure; the first one is kept and makes the tube safe."""
        if self.fault is not None:
            return
        self.fault = error
        self.interlock.tell(Failed(sentence=str(error)))
        self._on_failure(error)

    # The safe state

    def make_safe(self, reason: str) -> SafeStateReport:
        """Make the tube safe, interrupting other threads, and return the report.

        A tube in the safe state, without commands or failures since, is left as it is.
        """
        with self._making_safe:
            if (
                self._is_stopped
                and self.fault is None
                and self.report is not None
                and self.report.whole
            ):
                return self.report
            self._is_stopped = True
            dangerous: dict[Role, Station] = {
                role: self.stations[role] for role in DANGEROUS if role in self.stations
            }
            for station in dangerous.values():
                station.line.take_over()
            self._record("making safe", reason=reason)
            self.interlock.tell(SafeOrdered())
            # A port that stayed lost is left to later attempts: a run must not wait for each.
            is_patient = self.report is None or self.report.whole
            report = self.secure(self._record, self._crew, self._warn, is_patient=is_patient)
            if "supply" in dangerous:
                dangerous["supply"].driver.is_on = False
            self._record(
                "made safe", whole=report.whole, sentence=report.sentence(), **vars(report)
            )
            if report.whole:
                if self._setup.wires.light:
                    self.interlock.tell(LightRead(illuminance_lux=0.0))
                self.interlock.tell(GateRead(width_ns=0.0, rate_hz=0.0))
                self.interlock.tell(GainRead(mcp_v=0.0))
            self.report = report
            for station in dangerous.values():
                # The line stays closed to a procedure that does not end.
                # Longest wait for a procedure interrupted by the safe action, s
                if station.procedure.acquire(timeout=1.0):
                    station.line.release()
                    station.procedure.release()
            return report

    def keep_safe(self, record: Record) -> SafeStateReport | None:
        """Order and read back once more what was made safe; return the report where it turned out
        otherwise than the last.
        """
        with self._making_safe:
            before, self.report = self.report, self.secure(record, self._crew, is_patient=False)
            is_news = before is None or before.whole != self.report.whole
            return self.report if is_news else None

    def secure(
        self,
        record: Record,
        crew: Crew | None = None,
        warn: Warn = lambda report: None,
        *,
        is_patient: bool = True,
    ) -> SafeStateReport:
        """Run the safe action on the instruments that have a line, whatever the state says."""
        drivers: dict[Role, Any] = {role: station.driver for role, station in self.stations.items()}
        return make_safe(
            gate=drivers.get("gate"),
            supply=drivers.get("supply"),
            lamps=[drivers.get("light-source")] if self._setup.wires.light else [],
            record=record,
            crew=crew,
            warn=warn,
            is_patient=is_patient,
        )

    def safe_at_once(self) -> None:
        """Make the tube safe now, from any thread; no frame is taken for a good one from now on."""
        self.fault = self.fault or BenchStopped("the tube was made safe at once, as asked")
        self.make_safe("asked for at once")

    def close(self) -> str | None:
        """Write the last dose; return the reason of a failure, or None."""
        if self._dose is None:
            return None
        self.interlock.tell(SafeOrdered())
        return self._dose.close(2.0)  # Longest wait for the last dose to be written, s

    @contextmanager
    def _using(self, *roles: Role) -> Iterator[None]:
        """Run a procedure on several instruments; an error makes the tube safe."""
        with ExitStack() as procedures:
            for role in roles:
                if role in self.stations:
                    procedures.enter_context(self.stations[role].procedure)
            try:
                yield
            except BenchStopped:
                raise self.fault or BenchStopped(
                    "the tube was made safe while an instrument was set"
                ) from None
            except BenchError as error:
                self.fail(error)
                raise
