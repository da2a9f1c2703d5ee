"""Noise tied between pixels: white noise blurred by a kernel whose squares sum to one, so that its
variance stays.
"""

import numpy as np
from numpy.typing import NDArray


def correlate_noise(white: NDArray[np.floating], sigma_px: float) -> NDArray[np.floating]:
    """Blur white noise (frame, row, col) with a Gaussian of unit sum of squares.

    `sigma_px`: standard deviation of the Gaussian, px; 0 leaves the noise white.
    """
    if sigma_px <= 0:
        return white
    from scipy.ndimage import convolve1d

    reach = int(np.ceil(4 * sigma_px))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma_px) ** 2)
    kernel = kernel / np.sqrt(np.sum(kernel**2))
    return convolve1d(convolve1d(white, kernel, axis=1, mode="wrap"), kernel, axis=2, mode="wrap")
