"""Real Fourier transforms over rows and columns, single precision kept."""

from typing import Any

from numpy.typing import NDArray


def rfft_image(image: NDArray) -> NDArray[Any]:
    """Return the transform of real images (..., row, col), its last axis half as long plus one."""
    from scipy import fft

    transform: Any = fft.rfft2(image)
    return transform


def irfft_image(transform: NDArray, shape: tuple[int, int]) -> NDArray[Any]:
    """Return the real images (..., row, col) of the given shape that have a transform."""
    from scipy import fft

    image: Any = fft.irfft2(transform, s=shape)
    return image
