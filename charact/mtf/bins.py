"""The pixels near an edge, gathered by their distance from it: narrow bins where the edge rises, wide ones beyond."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.mtf.line import Line
from charact.mtf.picture import Picture

Array = NDArray[np.float64]

# Up to which distance bins have which width, px, whole multiples of the narrowest; and the width beyond.
NARROWEST_PX, WIDEST_PX = 0.125, 1.0
WIDTHS_PX = ((4.0, NARROWEST_PX), (8.0, 0.25), (16.0, 0.5))


@dataclass(frozen=True, kw_only=True)
class Gathered:
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
        index = self.bin_index[self.used]
        size = self.borders.size - 1
        count = np.bincount(index, minlength=size).astype(float)
        return np.bincount(index, weights=value[self.used], minlength=size) / np.maximum(count, 1), count


def gather(picture: Picture, line: Line, half_width_px: float, masked: NDArray[np.bool_]) -> Gathered:
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
    reach = _covered(distance, half_width_px)
    borders = _borders(reach)
    index = np.clip(np.searchsorted(borders, distance, side="right") - 1, 0, borders.size - 2)
    used = (distance >= borders[0]) & (distance < borders[-1]) & ~masked
    return Gathered(
        distance=distance, along=along, used=used, bin_index=index, borders=borders, half_width_px=min(reach)
    )


def _covered(distance: Array, half_width_px: float) -> tuple[float, float]:
    """Return how far to both sides most rows reach, at most the half width."""
    cells = np.bincount((np.abs(distance[distance < 0])).astype(np.int64), minlength=1)
    other = np.bincount(distance[distance >= 0].astype(np.int64), minlength=1)
    full = max(np.median(cells[:4]) if cells.size else 0, np.median(other[:4]) if other.size else 0)

    def reach(counts: NDArray) -> float:
        enough = counts >= 0.6 * full
        stop = int(np.argmin(enough)) if not enough.all() else counts.size
        return float(min(max(stop, 1), half_width_px))

    return reach(cells), reach(other)


def _borders(reach: tuple[float, float]) -> Array:
    """Return borders from -reach[0] to reach[1], wider with the distance from the edge."""
    sides = []
    for limit in reach:
        begin, parts = 0.0, []
        for end, width in (*WIDTHS_PX, (np.inf, WIDEST_PX)):
            stop = min(limit, end)
            parts.append(np.arange(begin + width, stop + 1e-9, width))
            begin = end
        sides.append(np.concatenate(parts))
    return np.concatenate([-sides[0][::-1], [0.0], sides[1]])
