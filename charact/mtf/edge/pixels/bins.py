"""The pixels near an edge, gathered by their distance from it: narrow bins where the edge rises, wide ones beyond."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from charact.mtf.edge.pixels.line import EdgeLine
from charact.mtf.mean_frame import OrientedFrame
from charact.robust import median

Array = NDArray[np.float64]

# Up to which distance bins have which width, px, whole multiples of the narrowest; and the width beyond.
NARROWEST_PX, WIDEST_PX = 0.125, 1.0
WIDTHS_PX = ((4.0, NARROWEST_PX), (8.0, 0.25), (16.0, 0.5))


@dataclass(frozen=True, kw_only=True)
class BinnedPixels:
    """Pixels of a band along the edge and the bins they fall in.

    Parameters
    ----------
    distance
        Distance of every pixel along the normal, positive on the bright side, shape (row, col), px.
    along
        Place along the edge from its middle, shape (row, col), px.
    used
        Pixels inside the band that are not masked, shape (row, col).
    bin_index
        Bin of every pixel, shape (row, col); meaningful where used.
    borders
        Borders of the bins, shape (bin + 1,), px.
    half_width_px
        Half the width of the band.
    """

    distance: Array
    along: Array
    used: NDArray[np.bool_]
    bin_index: NDArray[np.int64]
    borders: Array
    half_width_px: float

    def means(self, value: Array) -> tuple[Array, Array]:
        """Return mean of a quantity and count of pixels in every bin, shape (bin,)."""
        return _means(value, self.used, self.bin_index, self.borders.size - 1)

    @cached_property
    def place(self) -> Array:
        """Mean distance of the pixels of every bin, shape (bin,), px."""
        return self.means(self.distance)[0]

    def interpolate(self, mean: Array, rise: Array) -> Array:
        """Return a mean of each bin, with its rise per px for the place within the bin, at every pixel."""
        return _interpolate(self.distance, self.bin_index, self.place, mean, rise)


def coarsen(gathered: BinnedPixels) -> BinnedPixels:
    """Return the band with bins twice as wide, which hold the narrower ones whole; pixels beyond the last are left."""
    borders = _borders((-gathered.borders[0], gathered.borders[-1]), wider=2)
    middle = 0.5 * (gathered.borders[1:] + gathered.borders[:-1])
    into = np.searchsorted(borders, middle) - 1
    inside = (into >= 0) & (into < borders.size - 1)
    return replace(
        gathered,
        borders=borders,
        used=gathered.used & inside[gathered.bin_index],
        bin_index=np.clip(into, 0, borders.size - 2)[gathered.bin_index],
    )


@njit(cache=True)
def _means(value: Array, used: NDArray[np.bool_], index: NDArray[np.int64], size: int) -> tuple[Array, Array]:
    total, count = np.zeros(size), np.zeros(size)
    for row in range(value.shape[0]):
        for col in range(value.shape[1]):
            if used[row, col]:
                total[index[row, col]] += value[row, col]
                count[index[row, col]] += 1.0
    return total / np.maximum(count, 1.0), count


@njit(cache=True)
def _interpolate(distance: Array, index: NDArray[np.int64], place: Array, mean: Array, rise: Array) -> Array:
    out = np.empty(distance.shape)
    for row in range(distance.shape[0]):
        for col in range(distance.shape[1]):
            one = index[row, col]
            out[row, col] = mean[one] + rise[one] * (distance[row, col] - place[one])
    return out


@njit(cache=True)
def _bin_indices(distance: Array, borders: Array) -> NDArray[np.int64]:
    """Return the bin of every distance: borders lie on multiples of the narrowest width from the first."""
    last = borders.size - 2
    lookup = np.empty(int(np.rint((borders[-1] - borders[0]) / NARROWEST_PX)), np.int64)
    for one in range(borders.size - 1):
        begin = int(np.rint((borders[one] - borders[0]) / NARROWEST_PX))
        end = int(np.rint((borders[one + 1] - borders[0]) / NARROWEST_PX))
        lookup[begin:end] = one
    out = np.empty(distance.shape, np.int64)
    for row in range(distance.shape[0]):
        for col in range(distance.shape[1]):
            cell = int(np.floor((distance[row, col] - borders[0]) / NARROWEST_PX))
            out[row, col] = 0 if cell < 0 else last if cell >= lookup.size else lookup[cell]
    return out


def bin_pixels(picture: OrientedFrame, line: EdgeLine, half_width_px: float, masked: NDArray[np.bool_]) -> BinnedPixels:
    """Gather the pixels within a half width of the line.

    Parameters
    ----------
    half_width_px
        Half width of the band wanted; less where the picture ends earlier.
    masked
        Pixels to leave out, shape (row, col).
    """
    angle = line.angle_rad(picture.pitch_ratio)
    shape = picture.value.shape
    distance = line.across(shape) * np.cos(angle)
    row = np.arange(shape[0])[:, None] - (shape[0] - 1) / 2
    along = row * picture.pitch_ratio / np.cos(angle) + distance * np.tan(angle)
    reach = _coverage(distance, half_width_px)
    borders = _borders(reach)
    index = _bin_indices(distance, borders)
    used = (distance >= borders[0]) & (distance < borders[-1]) & ~masked
    return BinnedPixels(
        distance=distance, along=along, used=used, bin_index=index, borders=borders, half_width_px=min(reach)
    )


def _coverage(distance: Array, half_width_px: float) -> tuple[float, float]:
    """Return how far to both sides most rows reach, at most the half width."""
    cells, other = _columns(distance)
    full = max(median(cells[:4]) if cells.size else 0.0, median(other[:4]) if other.size else 0.0)

    def reach(counts: NDArray) -> float:
        enough = counts >= 0.6 * full
        stop = int(np.argmin(enough)) if not enough.all() else counts.size
        return float(min(max(stop, 1), half_width_px))

    return reach(cells), reach(other)


@njit(cache=True)
def _columns(distance: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the number of pixels at each whole distance, on the dark side and on the bright one, as far as any is."""
    dark, bright = np.zeros(1, np.int64), np.zeros(0, np.int64)
    low, high = distance.min(), distance.max()
    if low < 0:
        dark = np.zeros(int(-low) + 1, np.int64)
    if high >= 0:
        bright = np.zeros(int(high) + 1, np.int64)
    for one in distance.flat:
        if one < 0:
            dark[int(-one)] += 1
        else:
            bright[int(one)] += 1
    return dark, bright


def _borders(reach: tuple[float, float], wider: int = 1) -> Array:
    """Return borders from -reach[0] to reach[1], further apart with the distance from the edge, and so many times."""
    sides = []
    for limit in reach:
        begin, parts = 0.0, []
        for end, width in (*WIDTHS_PX, (np.inf, WIDEST_PX)):
            stop = min(limit, end)
            parts.append(np.arange(begin + wider * width, stop + 1e-9, wider * width))
            begin = end
        sides.append(np.concatenate(parts))
    return np.concatenate([-sides[0][::-1], [0.0], sides[1]])
