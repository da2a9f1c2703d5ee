"""Statistics of pixels and their neighbours in one pass over the exposures, with errors from image
blocks.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from charact.frames.spectrum import (
    Bins,
    along_rows,
    modes_of,
    products_of,
    smooth_length,
)
from charact.frames.temporal import Order, split_fields
from charact.frames.thresholds import STACK

Array = NDArray[np.float64]
Whole = NDArray[np.int64]
# Sums of each block, in this order.
SUMS = ("power", "right", "lower", "nearest", "level")


@dataclass(frozen=True, kw_only=True)
class PixelSums:
    """Products of the temporal fluctuations of pixels, less each pixel's and each exposure's mean.

    The pixel mean removes the fixed pattern, the exposure mean flicker.
    """

    size: tuple[int, int]  # rows and columns of an exposure
    mean_dn: Array  # mean of each exposure, shape (exposure,), DN
    # mean product of exposures of equal parity, shape (exposure, exposure), DN^2; 0 across parities
    products: Array
    # mean product of each exposure's fluctuations with the mean image of its parity, shape
    # (exposure,), DN^2
    with_mean: Array
    mean_square: Array  # variance over the image of that mean image, shape (parity,), DN^2
    # middle, mean_middle: for each parity the image centre of the fluctuations of some exposures,
    # shape (exposure, row, col), and of the mean image, shape (row, col), DN
    middle: tuple[NDArray[np.float32], ...]
    mean_middle: tuple[NDArray[np.float32], ...]
    # power, right, lower: block means of the sum over exposures of the square, and of the product
    # with the next pixel of the row and of the column, shape (block,), DN^2; NaN for a block
    # without such pairs
    power: Array
    right: Array
    lower: Array
    # nearest, pairs: block means of the summed products of the exposures nearest in time, shape
    # (block,), DN^2, and the number of these pairs
    nearest: Array
    pairs: int
    level: Array  # mean of the pixels of a block, shape (block,), DN
    # mean product of the modes of exposures, see
    # `charact.frames.spectrum.products_of`
    spectra: Array


def pixel_sums(data: NDArray, order: Order, bins: Bins) -> PixelSums:
    """Return the sums over the pixels of frames.

    `data`: pixels, shape (frame, row, col), DN; `order`: time order of the exposures; `bins`: bins
    of the spectra; `NO_BINS` for none.
    """
    fields = split_fields(data, order.row_step)
    rows, cols = fields[0].shape[1:]
    row_cuts, col_cuts = _cuts((rows, cols))
    total = np.zeros((len(SUMS), len(row_cuts) - 1, len(col_cuts) - 1))
    count = len(order.time)
    level, products, with_mean = np.empty(count), np.zeros((count, count)), np.zeros(count)
    modes, passes = [], []
    for parity, field in enumerate(fields):
        same = np.flatnonzero(order.parity == parity)
        level[same] = [_mean(image) for image in field]
        field_pass = _Pass(
            field, level[same], _nearest(order.time[same]), row_cuts, col_cuts, total, bins
        )
        products[np.ix_(same, same)], with_mean[same] = (
            field_pass.products / (rows * cols),
            field_pass.with_mean / (rows * cols),
        )
        modes += [modes_of(along, parity, bins) for along in field_pass.along]
        passes.append(field_pass)
    heights, widths = np.diff(row_cuts), np.diff(col_cuts)
    right, lower = widths.copy(), heights.copy()
    right[-1] -= 1
    lower[0] -= 1
    plain = np.outer(heights, widths)
    number = (plain, np.outer(heights, right), np.outer(lower, widths), plain, plain * len(fields))
    mean = {
        name: np.where(n > 0, part / np.maximum(n, 1), np.nan).ravel()
        for name, part, n in zip(SUMS, total, number, strict=True)
    }
    mean["level"] += level.mean()
    return PixelSums(
        size=(rows, cols),
        mean_dn=level,
        products=products,
        with_mean=with_mean,
        mean_square=np.array([field_pass.mean_square for field_pass in passes]) / (rows * cols),
        middle=tuple(field_pass.middle for field_pass in passes),
        mean_middle=tuple(field_pass.mean_middle for field_pass in passes),
        pairs=sum(len(field_pass.first) for field_pass in passes),
        spectra=_complete_products(products_of(np.array(modes), bins), order.parity),
        **mean,
    )


def _cuts(size: tuple[int, int]) -> list[Whole]:
    """Return the first row and column of each block, and the end of the last."""
    return [
        np.linspace(0, length, min(most, length) + 1).astype(np.int64)
        for length, most in zip(size, STACK.blocks, strict=True)
    ]


def window_ratio(sums: PixelSums, bins: Bins) -> float:
    """Return the variance of the image over that under the window of the spectra.

    Shot noise of a vignetted flat is stronger where the window weighs more.
    """
    cuts = _cuts(sums.size)
    if min(map(len, cuts)) < 3 or not sums.power.any():
        return 1.0
    of_image, under_window = (
        np.outer(*(_block_weights(weight, cut) for weight, cut in zip(weights, cuts, strict=True)))
        for weights in (
            [np.ones(length) for length in sums.size],
            [f.astype(np.float64) ** 2 for f in bins.fades],
        )
    )
    of_image, under_window = (
        float(np.average(sums.power, weights=weights.ravel()))
        for weights in (of_image, under_window)
    )
    return of_image / under_window


def _block_weights(weight: Array, cuts: Whole) -> Array:
    """Return the weight of each block in a sum of pixels, which lie on lines between the means of
    blocks.
    """
    middle = 0.5 * (cuts[1:] + cuts[:-1] - 1)
    at = np.arange(len(weight))
    block = np.clip(np.searchsorted(middle, at) - 1, 0, len(middle) - 2)
    part = (at - middle[block]) / (middle[block + 1] - middle[block])
    sums = [
        np.bincount(index, weights=weight * portion, minlength=len(middle))
        for index, portion in ((block, 1.0 - part), (block + 1, part))
    ]
    return np.asarray(sums[0] + sums[1], np.float64)


class _Pass:
    """One pass over the exposures of one parity, in bands of rows."""

    def __init__(
        self,
        field: NDArray,
        level: Array,
        nearest_pairs: tuple[Whole, Whole],
        row_cuts: Whole,
        col_cuts: Whole,
        total: Array,
        bins: Bins,
    ) -> None:
        count, rows, cols = field.shape
        self.first, self.second = nearest_pairs
        self.bins = bins
        self.products, self.with_mean, self.mean_square = (
            np.zeros((count, count)),
            np.zeros(count),
            0.0,
        )
        # Centred exposures sum to zero: all but one are independent.
        self.some = np.linspace(0, count - 2, min(count - 1, STACK.spectra)).round().astype(int)
        self.rows, self.cols = (_middle(length) for length in (rows, cols))
        side = (self.rows.stop - self.rows.start, self.cols.stop - self.cols.start)
        self.middle = np.empty((len(self.some), *side), np.float32)
        self.mean_middle = np.empty(side, np.float32)
        self.along = np.empty((count - 1, bins.window.shape[0], bins.columns), np.complex64)
        previous_row = np.zeros((count, cols), np.float32)
        # White noise loses the fraction 1/N with the mean of N pixels; it is restored.
        back = np.float32(np.sqrt(rows * cols / max(rows * cols - 1, 1)))
        step = max(1, STACK.band_pixels // (count * cols))
        for start in range(0, rows, step):
            band = field[:, start : start + step].astype(np.float32)
            mean = _centre(band, level, back)
            self.mean_square += _add(
                band,
                mean,
                previous_row,
                start,
                row_cuts,
                col_cuts,
                *nearest_pairs,
                self.products,
                self.with_mean,
                total,
            )
            previous_row = band[:, -1].copy()
            self._keep(band, mean, start)

    def _keep(self, band: NDArray[np.float32], mean: NDArray[np.float32], start: int) -> None:
        """Store the data of the spectra."""
        low, high = max(start, self.rows.start), min(start + len(mean), self.rows.stop)
        if low < high:
            from_band, to_middle = (
                np.s_[low - start : high - start],
                np.s_[low - self.rows.start : high - self.rows.start],
            )
            self.middle[:, to_middle] = band[self.some, from_band, self.cols]
            self.mean_middle[to_middle] = mean[from_band, self.cols]
        stop = min(start + len(mean), self.along.shape[1])
        if start < stop:
            self.along[:, start:stop] = along_rows(band[:-1, : stop - start], start, self.bins)


def _complete_products(products: Array, parity: Whole) -> Array:
    """Return the mode products of all exposures from those without the last of each parity, shape
    (bin, i, j).

    Centred exposures sum to zero: the last is minus the sum of the others.
    """
    made = np.zeros((len(parity), products.shape[1]))
    first = 0
    # The others are ordered by parity.
    for value in np.unique(parity):
        same = np.flatnonzero(parity == value)
        columns = first + np.arange(len(same) - 1)
        made[same[:-1], columns], made[same[-1], columns] = 1.0, -1.0
        first += len(columns)
    return made @ products @ made.T


def _middle(length: int) -> slice:
    """Return the centre of an axis, of a length with a fast transform."""
    side = smooth_length(min(length, STACK.side_px))
    return slice((length - side) // 2, (length - side) // 2 + side)


@njit(cache=True, fastmath=True)
def _mean(image):
    """Return the mean of an image in double precision."""
    total = 0.0
    for row in range(image.shape[0]):
        for col in range(image.shape[1]):
            total += image[row, col]
    return total / image.size


@njit(cache=True, fastmath=True)
def dot(first, second):
    """Return the sum of products, added in a fixed order."""
    total = np.float32(0.0)
    for i in range(len(first)):
        total += first[i] * second[i]
    return total


@njit(cache=True, fastmath=True)
def _centre(band, level, back):
    """Replace a band of exposures by its fluctuations, and return its mean over the exposures."""
    count, rows, cols = band.shape
    mean = np.zeros((rows, cols), np.float32)
    reciprocal = np.float32(1.0 / count)
    for row in range(rows):
        middle = mean[row]
        for t in range(count):
            line, frame_level = band[t, row], np.float32(level[t])
            for col in range(cols):
                line[col] -= frame_level
                middle[col] += line[col]
        for col in range(cols):
            middle[col] *= reciprocal
        for t in range(count):
            line = band[t, row]
            for col in range(cols):
                line[col] = (line[col] - middle[col]) * back
    return mean


@njit(cache=True, fastmath=True)
def _add(
    band, mean, previous_row, start, row_cuts, col_cuts, first, second, products, with_mean, total
):
    """Add the products of a band that starts at row `start`, below the row `previous_row`; return
    those of its mean.
    """
    count, rows, cols = band.shape
    mean_square, high = 0.0, 0
    sums = np.zeros((len(total), cols), np.float32)
    for row in range(rows):
        while start + row >= row_cuts[high + 1]:
            _flush(sums, total[:, high], col_cuts)
            high += 1
        mean_square += dot(mean[row], mean[row])
        for i in range(count):
            line = band[i, row]
            with_mean[i] += dot(mean[row], line)
            for j in range(i):
                square = dot(line, band[j, row])
                products[i, j] += square
                products[j, i] += square
            products[i, i] += dot(line, line)
        for t in range(count):
            line = band[t, row]
            _add_products(line, line, sums[0])
            _add_products(line[:-1], line[1:], sums[1])
            _add_products(line, band[t, row - 1] if row else previous_row[t], sums[2])
        for pair in range(len(first)):
            _add_products(band[first[pair], row], band[second[pair], row], sums[3])
        for col in range(cols):
            sums[4, col] += mean[row, col]
    _flush(sums, total[:, high], col_cuts)
    return mean_square


@njit(cache=True, fastmath=True)
def _add_products(first, second, sums):
    """Add the products of two rows, column for column."""
    for col in range(len(first)):
        sums[col] += first[col] * second[col]


@njit(cache=True, fastmath=True)
def _flush(sums, total, col_cuts):
    """Add the column sums to the block sums, and reset them."""
    for kind in range(len(sums)):
        for block_col in range(len(col_cuts) - 1):
            block = 0.0
            for col in range(col_cuts[block_col], col_cuts[block_col + 1]):
                block += sums[kind, col]
            total[kind, block_col] += block
    sums[:] = 0.0


def variance_error(sums: PixelSums, variance: float) -> float:
    """Return the standard error of the mean variance, from image blocks scaled to the mean
    level.
    """
    # Shot noise is lower in darker blocks.
    bright = sums.level.min() > 0.5 * sums.level.mean()
    scaled = sums.power * (sums.level.mean() / sums.level if bright else 1.0)
    if scaled.size < 2:
        return variance
    return float(
        variance * scaled.std(ddof=1) / max(float(scaled.mean()), 1e-12) / np.sqrt(scaled.size)
    )


def line_errors(sums: PixelSums, order: Order) -> tuple[float, float]:
    """Return the part of row noise, and of column noise, in the standard error of the variance,
    DN^2.

    Row noise of variance v in R rows of n exposures has the standard error v sqrt(2 / (R (n - 1))),
    whatever the number of pixels. It is the power of rows at frequency 0 above that at the lowest
    frequency, which blur affects alike.
    """
    count = len(order.time) / len(sums.middle)
    freedom = max(len(order.time) - len(sums.middle), 1)
    parts = [
        [_line_power(np.moveaxis(image, axis, -1)) for image in sums.middle] for axis in (2, 1)
    ]
    # Subtracting the mean of n exposures removes the fraction 1/n.
    rows, cols = (max(float(np.mean(part)), 0.0) * count / max(count - 1.0, 1.0) for part in parts)
    return rows * float(np.sqrt(2.0 / (sums.size[0] * freedom))), cols * float(
        np.sqrt(2.0 / (sums.size[1] * freedom))
    )


def _line_power(lines: NDArray[np.float32]) -> float:
    """Return the variance of the line means beyond that of the lowest frequency; lines along the
    last axis.
    """
    phase = 2.0 * np.pi * np.arange(lines.shape[-1], dtype=np.float32) / lines.shape[-1]
    waves = np.stack([np.ones_like(phase), np.cos(phase), np.sin(phase)], axis=1) / lines.shape[-1]
    power = np.mean((lines @ waves).reshape(-1, 3) ** 2, axis=0)
    return float(power[0] - power[1] - power[2])


def right_neighbour(sums: PixelSums) -> tuple[float, float]:
    """Return the correlation of neighbouring pixels of a row, and its standard error; zeros for
    rows of one pixel.
    """
    return _correlation(sums, sums.right) if sums.size[1] > 1 else (0.0, 0.0)


def lower_neighbour(sums: PixelSums) -> tuple[float, float]:
    """Return the correlation of neighbouring pixels of a column of one exposure, and its standard
    error.
    """
    return _correlation(sums, sums.lower) if sums.size[0] > 1 else (0.0, 0.0)


def _correlation(sums: PixelSums, products: Array) -> tuple[float, float]:
    """Return products over squares, and the standard error from the scatter of blocks."""
    is_known = np.isfinite(products)
    products, power = products[is_known], sums.power[is_known]
    ratio = products / np.maximum(power, 1e-12)
    error = ratio.std(ddof=1) / np.sqrt(ratio.size) if ratio.size > 1 else 1.0
    # Subtracting the mean of N pixels anticorrelates white noise by 1/(N - 1).
    mean_loss = 1.0 / max(sums.size[0] * sums.size[1] - 1, 1)
    return float(products.mean() / max(float(power.mean()), 1e-12)) + mean_loss, float(error)


def successor_correlation(sums: PixelSums, parity: Whole) -> tuple[float, float]:
    """Return the excess correlation of exposures nearest in time over the others, and its standard
    error.

    Centred exposures sum to zero, so the mean covariance of all pairs follows from the variance,
    and the excess needs the near pairs alone. It is free of centring bias and fixed pattern. With
    two exposures of one parity the error is infinite.
    """
    count = np.bincount(parity)
    other_pairs = int((count * (count - 1) // 2).sum()) - sums.pairs
    freedom = len(parity) - np.count_nonzero(count)
    if not other_pairs or sums.power.mean() <= 0 or sums.power.size < 2:
        return 0.0, np.inf
    contrast = (
        (sums.nearest / sums.pairs + (0.5 * sums.power + sums.nearest) / other_pairs)
        * freedom
        / sums.power.mean()
    )
    return float(contrast.mean()), float(contrast.std(ddof=1) / np.sqrt(contrast.size))


def _nearest(time: Whole) -> tuple[Whole, Whole]:
    """Return the indices of the pairs nearest in time."""
    distance = np.abs(time[:, None] - time)
    upper = np.triu(np.ones_like(distance, bool), 1)
    first, second = np.nonzero(
        upper & (distance == distance[upper].min(initial=np.iinfo(np.int64).max))
    )
    return first, second
