"""What can go wrong with an instrument: a small tree, each branch one that a caller can do something about."""

from typing import Any, Self


class BenchError(Exception):
    """An instrument failed.

    The message is one sentence that names the instrument, the rule and the value. Use it to catch whatever happens
    at the bench; `instrument` is the one that failed.
    """

    def __init__(self, sentence: str, *, instrument: str = "bench") -> None:
        super().__init__(sentence)
        self.instrument = instrument

    @classmethod
    def of(cls, instrument: str, rule: str, got: object, **details: Any) -> Self:
        """Return the error of an instrument that broke a rule; `details` are further arguments of the class."""
        return cls(f"the {instrument} must {rule}, got {got}", instrument=instrument, **details)


class InstrumentTimeout(BenchError):
    """No answer, or a part of one, within the time allowed: the line is open and the instrument off, hung or late."""


class InstrumentDisconnected(BenchError):
    """The port is gone, cannot be opened or is held by another program: somebody has to look at the cable."""


class InstrumentRejected(BenchError):
    """The instrument heard the command and did not obey, or reads back another value than it was given.

    Use this when the instrument is healthy and the setting is not; `code` is the instrument's own error code.
    """

    def __init__(self, sentence: str, *, instrument: str = "bench", code: int | None = None) -> None:
        super().__init__(sentence, instrument=instrument)
        self.code = code


class InstrumentTripped(BenchError):
    """The high-voltage supply switched itself off: a person has to find out why before the voltage is raised again."""


class InstrumentReplyError(BenchError):
    """The answer is not of the form that the question asks for: another instrument, or another answer, is there."""


class CameraError(BenchError):
    """A camera is missing, is held by another program, refuses a setting, or stopped sending."""


class BenchServerLost(BenchError):
    """The process that owns the serial ports is gone or does not answer: make the bench safe by other means."""


class BenchStopped(BenchError):
    """The bench is being made safe, and only the safe action may speak: a procedure ends without another order."""
