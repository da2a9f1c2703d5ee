"""What an answer must be: a number, or the value that was set; anything else ends in one sentence."""

import math

from drivers.errors import InstrumentRejected, InstrumentReplyError
from drivers.serial_lines.line import InstrumentLine

LONGEST_QUOTE = 100
"""Characters of an answer that a sentence repeats."""


def query_float(line: InstrumentLine, question: str) -> float:
    """Ask, and return the answer as a finite number; anything else is InstrumentReplyError."""
    return parse_float(line.ask(question), line=line, question=question)


def query_int(line: InstrumentLine, question: str) -> int:
    """Ask, and return the answer as a whole number; anything else is InstrumentReplyError."""
    value = query_float(line, question)
    if value != round(value):
        raise reply_error(line, f"answer {question} with a whole number", f"{value:g}")
    return round(value)


def parse_float(answer: str, *, line: InstrumentLine, question: str) -> float:
    """Read an answer as a finite number."""
    try:
        value = float(answer)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise reply_error(line, f"answer {question} with a number", repr(answer))
    return value


def verify_read_back(line: InstrumentLine, question: str, value: float, *, within: float = 0.0) -> None:
    """Ask for a setting; one that is not as it was set is InstrumentRejected."""
    answer = query_float(line, question)
    if abs(answer - value) > within:
        raise rejected_error(line, f"answer {question} with {value:g} as set", f"{answer:g}")


def reply_error(line: InstrumentLine, rule: str, got: str) -> InstrumentReplyError:
    """Return the error of an answer that is not of the form its question asks for."""
    return InstrumentReplyError(f"the {line.name} must {rule}, got {got[:LONGEST_QUOTE]}", instrument=line.name)


def rejected_error(line: InstrumentLine, rule: str, got: str, *, code: int | None = None) -> InstrumentRejected:
    """Return the error of an instrument that did not obey."""
    return InstrumentRejected(
        f"the {line.name} must {rule}, got {got[:LONGEST_QUOTE]}", instrument=line.name, code=code
    )
