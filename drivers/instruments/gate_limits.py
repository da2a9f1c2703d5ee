"""Common part of the gate generators: pulse limits and comparison with the settings."""

import time
from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

from drivers.errors import InstrumentRejected
from drivers.instruments.instrument import Instrument
from drivers.serial_lines.line import LONGEST_QUOTE, InstrumentLine
from labdata.errors import BadInput
from labdata.gating import Sync

MISSED_TRIGGERS = 2.0  # Trigger periods without a trigger after which the trigger counts as missing


class Gate(Instrument):
    """A pulse generator; its AB output drives a gate unit that is open while the level is high.

    It stores the reply to each setting that was read back, and `look` compares the present replies
    with them.
    """

    shut_commands: ClassVar[
        tuple[str, ...]
    ]  # Commands that shut the gate at once, sent one by one by the safe action

    shut_settings: ClassVar[
        tuple[tuple[str, str, int], ...]
    ]  # Read-backs of a shut gate: setting, query and reply

    step_ns: ClassVar[float]
    dead_ns: ClassVar[float]  # Time after the longest delay before the next trigger is accepted, ns

    sources: ClassVar[Mapping[Sync, int]]
    source_command: ClassVar[str]
    source_question: ClassVar[str]
    delay_question: ClassVar[str]
    status_question: ClassVar[str]
    triggered_bit: ClassVar[int]
    lost_bit: ClassVar[int]

    def __init__(self, line: InstrumentLine) -> None:
        super().__init__(line)
        self._kept: dict[str, tuple[str, str]] = {}  # setting and answer, by question
        self._external_hz, self._triggered_s = 0.0, 0.0

    def look(self) -> None:
        """Compare every setting with its read-back, and require the triggers of an external
        source.
        """
        if not self._kept:
            self.line.query_int(self.source_question)
        for question, (setting, answer) in self._kept.items():
            if (now := self.line.ask(question)) != answer:
                raise self.line.rejection(
                    f"keep its {setting} at {answer[:LONGEST_QUOTE]}",
                    f"{now[:40]}: somebody changed it at the panel, or it lost its settings",
                )
        if self._external_hz:
            self._require_triggers(self._external_hz, is_external=True)

    def check_pulse(
        self, *, width_ns: float, rate_hz: float, delay_ns: float = 0.0, sync: Sync = "free-running"
    ) -> None:
        """Require a pulse that this model can make; the parameters are those of `open`.

        The pulse must end before the next trigger, and width and delay are rounded by at most a
        millionth of it.
        """
        longest_ns = 1e9 / rate_hz - self.dead_ns - delay_ns
        if not self.step_ns <= width_ns <= longest_ns:
            raise BadInput(
                f"gate_ns must lie between {self.step_ns:g} and {longest_ns:.0f} at {rate_hz:g} "
                f"triggers a second, got {width_ns:g}"
            )
        if not delay_ns >= 0.0:
            raise BadInput(f"the delay of the gate must not be negative, got {delay_ns:g} ns")
        for name, value_ns in (("gate_ns", width_ns), ("the delay of the gate, ns,", delay_ns)):
            # Negligible relative rounding of a pulse: a field time is not a multiple of 5 ps
            if abs(value_ns - self.step_ns * round(value_ns / self.step_ns)) > 1e-6 * max(
                width_ns, value_ns
            ):
                raise BadInput(
                    f"{name} must be a multiple of the generator's {self.step_ns:g} ns, got "
                    f"{value_ns:.12g}"
                )

    def shut(self) -> None:
        """Shut the gate: no triggers, idle level 0 V; read back."""
        self._kept, self._external_hz = {}, 0.0
        self._set(*self.shut_commands)
        for setting, question, value in self.shut_settings:
            self._verify(setting, question, value)

    def open(
        self, *, width_ns: float, rate_hz: float, delay_ns: float = 0.0, sync: Sync = "free-running"
    ) -> float:
        """Open the gate for a time at each trigger, and return the width as read back, ns.

        Parameters
        ----------
        rate_hz
            Trigger rate, Hz: one trigger per field of the camera.
        delay_ns
            Delay from trigger to gate pulse, ns.

        Raises
        ------
        BadInput
            If this model cannot make the pulse, see `check_pulse`.
        InstrumentRejected
            If the instrument refuses a setting, reads another one back, loses triggers, or receives
            none.
        """
        self.check_pulse(width_ns=width_ns, rate_hz=rate_hz, delay_ns=delay_ns, sync=sync)
        self.shut()
        del self._kept[self.source_question]
        read_ns = self._program(width_ns=width_ns, rate_hz=rate_hz, delay_ns=delay_ns, sync=sync)
        self.line.query_int(self.status_question)
        self._set(f"{self.source_command} {self.sources[sync]}")
        self._verify("trigger source", self.source_question, self.sources[sync])
        self._triggered_s = time.monotonic()
        time.sleep(MISSED_TRIGGERS / rate_hz)
        is_external = sync != "free-running"
        try:
            self._require_triggers(rate_hz, is_external=is_external)
        except InstrumentRejected:
            self.shut()
            raise
        self._external_hz = rate_hz if is_external else 0.0
        return read_ns

    @abstractmethod
    def _program(self, *, width_ns: float, rate_hz: float, delay_ns: float, sync: Sync) -> float:
        """Set and read back all but the trigger source of a shut gate; return the width, ns."""

    def _require_triggers(self, rate_hz: float, *, is_external: bool) -> None:
        status, now_s = self.line.query_int(self.status_question), time.monotonic()
        if status & self.lost_bit:
            raise self.line.rejection("use every trigger", f"some lost at {rate_hz:g} Hz")
        if status & self.triggered_bit:
            self._triggered_s = now_s
        elif is_external and now_s - self._triggered_s >= MISSED_TRIGGERS / rate_hz:
            raise self.line.rejection(f"be triggered {rate_hz:g} times a second", "no trigger")

    def _verify(self, setting: str, question: str, value: float, *, tolerance: float = 0.0) -> None:
        """Read a setting back and keep the answer; one that is not as it was set is
        InstrumentRejected.
        """
        replies = self._kept  # a reply from before a safe action is discarded with its dictionary
        replies[question] = (
            setting,
            self.line.verify_read_back(question, value, tolerance=tolerance),
        )

    def _verify_delay(self, setting: str, edge: int, reference: int, delay_ns: float) -> float:
        """Read back the delay of an edge after another, ns, and store the reply."""
        replies, question = self._kept, self.delay_question.format(edge)
        answer = self.line.ask(question)
        after, _, seconds = answer.partition(",")
        if after != str(reference):
            raise self.line.rejection(f"keep edge {edge} behind edge {reference}", repr(answer))
        read_ns = self.line.parse_float(seconds, question) * 1e9
        if abs(read_ns - delay_ns) > self.step_ns:
            raise self.line.rejection(
                f"keep a {setting} of {delay_ns:g} ns", f"{read_ns:g} ns back"
            )
        replies[question] = setting, answer
        return read_ns
