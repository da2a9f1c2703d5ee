"""What a check finds: a flag, or none, and its sentence."""

from collections.abc import Sequence

Finding = tuple[str | None, str]


def flags_of(findings: Sequence[Finding]) -> tuple[str, ...]:
    """The flags, each once."""
    return tuple(dict.fromkeys(flag for flag, _ in findings if flag))


def notes_of(findings: Sequence[Finding]) -> tuple[str, ...]:
    """The sentences, each once."""
    return tuple(dict.fromkeys(sentence for _, sentence in findings))
