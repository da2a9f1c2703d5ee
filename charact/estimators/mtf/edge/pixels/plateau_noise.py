"""Temporal noise on the plateaus and slopes of an edge, and what its growth tells of the camera's
response.

Noise is taken from frame differences where there are several frames: fixed patterns and lamp
flicker are then excluded.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.thresholds import ACCURACY, LIMITS

Array = NDArray[np.float64]

# Lags along a row: of neighbours, and of distant pixels, which have only row noise in common.
LAGS_PX = (1, 8, 9, 10)


@dataclass(frozen=True, kw_only=True)
class TransferPoint:
    """Level and noise of one plateau: a point of a photon transfer curve, with its errors.

    Parameters
    ----------
    level
        Mean of its pixels, DN.
    variance, scatter
        Mean variance of a pixel, DN^2, and its relative standard uncertainty.
    covariance, covariance_sd
        Mean covariance of neighbours along a row less that of distant pixels, and its standard
        uncertainty, DN^2.
    """

    level: float
    variance: float
    scatter: float
    covariance: float
    covariance_sd: float


Sides = tuple[TransferPoint, TransferPoint]


def plateau_noise(
    frames: Array, expected: Array, sides: NDArray[np.int64], *, along: int, correlation_sum: float
) -> Sides | None:
    """Return the noise of the dark and of the bright plateau; None if a plateau has too few pixels.

    Parameters
    ----------
    frames
        Shape (frame, row, col), DN.
    expected
        Model of a single frame, shape (row, col), DN.
    sides
        0 for excluded pixels, 1 on the dark and 2 on the bright plateau, shape (row, col).
    along
        Axis of a frame along which neighbours belong to one field: 0 down its rows, 1 along them.
    correlation_sum
        Sum of the noise correlations: variance factor of averages relative to independent pixels.

    Notes
    -----
    The mean of a plateau in each frame and, of several frames, the mean of each pixel are
    subtracted. Uncertainties follow from the scatter of the pixels, which includes heavy-tailed
    pulses, and from their correlation.
    """
    residual = frames - (frames.mean(axis=0) if len(frames) > 1 else expected)
    free, widening, points = max(len(frames) - 1, 1), max(correlation_sum, 1.0), []
    for side in (sides == 1, sides == 2):
        if np.count_nonzero(side) < LIMITS.min_plateau_pixels:
            return None
        off = residual - residual[:, side].mean(axis=1)[:, None, None]
        square, product, *distant = (
            _lagged_products(off, side, along, lag) / free for lag in (0, *LAGS_PX)
        )
        unshared, variance = np.concatenate(distant), float(square.mean())
        pairs = max(product.size, 1)
        point = TransferPoint(
            level=float(frames[:, side].mean()),
            variance=variance,
            scatter=float(np.sqrt(square.var() * widening / square.size)) / max(variance, 1e-300),
            covariance=float(product.sum() / pairs - unshared.sum() / max(unshared.size, 1)),
            covariance_sd=float(np.sqrt(product.var() * widening / pairs))
            if product.size
            else np.inf,
        )
        points.append(point)
    return points[0], points[1]


def _lagged_products(off: Array, side: NDArray[np.bool_], along: int, lag: int) -> Array:
    """Return the sums over frames of the products of a plateau's pixels a lag apart."""
    off, side = np.moveaxis(off, along - 2, -1), np.moveaxis(side, along - 2, -1)
    last = max(side.shape[-1] - lag, 0)
    products = np.einsum("frc,frc->rc", off[..., :last], off[..., lag:])
    return products[side[:, :last] & side[:, lag:]]


@dataclass(frozen=True, kw_only=True)
class SlopeVariance:
    """Temporal variance on the slopes of a target over that expected from its plateaus.

    Parameters
    ----------
    ratio, sd
        Ratio and its standard uncertainty, dimensionless.
    """

    ratio: float = 1.0
    sd: float = np.inf

    @property
    def is_smoothed(self) -> bool:
        """Whether the plateaus are quieter than photon and read-out noise allow."""
        return self.ratio > LIMITS.slope_noise[0] + LIMITS.slope_noise[1] * self.sd


def noise_on_slopes(
    frames: Array, level: Array, steep: Array, sides: NDArray[np.int64]
) -> SlopeVariance:
    """Return the noise on the slopes of a target relative to that of its plateaus.

    Parameters
    ----------
    frames
        Shape (frame, row, col), DN; the target's lines run down the rows.
    level
        From 0 (dark) to 1 (bright), shape (row, col).
    steep
        Slope of the target across its lines, shape (row, col).
    sides
        0 for excluded pixels, 1 on the dark and 2 on the bright plateau, shape (row, col).

    Notes
    -----
    The variance of photon and read-out noise is linear in the level. Level and contrast of each
    frame are subtracted (lamp flicker), and from each row's slope the component of a displacement
    (line jitter). Correlated noise makes that component larger and the ratio smaller.
    """
    on_slope = (np.abs(steep) > LIMITS.min_slope * np.abs(steep).max()) & (
        np.count_nonzero(sides, axis=1) > 0
    )[:, None]
    if len(frames) < LIMITS.min_smoothing_frames or not on_slope.any():
        return SlopeVariance()
    residual, valid = frames - frames.mean(axis=0), on_slope | (sides > 0)
    design = np.stack([np.ones(np.count_nonzero(valid)), level[valid]])
    base, contrast = np.linalg.lstsq(design.T, residual[:, valid].T, rcond=None)[0]
    residual = residual - base[:, None, None] - contrast[:, None, None] * level
    free = len(frames) - 1
    square = np.sum(residual**2, axis=0) / free
    count = np.count_nonzero(on_slope, axis=1)
    shape = np.where(on_slope, steep, 0.0)
    displacement_power = np.einsum("fij,ij->fi", residual, shape) ** 2 / np.maximum(
        np.sum(shape**2, axis=1), 1e-300
    )
    slope = np.sum(square * on_slope, axis=1) - displacement_power.sum(axis=0) / free
    usable = count >= LIMITS.min_slope_pixels
    # The displacement of a row takes one degree of freedom.
    fraction = (count - 1) / np.maximum(count, 1)
    bright = np.where(on_slope, np.clip(level, 0.0, 1.0), 0.0).sum(axis=1) * fraction
    # Per row: variance on the slope, and the equivalent number of pixels at the dark and the bright
    # level.
    slope, bright, dark = ((usable * side) for side in (slope, bright, count * fraction - bright))
    plateaus = [
        (np.sum(square * (sides == side), axis=1), np.count_nonzero(sides == side, axis=1))
        for side in (1, 2)
    ]
    parts = [slope, dark, bright, *(part for plateau in plateaus for part in plateau)]
    rows = np.stack([np.asarray(part, np.float64) for part in parts])
    blocks = rows.shape[1] // ACCURACY.block_rows
    if blocks < ACCURACY.min_blocks:
        return SlopeVariance()
    sums = (
        rows[:, : blocks * ACCURACY.block_rows]
        .reshape(len(rows), blocks, ACCURACY.block_rows)
        .sum(axis=2)
    )
    total = sums.sum(axis=1, keepdims=True)
    if total[1:].min() <= 0:
        return SlopeVariance()
    # Of all rows, and with each block of them left out.
    slope, dark, bright, *plateaus = np.concatenate([total, total - sums], axis=1)
    dark_sum, dark_count, bright_sum, bright_count = plateaus
    expected = dark * dark_sum / np.maximum(dark_count, 1.0) + bright * bright_sum / np.maximum(
        bright_count, 1.0
    )
    ratio, *left_out = slope / np.maximum(expected, 1e-300)
    return SlopeVariance(ratio=float(ratio), sd=float(np.sqrt((blocks - 1) * np.var(left_out))))


@dataclass(frozen=True, kw_only=True)
class NoiseGrowth:
    """Ratio of the noise on the bright side of a target to that on the dark side.

    Parameters
    ----------
    ratio, scatter
        Ratio of the variances, or of the covariances of neighbours, and its relative standard
        uncertainty, dimensionless.
    photon_ratio
        Ratio of the signals, which photon noise has under a linear response; None: the black level
        is unknown.
    of_light
        Whether the ratio is that of covariances. Light pulses correlate neighbours, read-out noise
        does not.
    """

    ratio: float
    scatter: float
    photon_ratio: float | None
    of_light: bool = False


def noise_growth(sides: Sides, black_dn: float | None, *, several: bool) -> NoiseGrowth | None:
    """Return the ratio of the neighbours' covariances, of the variances where those are too small,
    or None.

    `several`: whether there are several frames that differ, so that the variances are those of
    temporal noise.
    """
    dark, bright = sides
    photons = None
    if black_dn is not None and bright.level > dark.level > black_dn:
        photons = (bright.level - black_dn) / (dark.level - black_dn)
        if (
            min(side.covariance / max(side.covariance_sd, 1e-300) for side in sides)
            >= LIMITS.min_covariance_sd
        ):
            scatter = [side.covariance_sd / side.covariance for side in sides]
            return NoiseGrowth(
                ratio=bright.covariance / dark.covariance,
                scatter=float(
                    np.linalg.norm([*scatter, ACCURACY.black_sd_dn / (dark.level - black_dn)])
                ),
                photon_ratio=photons,
                of_light=True,
            )
    if not several or max(dark.variance, bright.variance) <= 0:
        return None
    return NoiseGrowth(
        ratio=bright.variance / max(dark.variance, 1e-300),
        scatter=float(np.hypot(dark.scatter, bright.scatter)),
        photon_ratio=photons,
    )


def noise_flags(growth: NoiseGrowth) -> tuple[str, ...]:
    """Return `gamma` where the plateau noise contradicts a linear response.

    Notes
    -----
    Variance that falls with the signal indicates a compressive response. Under a linear response it
    grows at most in proportion to the signal above black; the covariance of neighbours grows in
    proportion to it.
    """
    margin = LIMITS.rising_variance[0] + LIMITS.rising_variance[1] * growth.scatter
    rising = growth.photon_ratio is not None and growth.ratio > growth.photon_ratio * margin
    if growth.of_light and growth.photon_ratio is not None:
        falling = growth.ratio * margin < growth.photon_ratio
    else:
        falling = (
            growth.ratio
            * (LIMITS.falling_variance[0] + LIMITS.falling_variance[1] * growth.scatter)
            < 1.0
        )
    return ("gamma",) if falling or rising else ()
