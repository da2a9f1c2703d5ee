"""The closed vocabulary of flags.

A flag is evidence in the data at hand that a number may be off by more than its interval. What is
merely unknown widens the interval or is a note.
"""

from collections.abc import Iterable

FLAGS: dict[str, str] = {
    "correlated-noise": "Noise is correlated between pixels; this method assumes white noise.",
    "lag": "Image lag: signal from earlier exposures contributes to this one.",
    "agc": (
        "An automatic gain or brightness control changed during the series; the mean is not "
        "proportional to light."
    ),
    "flicker": "The light varies periodically between exposures.",
    "drift": "The signal level or the target position drifts through the stack.",
    "clipped": "Pixels are at 0 DN or at full scale.",
    "saturated": "The signal is beyond the linear range of the camera.",
    "nonlinear": "The camera response deviates from linear by more than its uncertainty.",
    "gamma": "The camera response is curved like a gamma correction.",
    "processed": "The camera processes its images (sharpening or noise reduction).",
    "quantised": "The noise is smaller than the quantisation step.",
    "amplifiers": "Amplifiers of the chip differ; the number is of all of them.",
    "defects": "Hot, dead or stuck pixels are inside the region.",
    "no-darks": "No dark frames were available; the offset was assumed.",
    "dark-mismatch": "The dark frames do not match these frames: the black level differs.",
    "too-few-frames": "Too few frames for a reliable estimate of the scatter.",
    "low-signal": "The signal is close to the noise.",
    "no-target": "The expected target was not found.",
    "several-targets": "More than one target lies in the region of interest.",
    "curved-edge": "The edge is curved or rough along its length.",
    "gradient": "The illumination is non-uniform across the region.",
    "tilt-too-small": (
        "The edge or bar is nearly parallel to the pixel grid, so it cannot be oversampled."
    ),
    "window-too-small": "The region truncates the target or its blur.",
    "aliased": "The frequency is too close to Nyquist to be separated from its alias.",
    "interlace-motion": "The two fields of the frame disagree: the target moved between them.",
    "model-misfit": "The residuals of the fitted model exceed their noise.",
    "not-converged": (
        "The Markov chain did not converge; the interval is from the Laplace approximation."
    ),
    "prior-bound": "The posterior is truncated by a prior bound.",
    "several-modes": "The posterior is multimodal.",
    "extrapolated": "The value lies outside the measured range and depends on the fitted law.",
    "unlike-conditions": "The compared stacks were acquired under different conditions.",
    "uncalibrated": "The noise of a camera is unknown; it was estimated from the frame itself.",
    "unregistered": "The bands are shifted against each other.",
}


def order_flags(flags: Iterable[str]) -> tuple[str, ...]:
    """Return the flags in vocabulary order, without repeats; an unknown flag is a ValueError."""
    unordered = set(flags)
    if unknown := unordered - FLAGS.keys():
        raise ValueError(f"a flag must be one of labdata.flags.FLAGS, got {sorted(unknown)}")
    return tuple(flag for flag in FLAGS if flag in unordered)
