"""Gate generator: Stanford DG645 delay generator, AB output."""

from typing import ClassVar

from drivers.instruments.gate_limits import Gate
from drivers.instruments.instrument import InstrumentModel
from drivers.serial_lines.line import FramedLine
from labdata.gating import HOLDOFF, Sync

GATE_LEVEL_V = 4.0

INTERNAL, EXTERNAL, SINGLE_SHOT, LINE = 0, 1, 5, 6
EDGE_A, EDGE_B, OUTPUT_AB = 2, 3, 1

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


class DelayGenerator(Gate):
    """Stanford DG645: after each command the error queue is queried and the setting read back.

    The camera's field pulse is connected to the trigger input; a hold-off keeps early triggers from
    opening the gate too often.
    """

    # No triggers, and an idle level of 0 V, which keeps the gate unit closed
    shut_commands = (f"TSRC {SINGLE_SHOT}", "LPOL 1,1", "LOFF 1,0")

    shut_settings = (
        ("trigger source", "TSRC?", SINGLE_SHOT),
        ("output polarity", "LPOL? 1", 1),
        ("idle level", "LOFF? 1", 0),
    )
    step_ns, dead_ns = 5e-3, 100.0
    sources: ClassVar[dict[Sync, int]] = {
        "free-running": INTERNAL,
        "triggered": EXTERNAL,
        "line-locked": LINE,
    }
    source_command, source_question, delay_question = "TSRC", "TSRC?", "DLAY? {}"
    status_question, triggered_bit, lost_bit = "INSR?", 1, 2

    def identify(self) -> str:
        identity = self._identity("*IDN?", r".*DG645.*", "a DG645")
        self.line.write("*CLS")
        return identity

    def _program(self, *, width_ns: float, rate_hz: float, delay_ns: float, sync: Sync) -> float:
        for edge in (4, 5, 6, 7, 8, 9):
            self._set(f"DLAY {edge},0,0")
        hold_s = HOLDOFF / rate_hz if sync == "triggered" else 0.0
        advanced = int(hold_s > 0.0)
        modes = (
            ("burst mode", "BURM 0", "BURM?", 0),
            ("trigger prescaler", "PRES 0,1", "PRES? 0", 1),
            ("output prescaler", f"PRES {OUTPUT_AB},1", f"PRES? {OUTPUT_AB}", 1),
            ("trigger hold-off", f"HOLD {hold_s:.12f}", "HOLD?", hold_s),
            ("advanced triggering", f"ADVT {advanced}", "ADVT?", advanced),
            ("inhibit input", "INHB 0", "INHB?", 0),
        )
        for _, command, _, _ in modes:
            self._set(command)
        self._set(f"LAMP {OUTPUT_AB},{GATE_LEVEL_V:g}")
        if sync == "free-running":
            self._set(f"TRAT {rate_hz:.6f}")
        self._set(f"DLAY {EDGE_A},0,{delay_ns * 1e-9:.12f}")
        self._set(f"DLAY {EDGE_B},{EDGE_A},{width_ns * 1e-9:.12f}")
        for setting, _, question, value in modes:
            self._verify(setting, question, value, tolerance=1e-9)
        if sync == "free-running":
            self._verify("trigger rate", "TRAT?", rate_hz, tolerance=1e-5 * rate_hz)
        self._verify("amplitude", f"LAMP? {OUTPUT_AB}", GATE_LEVEL_V, tolerance=0.05)
        self._verify_delay("gate delay", EDGE_A, 0, delay_ns)
        return self._verify_delay("gate width", EDGE_B, EDGE_A, width_ns)

    def _error(self) -> tuple[int, str]:
        code = self.line.query_int("LERR?")
        return code, f"error {code}: {ERRORS.get(code, 'an error it does not explain')}"


MODEL = InstrumentModel(
    name="dg645",
    role="gate",
    title="delay generator",
    line=lambda port, address: FramedLine(port, name="delay generator"),
    driver=DelayGenerator,
    hardware_handshake=True,
)
