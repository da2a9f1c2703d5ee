"""Findings of checks: a finding with effect and remedy, a flag with a note, or a note alone."""

from collections.abc import Sequence

from labdata import flags

Finding = flags.Finding | tuple[str | None, str]


def flag_of(finding: Finding) -> str | None:
    """Return the flag; None for a note alone."""
    return finding.flag if isinstance(finding, flags.Finding) else finding[0]


def note_of(finding: Finding) -> str:
    """Return the note."""
    return finding.note if isinstance(finding, flags.Finding) else finding[1]


def flags_of(findings: Sequence[Finding]) -> tuple[str, ...]:
    """Return the flags without repetition."""
    return tuple(dict.fromkeys(flag for one in findings if (flag := flag_of(one))))


def notes_of(findings: Sequence[Finding]) -> tuple[str, ...]:
    """Return the notes without repetition."""
    return tuple(dict.fromkeys(note_of(one) for one in findings))
