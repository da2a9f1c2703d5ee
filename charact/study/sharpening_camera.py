"""A camera that sharpens its pictures: what it adds to them, and what that makes of the MTF."""

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
