"""Gate generator: Stanford DG535 delay generator behind a GPIB adapter, AB output at TTL level.

A question is a command without its last argument; there is no question for the identity. The output
stays at TTL level, 0 V at rest and 4 V from A to B. Facts are from the maker's manual; dead time
and digits of the rate are recalled.
"""

import re
from typing import ClassVar

from drivers.instruments.gate_limits import Gate
from drivers.instruments.instrument import InstrumentModel
from drivers.serial_lines.line import PrologixLine
from labdata.errors import BadInput
from labdata.gating import Sync

RATE_DIGITS = 4
INTERNAL, SINGLE_SHOT, LINE = 0, 2, 4
T0, A, B, AB, C, D = range(1, 7)
TTL, POSITIVE, HIGH_IMPEDANCE = 0, 1, 1
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


class Dg535(Gate):
    """Stanford DG535, without trigger hold-off and therefore without camera trigger."""

    shut_commands = (f"TM {SINGLE_SHOT}", f"OM {AB},{TTL}", f"OP {AB},{POSITIVE}")
    shut_settings = (
        ("trigger source", "TM", SINGLE_SHOT),
        ("output level", f"OM {AB}", TTL),
        ("output polarity", f"OP {AB}", POSITIVE),
    )
    step_ns, dead_ns = 5e-3, 1000.0
    sources: ClassVar[dict[Sync, int]] = {"free-running": INTERNAL, "line-locked": LINE}
    source_command, source_question, delay_question = "TM", "TM", "DT {}"
    status_question, triggered_bit, lost_bit = "IS", 4, 16

    def identify(self) -> str:
        """Identify it by the form of a delay, and clear old errors."""
        if not _DELAY.fullmatch(answer := self.line.ask(f"DT {A}")):
            raise self.line.reply_error(
                f"answer DT {A} with an edge and a delay, as a DG535 does", repr(answer)
            )
        self.line.ask("ES")
        return "DG535"

    def check_pulse(
        self, *, width_ns: float, rate_hz: float, delay_ns: float = 0.0, sync: Sync = "free-running"
    ) -> None:
        if sync not in self.sources:
            # Without hold-off, ringing of the trigger input would open the gate too often.
            raise BadInput(
                f"a DG535 must be {' or '.join(self.sources)}, as it has no trigger holdoff, got "
                f"{sync}"
            )
        super().check_pulse(width_ns=width_ns, rate_hz=rate_hz, delay_ns=delay_ns, sync=sync)

    def _program(self, *, width_ns: float, rate_hz: float, delay_ns: float, sync: Sync) -> float:
        for edge in (C, D):
            self._set(f"DT {edge},{T0},0")
        self._set(f"TZ {AB},{HIGH_IMPEDANCE}")
        if sync == "free-running":
            self._set(f"TR 0,{rate_hz:.{RATE_DIGITS}g}")
        self._set(f"DT {A},{T0},{delay_ns * 1e-9:.12f}")
        self._set(f"DT {B},{A},{width_ns * 1e-9:.12f}")
        if sync == "free-running":
            self._verify(
                "trigger rate", "TR 0", rate_hz, tolerance=0.5 * 10.0 ** (1 - RATE_DIGITS) * rate_hz
            )
        self._verify_delay("gate delay", A, T0, delay_ns)
        return self._verify_delay("gate width", B, A, width_ns)

    def _error(self) -> tuple[int, str]:
        status = self.line.query_int("ES")
        meanings = ", ".join(meaning for bit, meaning in enumerate(ERRORS) if status >> bit & 1)
        return status, f"error status {status}: {meanings or 'unexplained'}"


MODEL = InstrumentModel(
    name="dg535",
    role="gate",
    title="delay generator",
    line=lambda port, address: PrologixLine(port, name="delay generator", address=address),
    driver=Dg535,
)
