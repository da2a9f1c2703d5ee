"""The mean picture that finders look at, smoothed and searched for its highest places."""

import numpy as np
from numpy.typing import NDArray

from labdata.frames import FrameStack


def mean_frame_of(pictures: NDArray | FrameStack) -> tuple[NDArray[np.float32], bool]:
    """Return the mean (row, col) of a picture, stack or frames, and whether it holds whole codes of one frame."""
    data = pictures.data if isinstance(pictures, FrameStack) else np.asarray(pictures)
    if data.ndim == 2:
        data = data[None]
    whole = data.dtype.kind in "ui" or bool(np.all(data[0] == np.rint(data[0])))
    return np.ascontiguousarray(data.mean(axis=0, dtype=np.float64).astype(np.float32)), whole and len(data) == 1


def gaussian_blur(picture: NDArray[np.float32], scale_px: float) -> NDArray[np.float32]:
    """Return a picture smoothed with a Gaussian of a standard deviation."""
    import cv2

    return np.asarray(cv2.GaussianBlur(picture, (0, 0), scale_px, borderType=cv2.BORDER_REFLECT_101), np.float32)


def local_maximum(picture: NDArray[np.float32], rows: int, cols: int) -> NDArray[np.float32]:
    """Return the highest value within so many rows and columns around each pixel."""
    import cv2

    return np.asarray(cv2.dilate(picture, np.ones((rows, cols), np.uint8)), np.float32)
