"""Noise law of a band: described, measured from successive frames, or estimated from quiet blocks
of the frame.
"""

from functools import cache
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from charact.frames.noise_law import NoiseLaw
from charact.frames.rounding import QUANTISATION_DN2
from charact.fusion.pyramid import decompose, noise_gains, reduce_image
from charact.fusion.thresholds import FUSION
from labdata.frames import FrameStack

Array = NDArray[np.float64]
Image = NDArray[Any]  # float32
# Frames from which noise is measured: 3 differences at 10^4 places know a variance within 1 %.
LEAST_FRAMES, MOST_FRAMES = 4, 33
# Share of full scale below which noise grows with the mean.
LINEAR_SHARE = 0.8


def blur_px_of(blur_factor: float) -> float:
    """Return the width of the Gaussian that lowers the variance of white noise by a factor, px."""
    widths = np.linspace(0.05, 4.0, 200)
    offsets = np.arange(-20, 21)
    kernels = np.exp(-0.5 * (offsets / widths[:, None]) ** 2)
    factors = np.sum((kernels / kernels.sum(axis=1, keepdims=True)) ** 2, axis=1) ** 2
    return float(np.interp(-blur_factor, -factors, widths))


def measure_noise(stack: FrameStack, black_dn: float, *, of_light: bool = True) -> NoiseLaw | None:
    """Return the noise law of one frame from the differences of successive frames; None of less
    than four.

    `of_light`: whether the noise grows with the mean; otherwise one number is found. Of the frames
    the first 33 are used; objects that move are outliers.

    At `FUSION.map_level` of the pyramid, whose coefficients hardly feel the blur after the gain,
    the variance of half the squared differences is the noise power times that of white noise;
    against the mean it is a line through 16 groups of places with equal weight of relative
    deviations, each the median of its places. The blur is that which lowers the variance of pixels
    as found, median over the groups.
    """
    if len(stack) < LEAST_FRAMES:
        return None
    frames = stack.data[:MOST_FRAMES].astype(np.float32)
    level = FUSION.map_level
    mean = reduce_image(frames.mean(axis=0) - np.float32(black_dn), level)[-1]
    power, pixel = np.zeros_like(mean), np.zeros_like(mean)
    for earlier, later in pairwise(frames):
        step = (later - earlier) * np.float32(0.5**0.5)
        power += cv2.GaussianBlur(reduce_image(step, level)[-1] ** 2, (0, 0), 2.0)
        pixel += reduce_image(step * step, level)[-1]
    # Mirrored borders have more noise.
    inner = np.s_[4:-4, 4:-4]
    mean, power, pixel = mean[inner], power[inner], pixel[inner] / np.float32(len(frames) - 1)
    power = power / np.float32((len(frames) - 1) * noise_gains(0.0, level).detail[-1])
    top = np.inf if stack.full_scale_dn is None else LINEAR_SHARE * (stack.full_scale_dn - black_dn)
    usable = np.flatnonzero(mean.ravel() < top)
    groups = np.array_split(usable[np.argsort(mean.ravel()[usable])], 16 if of_light else 1)
    if min(len(group) for group in groups) < 16:
        return None
    signal, noise_power, variance = (
        np.array([np.median(field.ravel()[group]) for group in groups])
        for field in (mean, power, pixel)
    )
    if not (noise_power > 0.0).all():
        return None
    blur = blur_px_of(min(1.0, float(np.median(variance / noise_power))))
    if not of_light:
        return NoiseLaw(gain_dn=0.0, read_dn=float(noise_power[0] ** 0.5))
    (gain, read2), _ = nnls(
        np.stack([signal / noise_power, 1.0 / noise_power], axis=1), np.ones_like(noise_power)
    )
    return NoiseLaw(
        gain_dn=float(gain), read_dn=float(max(read2, QUANTISATION_DN2) ** 0.5), blur_px=blur
    )


def estimate_noise(image: Image) -> NoiseLaw:
    """Estimate the noise law of a camera from one frame.

    Of blocks of equal brightness those with the least variance hold noise and no structure. The
    variances of the two finest pyramid levels are taken from a low quantile of the blocks' mean
    squares, over the same quantile of white noise; constant blocks, clipped or without data, are
    left out. The ratio of the two levels gives the blur of the noise, the coarser one its power in
    groups of equal brightness, through which goes the line gain * mean + read^2. Where every block
    holds structure, this structure is counted as noise.
    """
    pyramid = decompose(image, 2)
    light = _block_means(image, FUSION.noise_block_px)
    order = np.argsort(light, axis=None)
    # The brightest blocks hold lamps.
    groups = np.array_split(order[: max(1, int(0.97 * order.size))], FUSION.noise_groups)
    mean = np.array([light.ravel()[group].mean() if group.size else 0.0 for group in groups])
    fine, coarse = (
        _quiet_variances(pyramid[level], level, light.shape, groups) for level in (0, 1)
    )
    usable = (fine > 0.0) & (coarse > 0.0)
    if not usable.any():
        return NoiseLaw(gain_dn=0.0, read_dn=float(image.std()) * 1e-3, is_known=False)
    mean, fine, coarse = mean[usable], fine[usable], coarse[usable]
    widths = np.linspace(0.0, 2.0, 41)
    gains = [noise_gains(float(width), 2).detail for width in widths]
    ratios = np.array([gain[0] / gain[1] for gain in gains])
    blur = float(np.interp(-np.median(fine / coarse), -ratios, widths))
    power = coarse / noise_gains(blur, 2).detail[1]
    rises = (power[1:] - power[0]) / np.maximum(mean[1:] - mean[0], 1e-6)
    slope = max(0.0, float(np.median(rises))) if rises.size else 0.0
    read = max(float(np.median(power - slope * mean)), 1e-3 * float(power.mean()))
    return NoiseLaw(
        gain_dn=slope, read_dn=float(np.sqrt(read)), blur_px=blur, read_blur_px=blur, is_known=False
    )


def _block_means(image: Image, side: int) -> Array:
    """Return the means of square blocks."""
    rows, cols = (size // side for size in image.shape)
    return (
        image[: rows * side, : cols * side]
        .reshape(rows, side, cols, side)
        .mean(axis=(1, 3), dtype=np.float64)
    )


def _quiet_variances(
    detail: Image, level: int, shape: tuple[int, ...], groups: list[NDArray[np.intp]]
) -> Array:
    """Return the variance of noise in the details of each group of blocks; 0 where all blocks are
    constant.
    """
    squares = _block_means(np.square(detail), FUSION.noise_block_px >> level)
    # Halving rounds up, so that a level may hold one row or column of blocks more than the frame.
    squares = squares[: shape[0], : shape[1]]
    quiet = []
    for group in groups:
        row, col = np.unravel_index(group, shape)
        in_level = (row < squares.shape[0]) & (col < squares.shape[1])
        of_group = squares[row[in_level], col[in_level]]
        of_group = of_group[of_group > 1e-6 * float(squares.mean())]
        quiet.append(
            np.quantile(of_group, FUSION.quiet_share) / _quantile_of_white_noise(level)
            if of_group.size
            else 0.0
        )
    return np.array(quiet)


@cache
def _quantile_of_white_noise(level: int) -> float:
    """Return the low quantile of the blocks' mean squares of white noise, over their mean."""
    noise = np.random.default_rng(0).standard_normal((1024, 1024)).astype(np.float32)
    squares = _block_means(np.square(decompose(noise, 2)[level]), FUSION.noise_block_px >> level)
    return float(np.quantile(squares, FUSION.quiet_share) / squares.mean())
