"""Covariance gain from a sum over a window of lags, and from the variance of superpixels: what needs no spectrum."""

import numpy as np
from numpy.typing import NDArray

from charact.method import Context, register
from charact.noise.gain.covariance_sum import QUANTITIES, measured
from charact.noise.gain.reach import settled
from charact.noise.gain.series import Series
from charact.noise.gain.summary import Summary
from charact.noise.gain.tiles import pooled
from labdata.measurement import Result
from labdata.session import Session

Array = NDArray[np.float64]

# Lags on either side of a pixel, along rows and columns alike, and sides of superpixels, px.
LAGS_PX = (1, 2, 4, 8, 16)
SIDES_PX = (1, 2, 4, 8, 16, 32)
# Part of an image that a window or a superpixel may fill, and tiles that the rest is cut into along each side.
LARGEST_SHARE = 0.02
TILES = 6


@register(
    "flats",
    "covariance-window",
    quantities=QUANTITIES,
    scope="As covariance-sum, without its model: covariances are summed up to a lag; what wings of the blur hold "
    "beyond is charged to its interval.",
)
def covariance_window(session: Session, *, context: Context) -> Result:
    """Measure the covariance gain as the sum of covariances over a window of lags; all else as `covariance_sum`.

    Notes
    -----
    Taking away each exposure's mean takes the covariance gain over N from every covariance of N pixels: a window of n
    lags is short by n/N of its sum, which is put back.
    """

    def estimate(series: Series, summary: Summary) -> tuple[float, float]:
        size = _size(series, context)
        reaches = [lag for lag in LAGS_PX if (2 * lag + 1) ** 2 <= LARGEST_SHARE * np.prod(size)]
        values, covariance = pooled(session, series, summary, lambda change: windowed(change, reaches), context=context)
        short = np.array([1.0 - (2 * lag + 1) ** 2 / np.prod(size) for lag in reaches])
        return settled(values / short, covariance / np.outer(short, short))

    return measured(session, context=context, method="covariance-window", estimate=estimate)


@register(
    "flats",
    "binning",
    quantities=QUANTITIES,
    scope="As covariance-sum, without its model: the variance of superpixels is extrapolated in one over their side; "
    "what wings of the blur hold beyond is charged to its interval.",
)
def binning(session: Session, *, context: Context) -> Result:
    """Measure the covariance gain from the variance of superpixels over their area; all else as `covariance_sum`.

    Notes
    -----
    The sum over a square of side b has variance b^2 (G - A / b + ...), as what lies at its rim is correlated with what
    lies outside: 2 V(2b) - V(b) leaves that out, V(b) the variance over b^2.
    """

    def estimate(series: Series, summary: Summary) -> tuple[float, float]:
        size = _size(series, context)
        sides = [side for side in SIDES_PX if side**2 <= LARGEST_SHARE * np.prod(size)]
        values, covariance = pooled(session, series, summary, lambda change: binned(change, sides), context=context)
        short = np.array([1.0 - side**2 / np.prod(size) for side in sides])
        twice = 2.0 * np.eye(len(sides))[1:] - np.eye(len(sides))[:-1]
        linear = twice / short
        return settled(linear @ values, linear @ covariance @ linear.T)

    return measured(session, context=context, method="binning", estimate=estimate)


def _size(series: Series, context: Context) -> tuple[int, int]:
    """Rows and columns of an exposure."""
    rows, cols = series.flats[0].size
    return (rows // 2 if context.interlaced else rows), cols


def windowed(change: NDArray[np.float32], reaches: list[int]) -> Array:
    """Return the product of pixels with all within each reach, summed over exposures, shape (tile, reach), DN^2."""
    from cv2 import BORDER_CONSTANT, boxFilter

    margin = max(reaches)
    inner = np.s_[margin:-margin, margin:-margin]
    total = np.zeros((len(reaches), *change[0][inner].shape))
    for image in change:
        for sums, reach in zip(total, reaches, strict=True):
            around = boxFilter(image, -1, (2 * reach + 1,) * 2, normalize=False, borderType=BORDER_CONSTANT)
            sums += (image * around)[inner]
    return _tile_means(total)


def binned(change: NDArray[np.float32], sides: list[int]) -> Array:
    """Return the square of superpixels over their area, summed over exposures, shape (tile, side), DN^2."""
    largest = sides[-1]
    rows, cols = (length // largest for length in change.shape[1:])
    out = np.empty((rows * cols, len(sides)))
    sums = change[:, : rows * largest, : cols * largest]
    for index, side in enumerate(sides):
        if index:
            sums = sums[:, ::2, ::2] + sums[:, 1::2, ::2] + sums[:, ::2, 1::2] + sums[:, 1::2, 1::2]
        square = np.einsum("trc,trc->rc", sums, sums) / side**2
        each = largest // side
        out[:, index] = square.reshape(rows, each, cols, each).mean(axis=(1, 3)).ravel()
    return out


def _tile_means(images: Array) -> Array:
    """Means over the tiles of images, shape (tile, image)."""
    rows, cols = (length // TILES for length in images.shape[1:])
    cut = images[:, : rows * TILES, : cols * TILES].reshape(len(images), TILES, rows, TILES, cols)
    return cut.mean(axis=(2, 4)).reshape(len(images), -1).T
