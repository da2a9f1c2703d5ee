"""The groups of parallel bars in a frame: where they lie, which way they point and how often they
repeat.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.bars.thresholds import ACCURACY as BAR_ACCURACY
from charact.estimators.mtf.mean_frame import Region
from charact.estimators.mtf.target_detection.smoothed_mean_frame import local_maximum, mean_frame_of
from charact.estimators.mtf.target_detection.thresholds import ACCURACY, THRESHOLDS
from labdata import BadInput, FrameStack

# Periods looked at outside the bars, and those that must be there.
BEYOND, LEAST_BEYOND = 0.8, 0.2
# Frequencies tried, over that of the filter.
RATIOS = np.linspace(0.88, 1.12, 25)


def matches_bars(
    position: NDArray, rows: NDArray, frequency: float, bars: int
) -> tuple[float, float, float] | None:
    """Return how much blurred bars explain, bright or dark, their middle and their frequency, None
    if they are none.

    Notes
    -----
    A group is a box over N periods on a ground with a cosine in it, dark at both its ends: the
    model is a constant, a slope, that box and that cosine. Bars of another number, an edge or a
    stripe leave too much unexplained.
    """
    value = rows.mean(axis=0)
    noise = float(np.mean(np.var(rows, axis=0, ddof=1))) / len(rows) * value.size
    tried = np.array(np.meshgrid(RATIOS * frequency, np.linspace(-0.6, 0.6, 21))).reshape(2, -1)
    design = _design((position - (tried[1] / frequency)[:, None]) * tried[0][:, None], bars)
    ground = np.stack([np.ones_like(position), position * frequency], axis=1)
    design = np.concatenate([np.broadcast_to(ground, (*design.shape[:2], 2)), design], axis=2)
    transposed = design.swapaxes(1, 2)
    right = transposed @ (value - value.mean())
    coefficient = np.linalg.solve(transposed @ design + 1e-9 * np.eye(4), right[..., None])[..., 0]
    variance = float(np.sum((value - value.mean()) ** 2))
    residual = variance - np.sum(coefficient * right, axis=1)
    best = int(np.argmin(residual))
    sign = -1.0 if coefficient[best, 3] < 0.0 else 1.0
    box, wave = sign * coefficient[best, 2:]
    unexplained = float(residual[best]) - min(2.0 * noise, THRESHOLDS.max_bar_noise * variance)
    # Filters of neighbouring frequencies are closer than the ends: what fits best there is no bars.
    if (
        tried[0, best] in (tried[0].min(), tried[0].max())
        or not wave > THRESHOLDS.modulation_sd * np.sqrt(2.0 * noise) / value.size
        or box < THRESHOLDS.min_box_over_wave * wave
    ):
        return None
    if unexplained > (1.0 - THRESHOLDS.min_explained) * variance:
        return None
    centre, fitted_frequency = float(tried[1, best] / frequency), float(tried[0, best])
    level = sign * (value - coefficient[best, 1] * position * frequency)
    explained = 1.0 - float(residual[best]) / variance
    return (
        (explained, centre, fitted_frequency)
        if _has_isolated_ends((position - centre) * fitted_frequency, level, bars)
        else None
    )


def _has_isolated_ends(phase: NDArray, level: NDArray, bars: int) -> bool:
    """Return whether a profile over phases in periods holds so many bars: one more, or less, shows
    next to the last.
    """
    backgrounds, ends = [], []
    for sign in (-1, 1):
        background = (sign * phase > 0.5 * bars + 0.15) & (sign * phase < 0.5 * bars + BEYOND)
        last = np.abs(phase - sign * 0.5 * (bars - 1)) < 0.25
        if np.count_nonzero(background) < 1 or np.count_nonzero(last) < 1:
            return False
        backgrounds.append(float(level[background].mean()))
        ends.append(float(level[last].mean()))
    height = 0.5 * (ends[0] + ends[1]) - min(backgrounds)
    group_level = float(level[np.abs(phase) < 0.5 * bars].mean())
    dark = (
        max(backgrounds) < min(backgrounds) + THRESHOLDS.max_background * height
        and max(backgrounds) < group_level - 0.25 * height
    )
    return dark and abs(ends[1] - ends[0]) < THRESHOLDS.max_inequality * height


def _design(phase: NDArray, bars: int) -> NDArray:
    """Return the box over so many periods and the cosine in it at phases in periods, shape (...,
    2).
    """
    edge = np.clip((0.5 * bars - np.abs(phase)) * 4.0, -1.0, 1.0)
    box = 0.5 * (1.0 + np.sin(0.5 * np.pi * edge))
    return np.stack([box, -box * np.cos(2.0 * np.pi * (phase + 0.5 * bars))], axis=-1)


Array = NDArray[np.float32]

# Frequencies looked at, cycles per pixel: geometric steps that half a group's bandwidth covers.
LOWEST, HIGHEST, STEP = 0.012, 0.46, 1.12
# A bar's length over its width, at least: USAF bars have 5, STANAG bars 7; the filter takes in this
# share of five.
ASPECT = 5.0
# Fewer bars are not distinguishable from other structure.
MIN_BARS = 3


@dataclass(frozen=True, kw_only=True)
class DetectedBarGroup:
    """A group of bars found in a frame."""

    # ROW, COL, HEIGHT, WIDTH that holds the group and its surroundings up to the next one, px
    region: Region
    frequency_cy_per_px: float  # Cycles per pixel across the bars, known to a few per cent
    # Direction across the bars from the row direction: 0 for bars that lie along columns, 90 along
    # rows
    orientation_deg: float
    bars: int  # How many they are
    significance: float  # Response of a filter for these bars over its spread


def find_bar_groups(
    pictures: NDArray | FrameStack, bars: int | None = None
) -> tuple[DetectedBarGroup, ...]:
    """Find groups of bars, bright or dark, that lie along columns or rows, up to about 8 degrees
    off.

    Parameters
    ----------
    pictures
        Picture (row, col), stack (frame, row, col) or frames; a stack is averaged.
    bars
        Number of bars of a group: those of fewer are not taken, in those of more some may be taken
        for a group. None: groups of any number from 3 on.

    Returns
    -------
    tuple of FoundBars
        In the order of their frequencies, low ones first.

    Raises
    ------
    BadInput
        If fewer than 3 bars are asked for: two bars are not distinguishable from other structure.

    Notes
    -----
    A filter of `bars` cycles, or of 3, its mean taken off, answers to bars of its frequency
    wherever they lie. Where it peaks over frequency and place the profile along it must hold just
    so many equal and even bars with ground on both sides.
    """
    if bars is not None and bars < 3:
        raise BadInput(f"a group of bars that is looked for must have at least 3 bars, got {bars}")
    picture, _ = mean_frame_of(pictures)
    groups = [
        group
        for transposed in (False, True)
        for group in _find_upright(
            np.ascontiguousarray(picture.T) if transposed else picture, bars, transposed=transposed
        )
    ]
    separate = _separate(groups)
    boxes = [_box(group) for group in separate]
    return tuple(
        DetectedBarGroup(
            region=_region(group, [box for box in boxes if box != _box(group)], picture.shape),
            frequency_cy_per_px=group.frequency,
            orientation_deg=90.0 if group.transposed else 0.0,
            bars=group.bars,
            significance=group.significance,
        )
        for group in sorted(separate, key=lambda group: group.frequency)
    )


@dataclass(frozen=True, kw_only=True)
class _Group:
    """A group in the frame: middle, frequency, number of bars, their length, px, modulation, DN."""

    row: float
    col: float
    frequency: float
    bars: int
    length_px: float
    transposed: bool
    amplitude: float
    significance: float


def _find_upright(picture: Array, bars: int | None, *, transposed: bool) -> list[_Group]:
    """Return the groups whose bars lie along columns: the strongest answers first, each looked at
    more closely.
    """
    answers = sorted(_detections(picture, bars or MIN_BARS), key=lambda answer: -answer.amplitude)[
        :600
    ]
    groups: list[_Group] = []
    for answer in answers:
        boxes = (_box(group) for group in groups)
        if not any(
            box[0] <= answer.row <= box[2] and box[1] <= answer.col <= box[3] for box in boxes
        ):
            group = _verify(picture, answer, bars)
            if group is not None:
                groups.append(group)
    return (
        [
            replace(upright_group, row=upright_group.col, col=upright_group.row, transposed=True)
            for upright_group in groups
        ]
        if transposed
        else groups
    )


@dataclass(frozen=True, kw_only=True)
class _Detection:
    """A place and frequency at which the filter answers: px, cycles per pixel, DN, and over its
    spread.
    """

    row: float
    col: float
    frequency: float
    amplitude: float
    significance: float


def _detections(picture: Array, bars: int) -> Iterator[_Detection]:
    """Answers of filters of all frequencies."""
    low, high = np.quantile(picture[::2, ::2], (0.001, 0.999))
    floor = THRESHOLDS.min_bar_contrast * float(high - low)
    count = int(np.log(HIGHEST / LOWEST) / np.log(STEP)) + 1
    for frequency in HIGHEST / STEP ** np.arange(count):
        factor = max(1, int(1.0 / (frequency * ACCURACY.pixels_per_period)))
        small = _block_means(picture, factor)
        period = 1.0 / (frequency * factor)
        if small.shape[1] < bars * period or small.shape[0] < 0.5 * ASPECT * period:
            continue
        response = _filter_amplitude(small, bars, period)
        # The median of a Rayleigh distribution is 1.1774 of its scale.
        spread = float(np.median(response)) / 1.1774
        # Bars that fill most of a picture are their own scatter.
        required = min(THRESHOLDS.bar_filter_sd * spread, THRESHOLDS.clear_bars * float(high - low))
        for row, col in _peaks(response, max(required, floor), bars, period):
            amplitude = float(response[row, col])
            yield _Detection(
                row=(row + 0.5) * factor - 0.5,
                col=(col + 0.5) * factor - 0.5,
                frequency=float(frequency),
                amplitude=amplitude,
                significance=amplitude / max(spread, 1e-12),
            )


def _block_means(picture: Array, factor: int) -> Array:
    rows, cols = (side // factor for side in picture.shape)
    cut = picture[: rows * factor, : cols * factor]
    return cut.reshape(rows, factor, cols, factor).mean(axis=(1, 3))


def _filter_amplitude(picture: Array, bars: int, period_px: float) -> Array:
    """Return the amplitude of a cosine of so many cycles around each pixel, averaged along the
    bars.
    """
    import cv2

    half = int(np.ceil(0.5 * bars * period_px))
    position = np.arange(-half, half + 1)
    window = np.clip(0.5 * bars * period_px + 0.5 - np.abs(position), 0.0, 1.0)
    wave = window * np.exp(2j * np.pi * position / period_px)
    wave -= window * wave.sum() / window.sum()
    wave /= 0.5 * np.sum(window)
    along = np.full(
        max(1, round(0.5 * ASPECT * ACCURACY.central_fraction * period_px)), 1.0, np.float32
    )
    along /= along.size
    parts = (
        cv2.sepFilter2D(
            picture, cv2.CV_32F, part.astype(np.float32), along, borderType=cv2.BORDER_REFLECT_101
        )
        for part in (wave.real, wave.imag)
    )
    return np.hypot(*(np.asarray(part, np.float32) for part in parts))


def _peaks(
    response: Array, min_response: float, bars: int, period_px: float
) -> list[tuple[int, int]]:
    """Return (row, col) of the places that reach a height, each the highest of its surroundings."""
    size = (2 * round(0.25 * ASPECT * period_px) + 1, 2 * round(0.25 * bars * period_px) + 1)
    rows, cols = np.nonzero(
        (response >= local_maximum(response, *size)) & (response > min_response)
    )
    return list(zip(rows.tolist(), cols.tolist(), strict=True))


def _verify(picture: Array, answer: _Detection, bars: int | None) -> _Group | None:
    """Return the group at a place if the profile there is that of so many bars, or of any number,
    else None.
    """
    looked = []
    for number, col in [(bars, answer.col)] if bars else _candidate_counts(picture, answer):
        at = replace(answer, col=col)
        strip = _strip(picture, at, number)
        if strip is None:
            continue
        fitted = matches_bars(*strip, answer.frequency, number)
        if fitted is not None:
            looked.append((fitted, number, at))
    if not looked:
        return None
    (_, centre, frequency), number, answer = max(looked, key=lambda match: match[0][0])
    top, bottom = _bar_extent(picture, answer.row, answer.col + centre, frequency, number)
    if (bottom - top) * frequency < THRESHOLDS.min_bar_aspect / 2:
        return None
    return _Group(
        row=0.5 * (top + bottom),
        col=answer.col + centre,
        frequency=frequency,
        bars=number,
        length_px=bottom - top,
        transposed=False,
        amplitude=answer.amplitude,
        significance=answer.significance,
    )


def _candidate_counts(picture: Array, answer: _Detection) -> list[tuple[int, float]]:
    """Return how many bars may lie about a place, and their middle: over as many periods the wave
    keeps its height.
    """
    from scipy.ndimage import gaussian_filter1d

    half = max(1, round(0.25 * ACCURACY.central_fraction * ASPECT / answer.frequency))
    middle = round(answer.row)
    rows = picture[max(middle - half, 0) : middle + half + 1]
    value = rows.mean(axis=0, dtype=np.float64)
    # Bars next to a border have background there, which is no wave.
    background = 0.5 * (value[:2].mean() + value[-2:].mean())
    wave = (value - background) * np.exp(-2j * np.pi * answer.frequency * np.arange(value.size))
    height = np.abs(
        gaussian_filter1d(wave, BAR_ACCURACY.smoothing_periods / answer.frequency, mode="constant")
    )
    centre = min(max(round(answer.col), 0), value.size - 1)
    low = height < 0.5 * height[centre]
    before, after = np.flatnonzero(low[:centre]), np.flatnonzero(low[centre:])
    first_col = int(before[-1]) + 1 if before.size else 0
    last_col = centre + int(after[0]) if after.size else value.size
    guess = round((last_col - first_col) * answer.frequency)
    return [
        (n, 0.5 * (first_col + last_col - 1)) for n in range(guess - 1, guess + 2) if n >= MIN_BARS
    ]


def _strip(picture: Array, answer: _Detection, bars: int) -> tuple[NDArray, NDArray] | None:
    """Return distances from the middle and the rows there, with the background next to the bars;
    None if outside.
    """
    half = max(1, round(0.25 * ACCURACY.central_fraction * ASPECT / answer.frequency))
    top, bottom = round(answer.row) - half, round(answer.row) + half + 1
    # The background may end at the border of the frame.
    reach, needed = ((0.5 * bars + beyond) / answer.frequency for beyond in (BEYOND, LEAST_BEYOND))
    first_col = max(int(np.floor(answer.col - reach)), 0)
    last_col = min(int(np.ceil(answer.col + reach)) + 1, picture.shape[1])
    if (
        top < 0
        or bottom > picture.shape[0]
        or first_col > answer.col - needed
        or last_col - 1 < answer.col + needed
    ):
        return None
    factor = max(1, int(1.0 / (answer.frequency * 2.0 * ACCURACY.pixels_per_period)))
    rows = picture[top:bottom, first_col : first_col + (last_col - first_col) // factor * factor]
    binned = rows.reshape(len(rows), -1, factor).mean(axis=2, dtype=np.float64)
    return first_col + (np.arange(binned.shape[1]) + 0.5) * factor - 0.5 - answer.col, binned


def _bar_extent(
    picture: Array, row: float, col: float, frequency: float, bars: int
) -> tuple[float, float]:
    """Return between which rows the modulation stands at half of what it is in the middle or
    more.
    """
    half = 0.5 * bars / frequency
    first_col, last_col = (
        max(int(np.floor(col - half)), 0),
        min(int(np.ceil(col + half)) + 1, picture.shape[1]),
    )
    phase = np.exp(-2j * np.pi * frequency * (np.arange(first_col, last_col) - col))
    max_rows = round(6.0 / frequency)
    first, last = max(round(row) - max_rows, 0), min(round(row) + max_rows + 1, picture.shape[0])
    part = picture[first:last, first_col:last_col]
    wave = (part - part.mean(axis=1, keepdims=True)) @ phase
    size = max(1, round(0.5 / frequency))
    smooth = np.convolve(wave, np.ones(size) / size, "same")
    centre = round(row) - first
    core = slice(max(centre - size, 0), centre + size + 1)
    level = float(np.median(np.abs(smooth[core])))
    low = np.abs(smooth) < 0.5 * level
    low_before, low_after = np.flatnonzero(low[:centre]), np.flatnonzero(low[centre:])
    return (
        float(first + (low_before[-1] + 1 if low_before.size else 0)),
        float(first + (centre + low_after[0] if low_after.size else len(low))),
    )


def _separate(groups: list[_Group]) -> list[_Group]:
    """Return one group for each place, the most modulated: harmonics of its bars have less
    modulation, but may be more significant, since less scatters at high frequencies.
    """
    separate: list[_Group] = []
    for group in sorted(groups, key=lambda group: -group.amplitude):
        if not any(_overlap(_box(group), _box(other)) for other in separate):
            separate.append(group)
    return separate


def _box(group: _Group) -> tuple[float, float, float, float]:
    """Return top, left, bottom and right of the bars."""
    across, along = 0.5 * (group.bars - 0.5) / group.frequency, 0.5 * group.length_px
    down, right = (across, along) if group.transposed else (along, across)
    return group.row - down, group.col - right, group.row + down, group.col + right


def _overlap(first: tuple[float, ...], second: tuple[float, ...]) -> bool:
    return (
        first[0] < second[2]
        and second[0] < first[2]
        and first[1] < second[3]
        and second[1] < first[3]
    )


def _region(
    group: _Group, other_boxes: list[tuple[float, float, float, float]], shape: tuple[int, ...]
) -> Region:
    """Return the group with a margin, cut half way to its neighbours."""
    box = _box(group)
    margin = max(14.0, 1.5 / group.frequency) + 4.0
    gaps = [max(o[0] - box[2], box[0] - o[2], o[1] - box[3], box[1] - o[3]) for o in other_boxes]
    margin = min(margin, max(0.5 * min(gaps, default=np.inf), 2.0))
    top, first_col = max(int(np.floor(box[0] - margin)), 0), max(int(np.floor(box[1] - margin)), 0)
    bottom = min(int(np.ceil(box[2] + margin)) + 1, shape[0])
    last_col = min(int(np.ceil(box[3] + margin)) + 1, shape[1])
    return top, first_col, bottom - top, last_col - first_col
