"""Pixels of a band along an edge, in bins by their distance from its line."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.edge.pixels.line import EdgeLine
from charact.estimators.mtf.edge.pixels.noise_model import NARROWEST_PX
from charact.estimators.mtf.mean_frame import OrientedFrame
from charact.frames.robust import median

Array = NDArray[np.float64]

# Distance up to which bins have which width, px, and the width beyond.
WIDTHS_PX = ((4.0, NARROWEST_PX), (8.0, 0.25), (16.0, 0.5), (np.inf, 1.0))


@dataclass(frozen=True, kw_only=True)
class BinnedPixels:
    """Pixels of a band along the edge and the bins they fall in.

    Parameters
    ----------
    distance, along
        Distance of every pixel along the normal, positive on the bright side, and position along
        the edge from its middle, shape (row, col), px.
    valid
        Pixels inside the band that are not masked, shape (row, col).
    bin_index
        Bin of every pixel, shape (row, col); meaningful where valid.
    borders
        Borders of the bins, shape (bin + 1,), px.
    half_width_px
        Half the width of the band.
    """

    distance: Array
    along: Array
    valid: NDArray[np.bool_]
    bin_index: NDArray[np.int64]
    borders: Array
    half_width_px: float

    def means(self, value: Array) -> tuple[Array, Array]:
        """Return mean of a quantity and count of pixels in every bin, shape (bin,)."""
        index, size = self.bin_index[self.valid], self.borders.size - 1
        count = np.bincount(index, minlength=size).astype(float)
        return np.bincount(index, value[self.valid], size) / np.maximum(count, 1.0), count

    def medians(self, value: Array) -> tuple[Array, Array]:
        """Return median of a quantity and count of pixels in every bin, shape (bin,)."""
        index, of_bin = self.bin_index[self.valid], value[self.valid]
        count = np.bincount(index, minlength=self.borders.size - 1)
        ordered = of_bin[np.lexsort((of_bin, index))]
        middle = np.cumsum(count) - count + np.maximum(count - 1, 0) // 2
        return ordered[np.minimum(middle, ordered.size - 1)], count.astype(float)

    @cached_property
    def mean_distance(self) -> Array:
        """Mean distance of the pixels of every bin, shape (bin,), px."""
        return self.means(self.distance)[0]


def bin_pixels(
    picture: OrientedFrame,
    line: EdgeLine,
    half_width_px: float,
    masked: NDArray[np.bool_] | None = None,
) -> BinnedPixels:
    """Bin the pixels within a half width of the line, less where the frame ends earlier; masked
    ones are left out.
    """
    angle = line.angle_rad(picture.pitch_ratio)
    shape = picture.value.shape
    distance = line.distance(shape, picture.pitch_ratio)
    row = np.arange(shape[0])[:, None] - (shape[0] - 1) / 2
    along = row * picture.pitch_ratio / np.cos(angle) + distance * np.tan(angle)
    # On both sides as far as most rows reach.
    flat = distance.ravel()
    counts = [
        np.bincount((-flat[flat < 0]).astype(np.int64)),
        np.bincount(flat[flat >= 0].astype(np.int64)),
    ]
    enough = 0.6 * max(median(pixels[:4]) if pixels.size else 0.0 for pixels in counts)
    extents = []
    for pixels in counts:
        stop = int(np.argmin(pixels >= enough)) if not (pixels >= enough).all() else pixels.size
        extents.append(float(min(max(stop, 1), half_width_px)))
    borders = _borders(extents[0], extents[1])
    # Borders lie on multiples of the narrowest width from the first.
    narrow = np.rint(np.diff(borders) / NARROWEST_PX).astype(np.int64)
    lookup = np.repeat(np.arange(narrow.size), narrow)
    cell = np.floor((distance - borders[0]) / NARROWEST_PX).astype(np.int64)
    return BinnedPixels(
        distance=distance,
        along=along,
        valid=(distance >= borders[0])
        & (distance < borders[-1])
        & (True if masked is None else ~masked),
        bin_index=lookup[np.clip(cell, 0, lookup.size - 1)],
        borders=borders,
        half_width_px=min(extents),
    )


def coarsen(gathered: BinnedPixels) -> BinnedPixels:
    """Return the band with bins twice as wide, which hold the narrower ones whole; pixels beyond
    the last are left.
    """
    borders = _borders(-gathered.borders[0], gathered.borders[-1], wider=2)
    middle = 0.5 * (gathered.borders[1:] + gathered.borders[:-1])
    into = np.searchsorted(borders, middle) - 1
    in_band = (into >= 0) & (into < borders.size - 1)
    return replace(
        gathered,
        borders=borders,
        valid=gathered.valid & in_band[gathered.bin_index],
        bin_index=np.clip(into, 0, borders.size - 2)[gathered.bin_index],
    )


def _borders(dark_px: float, bright_px: float, wider: int = 1) -> Array:
    """Return the borders of bins on both sides, which widen with the distance from the edge."""
    sides = []
    for limit in (dark_px, bright_px):
        begin, parts = 0.0, []
        for end, width in WIDTHS_PX:
            stop = min(limit, end)
            parts.append(np.arange(begin + wider * width, stop + 1e-9, wider * width))
            begin = end
        sides.append(np.concatenate(parts))
    return np.concatenate([-sides[0][::-1], [0.0], sides[1]])
