"""Findings of point sources: remedies, motion, undersampling."""

from labdata.flags import Finding

REMEDIES = {
    "clipped": "an offset that keeps the noise of dark pixels above the lowest code",
    "saturated": "less light or a shorter exposure, so that no pixel comes near full scale",
    "low-signal": "more light, a longer exposure or more frames",
    "model-misfit": "--roi around one source alone on even ground, focus, and a response without gamma or sharpening",
    "several-targets": "--roi around one source, or sources further apart",
    "window-too-small": "a larger --roi around the source",
    "prior-bound": "another focus or magnification, so that the spot is 1 to 10 px wide",
    "interlace-motion": "a source and a camera at rest, or frames of one field",
    "drift": "a source and a camera at rest, or fewer frames",
    "gamma": "frames taken with a straight response (gamma 1)",
    "aliased": "a spot blurred over more pixels: larger magnification or f-number",
    "not-converged": "another --seed",
}


def finding(flag: str, effect: str) -> Finding:
    """Return the finding of a flag with its effect and remedy."""
    return Finding(flag=flag, effect=effect, remedy=REMEDIES[flag])


def motion_findings(names: tuple[str, ...]) -> list[Finding]:
    """Return the findings of motion flags."""
    from charact.mtf.point.motion import DRIFT_PX, FIELDS_APART_PX, SHAKEN

    lowered = f"MTF50 is lowered by {100.0 * SHAKEN:g} % or more"
    effects = {
        "interlace-motion": f"odd and even rows show the source {FIELDS_APART_PX:g} px apart or more; {lowered}",
        "drift": f"the source moves by {DRIFT_PX:g} px over the frames, or shakes; {lowered}",
    }
    return [finding(name, effects[name]) for name in names]
