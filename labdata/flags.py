"""The closed vocabulary of flags, and a finding: a flag with the size of its effect and what settles it.

A flag is evidence in the data at hand that a number may be off by more than its interval. What is merely unknown widens
the interval or is a note.
"""

from collections.abc import Iterable
from dataclasses import dataclass

FLAGS: dict[str, str] = {
    "correlated-noise": "Neighbouring pixels share noise, which this method takes for white.",
    "lag": "Light of earlier frames is still in this one.",
    "agc": "An automatic gain or brightness control moved during the series: the mean does not follow the light.",
    "flicker": "The light changes periodically from frame to frame.",
    "drift": "The level, or the place of what is seen, moves through the stack.",
    "clipped": "Pixels sit at the lowest or the highest code.",
    "saturated": "The signal is beyond the linear range of the camera.",
    "nonlinear": "The response departs from a straight line by more than its noise.",
    "gamma": "The response is curved like a gamma correction.",
    "processed": "The camera alters its pictures before they are seen: sharpening, or noise reduction.",
    "quantised": "The noise is smaller than the steps of the digitiser.",
    "defects": "Hot, dead or stuck pixels are inside the region.",
    "no-darks": "There are no dark frames; the offset was assumed.",
    "dark-mismatch": "The dark frames do not fit: these frames' level without light lies elsewhere.",
    "too-few-frames": "There are too few frames for the spread to be trusted.",
    "low-signal": "The signal is barely above the noise.",
    "no-target": "The expected target was not found.",
    "several-targets": "More than one target lies in the region.",
    "curved-edge": "The edge is not straight: it is bent, or rough along its length.",
    "gradient": "The illumination changes across the region.",
    "tilt-too-small": "The edge or bar is too parallel to the pixel grid to be oversampled.",
    "window-too-small": "The region cuts off part of the target or of its blur.",
    "aliased": "The frequency is too near the sampling limit to be told from its alias.",
    "interlace-motion": "The two fields of the frame do not agree: something moved between them.",
    "model-misfit": "The data depart from the fitted model by more than their noise.",
    "not-converged": "The Markov chain did not meet its convergence rule; the interval comes from the curvature.",
    "prior-bound": "The posterior leans on a bound of its prior.",
    "several-modes": "The posterior has more than one peak.",
    "extrapolated": "The number lies beyond the levels that were measured and leans on the law fitted to them.",
    "unlike-conditions": "The stacks compared were taken under different conditions.",
}


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What a check found in the data.

    Parameters
    ----------
    flag
        A key of `FLAGS`.
    effect
        How far it may move which number, with its unit: "MTF50 may be up to 1.3 % high".
    remedy
        The option, frame or description that settles it, by its name: "--black-dn, or darks in the session".
    """

    flag: str
    effect: str
    remedy: str

    def __post_init__(self) -> None:
        ordered_flags((self.flag,))

    @property
    def note(self) -> str:
        """The finding as one line for people."""
        return f"{self.flag}: {self.effect}; what settles it: {self.remedy}"


def ordered_flags(flags: Iterable[str]) -> tuple[str, ...]:
    """Return the flags in vocabulary order, without repeats; a word outside the vocabulary is a ValueError."""
    given = set(flags)
    if unknown := given - FLAGS.keys():
        raise ValueError(f"a flag must be one of labdata.flags.FLAGS, got {sorted(unknown)}")
    return tuple(flag for flag in FLAGS if flag in given)
