"""Dark frames without fixed pattern and blinking pixels, for the search of single pulses."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.thresholds import EVENT_ACCURACY, EVENTS
from charact.frames.stack import Stack
from charact.frames.temporal import split_fields
from charact.method import Context
from labdata.frames import FrameStack

Array = NDArray[np.float64]

Images = NDArray[np.float32]
# Index of the filter matched to the spot.
MIDDLE = 3


@dataclass(frozen=True, kw_only=True)
class Filter:
    """Sum over a box of pixels less the mean on both sides, in one exposure or across several."""

    # high, broad: rows and columns of the box, odd
    high: int
    broad: int
    times: tuple[float, ...] = (1.0,)  # weights of successive exposures of one parity
    stride: int = 1  # exposures between successive ones of one parity: 2 for fields
    exposures: int = 64  # exposures of one parity in each pixel's subtracted mean

    @cached_property
    def columns(self) -> NDArray[np.float64]:
        """Weights along a row; their sum is zero."""
        side_px, gap = EVENT_ACCURACY.background_px, np.zeros(EVENT_ACCURACY.gap_px)
        side = np.full(side_px, -self.broad / (2.0 * side_px))
        return np.concatenate([side, gap, np.ones(self.broad), gap, side])

    @property
    def reach(self) -> tuple[int, int]:
        """Rows and columns of margin on each side."""
        return self.high // 2, len(self.columns) // 2

    def noise(self, line: tuple[float, ...]) -> float:
        """Return the output variance over that of white noise before the video filter along a
        line.
        """
        across, time = np.convolve(self.columns, line), np.asarray(self.times)
        return float(
            (across @ across) * self.high * (time @ time - time.sum() ** 2 / self.exposures)
        )

    def within(self, change: Images, margin: tuple[int, int]) -> Images:
        """Return the filtered images at all pixels with a margin of `margin` rows and columns.

        `change`: images, shape (exposure, row, col); `margin`: margin in rows and columns, at least
        that of the filter; the output is smaller by twice as many.
        """
        rows, cols = change.shape[1] - 2 * margin[0], change.shape[2] - 2 * margin[1]
        first_row, first_col = margin[0] - self.reach[0], margin[1] - self.reach[1]
        strip = change[:, first_row : first_row + rows]
        for shift in range(1, self.high):
            strip = strip + change[:, first_row + shift : first_row + shift + rows]
        total = np.zeros((*strip.shape[:2], strip.shape[2] + 1), np.float32)
        np.cumsum(strip, axis=2, out=total[..., 1:])
        side_px, gap = EVENT_ACCURACY.background_px, EVENT_ACCURACY.gap_px

        out = (
            total[..., first_col + side_px : first_col + side_px + cols]
            - total[..., first_col : first_col + cols]
        )

        def add(start: int, width: int) -> None:
            np.add(out, total[..., start + width : start + width + cols], out=out)
            np.subtract(out, total[..., start : start + cols], out=out)

        add(first_col + side_px + 2 * gap + self.broad, side_px)
        out *= np.float32(-self.broad / (2.0 * side_px))
        add(first_col + side_px + gap, self.broad)
        return out if len(self.times) == 1 else self.through_time(out)

    def through_time(self, still: Images) -> Images:
        """Return the weighted sum over successive exposures of box-filtered images."""
        count = len(still) - len(self.times) + 1
        return sum(np.float32(w) * still[i : i + count] for i, w in enumerate(self.times))  # type: ignore[return-value]


def common_reach(filters: Sequence[Filter]) -> tuple[int, int]:
    """Return the margin in rows and columns of all filters."""
    return max(matched.reach[0] for matched in filters), max(
        matched.reach[1] for matched in filters
    )


def boxes(step: int, *, stride: int, exposures: int, lag: bool) -> tuple[Filter, ...]:
    """Return filters from one pixel to several times a spot of half width `step`.

    `step`: half width of the matched filter, px; `stride`, `exposures`: as in `Filter`; `lag`:
    whether to include filters across exposures.
    """
    core_px, glow_px = 2 * step + 1, 6 * step + 1

    def box(high: int, broad: int, times: tuple[float, ...] = (1.0,)) -> Filter:
        return Filter(high=high, broad=broad, times=times, stride=stride, exposures=exposures)

    plain = (
        box(1, 1),
        box(1, core_px),
        box(core_px, 1),
        box(core_px, core_px),
        box(glow_px, glow_px),
    )
    return (
        plain
        + (box(core_px, core_px, (1.0, -1.0)), box(core_px, core_px, (1.0, 1.0, 1.0, 1.0))) * lag
    )


# Reference frequency of the wings, cycles per pixel.
REFERENCE_CY_PER_PX = 0.1


@dataclass(frozen=True, kw_only=True)
class PulseSpread:
    """Spread of a pulse after the gain."""

    # column_px, row_px: standard deviation of the Gaussian part along a row and a column, px
    column_px: float
    row_px: float
    # strength of the other part, exp(-wings (f/f0)^exponent) with f0 of 0.1 cycles per column pitch
    wings: float
    exponent: float  # its exponent
    row_pitch: float = 1.0  # row pitch of an exposure, column pitches


def _sides(matched: Filter) -> tuple[int, int]:
    """Return rows and columns of the positions around a filter, px."""
    rows, cols = (
        -(-(size + EVENT_ACCURACY.spot_px) // 8) * 8
        for size in (matched.high, len(matched.columns))
    )
    return rows, cols


@lru_cache(maxsize=64)
def _transfer(spot: PulseSpread, sides: tuple[int, int]) -> Array:
    """Return the transfer from a pulse to the light of a pixel."""
    squares, distance, pixel = _plane(spot.row_pitch, sides)
    gauss = spot.column_px**2 * squares[1] + spot.row_px**2 * squares[0]
    # Negative wings, tried by a fit, must not overflow.
    log_transfer = -2.0 * np.pi**2 * gauss - spot.wings * distance**spot.exponent
    return np.exp(np.minimum(log_transfer, EVENT_ACCURACY.max_log_transfer)) * pixel


@lru_cache(maxsize=8)
def _plane(row_pitch: float, sides: tuple[int, int]) -> tuple[tuple[Array, Array], Array, Array]:
    """Return squared frequencies along both axes, radial frequency over the reference, and pixel
    transfer.
    """
    fy, fx = _frequencies(sides)
    distance = np.hypot(fx, fy / row_pitch) / REFERENCE_CY_PER_PX
    return (
        (fy**2, fx**2),
        np.asarray(distance, np.float64),
        np.asarray(np.sinc(fx) * np.sinc(fy), np.float64),
    )


@lru_cache(maxsize=8)
def _frequencies(sides: tuple[int, int]) -> tuple[Array, Array]:
    fine = EVENT_ACCURACY.steps_per_px
    fy = np.fft.fftfreq(fine * sides[0])[:, None] * fine
    fx = np.fft.rfftfreq(fine * sides[1])[None, :] * fine
    return np.asarray(fy, np.float64), np.asarray(fx, np.float64)


def _comb(kernel: NDArray[np.float64], frequency: Array) -> NDArray[np.complex128]:
    """Return the transfer of weights on the pixel lattice, about the centre."""
    position = np.arange(len(kernel)) - len(kernel) // 2
    return np.asarray(
        np.exp(-2j * np.pi * np.multiply.outer(frequency.ravel(), position)) @ kernel, np.complex128
    )


@lru_cache(maxsize=64)
def _weights(matched: Filter, line: tuple[float, ...]) -> NDArray[np.complex128]:
    """Return the transfer of the filter and the video filter."""
    fy, fx = _frequencies(_sides(matched))
    return _comb(np.ones(matched.high), fy).real[:, None] * _comb(
        np.convolve(matched.columns, line), fx
    )


def responses(
    matched: Filter, spot: PulseSpread, line: tuple[float, ...] = (1.0,)
) -> tuple[Array, Array]:
    """Return the filter outputs of unit pulses at all positions: amplitudes, and the area in px of
    each.

    Thousands of positions are reduced to few amplitudes with equal area, mean and mean square.
    """
    return _responses(Filter(high=matched.high, broad=matched.broad), spot, line)


@lru_cache(maxsize=512)
def _responses(matched: Filter, spot: PulseSpread, line: tuple[float, ...]) -> tuple[Array, Array]:
    sides, fine = _sides(matched), EVENT_ACCURACY.steps_per_px
    # Filters and spots are symmetric along columns: one half counts twice, its borders once.
    half = fine * sides[0] // 2 + 1
    response = np.fft.irfft2(
        _transfer(spot, sides) * _weights(matched, line), s=(fine * sides[0], fine * sides[1])
    )[:half]
    once = np.full(half, 2.0)
    once[[0, -1]] = 1.0
    weight = np.broadcast_to(once[:, None], response.shape) / fine**2
    return quantise_amplitudes(response.ravel() * fine**2, weight.ravel())


def quantise_amplitudes(value: Array, weight: Array) -> tuple[Array, Array]:
    """Return few values with weights in place of many, with equal moments up to the second.

    Each value is assigned to the three nearest nodes by quadratic interpolation (some weights are
    negative). Nodes are proportional to squared integers; small values use the three around zero.
    """
    top, count = float(np.abs(value).max()), EVENT_ACCURACY.nodes
    position = np.sqrt(np.abs(value) / top) * count
    grid = np.arange(-count - 1, count + 2)
    nodes = top * (grid / count) ** 2 * np.sign(grid)
    is_outer = position > 1.5
    small, small_weight = value[~is_outer], weight[~is_outer]
    zero, unit = count + 1, nodes[count + 2]
    out = np.zeros(len(nodes))
    first, second = float(small_weight @ small) / unit, float(small_weight @ small**2) / unit**2
    out[zero - 1 : zero + 2] = (
        0.5 * (second - first),
        float(small_weight.sum()) - second,
        0.5 * (second + first),
    )
    large, large_weight = value[is_outer], weight[is_outer]
    middle = np.rint(np.copysign(position[is_outer], large)).astype(np.int64) + zero
    middle = np.clip(middle, 1, len(nodes) - 2)
    a, b, c = nodes[middle - 1], nodes[middle], nodes[middle + 1]
    to_a, to_b, to_c = large - a, large - b, large - c
    out += np.bincount(middle - 1, to_b * to_c / ((a - b) * (a - c)) * large_weight, len(nodes))
    out += np.bincount(middle, to_a * to_c / ((b - a) * (b - c)) * large_weight, len(nodes))
    out += np.bincount(middle + 1, to_a * to_b / ((c - a) * (c - b)) * large_weight, len(nodes))
    is_weighted = out != 0.0
    return nodes[is_weighted], out[is_weighted]


@dataclass(frozen=True, kw_only=True)
class DarkFrames:
    """Dark exposures without fixed pattern."""

    changes: tuple[
        Images, ...
    ]  # fluctuations of the exposures of each parity, shape (exposure, row, col), DN
    stride: int  # exposures between successive ones of one parity
    row_pitch: float  # row pitch of an exposure, column pitches
    defects: float  # fraction of blinking pixels, which are set to zero
    still: float  # fraction of values unchanged in the next exposure of the same parity
    full: float  # fraction of bright values at full scale

    def filters(self, step: int, *, lag: bool) -> tuple[Filter, ...]:
        """Return filters for a spot of half width `step`, px."""
        return boxes(step, stride=self.stride, exposures=len(self.changes[0]), lag=lag)

    def without_mean(self, usable: list[NDArray[np.bool_]]) -> "DarkFrames":
        """Return a copy with each pixel's mean computed from the usable values."""
        changes = []
        for change, mask in zip(self.changes, usable, strict=True):
            count = np.maximum(mask.sum(axis=0), 1)
            changes.append(
                change - (np.where(mask, change, 0.0).sum(axis=0) / count).astype(np.float32)
            )
        return replace(self, changes=tuple(changes))


def dark_frames(
    stack: FrameStack, context: Context, most_values: int = EVENTS.max_values
) -> DarkFrames:
    """Split fields, subtract each pixel's mean, and set blinking pixels to zero."""
    frames = min(len(stack), EVENTS.max_frames)
    middle = _middle(stack, frames, most_values)
    row_step = 2 if context.interlaced else 1
    changes, bad, pixels, still = [], 0, 0, []
    for field in split_fields(middle.data, row_step):
        image = field.astype(np.float32)
        still.append(float(np.mean(image[1:] == image[:-1])))
        change = image - image.mean(axis=0)
        change -= np.median(change[:, ::5, ::5], axis=(1, 2), keepdims=True)
        flickering = _flickering(change)
        change[:, flickering] = 0.0
        bad, pixels = bad + int(flickering.sum()), pixels + flickering.size
        changes.append(change)
    top = Stack.of(stack, context).ceiling_dn
    # Fraction at full scale of the brightest thousandth of the values.
    full = 0.0 if top is None else float(np.mean(middle.data >= top)) / 1e-3
    return DarkFrames(
        changes=tuple(changes),
        stride=len(changes),
        row_pitch=context.pitch_ratio * row_step,
        defects=bad / pixels,
        still=float(np.mean(still)),
        full=full,
    )


def _middle(stack: FrameStack, frames: int, most_values: int) -> FrameStack:
    """Return the first frames, cropped to the centre at an even row, which preserves the fields."""
    rows, cols = stack.data.shape[1:]
    side_fraction = min(1.0, np.sqrt(most_values / (frames * rows * cols)))
    height, width = max(1, int(side_fraction * rows)), max(1, int(side_fraction * cols))
    row, col = (rows - height) // 4 * 2, (cols - width) // 2
    return FrameStack(
        data=stack.data[:frames, row : row + height, col : col + width],
        frame_number=stack.frame_number[:frames],
    )


def spread(values: NDArray) -> float:
    """Return the standard deviation of the noise beneath the pulses, from the lower half of the
    values.
    """
    sample = values.ravel()[:: max(1, values.size // EVENT_ACCURACY.sample)]
    low, middle = np.quantile(sample, [0.15866, 0.5])
    return max(float(middle - low), 1e-6)


def _flickering(change: Images) -> NDArray[np.bool_]:
    """Return pixels that are bright more often than random pulses allow."""
    from scipy.special import gammaincc

    often = np.count_nonzero(change > EVENTS.bright_sd * spread(change), axis=0)
    expected = max(float(np.mean(often)), 1e-3)
    # Neighbouring pixels see the same pulses: robust against few pixels that dominate the mean.
    expected = max(
        min(expected, float(np.quantile(often, 0.9)) + 1e-3, len(change) - 1.0), 1e-3 * len(change)
    )
    suspect = (often > 1) & (often > 2.0 * expected)
    suspect[suspect] = (
        1.0 - gammaincc(often[suspect], expected)
    ) * often.size < EVENTS.blinking_false_alarm
    return suspect


def filter_exposures(frames: DarkFrames) -> list[Array]:
    """Return the exposures of each parity filtered for a small spot."""
    matched = frames.filters(1, lag=False)[MIDDLE]
    return [matched.within(change, matched.reach).astype(np.float64) for change in frames.changes]


def has_pulses(frames: DarkFrames) -> bool:
    """Return whether filtered pixels have the positive skewness of pulses."""
    parts, out = [], []
    for value in filter_exposures(frames):
        noise = spread(value)
        out.append(float(np.mean(value > EVENTS.outlier_sd * noise)))
        limit = 20.0 * noise
        cubes = np.clip(value, -limit, limit) ** 3
        side = EVENT_ACCURACY.skewness_block_px
        rows, cols = (size // side for size in cubes.shape[1:])
        blocks = cubes[:, : rows * side, : cols * side].reshape(len(cubes), rows, side, cols, side)
        parts.append(blocks.sum(axis=(2, 4)).ravel())
    total = np.concatenate(parts)
    # Bright pulses have negative sides, and few of them give no significant skewness.
    skewed = float(total.mean()) > EVENTS.skewness_sd * float(total.std()) / np.sqrt(len(total))
    return max(out) > EVENTS.outlier_fraction or skewed


def image_lag_reach(frames: DarkFrames) -> tuple[bool, bool]:
    """Return whether image lag is detected in the next field, and two exposures later."""
    matched, values = frames.filters(1, lag=False)[MIDDLE], filter_exposures(frames)
    if frames.stride == 1:
        return False, _is_correlated(values[0][:-2], values[0][2:], matched)
    even_fields, odd_fields = values
    across = any(
        _is_correlated(*pair, matched, lowered=0.0)
        for pair in ((even_fields, odd_fields), (odd_fields[:-1], even_fields[1:]))
    )
    return across, any(_is_correlated(value[:-1], value[1:], matched) for value in values)


def _is_correlated(
    before: Array, after: Array, matched: Filter, lowered: float | None = None
) -> bool:
    """Return whether pixels are correlated between two sets of exposures.

    `lowered` is the bias of the correlation by the subtracted mean; None: one over the number of
    exposures.
    """
    # Limit the weight of a single bright pulse.
    limit = 12.0 * spread(before)
    before, after = (np.clip(value, -limit, limit) for value in (before, after))
    before, after = before - before.mean(axis=0), after - after.mean(axis=0)
    product = before * after
    power = float(np.mean(before**2))
    # Values within the filter box and its video neighbours are correlated.
    area = 2.0 * matched.high * matched.broad
    sd = float(np.sqrt(np.mean(product**2) / (product.size / area))) / power
    correlation = float(np.mean(product)) / power + (
        1.0 / len(before) if lowered is None else lowered
    )
    return correlation > EVENTS.lag_sd * sd


def usable_values(
    change: Images, matched: Filter, limit_dn: float, after: int
) -> tuple[NDArray[np.bool_], Array]:
    """Return which values are far from every pulse above a limit, and the heights of these pulses.

    Starting with the brightest value, each pulse claims its surroundings.

    `matched`: filter whose output is compared with the limit, DN; `after`: exposures after such a
    pulse that are excluded too.
    """
    value = matched.within(change, matched.reach)
    usable, heights = np.ones(change.shape, bool), []
    pulses = np.argwhere(value > limit_dn)
    bright = value[tuple(pulses.T)]
    for index in np.argsort(-bright):
        frame, row, col = pulses[index] + (0, *matched.reach)
        if not usable[frame, row, col]:
            continue
        heights.append(float(bright[index]))
        area = (
            slice(max(frame - after, 0), frame + after + 1),
            slice(max(row - 2 * matched.high, 0), row + 2 * matched.high + 1),
            slice(max(col - len(matched.columns), 0), col + len(matched.columns) + 1),
        )
        usable[area] = False
    return usable, np.array(heights)


def fits_filters(frames: DarkFrames, min_px: int) -> bool:
    """Return whether images have enough rows and columns inside the margin of the widest
    filters.
    """
    margins = common_reach(boxes(3, stride=1, exposures=2, lag=False))
    return all(
        size - 2 * margin >= min_px
        for size, margin in zip(frames.changes[0].shape[1:], margins, strict=True)
    )
