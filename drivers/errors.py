"""What can go wrong with an instrument: a small tree, each branch one that a caller can do something about."""


class BenchError(Exception):
    """An instrument failed.

    The message is one sentence that names the instrument, the rule and the value. Use it to catch whatever happens
    at the bench; `instrument` is the one that failed.
    """

    def __init__(self, sentence: str, *, instrument: str = "bench") -> None:
        super().__init__(sentence)
        self.instrument = instrument


class InstrumentTimeout(BenchError):
    """No answer, or only a part of one, within the time allowed.

    Use this when the line is open and the instrument says nothing: it may be off, hung, or late.
    """


class InstrumentDisconnected(BenchError):
    """The port is gone, cannot be opened or is held by another program.

    Use this when talking again makes no sense before somebody looks at the cable.
    """


class InstrumentRejected(BenchError):
    """The instrument heard the command and did not obey, or reads back another value than it was given.

    Use this when the instrument is healthy and the setting is not; `code` is the instrument's own error code.
    """

    def __init__(self, sentence: str, *, instrument: str = "bench", code: int | None = None) -> None:
        super().__init__(sentence, instrument=instrument)
        self.code = code


class InstrumentTripped(BenchError):
    """The high-voltage supply switched itself off.

    Use this when a person has to find out why before the voltage is raised again.
    """


class InstrumentReplyError(BenchError):
    """The answer is not of the form that the question asks for.

    Use this when another instrument, or an answer to another question, is on the line.
    """


class BenchServerLost(BenchError):
    """The process that owns the serial ports is gone or does not answer.

    Use this when no process guards the bench any more: make it safe by other means.
    """


class BenchStopped(BenchError):
    """The bench is being made safe, and only the safe action may speak to its instruments.

    Use this in a procedure that has to end without an order of its own.
    """
