"""Noise that changes from frame to frame on both sides of an edge: no fixed pattern and no flicker of all is in it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.mtf.edge.pixels.profile import Profile
from charact.mtf.picture import Picture
from labdata.frames import FrameStack

Array = NDArray[np.float64]

# Share of the step up to which a pixel belongs to either side, and least pixels there.
PLATEAU, LEAST_PIXELS = 0.1, 50


@dataclass(frozen=True, kw_only=True)
class Side:
    """One side of an edge through all frames.

    Parameters
    ----------
    level
        Mean of its pixels, DN.
    variance, scatter
        Mean variance of a pixel from frame to frame, DN^2, and its relative standard error.
    """

    level: float
    variance: float
    scatter: float


def shimmer_of(stack: FrameStack, picture: Picture, profile: Profile) -> tuple[Side, Side] | None:
    """Return the dark and the bright side of an edge; None: a single frame, or a side of few pixels.

    Notes
    -----
    The mean of a side in each frame and that of each pixel are taken off. The error follows from how unequal the
    pixels' variances are, so that heavy-tailed pulses count as they are, and from what neighbours share.
    """
    if len(stack.data) < 2:
        return None
    value = np.interp(profile.gathered.distance, profile.distance, profile.value)
    level = (value - profile.dark) / (profile.step or 1.0)
    sides = [profile.gathered.used & side for side in (level < PLATEAU, level > 1.0 - PLATEAU)]
    if min(np.count_nonzero(side) for side in sides) < LEAST_PIXELS:
        return None
    frames = np.stack([picture.upright(one) for one in stack.data])
    tied = max(profile.grain.covariance_over_variance, 1.0)
    dark, bright = (_side(frames[:, side], tied) for side in sides)
    return dark, bright


def _side(values: Array, tied: float) -> Side:
    """Return a side from its pixels, shape (frame, pixel), whose averages are noisier by a factor."""
    frames, pixels = values.shape
    left = values - values.mean(axis=1)[:, None]
    left -= left.mean(axis=0)
    variances = np.sum(left**2, axis=0) / (frames - 1) * pixels / (pixels - 1)
    mean = float(variances.mean())
    scatter = float(variances.std(ddof=1)) / max(mean, 1e-300) * np.sqrt(tied / pixels)
    return Side(level=float(values.mean()), variance=mean, scatter=scatter)
