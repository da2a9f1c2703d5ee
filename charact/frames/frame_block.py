"""Statistics of a block of frames: clipped values, means, pixel products, fixed pattern and noise
spectra.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.frames.clipping import ClippedCounts, count_clipped
from charact.frames.pixels import (
    PixelSums,
    line_errors,
    lower_neighbour,
    pixel_sums,
    right_neighbour,
    successor_correlation,
    variance_error,
    window_ratio,
)
from charact.frames.spectrum import NO_BINS, Bins, bins_of, smooth_length
from charact.frames.temporal import (
    Order,
    autocovariance,
    order_of,
    same_row_lags,
    usable_lags,
)
from charact.frames.thresholds import STACK
from charact.method import Context
from labdata import Array, BadInput, FrameStack


@dataclass(frozen=True, kw_only=True)
class Pattern:
    """Spatial variance of the fixed pattern."""

    # variance_dn2, sd_dn2: the variance and its standard error, DN^2
    variance_dn2: float
    sd_dn2: float
    # whether the covariance is independent of the separation of exposures; if not, slow noise
    # counts as pattern
    settled: bool


def measure_fixed_pattern(order: Order, sums: PixelSums, min_separation: int) -> Pattern:
    """Return the spatial variance of the fixed pattern.

    `order`: order of the exposures; `sums`: products of their pixels; `min_separation`: smallest
    separation of compared exposures.

    The estimate is the mean covariance over the image of two exposures of the same rows, whose
    temporal noise is independent. Image lag correlates exposures near in time, so the separation is
    doubled until the covariance no longer falls.
    """
    parts = [
        _field_pattern(order, sums, int(parity), min_separation)
        for parity in np.unique(order.parity)
    ]
    return Pattern(
        variance_dn2=float(np.mean([part.variance_dn2 for part in parts])),
        sd_dn2=float(np.sqrt(np.sum([part.sd_dn2**2 for part in parts])) / len(parts)),
        settled=all(part.settled for part in parts),
    )


def _field_pattern(order: Order, sums: PixelSums, parity: int, min_separation: int) -> Pattern:
    """Return the pattern of the exposures of one parity."""
    same = np.flatnonzero(order.parity == parity)
    cross = sums.with_mean[same]
    products = sums.mean_square[parity] + cross[:, None] + cross + sums.products[np.ix_(same, same)]
    distance = np.abs(order.time[same][:, None] - order.time[same])
    spread = _spread(sums, parity)
    separation, excess = int(distance[distance > 0].min()), [0.0]
    while True:
        covariance, sd = _mean(products, distance >= separation, spread)
        further = distance >= 2 * separation
        if not further.any():
            slow_part = _remaining_correlation(excess)
            return Pattern(
                variance_dn2=covariance,
                sd_dn2=float(np.hypot(sd, slow_part)),
                settled=slow_part <= STACK.max_slow_noise * abs(covariance),
            )
        near_pairs = (distance >= separation) & ~further
        if not near_pairs.any():
            separation *= 2
            continue
        near_covariance, near_sd = _mean(products, near_pairs, spread)
        far_covariance, far_sd = _mean(products, further, spread)
        noise = float(np.hypot(near_sd, far_sd))
        has_settled = (
            near_covariance - far_covariance
            <= STACK.slow_noise_sd * noise + 0.5 * STACK.slow_noise_fraction * abs(far_covariance)
        )
        # A possible excess of near pairs adds to the error in proportion to their number.
        unseen = (max(near_covariance - far_covariance, 0.0) + noise) * float(
            near_pairs.sum() / (distance >= separation).sum()
        )
        if (
            has_settled
            and separation >= min_separation
            and (not any(excess) or unseen <= STACK.max_slow_noise * abs(covariance))
        ):
            return Pattern(
                variance_dn2=covariance, sd_dn2=float(np.hypot(sd, unseen)), settled=True
            )
        excess.append(
            0.0 if has_settled and not any(excess) else max(near_covariance - far_covariance, noise)
        )
        separation *= 2


def _remaining_correlation(excess: list[float]) -> float:
    """Return the excess beyond the last separation, extrapolated by the ratio of the last two."""
    before, last = ([np.nan, *excess])[-2:]
    if last <= 0:
        return 0.0
    return float(last**2 / before) if before > last else np.inf


def _mean(
    products: Array, chosen: NDArray[np.bool_], spread: tuple[float, float]
) -> tuple[float, float]:
    """Return the mean product over the chosen pairs and its standard error, for noise of the given
    spread.
    """
    weight = chosen / chosen.sum()
    common = float((weight * products).sum())
    noise = products - common
    weighted_noise = weight @ noise
    twice, crossed = spread
    square = 2.0 * max(float(np.trace(weighted_noise @ weighted_noise)), 0.0) * twice
    square += 4.0 * max(common, 0.0) * max(float((weighted_noise @ weight).sum()), 0.0) * crossed
    return common, float(np.sqrt(square))


def _spread(sums: PixelSums, parity: int) -> tuple[float, float]:
    """Return the inverse number of independent pixels, for noise with noise and for noise with the
    pattern.

    The image centre represents the image; variance missing from its mean image is shading at the
    lowest frequencies.
    """
    middle, pixels = sums.middle[parity], sums.size[0] * sums.size[1]
    noise, mean = (
        np.mean([_power(image) for image in middle], axis=0),
        _power(sums.mean_middle[parity]),
    )
    level = float(noise.mean())
    if level <= 0:
        return 0.0, 0.0
    # The mean square of a mean of m exponential powers is biased by 1 + 1/m.
    twice = float(np.mean(noise**2)) / level**2 / (1.0 + 1.0 / len(middle))
    lowest = np.delete(
        noise[
            np.ix_(
                *(
                    [0, min(1, n - 1), -1][:corner_count]
                    for n, corner_count in zip(noise.shape, (3, 2), strict=True)
                )
            )
        ],
        0,
    )
    noise_square = float(mean.mean()) / middle[0].size
    shading = max(sums.mean_square[parity] - noise_square, 0.0)
    crossed = noise_square * float(np.mean(mean * noise)) / max(
        float(mean.mean()), 1e-30
    ) + shading * float(lowest.mean())
    return twice / pixels, crossed / max((noise_square + shading) * level, 1e-30) / pixels


def _power(image: NDArray[np.float32]) -> Array:
    """Return the power of every mode of an image except its mean, half plane."""
    from scipy import fft

    modes = np.asarray(fft.rfft2(image, workers=1), np.complex64)
    power = modes.real.astype(np.float64) ** 2 + modes.imag.astype(np.float64) ** 2
    power[0, 0] = 0.0
    return power


@dataclass(frozen=True, kw_only=True)
class BlockSpectrum:
    """Temporal noise of one stack up to a largest lag: more lags mean less bias and more
    scatter.
    """

    lags: NDArray[
        np.int64
    ]  # lags, exposures, 0 first, shape (lag,); empty if no spectrum was requested
    power_dn2: Array  # autocovariance in time of the modes of each bin, shape (bin, lag), DN^2
    variance_dn2: float  # temporal variance of a pixel, DN^2


NO_SPECTRUM = BlockSpectrum(
    lags=np.empty(0, np.int64), power_dn2=np.empty((0, 0)), variance_dn2=0.0
)


@dataclass(frozen=True, kw_only=True)
class FrameBlock:
    """Statistics of a block of frames: values with their standard errors, and spectra."""

    codes: ClippedCounts
    frame_mean_dn: Array
    time: NDArray[np.int64]
    parity: NDArray[np.int64]
    variance: tuple[float, float]
    neighbour: tuple[float, float]
    lower: tuple[float, float]
    successor: tuple[float, float]
    pattern: Pattern
    few_lags: BlockSpectrum
    many_lags: BlockSpectrum

    @property
    def fixed_pattern(self) -> tuple[float, float]:
        """Variance of the fixed pattern and its standard error, DN^2."""
        return self.pattern.variance_dn2, self.pattern.sd_dn2


# Whether to compute noise spectra: in the bins of the covariance sum, or in those of a function of
# rows, columns and row pitch.
Spectra = bool | Callable[[int, int, float], Bins]


def run_of(frames: FrameStack, *, context: Context, spectra: Spectra) -> FrameBlock:
    """Return the statistics of one block of frames.

    Raises BadInput if values are out of range, or a frame has too few rows for two fields.
    """
    _check(frames, context)
    full_scale_dn = (
        context.full_scale_dn if context.full_scale_dn is not None else frames.full_scale_dn
    )
    bins = bins_of_run(frames.shape, context, spectra=spectra)
    order = order_of(frames.frame_number, interlaced=context.interlaced)
    sums = pixel_sums(frames.data, order, bins)
    plain = np.zeros(1, np.int64)
    variance = float(
        autocovariance(sums.products, order.time, order.parity, plain, within_parity=True)[0]
    )
    few_lags, many_lags = NO_SPECTRUM, NO_SPECTRUM
    if spectra:
        ratio = window_ratio(sums, bins)
        few_lags = _spectrum(sums, order, STACK.few_lags if spectra is True else 0, ratio)
        many_lags = _spectrum(sums, order, STACK.max_lags, ratio)
    rows, cols = line_errors(sums, order)
    lines = np.hypot(rows, cols)
    scale = max(variance, np.finfo(float).tiny)
    (right, right_sd), (lower, lower_sd) = right_neighbour(sums), lower_neighbour(sums)
    return FrameBlock(
        codes=count_clipped(frames.data, full_scale_dn),
        frame_mean_dn=sums.mean_dn.reshape(len(frames), -1).mean(axis=1),
        time=order.time,
        parity=order.parity,
        variance=(variance, float(np.hypot(variance_error(sums, variance), lines))),
        neighbour=(right, float(np.hypot(right_sd, rows / scale))),
        lower=(lower, float(np.hypot(lower_sd, cols / scale))),
        successor=successor_correlation(sums, order.parity),
        pattern=measure_fixed_pattern(
            order, sums, STACK.decay_exposures if context.interlaced else 1
        ),
        few_lags=few_lags,
        many_lags=many_lags,
    )


def bins_of_run(shape: tuple[int, int, int], context: Context, *, spectra: Spectra) -> Bins:
    """Return the spectral bins of frames of a shape; those of the covariance sum are cropped to
    fast transforms.
    """
    if not spectra:
        return NO_BINS
    step = 2 if context.interlaced else 1
    rows, cols, pitch = shape[1] // step, shape[2], context.pitch_ratio * step
    return (
        bins_of(smooth_length(rows), smooth_length(cols), pitch)
        if spectra is True
        else spectra(rows, cols, pitch)
    )


def _check(frames: FrameStack, context: Context) -> None:
    """Reject frames without valid statistics."""
    if context.interlaced and frames.data.shape[1] < 2:
        raise BadInput(f"interlaced frames must have at least two rows, got {frames.data.shape[1]}")
    if frames.data.dtype.itemsize <= 2:
        return
    largest = max(abs(float(frames.data.max())), abs(float(frames.data.min())))
    if largest > STACK.max_dn:
        raise BadInput(f"pixel values must lie below {STACK.max_dn:.0e} DN, got {largest:.3g}")


def _spectrum(sums: PixelSums, order: Order, max_lag: int, ratio: float) -> BlockSpectrum:
    """Return the unbiased temporal autocovariance up to a lag, of the image by that under the
    window.
    """
    lags = usable_lags(order.time, order.parity, max_lag)
    same = same_row_lags(lags, order.parity)
    variance = autocovariance(sums.products, order.time, order.parity, same, within_parity=True)[0]
    power = autocovariance(sums.spectra, order.time, order.parity, lags) * ratio
    return BlockSpectrum(lags=lags, power_dn2=power, variance_dn2=float(variance))
