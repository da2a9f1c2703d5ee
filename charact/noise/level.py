"""What one stack of dark or evenly lit frames tells: its level, its variance in time and the spectrum of its noise."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.cube import Cube, cube_of
from charact.noise.fields import Exposures, exposures, fluctuations, runs_of
from charact.noise.pattern import Pattern, fixed_pattern
from charact.noise.pixels import neighbours, products_of, successors, variance_error
from charact.noise.spectrum import NO_BINS, Bins, bins_of, cross_spectra
from charact.noise.temporal import autocovariance, usable_lags
from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.session import StackEntry

Array = NDArray[np.float64]

# Longest lag at which light of earlier exposures is looked for, and lags allowed for where none is seen, exposures.
MOST_LAGS = 12
FEW_LAGS = 2
# Exposures of an intensified camera this far apart no longer share the glow of the screen to speak of.
GLOW_EXPOSURES = 8
# So many values at the largest one are no chance.
PILED_UP = 16
# Squares of values beyond this leave the range of single precision.
LARGEST_DN = 1e9


@dataclass(frozen=True, kw_only=True)
class Spectrum:
    """Noise of one stack when so many lags are allowed for: the more, the less biased and the less certain.

    Parameters
    ----------
    lags
        Lags, exposures, 0 first, shape (lag,); none where no spectrum was asked for.
    power_dn2
        Autocovariance in time of the modes of each bin, shape (bin, lag), DN^2.
    variance_dn2
        Temporal variance of a pixel, DN^2.
    """

    lags: NDArray[np.int64]
    power_dn2: Array
    variance_dn2: float


NO_SPECTRUM = Spectrum(lags=np.empty(0, np.int64), power_dn2=np.empty((0, 0)), variance_dn2=0.0)


@dataclass(frozen=True, kw_only=True)
class Level:
    """Statistics of one stack; DN throughout.

    Parameters
    ----------
    label, kind, conditions
        As in the session.
    frames, pixels, size
        Number of frames, of pixels in each, and its rows and columns.
    mean_dn
        Mean over all pixels and frames.
    frame_mean_dn
        Mean of each frame, shape (frame,).
    variance_dn2, variance_sd_dn2
        Temporal variance of a pixel, mean over the image, and its standard error.
    neighbour_correlation, neighbour_sd
        Correlation of the fluctuations of pixels next to each other in a row, and its standard error.
    below_correlation, below_sd
        The same of pixels next to each other in a column of one exposure.
    successor_correlation, successor_sd
        Correlation of exposures next to each other in time beyond that of others, and its standard error; infinite
        for two frames.
    spatial_variance_dn2, spatial_sd_dn2
        Variance over the image of what does not change in time, and its standard error.
    settled
        Whether that variance is free of noise that exposures share for a while.
    low_share, high_share
        Share of pixel values at code 0 and at the highest code.
    few, many
        Spectra that allow for few and for many lags.
    runs, time, parity
        Runs of frames the statistics come from, and the exposures of one of them.
    bins
        Bins of the spectra.
    cube
        3-D noise; None where it was not asked for or the stack is too short for it.
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
    low_share: float
    high_share: float
    few: Spectrum
    many: Spectrum
    runs: int
    time: NDArray[np.int64]
    parity: NDArray[np.int64]
    bins: Bins
    cube: Cube | None = None


@dataclass(frozen=True, kw_only=True)
class Run:
    """Statistics of a run of frames: values with their standard errors, and spectra. Names as in `Level`."""

    time: NDArray[np.int64]
    parity: NDArray[np.int64]
    variance: tuple[float, float]
    neighbour: tuple[float, float]
    below: tuple[float, float]
    successor: tuple[float, float]
    pattern: Pattern
    few: Spectrum
    many: Spectrum
    bins: Bins


def read_level(entry: StackEntry, *, context: Context, spectra: bool = True, cube: bool = False) -> Level | None:
    """Read one stack and return its statistics; None where it holds a single frame, which shows no change in time.

    Raises
    ------
    BadInput
        If two frames have one number, values are beyond all bounds, or a frame is too low for two fields.
    """
    stack = entry.read()
    _check(entry.label, stack, context)
    if len(stack) < 2:
        return None
    runs = [_run(stack, first, last, context, spectra) for first, last in runs_of(stack)]
    weight = np.array([len(run.time) for run in runs], float)
    frame_mean = np.array([frame.mean(dtype=np.float64) for frame in stack.data])
    variance, variance_sd = _pooled([run.variance for run in runs], weight)
    neighbour, neighbour_sd = _pooled([run.neighbour for run in runs], weight)
    below, below_sd = _pooled([run.below for run in runs], weight)
    successor, successor_sd = _pooled([run.successor for run in runs], weight)
    pattern, pattern_sd = _pooled([(run.pattern.variance_dn2, run.pattern.sd_dn2) for run in runs], weight)
    low, high = _at_the_ends(stack, context)
    return Level(
        label=entry.label,
        kind=entry.kind,
        conditions=entry.conditions,
        frames=len(stack),
        pixels=stack.data[0].size,
        size=(stack.data.shape[1], stack.data.shape[2]),
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
        low_share=low,
        high_share=high,
        few=_mean_spectrum([run.few for run in runs], weight),
        many=_mean_spectrum([run.many for run in runs], weight),
        runs=len(runs),
        time=runs[0].time,
        parity=runs[0].parity,
        bins=runs[0].bins,
        cube=cube_of(stack, context=context) if cube else None,
    )


def _check(label: str, stack: FrameStack, context: Context) -> None:
    """Refuse frames that no statistic can be made of."""
    number = stack.frame_number
    if len(np.unique(number)) < len(number):
        raise BadInput(f"frames of {label} must have numbers of their own, got {number.tolist()[:8]}")
    if context.interlaced and stack.data.shape[1] < 2:
        raise BadInput(f"interlaced frames must have two rows at least, got {stack.data.shape[1]} in {label}")
    largest = float(np.abs(stack.data[[0, -1]].astype(np.float64)).max())
    if largest > LARGEST_DN:
        raise BadInput(f"pixel values of {label} must lie below {LARGEST_DN:.0e} DN, got {largest:.3g}")


def _run(stack: FrameStack, first: int, last: int, context: Context, spectra: bool) -> Run:
    """Statistics of a run of frames."""
    shots = exposures(stack, first, last, interlaced=context.interlaced)
    change = fluctuations(shots)
    pixel = products_of(change, shots.parity)
    plain = np.zeros(1, np.int64)
    variance = float(autocovariance(pixel, shots.time, shots.parity, plain, within_parity=True)[0])
    few, many, bins = NO_SPECTRUM, NO_SPECTRUM, NO_BINS
    if spectra:
        bins = bins_of(change.shape[1], change.shape[2], context.pitch_ratio * shots.row_step)
        modes = cross_spectra(change, shots.parity, bins)
        few, many = (_spectrum(modes, pixel, shots, most) for most in (FEW_LAGS, MOST_LAGS))
    return Run(
        time=shots.time,
        parity=shots.parity,
        variance=(variance, variance_error(change, shots.image, variance)),
        neighbour=neighbours(change),
        below=neighbours(change.swapaxes(1, 2)),
        successor=successors(change, shots.time, shots.parity),
        pattern=fixed_pattern(shots, change, GLOW_EXPOSURES if context.interlaced else 1),
        few=few,
        many=many,
        bins=bins,
    )


def _spectrum(modes: Array, pixel: Array, shots: Exposures, most: int) -> Spectrum:
    """Unbiased covariances in time up to a lag."""
    lags = usable_lags(shots.time, shots.parity, most)
    same = rows_lags(lags, shots.parity)
    variance = autocovariance(pixel, shots.time, shots.parity, same, within_parity=True)[0]
    power = autocovariance(modes, shots.time, shots.parity, lags)
    return Spectrum(lags=lags, power_dn2=power, variance_dn2=float(variance))


def rows_lags(lags: NDArray[np.int64], parity: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the lags between exposures of the same rows."""
    return lags[lags % 2 == 0] if len(np.unique(parity)) > 1 else lags


def _pooled(values: list[tuple[float, float]], weight: Array) -> tuple[float, float]:
    """Weighted mean and its standard error."""
    share = weight / weight.sum()
    value, sd = np.array(values).T
    return float(share @ value), float(np.sqrt(share**2 @ sd**2))


def _mean_spectrum(runs: list[Spectrum], weight: Array) -> Spectrum:
    """Mean of the spectra of all runs over the lags that all of them have."""
    lags = min((run.lags for run in runs), key=len)
    power = np.average([run.power_dn2[:, : len(lags)] for run in runs], axis=0, weights=weight)
    variance = float(np.average([run.variance_dn2 for run in runs], weights=weight))
    return Spectrum(lags=lags, power_dn2=power, variance_dn2=variance)


def _at_the_ends(stack: FrameStack, context: Context) -> tuple[float, float]:
    """Shares of values at code 0 and at the highest code, or at the highest value where values pile up there."""
    full_scale_dn = context.full_scale_dn if context.full_scale_dn is not None else stack.full_scale_dn
    low = float(np.mean(stack.data == 0))
    told = 0.0 if full_scale_dn is None else float(np.mean(stack.data >= full_scale_dn))
    return low, max(told, _piled_up(stack.data))


def _piled_up(data: NDArray) -> float:
    """Share of values at the largest one where it is commoner than any tail makes it: the camera stops there.

    The tail of a smooth distribution falls towards its largest value; codes need not be successive whole numbers.
    """
    value, count = np.unique(data[[0, -1]], return_counts=True)
    if len(value) < 2 or count[-1] < PILED_UP or count[-1] < count[-2] + 5.0 * np.sqrt(count[-2]):
        return 0.0
    return float(np.mean(data >= value[-1]))
