"""Whether light is missing about the bars, as where a camera sharpens its pictures: no blur takes any away.

The picture blurred over several widths is a direction in which the pixels may depart from it, all parameters free to
give way: what a sharpening camera takes off.
"""

import numpy as np
from numpy.typing import NDArray

from charact.mtf.bars.fit import Fit

Array = NDArray[np.float64]

# Standard deviations of the blurred copies, px, and by how many standard errors one must be taken off.
WIDTHS_PX, MISSED = (2.0, 4.0, 8.0), 3.5


def is_sharpened(fit: Fit) -> bool:
    """Tell whether a blurred copy of the bars is taken off them."""
    weight = 1.0 / fit.noise.variance
    basis = np.linalg.qr((fit.slope * np.sqrt(weight)).T)[0]
    spread = np.array([_blurred(fit, width) for width in WIDTHS_PX]) * np.sqrt(weight)
    apart = (spread - (spread @ basis) @ basis.T) * np.sqrt(weight)
    sd = np.sqrt(np.diag(fit.noise.spread(apart, fit.window)))
    return bool(np.min(apart @ fit.residual_dn / np.maximum(sd, 1e-300)) < -MISSED)


def _blurred(fit: Fit, width_px: float) -> Array:
    """Return the bars' light blurred, in the pixels of the window, beyond which there is none."""
    from scipy.ndimage import gaussian_filter

    light = np.zeros(fit.window.shape)
    light[fit.window] = fit.model_dn - fit["pedestal_dn"]
    return gaussian_filter(light, width_px, mode="nearest")[fit.window]
