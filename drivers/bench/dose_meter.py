"""The dose meter: it watches the interlock and writes what the tube went through into the tube's ledger."""

import math

from drivers.bench.state import TubeState
from labdata.background import BackgroundWriter
from labdata.dose_ledger import DoseLedger
from labdata.limits import LimitsInForce
from labdata.tube_dose import Dose, dose_of, total_dose

LONGEST_S = 10.0
"""A dose is written down at least so often while the gate is open, s: what a crash can lose."""


class DoseMeter:
    """Integrates the current that may have flowed and keeps it in the ledger of a tube.

    It counts what may be true of the tube (`TubeState`), so that it errs on the side of too much; a state of which
    nothing has been read yet is not counted.
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
        """Why the dose cannot be written, in a sentence."""
        if not self._unwritten or (error := self._writer.failure) is None:
            return None
        return f"the tube's dose must be written to {self._ledger.path}, got: {getattr(error, 'strerror', '') or error}"

    def watch(self, state: TubeState, now_s: float) -> None:
        """Count the time that a state lasted until now; write it down once the gate is shut, or it lasts long.

        Nothing is raised or waited for: it may be the shutting of the gate that comes next.
        """
        passed_s = 0.0 if self._last_s is None else now_s - self._last_s
        self._last_s = now_s
        if passed_s > 0.0 and math.isfinite(state.mcp_v) and math.isfinite(state.light_lux) and state.mcp_v > 0.0:
            self._pending.append(self._dose(state, passed_s))
            self._pending_s += passed_s
        if self._pending and (self._pending_s >= LONGEST_S or (state.shut and self._has_charge())):
            self._write()

    def flush(self, timeout_s: float) -> bool:
        """Wait until what was counted so far is written or refused; return whether that is so."""
        return self._writer.flush(timeout_s)

    def close(self, timeout_s: float) -> str | None:
        """Write what was counted since the last time; return why that failed, if it did."""
        self._write()
        self._writer.put(None)  # what a disk refused is tried once more
        if self._writer.flush(timeout_s):
            self._writer.close(timeout_s)
            return self.failure
        return f"the tube's dose must be written to {self._ledger.path}, got a disk that takes nothing"

    def _write(self) -> None:
        if self._pending:
            self._writer.put(total_dose(self._pending))
        self._pending, self._pending_s = [], 0.0

    def _append(self, dose: Dose | None) -> None:
        """Append to the ledger, with what a disk that refused has not taken yet; in the writer's thread."""
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
        return any(one.charge_c_per_cm2 > 0.0 for one in self._pending)
