"""What an answer must be: a number, or the value that was set; anything else ends in one sentence."""

import math

from drivers.errors import InstrumentConfused, InstrumentRefused
from drivers.wire.line import Line

LONGEST_QUOTE = 100
"""Characters of an answer that a sentence repeats."""


def asked_number(line: Line, question: str) -> float:
    """Ask, and return the answer as a finite number; anything else is InstrumentConfused."""
    return number(line.ask(question), line=line, question=question)


def asked_whole(line: Line, question: str) -> int:
    """Ask, and return the answer as a whole number; anything else is InstrumentConfused."""
    value = asked_number(line, question)
    if value != round(value):
        raise confused(line, f"answer {question} with a whole number", f"{value:g}")
    return round(value)


def number(answer: str, *, line: Line, question: str) -> float:
    """Read an answer as a finite number."""
    try:
        value = float(answer)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise confused(line, f"answer {question} with a number", repr(answer))
    return value


def expect(line: Line, question: str, value: float, *, within: float = 0.0) -> None:
    """Ask for a setting; one that is not as it was set is InstrumentRefused."""
    answer = asked_number(line, question)
    if abs(answer - value) > within:
        raise refused(line, f"answer {question} with {value:g} as set", f"{answer:g}")


def confused(line: Line, rule: str, got: str) -> InstrumentConfused:
    """Return the error of an answer that is not of the form its question asks for."""
    return InstrumentConfused(f"the {line.name} must {rule}, got {got[:LONGEST_QUOTE]}", instrument=line.name)


def refused(line: Line, rule: str, got: str, *, code: int | None = None) -> InstrumentRefused:
    """Return the error of an instrument that did not obey."""
    return InstrumentRefused(f"the {line.name} must {rule}, got {got[:LONGEST_QUOTE]}", instrument=line.name, code=code)
