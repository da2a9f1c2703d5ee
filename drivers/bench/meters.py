"""Auxiliary meters of the bench, and the meter of the tube's dose."""

import math
import time
from collections.abc import Mapping
from typing import Any

from drivers.bench.state import TubeState
from drivers.errors import BenchError
from labdata import BackgroundWriter, Conditions, Dose, DoseLedger, dose_of, total_dose
from labdata.instrument_config import Meters, Role
from labdata.limits import LimitsInForce

Reading = tuple[
    Conditions, tuple[str, ...]
]  # Conditions read, and one sentence for each meter that did not answer


class AuxiliaryMeters:
    """Light meter and thermometer, if present among the drivers by role."""

    def __init__(self, drivers: Mapping[Role, Any], meters: Meters) -> None:
        self._light_meter, self._thermometer = (
            drivers.get("light-meter"),
            drivers.get("thermometer"),
        )
        self._meters, self._is_tuned = meters, False

    def prepare(self) -> None:
        """Identify the required meters; a wrong instrument is a BenchError."""
        if self._light_meter is not None and self._meters.light_needed:
            self._tune(self._light_meter)
        if self._thermometer is not None and self._meters.temperature_needed:
            self._thermometer.identify()

    def read(self) -> Reading:
        """Read the meters; a time-out of a required one is a BenchError."""
        known: dict[str, Any] = {}
        silent: list[str] = []
        for meter, read, needed in (
            (self._light_meter, self.read_light, self._meters.light_needed),
            (self._thermometer, self._read_temperature, self._meters.temperature_needed),
        ):
            try:
                known |= {} if meter is None else read(meter)
            except BenchError as error:
                if needed:
                    raise
                silent.append(f"not read with the stack: {error}")
        return Conditions(**known), tuple(silent)

    def read_light(self, meter: Any) -> dict[str, Any]:
        """Read the light meter and return conditions by name."""
        if not self._is_tuned:
            self._tune(meter)
        watts, now_s = meter.power_w(), time.time()
        lux = None if self._meters.lux_per_w is None else watts * self._meters.lux_per_w
        return {"metered_w": watts, "metered_lux": lux, "metered_time_s": now_s}

    def _tune(self, meter: Any) -> None:
        meter.identify()
        meter.tune(self._meters.wavelength_nm)
        self._is_tuned = True

    def _read_temperature(self, meter: Any) -> dict[str, Any]:
        return {"temperature_c": meter.temperature_c(), "temperature_time_s": time.time()}


# Longest interval between writes of the dose while the gate is open, s; a crash loses no more
LONGEST_S = 10.0


class DoseMeter:
    """Integrates the largest possible current and appends the dose to the ledger of a tube.

    It uses the worst case of the tube (`TubeState`), which overestimates the dose; a state of which
    nothing has been read is not counted.
    """

    def __init__(self, ledger: DoseLedger, limits: LimitsInForce, *, session: str) -> None:
        self._ledger, self._limits, self._session = ledger, limits, session
        self._last_s: float | None = None
        self._pending: list[Dose] = []
        self._pending_s = 0.0
        self._unwritten: list[Dose] = []
        self._writer: BackgroundWriter[Dose | None] = BackgroundWriter(self._append, name="dose")

    @property
    def failure(self) -> str | None:
        """Sentence on why the dose cannot be written, or None."""
        if not self._unwritten or (error := self._writer.failure) is None:
            return None
        return (
            f"the tube's dose must be written to {self._ledger.path}, got: "
            f"{getattr(error, 'strerror', '') or error}"
        )

    def watch(self, state: TubeState, now_s: float) -> None:
        """Add the time of a state until now; write the dose when the gate is shut or the state
        lasts long.

        Raises nothing and never waits, since the next command may be to shut the gate.
        """
        passed_s = 0.0 if self._last_s is None else now_s - self._last_s
        self._last_s = now_s
        if (
            passed_s > 0.0
            and math.isfinite(state.mcp_v)
            and math.isfinite(state.light_lux)
            and state.mcp_v > 0.0
        ):
            self._pending.append(self._dose(state, passed_s))
            self._pending_s += passed_s
        if self._pending and (self._pending_s >= LONGEST_S or (state.shut and self._has_charge())):
            self._write()

    def flush(self, timeout_s: float) -> bool:
        """Wait until the dose so far is written or refused; return whether it is."""
        return self._writer.flush(timeout_s)

    def close(self, timeout_s: float) -> str | None:
        """Write the remaining dose; return the reason of a failure, or None."""
        self._write()
        self._writer.enqueue(None)  # retry what the disk refused
        if self._writer.flush(timeout_s):
            self._writer.close(timeout_s)
            return self.failure
        return (
            f"the tube's dose must be written to {self._ledger.path}, got a disk that takes nothing"
        )

    def _write(self) -> None:
        if self._pending:
            self._writer.enqueue(total_dose(self._pending))
        self._pending, self._pending_s = [], 0.0

    def _append(self, dose: Dose | None) -> None:
        """Append to the ledger, with doses that the disk refused before; in the writer's thread."""
        self._unwritten += [] if dose is None else [dose]
        if not self._unwritten:
            return
        self._ledger.append(total_dose(self._unwritten), session=self._session)
        self._unwritten.clear()

    def _dose(self, state: TubeState, seconds: float) -> Dose:
        load = self._limits.load
        return dose_of(
            delivered_na_per_cm2=load.screen_na_per_cm2(state.light_lux, state.mcp_v, state.duty),
            lit_s=seconds,
            at_gain_s=seconds,
            point=state.point,
            log_sd=load.log_sd(state.mcp_v),
        )

    def _has_charge(self) -> bool:
        return any(dose.charge_c_per_cm2 > 0.0 for dose in self._pending)
