"""The gate, older: a Stanford DG535 behind a GPIB adapter, its AB output at TTL level before the gate unit.

A question is a command without its last argument; there is no question for the identity. The output stays at TTL level,
0 V at rest and 4 V from A to B. Facts are from the maker's manual; dead time and digits of the rate are recalled.
"""

import re
import time

from drivers.instruments.gate_limits import check_pulse
from drivers.serial_lines.line import InstrumentLine
from drivers.serial_lines.replies import parse_float, query_int, rejected_error, reply_error, verify_read_back
from labdata.errors import BadInput
from labdata.gating import Sync

STEP_NS = 5e-3
DEAD_NS = 1000.0
RATE_DIGITS = 4
INTERNAL, SINGLE_SHOT, LINE = 0, 2, 4
SOURCES: dict[Sync, int] = {"free-running": INTERNAL, "line-locked": LINE}
T0, A, B, AB, C, D = 1, 2, 3, 4, 5, 6
TTL, POSITIVE, HIGH_IMPEDANCE = 0, 1, 1
RATE_ERROR = 16
ERRORS = (
    "unrecognised command",
    "wrong number of parameters",
    "value not allowed",
    "wrong mode",
    "delays that refer to each other",
    "delay out of range",
    "recalled settings are corrupt",
)
_DELAY = re.compile(r"(\d),([+-]\d{1,3}\.\d{12})")


class Dg535:
    """The delay generator, its AB output wired to a gate unit that opens while the level is high.

    Parameters
    ----------
    line
        InstrumentLine to the instrument.
    """

    shut_commands = (f"TM {SINGLE_SHOT}", f"OM {AB},{TTL}", f"OP {AB},{POSITIVE}")

    def __init__(self, line: InstrumentLine) -> None:
        self.line = line

    def identify(self) -> str:
        """Return what kind it is, told by the form of a delay, and clear old errors."""
        self._delay_ns(A)
        self.line.ask("ES")
        return "DG535"

    def look(self) -> None:
        """Ask for a sign of life."""
        query_int(self.line, "TM")

    def check_pulse(
        self, *, width_ns: float, rate_hz: float, delay_ns: float = 0.0, sync: Sync = "free-running"
    ) -> None:
        """Refuse (BadInput) a pulse that does not fit between two triggers, is finer than 5 ps, or has no holdoff."""
        if sync not in SOURCES:
            # Nothing in it would keep a trigger input that rings from opening the gate far too often.
            raise BadInput(f"a DG535 must be {' or '.join(SOURCES)}, as it has no trigger holdoff, got {sync}")
        check_pulse(width_ns, rate_hz=rate_hz, delay_ns=delay_ns, step_ns=STEP_NS, dead_ns=DEAD_NS)

    def shut(self) -> None:
        """Shut the gate: no triggers, TTL level of positive polarity, so that rest is 0 V; read back."""
        for command in self.shut_commands:
            self._set(command)
        verify_read_back(self.line, "TM", SINGLE_SHOT)
        verify_read_back(self.line, f"OM {AB}", TTL)
        verify_read_back(self.line, f"OP {AB}", POSITIVE)

    def open(self, *, width_ns: float, rate_hz: float, delay_ns: float = 0.0, sync: Sync = "free-running") -> float:
        """Open the gate for a time at each trigger and return its width as read back, ns.

        Raises
        ------
        BadInput
            If the pulse does not fit or is finer than a step.
        InstrumentRejected
            If a setting is refused or read back otherwise, or triggers are lost.
        """
        self.check_pulse(width_ns=width_ns, rate_hz=rate_hz, delay_ns=delay_ns, sync=sync)
        self.shut()
        for edge in (C, D):
            self._set(f"DT {edge},{T0},0")
        self._set(f"TZ {AB},{HIGH_IMPEDANCE}")
        if sync == "free-running":
            self._set(f"TR 0,{rate_hz:.{RATE_DIGITS}g}")
        self._set(f"DT {A},{T0},{delay_ns * 1e-9:.12f}")
        self._set(f"DT {B},{A},{width_ns * 1e-9:.12f}")
        if sync == "free-running":
            verify_read_back(self.line, "TR 0", rate_hz, within=0.5 * 10.0 ** (1 - RATE_DIGITS) * rate_hz)
        read_ns = self._delay_ns(B, after=A)
        if abs(read_ns - width_ns) > STEP_NS:
            raise rejected_error(self.line, f"keep a gate of {width_ns:g} ns", f"{read_ns:g} ns back")
        self._trigger(SOURCES[sync], rate_hz)
        return read_ns

    def _trigger(self, source: int, rate_hz: float) -> None:
        query_int(self.line, "IS")
        self._set(f"TM {source}")
        verify_read_back(self.line, "TM", source)
        time.sleep(2.0 / rate_hz)
        if query_int(self.line, "IS") & RATE_ERROR:
            self.shut()
            raise rejected_error(self.line, "use every trigger", f"some lost at {rate_hz:g} Hz")

    def _delay_ns(self, edge: int, *, after: int | None = None) -> float:
        answer = self.line.ask(f"DT {edge}")
        match = _DELAY.fullmatch(answer)
        if match is None:
            raise reply_error(self.line, f"answer DT {edge} with an edge and a delay, as a DG535 does", repr(answer))
        if after is not None and int(match[1]) != after:
            raise rejected_error(self.line, f"keep edge {edge} behind edge {after}", repr(answer))
        return parse_float(match[2], line=self.line, question=f"DT {edge}") * 1e9

    def _set(self, command: str) -> None:
        self.line.write(command)
        if status := query_int(self.line, "ES"):
            meanings = ", ".join(meaning for bit, meaning in enumerate(ERRORS) if status >> bit & 1)
            raise rejected_error(
                self.line, f"accept {command!r}", f"error status {status}: {meanings or 'unexplained'}", code=status
            )
