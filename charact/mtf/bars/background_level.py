"""The light around a bar target: the ground that shows its pedestal, and what a curved response adds to it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.mtf.bars.amplitudes import Amplitudes
from charact.mtf.bars.target import BarTarget, amplitude
from charact.mtf.bars.thresholds import OTHER_FRACTION

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Light elsewhere stands this many deviations out of the smoothed ground.
OTHER_SD, OTHER_SMOOTHING_PX, OTHER_REACH_PX = 6.0, 2.0, 8


@dataclass(frozen=True, kw_only=True)
class TargetBackground:
    """Pixels that show a target's pedestal.

    Parameters
    ----------
    beyond
        Pixels beyond the window without other light, shape (row, col).
    crowded
        Whether the blur of other light reaches into the window.
    """

    beyond: Mask
    crowded: bool


def target_background(mean: Array, target: BarTarget, margin_px: float) -> TargetBackground:
    """Return the background of a target in a mean frame (row, col), other objects excluded."""
    from scipy.ndimage import binary_dilation, gaussian_filter

    shape = (mean.shape[0], mean.shape[1])
    outside = ~target.box(shape, margin_px)
    smooth = np.asarray(gaussian_filter(mean, OTHER_SMOOTHING_PX))
    level = float(np.median(smooth[outside]))
    spread = 1.4826 * float(np.median(np.abs(smooth[outside] - level)))
    height = float(np.abs(smooth[target.box(shape, 0.0)] - level).max())
    other = outside & (np.abs(smooth - level) > max(OTHER_SD * spread, OTHER_FRACTION * height))
    other = np.asarray(binary_dilation(other, iterations=OTHER_REACH_PX), bool) & outside
    crowded = bool((other & target.box(shape, margin_px + OTHER_REACH_PX)).any())
    beyond = outside & ~other
    # If hardly any background remains, the objects are the background.
    return TargetBackground(beyond=beyond if beyond.sum() > 0.25 * outside.sum() else outside, crowded=crowded)


def second_harmonic(mean: Array, target: BarTarget, window: Mask, pedestal: float, found: Amplitudes) -> float:
    """Return the image's spectrum at twice the bar frequency in the phase of the bars, over the fundamental.

    Bars as wide as their gaps have no such component, whatever the blur; a nonlinear response adds one. Returns 0 where
    the alias of the fundamental overlaps.
    """
    direction = max(abs(np.cos(target.angle_rad)), abs(np.sin(target.angle_rad)))
    if abs(1.0 - 3.0 * target.frequency * direction) < 2.0 * target.frequency / target.bars:
        return 0.0
    double = amplitude(mean - pedestal, target, 2.0 * target.frequency, window)
    return float(np.real(double * np.exp(-2j * found.phase_rad)) / found.fundamental)
