"""Errors of instruments and cameras, one class for each remedy."""

from typing import Any, Self


class BenchError(Exception):
    """An instrument failed; one sentence with instrument, rule and value. Use it to catch any error
    of the bench.
    """

    def __init__(self, sentence: str, *, instrument: str = "bench") -> None:
        super().__init__(sentence)
        self.instrument = instrument

    @classmethod
    def of(cls, instrument: str, rule: str, got: object, **details: Any) -> Self:
        """Return the error of an instrument that broke a rule; `details` are further arguments of
        the class.
        """
        return cls(f"the {instrument} must {rule}, got {got}", instrument=instrument, **details)


class InstrumentTimeout(BenchError):
    """No complete reply within the time limit: the line is open, the instrument off, hung or
    late.
    """


class InstrumentDisconnected(BenchError):
    """The port is gone, cannot be opened or is in use by another program: check the cable."""


class InstrumentRejected(BenchError):
    """The instrument did not obey a command, or reads back another value; `code` is its error
    code.
    """

    def __init__(
        self, sentence: str, *, instrument: str = "bench", code: int | None = None
    ) -> None:
        super().__init__(sentence, instrument=instrument)
        self.code = code


class InstrumentTripped(BenchError):
    """The high-voltage supply switched itself off: find the cause before the voltage is raised
    again.
    """


class InstrumentReplyError(BenchError):
    """The reply has not the form of the query: another instrument, or a reply to another query."""


class CameraError(BenchError):
    """A camera is missing, in use by another program, refuses a setting, or stopped sending."""


class BenchServerLost(BenchError):
    """The bench server is gone or does not answer: make the bench safe by other means."""


class BenchStopped(BenchError):
    """A safe action was asked for at once, or has taken the line over: what goes on ends without
    another command or frame.
    """
