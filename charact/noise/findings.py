"""What a check finds: a finding with its effect and remedy, a flag with its sentence, or a sentence alone."""

from collections.abc import Sequence

from labdata import flags

Finding = flags.Finding | tuple[str | None, str]


def flag_of(finding: Finding) -> str | None:
    """Return the flag; None for a sentence alone."""
    return finding.flag if isinstance(finding, flags.Finding) else finding[0]


def note_of(finding: Finding) -> str:
    """Return the sentence."""
    return finding.note if isinstance(finding, flags.Finding) else finding[1]


def flags_of(findings: Sequence[Finding]) -> tuple[str, ...]:
    """Return the flags, each once."""
    return tuple(dict.fromkeys(flag for one in findings if (flag := flag_of(one))))


def notes_of(findings: Sequence[Finding]) -> tuple[str, ...]:
    """Return the sentences, each once."""
    return tuple(dict.fromkeys(note_of(one) for one in findings))
