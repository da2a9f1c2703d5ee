"""Statistics of one stack of dark or uniformly illuminated frames: level, temporal variance, noise spectrum."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.cube.cube import Cube
from charact.noise.stack.clipped_counts import sum_counts
from charact.noise.stack.frame_block import BlockSpectrum, FrameBlock, bins_of_run, rows_lags
from charact.noise.stack.spectrum import Bins
from labdata.conditions import Conditions
from labdata.session import StackEntry

__all__ = ["BlockSpectrum", "StackStatistics", "rows_lags", "stack_statistics"]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class StackStatistics:
    """Statistics of one stack, in DN.

    Parameters
    ----------
    label, kind, conditions
        As in the session.
    frames, pixels, size
        Number of frames and of pixels of a frame; rows and columns.
    mean_dn
        Mean over all pixels and frames.
    frame_mean_dn
        Mean of each frame, shape (frame,).
    variance_dn2, variance_sd_dn2
        Temporal variance of a pixel, mean over the image, and its standard error.
    neighbour_correlation, neighbour_sd
        Correlation of neighbouring pixels of a row, and its standard error.
    below_correlation, below_sd
        Correlation of neighbouring pixels of a column of one exposure.
    successor_correlation, successor_sd
        Correlation of successive exposures relative to others, and its standard error; infinite for two frames.
    spatial_variance_dn2, spatial_sd_dn2
        Spatial variance of the fixed pattern, and its standard error.
    settled
        Whether that variance is free of slowly varying noise.
    low_fraction, high_fraction
        Fraction of pixel values at 0 DN and at full scale.
    few, many
        Spectra with few and with many temporal lags.
    runs, time, parity
        Number of blocks of frames, and the exposures of one of them.
    bins
        Bins of the spectra.
    cube
        3-D noise; None if not requested or the stack is too short.
    """

    label: str
    kind: str
    conditions: Conditions
    frames: int
    pixels: int
    size: tuple[int, int]
    mean_dn: float
    frame_mean_dn: Array
    variance_dn2: float
    variance_sd_dn2: float
    neighbour_correlation: float
    neighbour_sd: float
    below_correlation: float
    below_sd: float
    successor_correlation: float
    successor_sd: float
    spatial_variance_dn2: float
    spatial_sd_dn2: float
    settled: bool
    low_fraction: float
    high_fraction: float
    few: BlockSpectrum
    many: BlockSpectrum
    runs: int
    time: NDArray[np.int64]
    parity: NDArray[np.int64]
    bins: Bins
    cube: Cube | None = None


def stack_statistics(
    entry: StackEntry, runs: list[FrameBlock], cube: Cube | None, *, shape: tuple[int, int, int], context: Context
) -> StackStatistics:
    """Return the statistics of a stack from those of its blocks."""
    weight = np.array([len(run.time) for run in runs], float)
    frame_mean = np.concatenate([run.frame_mean_dn for run in runs])
    variance, variance_sd = _pool([run.variance for run in runs], weight)
    neighbour, neighbour_sd = _pool([run.neighbour for run in runs], weight)
    below, below_sd = _pool([run.below for run in runs], weight)
    successor, successor_sd = _pool([run.successor for run in runs], weight)
    pattern, pattern_sd = _pool([(run.pattern.variance_dn2, run.pattern.sd_dn2) for run in runs], weight)
    codes = sum_counts([run.codes for run in runs])
    return StackStatistics(
        label=entry.label,
        kind=entry.kind,
        conditions=entry.conditions,
        frames=shape[0],
        pixels=shape[1] * shape[2],
        size=shape[1:],
        mean_dn=float(frame_mean.mean()),
        frame_mean_dn=frame_mean,
        variance_dn2=variance,
        variance_sd_dn2=variance_sd,
        neighbour_correlation=neighbour,
        neighbour_sd=neighbour_sd,
        below_correlation=below,
        below_sd=below_sd,
        successor_correlation=successor,
        successor_sd=successor_sd,
        spatial_variance_dn2=pattern,
        spatial_sd_dn2=pattern_sd,
        settled=all(run.pattern.settled for run in runs),
        low_fraction=codes.low_fraction,
        high_fraction=codes.high_fraction,
        few=_mean_spectrum([run.few for run in runs], weight),
        many=_mean_spectrum([run.many for run in runs], weight),
        runs=len(runs),
        time=runs[0].time,
        parity=runs[0].parity,
        bins=bins_of_run(shape, context, spectra=len(runs[0].few.lags) > 0),
        cube=cube,
    )


def _pool(values: list[tuple[float, float]], weight: Array) -> tuple[float, float]:
    """Return a weighted mean and its standard error."""
    share = weight / weight.sum()
    value, sd = np.array(values).T
    return float(share @ value), float(np.sqrt(share**2 @ sd**2))


def _mean_spectrum(runs: list[BlockSpectrum], weight: Array) -> BlockSpectrum:
    """Return the mean spectrum of all blocks over their common lags."""
    if len(runs) == 1:
        return runs[0]
    lags = min((run.lags for run in runs), key=len)
    power = np.average([run.power_dn2[:, : len(lags)] for run in runs], axis=0, weights=weight)
    variance = float(np.average([run.variance_dn2 for run in runs], weights=weight))
    return BlockSpectrum(lags=lags, power_dn2=power, variance_dn2=variance)
