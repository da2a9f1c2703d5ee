"""Statistics of a block of frames: clipped values, means, pixel products, fixed pattern and noise spectra."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.stack.clipped_counts import ClippedCounts, count_clipped
from charact.noise.stack.exposure_order import Order, order_of
from charact.noise.stack.pattern import Pattern, measure_fixed_pattern
from charact.noise.stack.pixels import (
    PixelSums,
    line_errors,
    lower_neighbour,
    pixel_sums,
    right_neighbour,
    successor_correlation,
    variance_error,
)
from charact.noise.stack.spectrum import NO_BINS, Bins, bins_of, smooth_length
from charact.noise.stack.temporal import autocovariance, usable_lags
from charact.noise.thresholds import STACK
from labdata.errors import BadInput
from labdata.frames import FrameStack

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class BlockSpectrum:
    """Temporal noise of one stack up to a largest lag: more lags mean less bias and more scatter.

    Parameters
    ----------
    lags
        Lags, exposures, 0 first, shape (lag,); empty if no spectrum was requested.
    power_dn2
        Autocovariance in time of the modes of each bin, shape (bin, lag), DN^2.
    variance_dn2
        Temporal variance of a pixel, DN^2.
    """

    lags: NDArray[np.int64]
    power_dn2: Array
    variance_dn2: float


NO_SPECTRUM = BlockSpectrum(lags=np.empty(0, np.int64), power_dn2=np.empty((0, 0)), variance_dn2=0.0)


@dataclass(frozen=True, kw_only=True)
class FrameBlock:
    """Statistics of a block of frames: values with their standard errors, and spectra. Names as in `Level`."""

    codes: ClippedCounts
    frame_mean_dn: Array
    time: NDArray[np.int64]
    parity: NDArray[np.int64]
    variance: tuple[float, float]
    neighbour: tuple[float, float]
    below: tuple[float, float]
    successor: tuple[float, float]
    pattern: Pattern
    few: BlockSpectrum
    many: BlockSpectrum


def run_of(frames: FrameStack, *, context: Context, spectra: bool) -> FrameBlock:
    """Return the statistics of one block of frames.

    Raises
    ------
    BadInput
        If values are out of range, or a frame has too few rows for two fields.
    """
    _check(frames, context)
    full_scale_dn = context.full_scale_dn if context.full_scale_dn is not None else frames.full_scale_dn
    bins = bins_of_run(frames.shape, context, spectra=spectra)
    order = order_of(frames.frame_number, interlaced=context.interlaced)
    sums = pixel_sums(frames.data, order, bins)
    plain = np.zeros(1, np.int64)
    variance = float(autocovariance(sums.products, order.time, order.parity, plain, within_parity=True)[0])
    few, many = NO_SPECTRUM, NO_SPECTRUM
    if spectra:
        few, many = (_spectrum(sums, order, most) for most in (STACK.few_lags, STACK.max_lags))
    rows, cols = line_errors(sums, order)
    lines = np.hypot(rows, cols)
    scale = max(variance, np.finfo(float).tiny)
    return FrameBlock(
        codes=count_clipped(frames.data, full_scale_dn),
        frame_mean_dn=sums.mean_dn.reshape(len(frames), -1).mean(axis=1),
        time=order.time,
        parity=order.parity,
        variance=(variance, float(np.hypot(variance_error(sums, variance), lines))),
        neighbour=_with_error(right_neighbour(sums), rows / scale),
        below=_with_error(lower_neighbour(sums), cols / scale),
        successor=successor_correlation(sums, order.parity),
        pattern=measure_fixed_pattern(order, sums, STACK.decay_exposures if context.interlaced else 1),
        few=few,
        many=many,
    )


def _with_error(known: tuple[float, float], error: float) -> tuple[float, float]:
    """Return a value with one more independent error."""
    return known[0], float(np.hypot(known[1], error))


def bins_of_run(shape: tuple[int, int, int], context: Context, *, spectra: bool) -> Bins:
    """Return the spectral bins of frames of a shape, cropped to lengths with a fast transform."""
    if not spectra:
        return NO_BINS
    step = 2 if context.interlaced else 1
    return bins_of(smooth_length(shape[1] // step), smooth_length(shape[2]), context.pitch_ratio * step)


def _check(frames: FrameStack, context: Context) -> None:
    """Reject frames without valid statistics."""
    if context.interlaced and frames.data.shape[1] < 2:
        raise BadInput(f"interlaced frames must have at least two rows, got {frames.data.shape[1]}")
    if frames.data.dtype.itemsize <= 2:
        return
    largest = max(abs(float(frames.data.max())), abs(float(frames.data.min())))
    if largest > STACK.max_dn:
        raise BadInput(f"pixel values must lie below {STACK.max_dn:.0e} DN, got {largest:.3g}")


def _spectrum(sums: PixelSums, order: Order, most: int) -> BlockSpectrum:
    """Return the unbiased temporal autocovariance up to a lag."""
    lags = usable_lags(order.time, order.parity, most)
    same = rows_lags(lags, order.parity)
    variance = autocovariance(sums.products, order.time, order.parity, same, within_parity=True)[0]
    power = autocovariance(sums.spectra, order.time, order.parity, lags)
    return BlockSpectrum(lags=lags, power_dn2=power, variance_dn2=float(variance))


def rows_lags(lags: NDArray[np.int64], parity: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the lags between exposures of the same rows."""
    return lags[lags % 2 == 0] if len(np.unique(parity)) > 1 else lags
