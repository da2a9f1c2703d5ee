"""High-voltage supply: Stanford PS350 behind a GPIB adapter."""

import time
from collections.abc import Callable

from drivers.instruments.instrument import InstrumentModel
from drivers.instruments.voltage_limits import FALL_S, SETTLED_V, Supply
from drivers.serial_lines.line import PrologixLine

STEP_S = 0.2
SETTLE_S, SETTLE_READINGS = 0.1, 25
VOLTAGE_TRIP, CURRENT_TRIP, HV_ON = 2, 4, 128
EXECUTION_ERROR, COMMAND_ERROR = 16, 32

OFF_COMMAND = "HVOF"


class HighVoltage(Supply):
    """The supply; it takes steps of at most 50 V."""

    off_commands = (OFF_COMMAND,)
    reading = "VOUT?"
    lowest_v, highest_v = 50.0, 5000.0  # the minimum is recalled

    def identify(self) -> str:
        identity = self._identity("*IDN?", r"(?i).*(PS3\d\d|2290).*", "of the PS300 series")
        self.line.write("*CLS")
        return identity

    def prepare(self, *, limit_v: float) -> None:
        self.order_off()
        if self._status() & (VOLTAGE_TRIP | CURRENT_TRIP):
            raise self._trip_error("before anything was switched on")
        self._set(f"VSET {self.lowest_v:.0f}")
        self._set(f"VLIM {limit_v:.0f}")
        if (kept_v := self.line.query_float("VLIM?")) > limit_v:
            raise self.line.rejection(f"keep a limit of {limit_v:g} V", f"{kept_v:g} V back")

    def read_voltage_v(self) -> float:
        return self.line.query_float("VOUT?")

    def check_on(self) -> None:
        status = self._status()  # reading clears trips: only the owner of the line may do it
        if status & VOLTAGE_TRIP:
            raise self._trip_error("on voltage")
        if status & CURRENT_TRIP:
            raise self._trip_error("on current")
        if not status & HV_ON:
            raise self._trip_error("without a trip bit")

    def _require_off(self) -> None:
        if self._status() & HV_ON:
            raise self.line.rejection(
                "stay off", "high voltage on: somebody switched it on at the panel"
            )

    def _order_off(self) -> None:
        self._set(OFF_COMMAND)

    def _switch_on(self) -> None:
        """Switch on; a trip that was not cleared at the instrument is InstrumentTripped."""
        self._set(f"VSET {self.lowest_v:.0f}")
        self.line.write("HVON")
        if self.line.query_int("*ESR?") & EXECUTION_ERROR:
            raise self._trip_error(
                "not cleared since: find its cause, then clear it at the instrument"
            )

    def _raise(self, goal_v: float, rate_v_per_s: float, check: Callable[[], None]) -> float:
        start_v = self.line.query_float("VSET?")
        step_v = min(50.0, rate_v_per_s * STEP_S)
        began_s, level_v = time.monotonic(), start_v
        while level_v < goal_v:
            level_v = min(level_v + step_v, goal_v)
            time.sleep(max(0.0, began_s + (level_v - start_v) / rate_v_per_s - time.monotonic()))
            check()
            self.check_on()
            self._set(f"VSET {level_v:.10g}")
        return self._settle(goal_v, check)

    def _lower(self, goal_v: float, check: Callable[[], None]) -> float:
        self._set(f"VSET {goal_v:.10g}")
        deadline_s = time.monotonic() + FALL_S
        while self.read_voltage_v() > goal_v + SETTLED_V and time.monotonic() < deadline_s:
            check()
            time.sleep(SETTLE_S)
        return self._settle(goal_v, check)

    def _settle(self, goal_v: float, check: Callable[[], None]) -> float:
        """Return the output when two readings agree."""
        before_v = now_v = self.read_voltage_v()
        for reading in range(SETTLE_READINGS):
            time.sleep(SETTLE_S + 0.5 * SETTLE_S * reading)
            check()
            now_v = self.read_voltage_v()
            if abs(now_v - before_v) < SETTLED_V:
                break
            before_v = now_v
        self.check_on()
        if abs(now_v - goal_v) > SETTLED_V:
            raise self._wrong_output(goal_v, f"{now_v:g} V")
        return now_v

    def _error(self) -> tuple[int, str]:
        code = self.line.query_int("*ESR?") & (EXECUTION_ERROR | COMMAND_ERROR)
        is_state = bool(code & EXECUTION_ERROR)
        meaning = "not possible in its present state or range" if is_state else "not understood"
        return code, f"event status {code}: {meaning}"

    def _status(self) -> int:
        return self.line.query_int("*STB?")


MODEL = InstrumentModel(
    name="ps350",
    role="supply",
    title="high-voltage supply",
    line=lambda port, address: PrologixLine(port, name="high-voltage supply", address=address),
    driver=HighVoltage,
)
