"""How a Stanford Research instrument reads a line: `;` separates, case is free, blanks before arguments optional."""

import re
from dataclasses import dataclass

_COMMAND = re.compile(r"^(\*[A-Z]{3}|[A-Z]{4})(\?)?\s*(.*)$", re.DOTALL)


@dataclass(frozen=True, kw_only=True)
class Command:
    """One command of a line.

    Parameters
    ----------
    mnemonic
        Upper-case mnemonic, such as "DLAY" or "*IDN".
    query
        Whether it asks.
    arguments
        Arguments as they were written, stripped of blanks.
    """

    mnemonic: str
    query: bool
    arguments: tuple[str, ...]


def commands_of(line: str) -> list[Command | None]:
    """Split a line into commands; None stands for text that is no command at all."""
    return [_command(part) for part in line.upper().split(";") if part.strip()]


def _command(text: str) -> Command | None:
    match = _COMMAND.match(text.strip())
    if match is None:
        return None
    mnemonic, mark, rest = match.groups()
    arguments = tuple(part.strip() for part in rest.split(",")) if rest.strip() else ()
    return Command(mnemonic=mnemonic, query=bool(mark), arguments=arguments)
