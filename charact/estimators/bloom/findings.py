"""Findings of the room: the effect of each where its check states no other, and its remedy."""

from collections.abc import Iterable
from dataclasses import replace

from charact.verdict import Finding, judge
from labdata import Measurement

SAME_SETTINGS = "darks and point stacks taken at the same gain, gate and exposure"
# Effect and remedy of each flag.
FINDINGS = {
    "model-misfit": (
        "the frame contradicts a single round source",
        "a frame with a single round source, and a stack between those that differ",
    ),
    "prior-bound": (
        "every core is clipped or beyond the model: the source's signal is hardly known",
        "a stack with an unclipped core",
    ),
    "window-too-small": (
        "what is measured reaches the border of the frame",
        "a larger frame, or the source closer to its centre",
    ),
    "several-targets": (
        "light of another source is included, or pixels of it are missing",
        "one source in the frame, or `roi` around one of them",
    ),
    "quantised": (
        "fewer than 20 DN lie between dark and full scale: rounding moves the threshold's contour",
        "a higher camera gain or more bits, so that noise exceeds 1 DN",
    ),
    "low-signal": (
        "within its noise the signal crosses the threshold at several places",
        "more frames, or more light",
    ),
    "unlike-conditions": ("the background lies below the dark level", SAME_SETTINGS),
    "agc": (
        "the background is fainter than that of the faintest stack: the gain fell",
        "automatic gain and brightness control switched off",
    ),
    "drift": (
        "the source moves, or its light or the background changes, through the stack",
        "a stationary source and a stable lamp, or fewer frames per stack",
    ),
    "lag": (
        "the source is switched off within the stack",
        "a pause after switch-off, and stacks of a constant source",
    ),
    "dark-mismatch": ("noise or background contradicts the dark level", SAME_SETTINGS),
    "clipped": (
        "the streak is at full scale: a lower limit of the full well",
        "a stack whose streak stays below full scale",
    ),
    "extrapolated": (
        "one level of light shows smear: nothing shows that it is proportional to the light",
        "a second stack with smear",
    ),
    "nonlinear": (
        "the fraction changes with the light",
        "stated illuminance proportional to the lamp's",
    ),
    "no-darks": ("the black level is unknown", "darks at the same settings"),
    "not-converged": (
        "the interval may be a third too narrow",
        "another `seed`, or more frames",
    ),
    "several-modes": ("two values fit about equally well", "more frames, or more light"),
}


def finding(flag: str, effect: str | None = None, bound: float | None = None) -> Finding:
    """Return the finding of a flag with its remedy; None: the effect of the table."""
    usual, remedy = FINDINGS[flag]
    return Finding(flag=flag, effect=effect or usual, remedy=remedy, bound=bound)


DIAMETERS = ("bloom_diameter", "bloom_diameter_background", "bloom_diameter_clip")
# Of the region at full scale, whose threshold needs no black level, and the findings of that level.
AT_FULL_SCALE = ("bloom_diameter_clip", "saturated_area")
OF_BLACK_LEVEL = ("dark-mismatch", "unlike-conditions")


def judge_region(measurement: Measurement, findings: Iterable[Finding]) -> Measurement:
    """Judge a quantity by findings whose bounds are those of a bloom's diameter, px."""
    quantity = measurement.quantity
    of_quantity = []
    for check in findings:
        bound = check.bound if quantity in DIAMETERS else None
        if quantity in AT_FULL_SCALE and check.flag in OF_BLACK_LEVEL:
            bound = 0.0
        of_quantity.append(replace(check, bound=bound))
    return judge(measurement, of_quantity)
