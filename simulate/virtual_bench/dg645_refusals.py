"""What a Stanford DG645 refuses: its error codes, and how it reads numbers."""

import math

ILLEGAL_VALUE, ILLEGAL_MODE, ILLEGAL_DELAY, ILLEGAL_LINK, RECALL_FAILED = 10, 11, 12, 13, 14
ILLEGAL_COMMAND, UNDEFINED_COMMAND, ILLEGAL_QUERY, ILLEGAL_SET, NULL_PARAMETER = 110, 111, 112, 113, 114
EXTRA_PARAMETERS, MISSING_PARAMETERS, BAD_FLOAT, BAD_INTEGER = 115, 116, 118, 120
OVERRUN, TOO_MANY_ERRORS = 171, 254


class RefusedCommand(Exception):
    """The instrument does not do this; `code` goes to its error queue."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


def numbers(arguments: tuple[str, ...], kinds: tuple[type, ...]) -> list:
    """Read arguments as numbers of the given kinds; a wrong count or form is refused with its own code."""
    if len(arguments) != len(kinds):
        raise RefusedCommand(MISSING_PARAMETERS if len(arguments) < len(kinds) else EXTRA_PARAMETERS)
    return [_number(text, kind) for text, kind in zip(arguments, kinds, strict=True)]


def _number(text: str, kind: type) -> float:
    if not text:
        raise RefusedCommand(NULL_PARAMETER)
    try:
        value = kind(text)
    except ValueError:
        raise RefusedCommand(BAD_FLOAT if kind is float else BAD_INTEGER) from None
    if not math.isfinite(value):
        raise RefusedCommand(BAD_FLOAT)
    return value
