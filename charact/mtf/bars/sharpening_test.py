"""Test for sharpening: light missing around the bars, which no blur removes.

Blurred copies of the image are directions in which the pixels may depart from it, all parameters free.
"""

import numpy as np
from numpy.typing import NDArray

from charact.mtf.bars.fit import MIN_VARIANCE, BarFit

Array = NDArray[np.float64]

# Standard deviations of the blurred copies, px; by how many standard errors one must be taken off, and what share of
# it: the table of the picture is good to a few parts in ten thousand.
WIDTHS_PX, MIN_MISSING_SD, MIN_FRACTION = (2.0, 4.0, 8.0), 3.5, 3e-3
# Of a copy that the parameters make up but for this share of its squares the table's own error is as large.
MIN_INDEPENDENT_FRACTION = 1e-5


def sharpening(fit: BarFit) -> float:
    """Return the fraction of a blurred copy of the bars that is missing, 0 where not significant."""
    weight = 1.0 / np.maximum(fit.noise.variance, MIN_VARIANCE * fit["level_dn"] ** 2)
    basis = np.linalg.qr((fit.slope * np.sqrt(weight)).T)[0]
    spread = np.array([_blur_bars(fit, width) for width in WIDTHS_PX]) * np.sqrt(weight)
    apart = (spread - (spread @ basis) @ basis.T) * np.sqrt(weight)
    missing = -(apart @ fit.residual_dn)
    sd = np.sqrt(np.maximum(np.diag(fit.noise.spread(apart, fit.window)), 0.0))
    whole = np.sum(apart * spread / np.sqrt(weight), axis=1)
    apart_share = np.sum((apart / np.sqrt(weight)) ** 2, axis=1) / np.sum(spread**2, axis=1)
    sure = (missing > MIN_MISSING_SD * sd) & (missing > MIN_FRACTION * whole) & (apart_share > MIN_INDEPENDENT_FRACTION)
    return float(np.max(np.where(sure, missing / whole, 0.0)))


def _blur_bars(fit: BarFit, width_px: float) -> Array:
    """Return the bars' light blurred, in the pixels of the window."""
    from scipy.ndimage import gaussian_filter

    light = np.zeros(fit.window.shape)
    light[fit.window] = fit.model_dn - fit["pedestal_dn"]
    return gaussian_filter(light, width_px, mode="nearest")[fit.window]
