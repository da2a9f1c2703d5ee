"""What sharpening by a camera leaves in the noise of any target."""

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.thresholds import ACCURACY, LIMITS
from charact.frames.noise_law import masked_covariance
from labdata import Array

# Range of the noise correlation, px.
REACH_PX = 2


def noise_gain(noise: Array, flat: NDArray[np.bool_], absorbed: float = 0.0) -> float:
    """Return the factor by which sharpening raised the noise; 1: neighbours are not anticorrelated.

    Parameters
    ----------
    noise
        Residuals over their standard deviation, shape (row, col).
    flat
        Pixels without structure, shape (row, col).
    absorbed
        Sum of the correlation that was subtracted with fitted means.

    Notes
    -----
    Gain = C^(-1/2), C = 1 + 2 sum rho over half the lags up to 2 px. Blur correlates neighbours;
    only differences between pixels make them anticorrelated. Means over many pixels are unchanged,
    so C, the sum of the noise's correlation, falls below 1 and the noise rises.
    """
    pixels = int(np.count_nonzero(flat))
    if pixels < ACCURACY.sharpening_pixels:
        return 1.0
    largest = np.array([-1.0, 1.0]) * ACCURACY.sharpening_clip_sd
    covariance, _ = masked_covariance(
        np.where(flat, np.clip(noise, *largest), 0.0)[None], flat, REACH_PX
    )
    variance = float(covariance[REACH_PX, REACH_PX])
    # A variance below 1 is the residual of the means, not noise.
    total = (float(covariance.sum()) - variance) / max(variance, 1.0)
    opposed = -(total + absorbed)
    # Opposite lags are equal: half of them count.
    error = np.sqrt(2.0 * (covariance.size - 1) / pixels)
    if opposed > max(LIMITS.min_anticorrelation, LIMITS.anticorrelation_sd * error):
        return float(max(1.0 - opposed, 0.05) ** -0.5)
    return 1.0
