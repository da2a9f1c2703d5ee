"""Frames of an intensified camera put together from single photoelectrons, each where it fell.

A photoelectron falls anywhere, leaves a pulse of random height and blurs into a Gaussian that the pixels integrate.
Many to a pixel are drawn by cells of half a pixel instead: mean and covariances of pixels are then the same to 5e-5 and
third and fourth moments to 3e-3, for blur of half a pixel and more.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from labdata.frames import FrameStack

Floats = NDArray[np.float32]

# Photoelectrons a pixel up to which each is placed for itself.
PLACED_ONE_BY_ONE = 1.0
# Cells a pixel, along rows and along columns, that more of them are drawn in.
CELLS = 2
# Standard deviations of the blur beyond which nothing of a pulse is left to speak of: 6e-7.
REACH = 5.0


@dataclass(frozen=True, kw_only=True)
class PulseScene:
    """Even light on an intensified camera.

    Parameters
    ----------
    photoelectrons
        Mean number of photoelectrons on a pixel and frame.
    excess_noise_factor
        F^2 = 1 + relative variance of the pulse heights, which are gamma distributed; above 1.
    blur_px
        Standard deviation of the Gaussian blur after the gain, px; 0: a pulse stays in the pixel it fell on.
    photoelectron_gain_dn, electron_gain_dn
        k, DN a photoelectron, and K, DN an electron of the CCD.
    read_noise_dn, black_dn
        White noise of the electronics and the dark level, DN.
    rows, cols, frames
        Size of the stack.
    """

    photoelectrons: float
    excess_noise_factor: float
    blur_px: float
    photoelectron_gain_dn: float = 20.0
    electron_gain_dn: float = 0.05
    read_noise_dn: float = 1.5
    black_dn: float = 60.0
    rows: int = 128
    cols: int = 128
    frames: int = 16

    @property
    def covariance_gain_dn(self) -> float:
        """K + k F^2, DN."""
        return self.electron_gain_dn + self.photoelectron_gain_dn * self.excess_noise_factor

    def drawn(self, rng: np.random.Generator) -> FrameStack:
        """Draw the frames."""
        charge = rng.poisson(np.maximum(self.light(rng), 0.0) / self.electron_gain_dn)
        dn = self.black_dn + self.electron_gain_dn * charge + self.read_noise_dn * rng.standard_normal(charge.shape)
        return FrameStack(data=np.clip(np.rint(dn), 0, 65535).astype(np.uint16), full_scale_dn=65535.0)

    def light(self, rng: np.random.Generator, *, one_by_one: bool | None = None) -> Floats:
        """Draw the light on the CCD, DN, shape (frame, row, col).

        Parameters
        ----------
        one_by_one
            Whether each photoelectron is placed for itself; None: where they are few.
        """
        if self.photoelectrons == 0:
            return np.zeros((self.frames, self.rows, self.cols), np.float32)
        few = self.photoelectrons <= PLACED_ONE_BY_ONE if one_by_one is None else one_by_one
        return self._placed(rng) if few else self._by_cells(rng)

    @property
    def margin_px(self) -> int:
        """Pixels around the frame whose pulses reach into it."""
        return math.ceil(REACH * self.blur_px)

    def _heights(self, rng: np.random.Generator, counts: NDArray[np.int64]) -> Floats:
        """Sums of the heights of so many pulses, DN: n gamma heights of shape m add up to one of shape n m."""
        shape = 1.0 / (self.excess_noise_factor - 1.0)
        summed = rng.standard_gamma((counts * shape).astype(np.float32), dtype=np.float32)
        return summed * np.float32(self.photoelectron_gain_dn / shape)

    def _placed(self, rng: np.random.Generator) -> Floats:
        """Every photoelectron at a place and of a height of its own."""
        margin = self.margin_px
        high, wide = self.rows + 2 * margin, self.cols + 2 * margin
        out = np.zeros((self.frames, self.rows, self.cols), np.float32)
        for frame in out:
            count = rng.poisson(self.photoelectrons * high * wide)
            row, col = rng.uniform(-margin, high - margin, count), rng.uniform(-margin, wide - margin, count)
            _place(frame, row, col, self._heights(rng, np.ones(count, np.int64)), self.blur_px)
        return out

    def _by_cells(self, rng: np.random.Generator) -> Floats:
        """The photoelectrons of each cell at its middle: a Poisson number, their heights summed."""
        if self.blur_px == 0:
            return self._heights(rng, rng.poisson(self.photoelectrons, (self.frames, self.rows, self.cols)))
        high, wide = (CELLS * (length + 2 * self.margin_px) for length in (self.rows, self.cols))
        counts = rng.poisson(self.photoelectrons / CELLS**2, (self.frames, high, wide))
        across = integrals(self.cols, self.margin_px, self.blur_px)
        down = integrals(self.rows, self.margin_px, self.blur_px)
        return np.matmul(down.T, self._heights(rng, counts) @ across, dtype=np.float32)


def integrals(length: int, margin: int, blur_px: float) -> Floats:
    """Return the share of a pulse in the middle of each cell that each pixel holds, shape (cell, pixel)."""
    from scipy.special import ndtr

    place = (np.arange(CELLS * (length + 2 * margin)) + 0.5) / CELLS - margin
    edges = ndtr((np.arange(length + 1) - place[:, None]) / blur_px)
    return np.diff(edges, axis=1).astype(np.float32)


@numba.njit(cache=True)
def _place(frame, row, col, height, blur_px):
    """Add pulses to a frame, each integrated over its pixels; pixel i reaches from i to i + 1."""
    rows, cols = frame.shape
    most = int(2 * REACH * blur_px) + 3
    down, across = np.zeros(most, np.float32), np.zeros(most, np.float32)
    for n in range(len(height)):
        if blur_px == 0.0:
            frame[int(row[n]), int(col[n])] += height[n]
            continue
        top, count_down = _integrated(row[n], blur_px, down)
        left, count_across = _integrated(col[n], blur_px, across)
        for i in range(max(0, -top), min(count_down, rows - top)):
            strength = height[n] * down[i]
            for j in range(max(0, -left), min(count_across, cols - left)):
                frame[top + i, left + j] += strength * across[j]


@numba.njit(cache=True)
def _integrated(place, blur_px, share):
    """Integrate a Gaussian over the pixels within its reach; return the first of them and their number."""
    first = math.floor(place - REACH * blur_px)
    count = math.floor(place + REACH * blur_px) - first + 1
    below = 0.5 * math.erf((first - place) / (blur_px * math.sqrt(2.0)))
    for i in range(count):
        above = 0.5 * math.erf((first + i + 1 - place) / (blur_px * math.sqrt(2.0)))
        share[i] = above - below
        below = above
    return first, count
