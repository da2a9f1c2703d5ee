"""Findings of checks and their likely causes, and the method and provenance of every measurement of
noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from charact import verdict
from charact.estimators.noise.thresholds import SWEEP
from charact.frames.rounding import (
    FEWEST_DIFFERENCES,
    QUANTISATION_DN2,
    QUANTISED_DN2,
    rounding_step,
)
from charact.method import Context
from labdata import Provenance, Session, open_lazy_stack


class Unmeasurable(Exception):
    """A quantity that the data cannot give; the message is the reason of its refusal."""


class Finding(NamedTuple):
    """What a check found: a flag with its note, or a note alone."""

    flag: str | None
    note: str


def with_remedy(flag: str, effect: str, remedy: str) -> Finding:
    """Return a finding of a flag whose note names the effect and what settles it."""
    return Finding(flag, verdict.Finding(flag=flag, effect=effect, remedy=remedy).note)


def flags_of(findings: Sequence[Finding]) -> tuple[str, ...]:
    """Return the flags without repetition."""
    return tuple(dict.fromkeys(finding.flag for finding in findings if finding.flag))


def notes_of(findings: Sequence[Finding]) -> tuple[str, ...]:
    """Return the notes without repetition; that of a flag begins with it."""
    named = (
        f"{finding.flag}: {finding.note}"
        if finding.flag and finding.note and not finding.note.startswith(f"{finding.flag}: ")
        else finding.note
        for finding in findings
    )
    return tuple(dict.fromkeys(named))


def provenance(context: Context, **settings) -> Provenance:
    """Return version, seed and settings."""
    from charact import __version__

    known = {
        "interlaced": context.interlaced,
        "quick": context.quick,
        "pitch_ratio": context.pitch_ratio,
    }
    return Provenance(version=__version__, seed=context.seed, settings=known | settings)


def fields_of(method: str, context: Context, **settings) -> dict[str, Any]:
    """Return the fields common to all measurements of a method."""
    return {"method": method, "provenance": provenance(context, **settings)}


@dataclass(frozen=True, kw_only=True)
class Cause:
    """Stage of the camera, or fault of its frames, that may be the cause of a deviation, and what
    settles it.
    """

    stage: str
    remedy: str

    def finding(self, flag: str, evidence: str) -> verdict.Finding:
        """Return the finding of a flag by what was seen."""
        return verdict.Finding(flag=flag, effect=f"{self.stage}: {evidence}", remedy=self.remedy)


AVERAGED = Cause(
    stage="frames averaged with earlier ones, in the grabber or by noise reduction in time",
    remedy="frames without averaging or noise reduction",
)
LAGGING = Cause(
    stage=(
        "image lag, as of a phosphor unlike its description, or frames averaged with earlier ones"
    ),
    remedy="frames without averaging, or a description of the phosphor's decay",
)
UNSTEADY = Cause(
    stage="drift or a step of lamp or gain within a stack, as of automatic gain",
    remedy="automatic gain off, and a lamp that has settled",
)
AUTOMATIC = Cause(stage="automatic gain or brightness control", remedy="both switched off")
COARSE = Cause(
    stage="a digitiser of fewer bits than the session says, or a bit that is stuck",
    remedy="the camera's mode of full depth, or frames divided by the step and their bit_depth",
)
CURVED = Cause(
    stage="a nonlinear response or gamma of amplifier, digitiser or grabber, saturation of the "
    "microchannel plate, or light other than stated",
    remedy="a gamma of 1, flats of the linear range only, and the light of each as it was",
)
PROCESSING = Cause(
    stage="sharpening, noise reduction or averaging of frames in camera or grabber",
    remedy="frames with processing switched off (raw)",
)
SHARPENED = Cause(
    stage="sharpening in camera or grabber, or a wider video band than described",
    remedy="frames with sharpening switched off (raw)",
)
SPREAD = Cause(
    stage=(
        "blur, interpolation or a correction of distortion in camera or grabber, or noise of rows"
    ),
    remedy="frames without processing (raw)",
)
OFF_AXIS = Cause(
    stage="blur after the gain that grows off axis, or a correction of distortion in the camera",
    remedy="frames without correction of distortion; the description of a fibre taper",
)
LENS_OFF_AXIS = Cause(
    stage="blur of lens or tube that grows off axis",
    remedy="edges of which each lies at one distance from the axis",
)


def flags_of_rounding(variance_dn2: float) -> tuple[str, ...]:
    """Return the flag of noise smaller than the quantisation step."""
    return ("quantised",) if variance_dn2 < QUANTISED_DN2 else ()


def step_finding(session: Session) -> verdict.Finding | None:
    """Return the finding of darks and flats whose grey values are multiples of a step that adds to
    their noise.

    A digitiser of fewer bits than its frames rounds to steps of s DN, whose variance is s^2/12
    where 1/12 is counted. The finding is raised where the difference exceeds
    `SWEEP.max_quantisation` of the least variance.
    """
    stacks = [open_lazy_stack(entry) for entry in session.of_kind("dark", "flat")]
    first = [stack.frames(0, 1)[0] for stack in stacks]
    step = rounding_step(first, FEWEST_DIFFERENCES) or 1.0
    pairs = (
        [stack.frames(0, 2).astype(float) for stack in stacks if len(stack) > 1] if step > 1 else []
    )
    if not pairs:
        return None
    variance_dn2 = min(float(np.var(pair[1] - pair[0])) / 2.0 for pair in pairs)
    added = (step**2 - 1.0) * QUANTISATION_DN2
    if added <= SWEEP.max_quantisation * variance_dn2:
        return None
    return COARSE.finding(
        "quantised",
        f"all grey values are multiples of {step:g} DN: rounding adds {added:.3g} DN2 to a least "
        f"variance of {variance_dn2:.3g} DN2, and levels of a digitiser that cuts off are "
        f"{(step - 1.0) / 2.0:g} DN low",
    )
