"""Findings of the bloom room: what each flag says about the size of its effect, and what settles it."""

from collections.abc import Mapping

from labdata.flags import Finding
from labdata.measurement import Measurement

# What settles each flag that this room raises.
REMEDIES = {
    "model-misfit": "a frame with one round source alone in it, and a level between those that differ",
    "prior-bound": "a level whose core is not cut at full scale",
    "window-too-small": "a larger frame, or the source nearer to its middle",
    "several-targets": "one source in the frame, or --roi about one of them",
    "quantised": "a higher camera gain or more bits, so that noise exceeds a code",
    "low-signal": "more frames, or more light",
    "unlike-conditions": "darks and point stacks taken at the same gain, gate and exposure",
    "agc": "automatic gain and brightness control switched off",
    "drift": "a source and a lamp at rest, or fewer frames a stack",
    "lag": "a pause after the source goes out, and stacks of a source that stays on",
    "dark-mismatch": "dark frames taken with the point stacks, at the same gain, gate and exposure",
    "clipped": "a level whose streak stays below full scale",
    "extrapolated": "a second level that shows smear",
    "nonlinear": "stated light that follows the lamp",
    "gradient": "a mask without leaks, or a frame of the mask with its pinhole closed",
    "not-converged": "another --seed, or more frames",
}


def add_findings(measurement: Measurement, effects: Mapping[str, str] | None = None) -> Measurement:
    """Return a measurement with the effect and the remedy of each of its flags among its notes.

    Parameters
    ----------
    measurement
        Of this room; a refused one stays as it is.
    effects
        Size of the effect by flag, where these data show one; otherwise the interval is the scale.
    """
    if measurement.status == "refused" or measurement.value is None:
        return measurement
    found = [
        Finding(flag=flag, effect=(effects or {}).get(flag, _beyond_interval(measurement)), remedy=REMEDIES[flag])
        for flag in measurement.flags
    ]
    return measurement.with_(findings=found)


def _beyond_interval(measurement: Measurement) -> str:
    """Effect of a flag whose size the data do not show."""
    low, high = measurement.interval95 or (measurement.value, measurement.value)
    assert low is not None and high is not None
    unit = "" if measurement.unit == "1" else f" {measurement.unit}"
    return f"{measurement.quantity} may be off by more than its half interval of {0.5 * (high - low):.3g}{unit}"
