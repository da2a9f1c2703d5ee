"""What the stream asks of light behind the gain: exposures drawn one after the other, beyond their mean."""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

# Does work on rows in bands of whole blocks: (work of first and last row, rows, rows in a block).
Shared = Callable[[Callable[[int, int], None], int, int], None]


class OuterWing(Protocol):
    """What reaches farther than the compact kernel; names as in `Kernel`."""

    @property
    def height(self) -> int:
        """Rows of the chip in a pixel as read."""
        ...

    @property
    def wing(self) -> NDArray[np.float32]:
        """Weights of coarse cells."""
        ...


class PhosphorSampler(Protocol):
    """The screen from one exposure to the next.

    Parameters
    ----------
    shown
        Electrons beyond the mean that come out in each exposure of a frame, shape (exposure, plane, row, col).
    spread
        Separable kernels that take them to pixels, two of shape (plane, rank, tap).
    """

    shown: NDArray[np.float32]
    spread: tuple[NDArray[np.float32], NDArray[np.float32]]

    @property
    def far(self) -> OuterWing:
        """What reaches farther than the compact kernels."""
        ...

    def forget(self) -> None:
        """Hold nothing but the mean."""
        ...

    def expose(self, frame: int, brightness: float, shared: Shared) -> NDArray[np.float32]:
        """Draw the pulses of a frame's exposures, of so much the mean light, and let the screen glow.

        Returns
        -------
        NDArray
            What each exposure shows beyond the mean, summed over coarse cells, shape (exposure, coarse row, coarse
            col).
        """
        ...


class EventSampler(Protocol):
    """Light made ready."""

    @property
    def pulse_e(self) -> float:
        """Variance of a pixel's charge over its mean, as pulses make it, e-."""
        ...

    def screen(self, seed: int) -> PhosphorSampler:
        """Return a screen that has shown nothing yet."""
        ...


def key_of(seed: int, purpose: int, number: int) -> np.uint64:
    """Return the key of one generator of rows."""
    # Exposures before the first frame, whose light it still shows, have numbers below zero; seeds may not.
    return np.random.SeedSequence([seed, purpose, number + 2**32]).generate_state(1, np.uint64)[0]


def float32_values(*numbers: float) -> tuple[np.float32, ...]:
    """Return numbers in single precision."""
    return tuple(np.float32(number) for number in numbers)
