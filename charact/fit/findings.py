"""Likely causes of what a fit meets: flags of its measurements, a misfit, and automatic gain."""

from charact.method.causes import AUTOMATIC, CURVED, LAGGING, PROCESSING, SPREAD, UNSTEADY, Cause
from labdata.conditions import Conditions
from labdata.flags import Finding
from labdata.measurement import Measurement, Result

# Flags by which a measurement speaks of a stage of the camera or bench that the fit does not know. Others are of the
# target, the number of frames or the method.
CAUSES = {
    "agc": AUTOMATIC, "nonlinear": CURVED, "gamma": CURVED, "processed": PROCESSING, "correlated-noise": SPREAD,
    "drift": UNSTEADY, "flicker": UNSTEADY,
}  # fmt: skip
# What an observation that no parameters explain may come from, by its name.
CAUSES_OF_MISFIT = {
    "levels": CURVED,
    "photon transfer": CURVED,
    "noise": Cause(
        stage=f"{CURVED.stage}, or sharpening or interpolation in camera or grabber",
        remedy="raw frames of a gamma of 1, of the linear range only",
    ),
    "image lag": LAGGING,
    "covariance of neighbours in a row": SPREAD,
    "offsets of rows": SPREAD,
}


def has_automatic_gain(conditions: Conditions) -> bool:
    """Whether the gain of a stack is unknown, as a control of the camera or tube set it."""
    return bool(conditions.automatic_gain or conditions.brightness_control)


def findings_of(result: Result) -> tuple[Finding, ...]:
    """Return what flags of measurements say of the camera's stages: one finding a flag.

    The fit leaves measurements with most of these flags out, but not the levels and the noise of the same frames. Flags
    of the whole session, which are of its flats, count before those of single targets.
    """
    kept = [m for m in result.measurements if m.status != "refused"]
    whole = _findings_among([m for m in kept if m.stack is None])
    return whole or _findings_among(kept)


def _findings_among(measurements: list[Measurement]) -> tuple[Finding, ...]:
    found = []
    for flag, cause in CAUSES.items():
        own = [m for m in measurements if flag in m.flags]
        if own:
            notes = dict.fromkeys(n.partition(": ")[2] for m in own for n in m.notes if n.startswith(f"{flag}: "))
            seen = next(iter(notes), f"flag of {own[0].quantity}").partition("; what settles it")[0]
            found.append(cause.finding(flag, seen))
    return tuple(found)


def misfit_finding(parts: dict[str, float], numbers: int, factor: float) -> Finding:
    """Return the finding of a misfit: the observation with most of it, and its likely cause.

    Parameters
    ----------
    parts
        Chi-squared of each observation by its name.
    numbers
        Number of observed numbers.
    factor
        Factor by which all errors are multiplied.
    """
    worst = max(parts, key=lambda name: parts[name])
    cause = CAUSES_OF_MISFIT.get(worst)
    said = (
        f"chi-squared {sum(parts.values()):.0f} for {numbers} numbers, {parts[worst]:.0f} of it from {worst}; "
        f"all errors were multiplied by {factor:.1f}"
    )
    return Finding(
        flag="model-misfit",
        effect=said if cause is None else f"{said}; likely {cause.stage}",
        remedy="a description that fits the camera" if cause is None else cause.remedy,
    )
