"""Findings of checks with their remedies and likely causes, and the method and provenance of every
measurement of noise.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from charact.estimators.noise.thresholds import CHECKS, SWEEP
from charact.frames.rounding import (
    FEWEST_DIFFERENCES,
    QUANTISATION_DN2,
    QUANTISED_DN2,
    rounding_step,
    variance_range_before_rounding,
)
from charact.method import Context
from charact.verdict import Finding, judge
from labdata import Measurement, Posterior, Provenance, Session, open_lazy_stack
from labdata.flags import FLAGS

# What was seen in data: findings, which `judge` weighs, and plain notes.
Remarks = list[Finding | str]
REMEDIES = {
    "amplifiers": "`amplifier`, or the numbers of each",
    "agc": "automatic gain and brightness control switched off",
    "clipped": "a black level and light at which no pixel reaches an end of the scale",
    "correlated-noise": "`method` covariance-sum",
    "defects": "a cooler sensor",
    "drift": "a lamp that has settled, or fewer frames",
    "extrapolated": "flats at that light",
    "flicker": "a lamp on direct current, or exposures of whole periods",
    "gamma": "linear frames (raw, a gamma of 1)",
    "interlace-motion": "`interlaced`",
    "lag": "more frames, or a longer time between them",
    "low-signal": "a higher gain of the tube",
    "model-misfit": "raw frames of steady light without shading",
    "no-darks": "dark frames at the settings of the flats",
    "nonlinear": "flats of the linear range only",
    "not-converged": "more frames, or another `seed`",
    "prior-bound": "more frames",
    "processed": "frames with sharpening and noise reduction switched off (raw)",
    "quantised": "a higher camera gain or bit depth",
    "saturated": "flats of less light",
    "several-modes": "more frames",
    "too-few-frames": "more frames",
    "unlike-conditions": "darks at every setting",
}


class Unmeasurable(Exception):
    """A quantity that the data cannot give; the message is the reason of its refusal."""


def finding(
    flag: str, effect: str, remedy: str = "", *, bound: float | None = None, sign: int = 0
) -> Finding:
    """Return the finding of a flag with its effect, and the remedy of the flag without another."""
    return Finding(
        flag=flag, effect=effect, remedy=remedy or REMEDIES[flag], bound=bound, sign=sign
    )


def findings_in(remarks: Iterable[Finding | str]) -> list[Finding]:
    """Return what was seen without the plain notes."""
    return [entry for entry in remarks if isinstance(entry, Finding)]


def bounded(remarks: Iterable[Finding | str], bound: float | None = None, sign: int = 0) -> Remarks:
    """Return what was seen with one bound in the unit of a quantity; without one unbounded."""
    return [
        replace(entry, bound=bound, sign=sign) if isinstance(entry, Finding) else entry
        for entry in remarks
    ]


def scaled(remarks: Iterable[Finding | str], value: float) -> Remarks:
    """Return what was seen with relative bounds times the value that they concern."""
    return [
        replace(entry, bound=entry.bound * abs(value))
        if isinstance(entry, Finding) and entry.bound is not None
        else entry
        for entry in remarks
    ]


def judged(measurement: Measurement, remarks: Sequence[Finding | str]) -> Measurement:
    """Return a measurement with the plain notes, judged by the findings."""
    plain = dict.fromkeys(entry for entry in remarks if isinstance(entry, str))
    noted = replace(measurement, notes=(*measurement.notes, *plain))
    return judge(noted, findings_in(remarks))


def posterior_findings(posterior: Posterior) -> list[Finding]:
    """Return the findings of a posterior's flags."""
    return [finding(flag, FLAGS[flag].rstrip(".")) for flag in posterior.flags]


def rounding_findings(variance_dn2: float, included_dn2: float = QUANTISATION_DN2) -> list[Finding]:
    """Return the finding of noise smaller than the quantisation step, with its bound on the
    standard deviation, DN.

    Noise of variance v before rounding to steps s has the variance v + s^2/12 where rounding is
    independent; v lies within `variance_range_before_rounding`. `included_dn2`: what the printed
    noise holds of s^2/12.
    """
    if variance_dn2 >= QUANTISED_DN2:
        return []
    noise_dn = max(variance_dn2, 0.0) ** 0.5
    printed_dn2 = max(variance_dn2 - QUANTISATION_DN2 + included_dn2, 0.0)
    effects_dn = [
        printed_dn2**0.5 - (before_dn2 + included_dn2) ** 0.5
        for before_dn2 in variance_range_before_rounding(noise_dn**2)
    ]
    low, high = min(effects_dn), max(effects_dn)
    return [
        finding(
            "quantised",
            f"the noise of {noise_dn:.2g} DN is smaller than the quantisation step",
            bound=max(-low, high),
            sign=-1 if high < 0.0 else 1 if low > 0.0 else 0,
        )
    ]


def clipping_effects(
    fraction: float, noise_dn: float, mean_dn: float
) -> tuple[float | None, float | None]:
    """Return by how much values cut off at 0 DN raise the mean and lower the standard deviation of
    noise, DN; None where noise does not explain so many values at 0 DN.

    Of normal noise of standard deviation s, cut at z s with the fraction p = Phi(z) below, the mean
    is s (m - z) with m = phi(z) + z p, and the variance s^2 (1 - p + z phi(z) + z^2 p - m^2).
    Pulses above the noise leave less of the standard deviation to what is cut.
    """
    from scipy.special import ndtri

    if not 0.0 < fraction < CHECKS.unbounded_clipping:
        return (None, None) if fraction else (0.0, 0.0)
    z = float(ndtri(fraction))
    density = float(np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi))
    raised = density + z * fraction
    sd_dn = noise_dn / float(np.sqrt(1.0 - fraction + z * density + z**2 * fraction - raised**2))
    if mean_dn > CHECKS.explained_clipping * sd_dn * (raised - z):
        return None, None
    return sd_dn * raised, sd_dn - noise_dn


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

    def finding(self, flag: str, evidence: str) -> Finding:
        """Return the finding of a flag by what was seen."""
        return Finding(flag=flag, effect=f"{self.stage}: {evidence}", remedy=self.remedy)


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


def step_finding(session: Session) -> Finding | None:
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
