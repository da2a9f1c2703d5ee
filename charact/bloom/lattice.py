"""A frame's pixels and frequencies by their distance from a place and from zero: round things looked up on it fast."""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from charact.bloom.posterior_psf import PosteriorPsf, nodes

Array = NDArray[np.float64]

# Steps of the tables that round functions are looked up in, cy/px and px, and how far the second reaches.
FREQUENCY_STEP = 5e-4
RADIUS_STEP_PX, REACH_PX = 0.1, 150.0


@dataclass(frozen=True, kw_only=True)
class FrameGrid:
    """The pixels of a frame, with room around it into which light spreads instead of coming in on the other side.

    Parameters
    ----------
    shape
        Rows and columns of the frame.
    room_px
        Room on each side, px.
    pitch_ratio
        Row pitch over column pitch.
    """

    shape: tuple[int, int]
    room_px: int
    pitch_ratio: float = 1.0

    @cached_property
    def transform_shape(self) -> tuple[int, int]:
        """Rows and columns with the room, of quick transforms."""
        from scipy.fft import next_fast_len

        rows, cols = (next_fast_len(size + self.room_px, True) for size in self.shape)
        return int(rows or 0), int(cols or 0)

    @cached_property
    def frequency_index(self) -> NDArray[np.int32]:
        """Place in a table of step `FREQUENCY_STEP` of every frequency of a transform, shape (row, half col)."""
        rows, cols = self.transform_shape
        down = np.fft.fftfreq(rows) / self.pitch_ratio
        frequency = np.hypot(down[:, None], np.fft.rfftfreq(cols)[None, :])
        return np.rint(frequency / FREQUENCY_STEP).astype(np.int32)

    @cached_property
    def frequency(self) -> Array:
        """Frequencies of the table, cy per column pitch."""
        return np.asarray(FREQUENCY_STEP * np.arange(int(self.frequency_index.max()) + 1), np.float64)

    def forward_transform(self, image: NDArray) -> NDArray[np.complex64]:
        """Transform of a frame with nothing around it."""
        from scipy.fft import rfft2

        return np.asarray(rfft2(np.asarray(image, np.float32), s=self.transform_shape))

    def filtered(self, transform: NDArray[np.complex64], table: Array) -> NDArray[np.float32]:
        """Frame of a transform times a round transfer function, given as a table over `frequency`."""
        from scipy.fft import irfft2

        rows, cols = self.shape
        back = irfft2(
            transform * table.astype(np.float32)[self.frequency_index], s=self.transform_shape, overwrite_x=True
        )
        return np.asarray(back)[:rows, :cols]

    def distance(self, row: float, col: float) -> Array:
        """Distance of every pixel from a place, column pitches, shape (row, col)."""
        rows, cols = self.shape
        return np.hypot((np.arange(rows)[:, None] - row) * self.pitch_ratio, np.arange(cols)[None, :] - col)

    def apart(self, one: tuple[float, float], other: tuple[float, float]) -> float:
        """Distance of two places, column pitches."""
        return float(np.hypot((one[0] - other[0]) * self.pitch_ratio, one[1] - other[1]))

    def middle(self, region: NDArray[np.int64]) -> tuple[float, float]:
        """Middle of some pixels, row and col."""
        rows, cols = np.divmod(region, self.shape[1])
        return float(rows.mean()), float(cols.mean())

    def at_border(self, region: NDArray[np.int64]) -> bool:
        """Whether some pixels reach the border of the frame."""
        rows, cols = np.divmod(region, self.shape[1])
        last = self.shape[0] - 1, self.shape[1] - 1
        return bool(rows.min() == 0 or cols.min() == 0 or rows.max() == last[0] or cols.max() == last[1])

    def point_image(self, place: tuple[float, float], profile: Array, pixels: NDArray[np.int64]) -> Array:
        """What one unit of light at a place leaves in some pixels, for a density against distance, 1/px."""
        rows, cols = np.divmod(pixels, self.shape[1])
        radius = np.hypot((rows - place[0]) * self.pitch_ratio, cols - place[1])
        return radial(radius, profile) * self.pitch_ratio

    def patch(self, region: NDArray[np.int64], table: Array) -> NDArray[np.float32]:
        """What one unit of light, spread evenly over some pixels, leaves in the frame, for a transfer as a table."""
        image = np.zeros(self.shape, np.float32)
        image.ravel()[region] = 1.0 / len(region)
        return self.filtered(self.forward_transform(image), table)

    def around(self, row: float, col: float) -> tuple[slice, slice]:
        """Rows and columns of the pixels that a source at a place reaches."""
        down, across = int(REACH_PX / self.pitch_ratio) + 1, int(REACH_PX) + 1
        rows = slice(max(0, int(row) - down), min(self.shape[0], int(row) + down + 1))
        cols = slice(max(0, int(col) - across), min(self.shape[1], int(col) + across + 1))
        return rows, cols


def profiles(spread: PosteriorPsf) -> Array:
    """Density of every draw of a spread against distance, in steps of `RADIUS_STEP_PX`, shape (draw, radius)."""
    return spread.transfer(nodes()[0]) @ kernel()


@cache
def kernel() -> Array:
    """Takes a transfer function on `nodes` to the density at multiples of `RADIUS_STEP_PX`, shape (node, radius)."""
    from scipy.special import j0

    frequency, weight = nodes()
    radius = RADIUS_STEP_PX * np.arange(int(REACH_PX / RADIUS_STEP_PX) + 1)
    return (2.0 * np.pi * weight * frequency)[:, None] * j0(2.0 * np.pi * np.outer(frequency, radius))


def radial(radius_px: ArrayLike, profile: Array) -> Array:
    """Look up a round function given in steps of `RADIUS_STEP_PX`; nothing beyond its end."""
    place = np.asarray(radius_px) / RADIUS_STEP_PX
    index = np.minimum(place.astype(np.int32), len(profile) - 2)
    share = place - index
    found = profile[index] * (1.0 - share) + profile[index + 1] * share
    return np.where(place < len(profile) - 1, found, 0.0)
