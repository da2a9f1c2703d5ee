"""The mean picture that finders look at, smoothed and searched for its highest places."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.target_detection.thresholds import ACCURACY, THRESHOLDS
from labdata.frames import FrameStack


def mean_frame_of(pictures: NDArray | FrameStack) -> tuple[NDArray[np.float32], bool]:
    """Return the mean (row, col) of a picture, stack or frames, and whether it holds whole codes of
    one frame.
    """
    data = pictures.data if isinstance(pictures, FrameStack) else np.asarray(pictures)
    if data.ndim == 2:
        data = data[None]
    has_whole_codes = data.dtype.kind in "ui" or bool(np.all(data[0] == np.rint(data[0])))
    return np.ascontiguousarray(
        data.mean(axis=0, dtype=np.float64).astype(np.float32)
    ), has_whole_codes and len(data) == 1


def gaussian_blur(picture: NDArray[np.float32], scale_px: float) -> NDArray[np.float32]:
    """Return a picture smoothed with a Gaussian of a standard deviation."""
    import cv2

    return np.asarray(
        cv2.GaussianBlur(picture, (0, 0), scale_px, borderType=cv2.BORDER_REFLECT_101), np.float32
    )


def local_maximum(picture: NDArray[np.float32], rows: int, cols: int) -> NDArray[np.float32]:
    """Return the highest value within so many rows and columns around each pixel."""
    import cv2

    return np.asarray(cv2.dilate(picture, np.ones((rows, cols), np.uint8)), np.float32)


Array = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class Gradient:
    """Derivatives of a picture smoothed with a Gaussian."""

    scale_px: float  # Standard deviation of the Gaussian, px
    # down, right: derivatives along rows' and columns' index, shape (row, col), DN per px
    down: Array
    right: Array
    modulus: Array  # Their modulus, DN per px
    # Modulus over the standard deviation of one component in noise alone, and 0 where it is less
    # than that of the lowest step that counts
    significance: Array


def gradient(picture: NDArray, scale_px: float, *, whole_codes: bool) -> Gradient:
    """Differentiate a picture (row, col) at a scale.

    Notes
    -----
    White noise of standard deviation s gives each component s / (sqrt(8 pi) scale^2), a step A of
    blur b at its middle A / sqrt(2 pi (scale^2 + b^2)). The noise is not taken as white: it is read
    off the quiet part of the gradient itself, in blocks, as a function of the level, for light
    brings noise.
    """
    smooth = gaussian_blur(np.asarray(picture, np.float32), scale_px)
    down, right = (np.asarray(part, np.float32) for part in np.gradient(smooth))
    modulus = np.hypot(right, down)
    noise = _noise(smooth, right, down, scale_px)
    rounding = (
        0.29 / (np.sqrt(8.0 * np.pi) * scale_px**2)
        if whole_codes
        else 1e-9 * (1.0 + float(np.ptp(smooth)))
    )
    low, high = np.quantile(smooth[::2, ::2], (0.001, 0.999))
    floor = THRESHOLDS.min_step * (high - low) / np.sqrt(2.0 * np.pi * (scale_px**2 + 1.5**2))
    significance = np.where(modulus > floor, modulus / np.maximum(noise, rounding), 0.0).astype(
        np.float32
    )
    return Gradient(
        scale_px=scale_px, down=down, right=right, modulus=modulus, significance=significance
    )


def _noise(smooth: Array, right: Array, down: Array, scale_px: float) -> Array:
    """Return the standard deviation of a component in noise alone at every pixel, from its
    level.
    """
    size = int(max(32, 12 * scale_px))
    rows, cols = (max(1, side // size) for side in smooth.shape)
    block_level, block_sd = [], []
    for part_rows in np.array_split(np.arange(smooth.shape[0]), rows):
        for part_cols in np.array_split(np.arange(smooth.shape[1]), cols):
            block = (slice(part_rows[0], part_rows[-1] + 1), slice(part_cols[0], part_cols[-1] + 1))
            differences = np.abs(np.concatenate([right[block].ravel(), down[block].ravel()]))
            block_level.append(float(np.median(smooth[block])))
            # The lowest quarter of the moduli, which structure hardly changes, ends at 0.318639
            # standard deviations.
            block_sd.append(float(np.quantile(differences, 0.25)) / 0.318639)
    level, sd = np.array(block_level), np.array(block_sd)
    level_index = np.clip(
        ((level - level.min()) / max(np.ptp(level), 1e-12) * ACCURACY.noise_levels).astype(int),
        0,
        ACCURACY.noise_levels - 1,
    )
    filled = [
        number for number in range(ACCURACY.noise_levels) if np.count_nonzero(level_index == number)
    ]
    middles = [float(np.mean(level[level_index == number])) for number in filled]
    quiet = [float(np.quantile(sd[level_index == number], 0.4)) for number in filled]
    return np.interp(smooth, middles, quiet).astype(np.float32)
