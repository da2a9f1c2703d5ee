"""Findings of checks, and the method and provenance of every measurement of noise."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from charact.method import Context
from labdata import flags
from labdata.measurement import Provenance


class Unmeasurable(Exception):
    """A quantity that the data cannot give; the message is the reason of its refusal."""


class Finding(NamedTuple):
    """What a check found: a flag with its note, or a note alone."""

    flag: str | None
    note: str


def with_remedy(flag: str, effect: str, remedy: str) -> Finding:
    """Return a finding of a flag whose note names the effect and what settles it."""
    return Finding(flag, flags.Finding(flag=flag, effect=effect, remedy=remedy).note)


def flags_of(findings: Sequence[Finding]) -> tuple[str, ...]:
    """Return the flags without repetition."""
    return tuple(dict.fromkeys(one.flag for one in findings if one.flag))


def notes_of(findings: Sequence[Finding]) -> tuple[str, ...]:
    """Return the notes without repetition; that of a flag begins with it."""
    named = (
        f"{one.flag}: {one.note}" if one.flag and one.note and not one.note.startswith(f"{one.flag}: ") else one.note
        for one in findings
    )
    return tuple(dict.fromkeys(named))


def provenance(context: Context, **settings) -> Provenance:
    """Return version, seed and settings."""
    from charact import __version__

    known = {"interlaced": context.interlaced, "quick": context.quick, "pitch_ratio": context.pitch_ratio}
    return Provenance(version=__version__, seed=context.seed, settings=known | settings)


def fields_of(method: str, context: Context, **settings) -> dict[str, Any]:
    """Return the fields common to all measurements of a method."""
    return {"method": method, "provenance": provenance(context, **settings)}
