"""Effects of a camera on its pictures: sharpening, and noise correlated between pixels."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]

# Standard deviation of the Gaussian whose blurred copy is taken off, px.
MASK_PX = 2.0


def sharpen_images(pictures: Array, amount: float) -> Array:
    """Return pictures with so much of what a blurred copy lacks added, shape (..., row, col)."""
    if amount == 0.0:
        return pictures
    from scipy.ndimage import gaussian_filter

    return pictures + amount * (
        pictures - gaussian_filter(pictures, MASK_PX, axes=(-2, -1), mode="nearest")
    )


def boost(frequency_cy_per_px: Array | float, amount: float) -> Array | float:
    """Return what sharpening makes of the MTF at a frequency in any direction, cycles per pixel, as
    a factor.
    """
    return 1.0 + amount * (
        1.0 - np.exp(-2.0 * (np.pi * np.asarray(frequency_cy_per_px) * MASK_PX) ** 2)
    )


def correlate_noise(white: NDArray[np.floating], sigma_px: float) -> NDArray[np.floating]:
    """Blur white noise (frame, row, col) with a Gaussian of unit sum of squares.

    `sigma_px`: standard deviation of the Gaussian, px; 0 leaves the noise white.
    """
    if sigma_px <= 0:
        return white
    from scipy.ndimage import convolve1d

    radius_px = int(np.ceil(4 * sigma_px))
    kernel = np.exp(-0.5 * (np.arange(-radius_px, radius_px + 1) / sigma_px) ** 2)
    kernel = kernel / np.sqrt(np.sum(kernel**2))
    return convolve1d(convolve1d(white, kernel, axis=1, mode="wrap"), kernel, axis=2, mode="wrap")
