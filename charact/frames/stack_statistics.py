"""Statistics of one stack of dark or uniformly illuminated frames: level, temporal variance, noise
spectrum.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.frames.clipping import sum_counts
from charact.frames.cube import Cube, cube_of
from charact.frames.frame_block import (
    BlockSpectrum,
    FrameBlock,
    Spectra,
    bins_of_run,
    run_of,
)
from charact.frames.spectrum import BAND_CY_PER_PX, ROW_LIMIT_CY, Bins
from charact.frames.temporal import runs_of
from charact.frames.thresholds import STACK
from charact.method import Context
from labdata import Array, BadInput, Conditions, StackEntry, open_lazy_stack
from labdata.frames import FrameStack, LazyStack


@dataclass(frozen=True, kw_only=True)
class StackStatistics:
    """Statistics of one stack, in DN."""

    # label, kind, conditions: as in the session
    label: str
    kind: str
    conditions: Conditions
    # frames, pixels, size: number of frames and of pixels of a frame; rows and columns
    frames: int
    pixels: int
    size: tuple[int, int]
    mean_dn: float  # mean over all pixels and frames
    frame_mean_dn: Array  # mean of each frame, shape (frame,)
    # variance_dn2, variance_sd_dn2: temporal variance of a pixel, mean over the image, and its
    # standard error
    variance_dn2: float
    variance_sd_dn2: float
    # neighbour_correlation, neighbour_sd: correlation of neighbouring pixels of a row, and its
    # standard error
    neighbour_correlation: float
    neighbour_sd: float
    # below_correlation, below_sd: correlation of neighbouring pixels of a column of one exposure
    below_correlation: float
    below_sd: float
    # successor_correlation, successor_sd: correlation of successive exposures relative to others,
    # and its standard error; infinite for two frames
    successor_correlation: float
    successor_sd: float
    # spatial_variance_dn2, spatial_sd_dn2: spatial variance of the fixed pattern, and its standard
    # error
    spatial_variance_dn2: float
    spatial_sd_dn2: float
    settled: bool  # whether that variance is free of slowly varying noise
    # low_fraction, high_fraction: fraction of pixel values at 0 DN and at full scale
    low_fraction: float
    high_fraction: float
    # few, many: spectra with few and with many temporal lags
    few_lags: BlockSpectrum
    many_lags: BlockSpectrum
    # runs, time, parity: number of blocks of frames, and the exposures of one of them
    runs: int
    time: NDArray[np.int64]
    parity: NDArray[np.int64]
    bins: Bins  # bins of the spectra
    cube: Cube | None = None  # 3-D noise; None if not requested or the stack is too short
    entry: StackEntry | None = None  # the stack
    averaged: int = 1  # number of frames of the camera of which each frame is the mean

    @property
    def data(self) -> NDArray:
        """Frames, shape (frame, row, col), DN; none where the stack is not known."""
        return np.zeros((0, *self.size)) if self.entry is None else self.entry.read().data

    @property
    def is_digitised(self) -> bool:
        """Whether the values are integers, not means."""
        return self.entry is not None and open_lazy_stack(self.entry).dtype.kind in "ui"

    @property
    def mean_sd_dn(self) -> float:
        """Standard error of the mean by the scatter of frames, DN, at least that of white noise."""
        return self.mean_sd_above(1e-12)

    def mean_sd_above(self, variance_dn2: float) -> float:
        """Return the standard error of the mean, DN, at least that of white noise of a variance."""
        variance_dn2 = max(self.variance_dn2, variance_dn2)
        scatter = np.std(self.frame_mean_dn, ddof=1) / np.sqrt(self.frames)
        return float(max(scatter, np.sqrt(variance_dn2 / (self.pixels * self.frames))))


# Largest stack that is read at once; of a larger one each block is a part, and the cube another.
WHOLE_BYTES = 128 * 2**20


@dataclass(frozen=True, kw_only=True)
class Part:
    """Task: some of the statistics of a stack."""

    entry: StackEntry
    runs: tuple[tuple[int, int], ...]  # first and last-plus-one frame of each block
    at_once: bool  # whether to read the complete stack at once
    cube: bool  # whether to compute 3-D noise
    spectra: Spectra
    context: Context


PartStatistics = tuple[tuple[FrameBlock, ...], Cube | None]


# Names of the pooled values of blocks and their standard errors.
_POOLED = {
    "variance": ("variance_dn2", "variance_sd_dn2"),
    "neighbour": ("neighbour_correlation", "neighbour_sd"),
    "lower": ("below_correlation", "below_sd"),
    "successor": ("successor_correlation", "successor_sd"),
    "fixed_pattern": ("spatial_variance_dn2", "spatial_sd_dn2"),
}


def _join(
    entry: StackEntry,
    part_statistics: list[PartStatistics],
    *,
    shape: tuple[int, int, int],
    bins: Bins,
) -> StackStatistics | None:
    """Return the statistics of a stack from those of its parts; None for a single frame."""
    runs = [run for part in part_statistics for run in part[0]]
    if not runs:
        return None
    weight = np.array([len(run.time) for run in runs], float)
    weights = weight / weight.sum()
    pooled: dict[str, Any] = {}
    for name, (value, error) in _POOLED.items():
        values, errors = np.array([getattr(run, name) for run in runs]).T
        pooled |= {value: float(weights @ values), error: float(np.sqrt(weights**2 @ errors**2))}
    codes = sum_counts([run.codes for run in runs])
    frame_mean = np.concatenate([run.frame_mean_dn for run in runs])
    return StackStatistics(
        label=entry.label,
        entry=entry,
        kind=entry.kind,
        conditions=entry.conditions,
        frames=shape[0],
        pixels=shape[1] * shape[2],
        size=shape[1:],
        mean_dn=float(frame_mean.mean()),
        frame_mean_dn=frame_mean,
        **pooled,
        settled=all(run.pattern.settled for run in runs),
        low_fraction=codes.low_fraction,
        high_fraction=codes.high_fraction,
        few_lags=_mean_spectrum([run.few_lags for run in runs], weight),
        many_lags=_mean_spectrum([run.many_lags for run in runs], weight),
        runs=len(runs),
        time=runs[0].time,
        parity=runs[0].parity,
        bins=bins,
        cube=next((cube for _, cube in part_statistics if cube is not None), None),
    )


def _mean_spectrum(runs: list[BlockSpectrum], weight: Array) -> BlockSpectrum:
    """Return the mean spectrum of all blocks over their common lags."""
    if len(runs) == 1:
        return runs[0]
    lags = min((run.lags for run in runs), key=len)
    power = np.average([run.power_dn2[:, : len(lags)] for run in runs], axis=0, weights=weight)
    variance = float(np.average([run.variance_dn2 for run in runs], weights=weight))
    return BlockSpectrum(lags=lags, power_dn2=power, variance_dn2=variance)


def read_levels_of(
    entries: Sequence[StackEntry], *, context: Context, spectra: Spectra = True, cubes: bool = False
) -> list[StackStatistics | None]:
    """Return the statistics of stacks; None for a stack of a single frame.

    `cubes`: whether to compute 3-D noise. `context.spread` maps over the parts of stacks. Raises
    BadInput if frame numbers repeat, values are out of range, or a frame has too few rows for two
    fields.
    """
    alone = replace(context, progress=Context.progress, spread=Context.spread)
    # Workers run in other folders.
    entries = [replace(entry, folder=entry.folder.absolute()) for entry in entries]
    stacks = [open_lazy_stack(entry) for entry in entries]
    parts = [
        _parts(entry, stack, alone, spectra, cubes)
        for entry, stack in zip(entries, stacks, strict=True)
    ]
    results = iter(
        context.spread(part_statistics, [part for of_stack in parts for part in of_stack])
    )
    levels: list[StackStatistics | None] = []
    for entry, stack, of_stack in zip(entries, stacks, parts, strict=True):
        context.progress(f"noise of {entry.label}", len(levels) / len(entries))
        of_entry = list(islice(results, len(of_stack)))
        bins = bins_of_run(stack.shape, context, spectra=spectra if of_entry else False)
        levels.append(_join(entry, of_entry, shape=stack.shape, bins=bins))
    return levels


def part_statistics(part: Part) -> PartStatistics:
    """Read the frames of a part and return its statistics: those of its blocks, and 3-D noise."""
    stack = open_lazy_stack(part.entry)
    if part.at_once:
        stack = stack.in_memory()
    try:
        runs = tuple(
            run_of(_frames(stack, first, last), context=part.context, spectra=part.spectra)
            for first, last in part.runs
        )
    except BadInput as error:
        raise BadInput(f"{error}, in stack {part.entry.label!r}") from None
    return runs, cube_of(stack, context=part.context) if part.cube else None


def _parts(
    entry: StackEntry, stack: LazyStack, context: Context, spectra: Spectra, cube: bool
) -> list[Part]:
    """Return the parts of a stack."""
    number = stack.frame_number
    if len(np.unique(number)) < len(number):
        raise BadInput(f"frame numbers of {entry.label} must be unique, got {number.tolist()[:8]}")
    if len(stack) < 2:
        return []
    runs = tuple(runs_of(stack))
    every = Part(entry=entry, runs=runs, cube=cube, spectra=spectra, context=context, at_once=True)
    if stack.size_bytes <= WHOLE_BYTES:
        return [every]
    parts = [replace(every, runs=(run,), cube=False, at_once=False) for run in runs]
    return [*parts, replace(every, runs=(), at_once=False)] if cube else parts


def _frames(stack: LazyStack, first: int, last: int) -> FrameStack:
    """Return the frames of one block."""
    stamped = len(stack.frame_number) == len(stack)
    number = stack.frame_number[first:last] if stamped else np.arange(first, last)
    return FrameStack(
        data=stack.frames(first, last), frame_number=number, full_scale_dn=stack.full_scale_dn
    )


# Side of the square, pixels of one exposure; larger than the blur.
SIDE_PX = 10


@dataclass(frozen=True, kw_only=True)
class Shares:
    """Weights of the noise spectrum in the variance of a square's mean."""

    bins: Array  # weight of the power of each bin, shape (bin,)
    outer: float  # weight of the mean power of the modes beyond all bins
    modes: Array  # fraction of all modes in each bin, shape (bin,)
    edge: NDArray[np.bool_]  # bins of the outermost ring, shape (bin,)


def shares_of(bins: Bins, side: int = SIDE_PX) -> Shares:
    """Return the weights of a square of `side` pixels.

    Modes of the band without a bin (on the axes and in the smallest rings) count with the nearest
    bin.
    """
    rows, cols = bins.window.shape
    row, col = (
        np.abs(np.fft.fftfreq(rows))[:, None].astype(float),
        np.fft.rfftfreq(cols)[None, :].astype(float),
    )
    count = np.where((col == 0) | (col == 0.5), 1.0, 2.0) * np.ones((rows, 1)) / (rows * cols)
    weight = count * _response(row, side) * _response(col, side)
    y, x = np.broadcast_arrays(row / bins.row_pitch, col)
    in_band = (np.hypot(x, y) < BAND_CY_PER_PX) & (row <= ROW_LIMIT_CY)
    bin_index = np.array(bins.select)
    lost = in_band & (bin_index < 0)
    radius = np.hypot(bins.column_cy_per_px, bins.row_cy_per_px)
    across = (x[lost][:, None] - bins.column_cy_per_px) ** 2 + (
        y[lost][:, None] - bins.row_cy_per_px
    ) ** 2
    outward = (np.hypot(x, y)[lost][:, None] - radius) ** 2
    # Power depends mainly on the radius.
    bin_index[lost] = (outward + 0.05 * across).argmin(axis=1)
    number = len(bins.modes)
    return Shares(
        bins=np.bincount(bin_index[in_band], weight[in_band], number).astype(float),
        outer=float(weight[~in_band].sum()),
        modes=np.bincount(bin_index[in_band], count[in_band], number).astype(float),
        edge=radius > 0.9 * radius.max(),
    )


def _response(frequency: Array, side: int) -> Array:
    """Return the squared transfer of the mean of `side` pixels."""
    sine = np.sin(np.pi * frequency)
    safe = np.where(sine == 0, 1.0, sine)
    return np.where(sine == 0, 1.0, (np.sin(np.pi * side * frequency) / (side * safe)) ** 2)


def area_variance(
    level: StackStatistics, spectrum: BlockSpectrum, shares: Shares, exposures: float
) -> tuple[float, float]:
    """Return the variance of a square's mean and its standard error, DN^2.

    `level`, `spectrum`: a stack and the spectrum of its noise; `shares`: weights of the square;
    `exposures`: independent exposures behind the spectrum.

    The variance is the sum over modes of power times (sin(pi n f) / (n sin(pi f)))^2 along rows and
    columns. For white noise it is the pixel variance over n^2, for blurred noise larger by the
    inverse blur factor. Beyond the bins the power is taken midway between their outer edge and the
    mean beyond, which follows from the pixel variance. Row, column and frame noise lies on the
    excluded axes and is added from the 3-D noise if available.
    """
    power = spectrum.power_dn2[:, 0]
    outer_power = float(spectrum.variance_dn2 - shares.modes @ power) / max(
        1.0 - shares.modes.sum(), 1e-6
    )
    edge = float(np.average(power[shares.edge], weights=level.bins.modes[shares.edge]))
    outer_variance = shares.outer * 0.5 * (edge + outer_power)
    variance = float(shares.bins @ power) + outer_variance
    bin_variance = (shares.bins * power) ** 2 / (
        level.bins.modes * level.bins.efficiency * exposures
    )
    pulses = variance * level.variance_sd_dn2 / max(level.variance_dn2, 1e-12)
    parts = [
        np.sqrt(bin_variance.sum()),
        0.3 * shares.outer * abs(edge - outer_power),
        STACK.binning_sd * variance,
        pulses,
    ]
    line_variance, line_sd = _whole_lines(level)
    return variance + line_variance, float(np.sqrt(np.sum(np.square(parts)) + line_sd**2))


def _whole_lines(level: StackStatistics, side: int = SIDE_PX) -> tuple[float, float]:
    """Return the variance of a square's mean by frame, row and column noise, and its standard
    error, DN^2.
    """
    if level.cube is None:
        return 0.0, 0.0
    rng = np.random.default_rng(8)
    parts = level.cube.components
    shares = {"t": 1.0, "tv": 1.0 / side, "th": 1.0 / side}
    value = sum(factor * parts[name].variance_dn2 for name, factor in shares.items())
    draws = sum(
        (factor * parts[name].draws(rng, 400) for name, factor in shares.items()), np.zeros(400)
    )
    low, high = np.quantile(draws, [0.16, 0.84])
    return float(value), float(0.5 * (high - low))
