"""The gate: a Stanford DG645 delay generator whose AB output opens the gate unit for a set time at each trigger."""

import re
import time

from drivers.errors import InstrumentRejected, InstrumentReplyError
from drivers.instruments.gate_limits import check_pulse
from drivers.serial_lines.line import InstrumentLine
from drivers.serial_lines.replies import parse_float, query_int, verify_read_back
from labdata.gating import HOLDOFF, Sync

IDENTITY = r".*DG645.*"
STEP_NS = 5e-3
GATE_LEVEL_V = 4.0
DEAD_NS = 100.0
"""The next trigger must come this much after the longest delay, ns."""

INTERNAL, EXTERNAL, SINGLE_SHOT, LINE = 0, 1, 5, 6
SOURCES: dict[Sync, int] = {"free-running": INTERNAL, "triggered": EXTERNAL, "line-locked": LINE}
TRIGGER_INPUT = 0
EDGE_A, EDGE_B, OUTPUT_AB = 2, 3, 1
TRIGGERED, RATE_ERROR = 1, 2
_OTHER_EDGES = (4, 5, 6, 7, 8, 9)

ERRORS = {
    10: "illegal value",
    11: "illegal mode",
    12: "illegal delay",
    13: "illegal link",
    14: "recall failed",
    15: "not allowed",
    16: "failed self test",
    17: "failed auto calibration",
    30: "lost data",
    32: "no listener",
    110: "illegal command",
    111: "undefined command",
    112: "illegal query",
    113: "illegal set",
    114: "null parameter",
    115: "extra parameters",
    116: "missing parameters",
    117: "parameter overflow",
    118: "invalid floating point number",
    120: "invalid integer",
    121: "integer overflow",
    122: "invalid hexadecimal",
    126: "syntax error",
    170: "communication error",
    171: "overrun",
    254: "too many errors",
}

SHUT_COMMANDS = ("TSRC 5", "LPOL 1,1", "LOFF 1,0")
"""No triggers, and an idle level of 0 V, which keeps the gate unit closed."""


class DelayGenerator:
    """The delay generator, its AB output wired to a gate unit that opens while the level is high.

    Every setting is set, the error queue asked, and the setting read back.

    Parameters
    ----------
    line
        InstrumentLine to the instrument.
    """

    shut_commands = SHUT_COMMANDS

    def __init__(self, line: InstrumentLine) -> None:
        self.line = line

    def identify(self) -> str:
        """Return the instrument's identity and empty its error queue; another instrument is InstrumentReplyError."""
        identity = self.line.ask("*IDN?")
        if not re.fullmatch(IDENTITY, identity):
            raise InstrumentReplyError(
                f"the {self.line.name} must be a DG645, got {identity[:80]!r}", instrument=self.line.name
            )
        self.line.write("*CLS")
        return identity

    def look(self) -> None:
        """Ask for a sign of life."""
        query_int(self.line, "TSRC?")

    def check_pulse(
        self, *, width_ns: float, rate_hz: float, delay_ns: float = 0.0, sync: Sync = "free-running"
    ) -> None:
        """Refuse (BadInput) a gate that this model cannot open and close between two triggers, or not so finely."""
        check_pulse(width_ns, rate_hz=rate_hz, delay_ns=delay_ns, step_ns=STEP_NS, dead_ns=DEAD_NS)

    def shut(self) -> None:
        """Shut the gate: no triggers, idle level 0 V."""
        for command in SHUT_COMMANDS:
            self.line.write(command)
        self._refuse_errors("; ".join(SHUT_COMMANDS))
        for setting, shut in (("TSRC?", SINGLE_SHOT), ("LPOL? 1", 1), ("LOFF? 1", 0)):
            verify_read_back(self.line, setting, shut)

    def open(self, *, width_ns: float, rate_hz: float, delay_ns: float = 0.0, sync: Sync = "free-running") -> float:
        """Open the gate for a time at each trigger.

        Parameters
        ----------
        width_ns
            Time that the gate is open at each trigger, ns.
        rate_hz
            Triggers a second, Hz: one for each field of the camera.
        delay_ns
            From trigger to opening, ns.
        sync
            What triggers. The camera's field pulse comes to the trigger input; a holdoff keeps triggers that come too
            early from opening the gate more often than was asked.

        Returns
        -------
        float
            Width as read back, ns.

        Raises
        ------
        BadInput
            If the gate cannot open and close between two triggers, or width or delay are finer than 5 ps.
        InstrumentRejected
            If the instrument refuses a setting, reads another one back, loses triggers, or gets none.
        """
        self.check_pulse(width_ns=width_ns, rate_hz=rate_hz, delay_ns=delay_ns)
        self.shut()
        for edge in _OTHER_EDGES:
            self._set(f"DLAY {edge},0,0")
        self._set("BURM 0")
        self._hold_off(HOLDOFF / rate_hz if sync == "triggered" else None)
        self._set("INHB 0")
        self._set(f"LAMP {OUTPUT_AB},{GATE_LEVEL_V:g}")
        if sync == "free-running":
            self._set(f"TRAT {rate_hz:.6f}")
        self._set(f"DLAY {EDGE_A},0,{delay_ns * 1e-9:.12f}")
        self._set(f"DLAY {EDGE_B},{EDGE_A},{width_ns * 1e-9:.12f}")
        if sync == "free-running":
            verify_read_back(self.line, "TRAT?", rate_hz, within=1e-5 * rate_hz)
        verify_read_back(self.line, f"LAMP? {OUTPUT_AB}", GATE_LEVEL_V, within=0.05)
        read_ns = self._width_ns()
        if abs(read_ns - width_ns) > STEP_NS:
            raise InstrumentRejected(
                f"the {self.line.name} must keep a gate of {width_ns:g} ns, got {read_ns:g} ns back",
                instrument=self.line.name,
            )
        self._trigger(SOURCES[sync], rate_hz)
        return read_ns

    def _hold_off(self, seconds: float | None) -> None:
        """Refuse triggers for a time after each one that is taken; None: only as long as the gate is busy."""
        if seconds is None:
            self._set("ADVT 0")
            return
        for prescaler in (TRIGGER_INPUT, OUTPUT_AB):
            self._set(f"PRES {prescaler},1")
        self._set(f"HOLD {seconds:.12f}")
        self._set("ADVT 1")
        verify_read_back(self.line, "HOLD?", seconds, within=1e-9)
        verify_read_back(self.line, "ADVT?", 1)

    def _trigger(self, source: int, rate_hz: float) -> None:
        self.line.ask("INSR?")
        self._set(f"TSRC {source}")
        verify_read_back(self.line, "TSRC?", source)
        time.sleep(2.0 / rate_hz)
        status = query_int(self.line, "INSR?")
        if source != INTERNAL and not status & TRIGGERED:
            self.shut()
            raise InstrumentRejected(
                f"the {self.line.name} must be triggered {rate_hz:g} times a second, got no trigger",
                instrument=self.line.name,
            )
        if status & RATE_ERROR:
            self.shut()
            raise InstrumentRejected(
                f"the {self.line.name} must use every trigger, got some lost at {rate_hz:g} Hz",
                instrument=self.line.name,
            )

    def _width_ns(self) -> float:
        answer = self.line.ask(f"DLAY? {EDGE_B}")
        reference, _, seconds = answer.partition(",")
        if reference != str(EDGE_A):
            raise InstrumentRejected(
                f"edge B of the {self.line.name} must follow edge A, got {answer[:80]!r}", instrument=self.line.name
            )
        return parse_float(seconds, line=self.line, question=f"DLAY? {EDGE_B}") * 1e9

    def _set(self, command: str) -> None:
        self.line.write(command)
        self._refuse_errors(command)

    def _refuse_errors(self, command: str) -> None:
        if code := query_int(self.line, "LERR?"):
            meaning = ERRORS.get(code, "an error it does not explain")
            raise InstrumentRejected(
                f"the {self.line.name} must accept {command!r}, got error {code}: {meaning}",
                instrument=self.line.name,
                code=code,
            )
