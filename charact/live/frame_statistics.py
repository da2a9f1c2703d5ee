"""Meters of one frame: mean, saturated pixels, temporal noise and histogram, no pixel left out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.mtf.mean_frame import Region
from labdata.errors import BadInput
from labdata.frames import read_only

BINS = 256
# Tiles wider than any blur, so that their means scatter independently; smaller ones in a small region.
TILE_PX, LEAST_TILE_PX, LEAST_TILES = 32, 8, 16


@dataclass(frozen=True, kw_only=True)
class FrameStatistics:
    """What one frame, and its difference to the one before, tell.

    Parameters
    ----------
    mean_dn
        Mean over the region, DN.
    highest_dn
        Highest pixel of the whole frame, DN.
    pixels
        Pixels of the whole frame.
    saturated_px
        Pixels of the whole frame at or above full scale, each one counted.
    noise_dn, noise_se_dn
        Temporal noise of a pixel over the region and its standard error, DN; None without a frame before.
    histogram
        Pixels of the whole frame by code, shape (bin,). Codes above full scale are in the last bin.
    bin_dn
        Width of a bin, DN.
    """

    mean_dn: float
    highest_dn: float
    pixels: int
    saturated_px: int
    noise_dn: float | None
    noise_se_dn: float | None
    histogram: NDArray[np.int64]
    bin_dn: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "histogram", read_only(self.histogram))


def measure_frame(
    frame: NDArray, before: NDArray | None = None, *, full_scale_dn: float, region: Region | None = None
) -> FrameStatistics:
    """Read the meters of a frame.

    Parameters
    ----------
    frame
        Pixels, shape (row, col), DN, whole numbers.
    before
        The frame before it, of the same shape; None where there is none.
    full_scale_dn
        Highest code of the digitiser, DN.
    region
        ROW, COL, HEIGHT, WIDTH over which mean and noise are taken; None: the whole frame.

    Raises
    ------
    BadInput
        If the pixels are not whole numbers, the frames differ in shape, or the region leaves them.
    """
    if frame.ndim != 2 or frame.dtype.kind != "u":
        raise BadInput(f"meters need a frame (row, col) of unsigned codes, got {frame.ndim} axes of {frame.dtype}")
    if before is not None and before.shape != frame.shape:
        raise BadInput(f"two frames must have one shape to be compared, got {before.shape} and {frame.shape}")
    inside = _inside(frame, region)
    noise, error = (None, None) if before is None else temporal_noise(inside, _inside(before, region))
    histogram, bin_dn = _histogram(frame, full_scale_dn)
    return FrameStatistics(
        mean_dn=float(inside.mean()),
        highest_dn=float(frame.max()),
        pixels=frame.size,
        saturated_px=int(np.count_nonzero(frame >= full_scale_dn)),
        noise_dn=noise,
        noise_se_dn=error,
        histogram=histogram,
        bin_dn=bin_dn,
    )


def temporal_noise(frame: NDArray, before: NDArray) -> tuple[float, float | None]:
    """Return the temporal noise of a pixel, root mean square over the pixels, and its standard error, DN.

    Parameters
    ----------
    frame, before
        Two frames of one scene, shape (row, col), DN.

    Notes
    -----
    Half the variance of the difference, which removes the scene, the fixed pattern and a light that flickers evenly. A
    phosphor that glows on makes frames alike and the noise too small. The standard error is from the scatter between
    neighbouring tiles, half the mean square of successive differences (J. von Neumann, Ann. Math. Statist. 12 (1941)
    367), so that noise correlated between pixels, or of another level in another part, does not make it too small.
    """
    difference = frame.astype(np.float32) - before
    difference -= difference.mean()
    square = np.square(difference, out=difference)
    noise = float(np.sqrt(0.5 * square.mean(dtype=np.float64)))
    tiles = _tiles(square)
    if tiles.size < LEAST_TILES or min(tiles.shape) < 2 or noise == 0.0:
        return noise, None
    # Across an edge neighbours differ by more than chance, along it they do not.
    scatter = min(np.mean(np.diff(tiles, axis=axis) ** 2) for axis in (0, 1))
    error_of_mean_square = np.sqrt(0.5 * scatter / tiles.size)
    return noise, float(0.25 * error_of_mean_square / noise)


def _tiles(values: NDArray) -> NDArray[np.float64]:
    """Return the means of square tiles, shape (tile row, tile col); what does not fill a tile is left out."""
    side = int(np.clip(min(values.shape) // 8, LEAST_TILE_PX, TILE_PX))
    rows, cols = (length // side for length in values.shape)
    whole = values[: rows * side, : cols * side]
    return whole.reshape(rows, side, cols, side).mean(axis=(1, 3), dtype=np.float64)


def _histogram(frame: NDArray, full_scale_dn: float) -> tuple[NDArray[np.int64], float]:
    bits = max(int(full_scale_dn).bit_length() - BINS.bit_length() + 1, 0)
    counts = np.bincount((frame >> bits).ravel(), minlength=BINS)
    last = int(full_scale_dn) >> bits
    return np.append(counts[:last], counts[last:].sum()), float(1 << bits)


def _inside(frame: NDArray, region: Region | None) -> NDArray:
    if region is None:
        return frame
    row, col, height, width = region
    rows, cols = frame.shape
    if min(row, col) < 0 or min(height, width) < 1 or row + height > rows or col + width > cols:
        raise BadInput(
            f"a region ROW,COL,HEIGHT,WIDTH must lie inside the image of {rows} rows and {cols} columns, "
            f"got {row},{col},{height},{width}"
        )
    return frame[row : row + height, col : col + width]
