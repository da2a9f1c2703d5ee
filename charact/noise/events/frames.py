"""Dark frames without fixed pattern and blinking pixels, for the search of single pulses."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.events.filters import MIDDLE, Filter, boxes, common_reach
from charact.noise.stack.temporal import exposures
from charact.noise.thresholds import EVENT_ACCURACY, EVENTS
from labdata.frames import FrameStack

Array = NDArray[np.float64]
Images = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class DarkFrames:
    """Dark exposures without fixed pattern."""

    changes: tuple[Images, ...]  # fluctuations of the exposures of each parity, shape (exposure, row, col), DN
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
        for change, good in zip(self.changes, usable, strict=True):
            count = np.maximum(good.sum(axis=0), 1)
            changes.append(change - (np.where(good, change, 0.0).sum(axis=0) / count).astype(np.float32))
        return replace(self, changes=tuple(changes))


def dark_frames(stack: FrameStack, context: Context, most_values: int = EVENTS.max_values) -> DarkFrames:
    """Split fields, subtract each pixel's mean, and set blinking pixels to zero."""
    frames = min(len(stack), EVENTS.max_frames)
    middle = _middle(stack, frames, most_values)
    shots = exposures(middle, 0, frames, interlaced=context.interlaced)
    changes, bad, pixels, still = [], 0, 0, []
    for parity in np.unique(shots.parity):
        image = shots.image[shots.parity == parity]
        still.append(float(np.mean(image[1:] == image[:-1])))
        change = image - image.mean(axis=0)
        change -= np.median(change[:, ::5, ::5], axis=(1, 2), keepdims=True)
        flickering = _flickering(change)
        change[:, flickering] = 0.0
        bad, pixels = bad + int(flickering.sum()), pixels + flickering.size
        changes.append(change)
    full_scale_dn = context.full_scale_dn if context.full_scale_dn is not None else stack.full_scale_dn
    return DarkFrames(changes=tuple(changes), stride=len(changes), row_pitch=context.pitch_ratio * shots.row_step,
                      defects=bad / pixels, still=float(np.mean(still)), full=_full(middle.data, full_scale_dn)
                      )  # fmt: skip


def _middle(stack: FrameStack, frames: int, most_values: int) -> FrameStack:
    """Return the first frames, cropped to the centre at an even row, which preserves the fields."""
    rows, cols = stack.data.shape[1:]
    share = min(1.0, np.sqrt(most_values / (frames * rows * cols)))
    high, wide = max(1, int(share * rows)), max(1, int(share * cols))
    row, col = (rows - high) // 4 * 2, (cols - wide) // 2
    return FrameStack(data=stack.data[:frames, row : row + high, col : col + wide],
                      frame_number=stack.frame_number[:frames])  # fmt: skip


def spread(values: NDArray) -> float:
    """Return the standard deviation of the noise beneath the pulses, from the lower half of the values."""
    sample = values.ravel()[:: max(1, values.size // EVENT_ACCURACY.sample)]
    low, middle = np.quantile(sample, [0.15866, 0.5])
    return max(float(middle - low), 1e-6)


def _flickering(change: Images) -> NDArray[np.bool_]:
    """Return pixels that are bright more often than random pulses allow."""
    from scipy.special import gammaincc

    often = np.count_nonzero(change > EVENTS.bright_sd * spread(change), axis=0)
    expected = max(float(np.mean(often)), 1e-3)
    # Neighbouring pixels see the same pulses: robust against few pixels that dominate the mean.
    expected = max(min(expected, float(np.quantile(often, 0.9)) + 1e-3, len(change) - 1.0), 1e-3 * len(change))
    suspect = (often > 1) & (often > 2.0 * expected)
    suspect[suspect] = (1.0 - gammaincc(often[suspect], expected)) * often.size < EVENTS.blinking_false_alarm
    return suspect


def _full(data: NDArray, full_scale_dn: float | None) -> float:
    """Return the fraction at full scale of the brightest thousandth of the values."""
    if full_scale_dn is None:
        return 0.0
    return float(np.mean(data >= full_scale_dn)) / 1e-3


def filter_exposures(frames: DarkFrames) -> list[Array]:
    """Return the exposures of each parity filtered for a small spot."""
    one = frames.filters(1, lag=False)[MIDDLE]
    return [one.within(change, one.reach).astype(np.float64) for change in frames.changes]


def has_pulses(frames: DarkFrames) -> bool:
    """Return whether filtered pixels have the positive skewness of pulses."""
    parts, out = [], []
    for value in filter_exposures(frames):
        noise = spread(value)
        out.append(float(np.mean(value > EVENTS.outlier_sd * noise)))
        limit = 20.0 * noise
        cubes = np.clip(value, -limit, limit) ** 3
        rows, cols = (
            size // EVENT_ACCURACY.skewness_block_px * EVENT_ACCURACY.skewness_block_px for size in cubes.shape[1:]
        )
        blocks = cubes[:, :rows, :cols].reshape(
            len(cubes),
            rows // EVENT_ACCURACY.skewness_block_px,
            EVENT_ACCURACY.skewness_block_px,
            cols // EVENT_ACCURACY.skewness_block_px,
            EVENT_ACCURACY.skewness_block_px,
        )
        parts.append(blocks.sum(axis=(2, 4)).ravel())
    total = np.concatenate(parts)
    # Bright pulses have negative sides, and few of them give no significant skewness.
    return max(out) > EVENTS.outlier_fraction or float(total.mean()) > EVENTS.skewness_sd * float(
        total.std()
    ) / np.sqrt(len(total))


@dataclass(frozen=True, kw_only=True)
class ImageLagCorrelation:
    """Exposures with image lag."""

    across: bool  # in the next field
    later: bool  # two exposures later


def image_lag_correlation(frames: DarkFrames) -> ImageLagCorrelation:
    """Return in which later exposures image lag is detected."""
    one, values = frames.filters(1, lag=False)[MIDDLE], filter_exposures(frames)
    if frames.stride == 1:
        return ImageLagCorrelation(across=False, later=_is_correlated(values[0][:-2], values[0][2:], one))
    even, odd = values
    across = any(_is_correlated(*pair, one, lowered=0.0) for pair in ((even, odd), (odd[:-1], even[1:])))
    return ImageLagCorrelation(across=across, later=any(_is_correlated(value[:-1], value[1:], one) for value in values))


def _is_correlated(before: Array, after: Array, one: Filter, lowered: float | None = None) -> bool:
    """Return whether pixels are correlated between two sets of exposures.

    `lowered` is the bias of the correlation by the subtracted mean; None: one over the number of exposures.
    """
    # Limit the weight of a single bright pulse.
    limit = 12.0 * spread(before)
    before, after = (np.clip(value, -limit, limit) for value in (before, after))
    before, after = before - before.mean(axis=0), after - after.mean(axis=0)
    product = before * after
    power = float(np.mean(before**2))
    # Values within the filter box and its video neighbours are correlated.
    area = 2.0 * one.high * one.broad
    sd = float(np.sqrt(np.mean(product**2) / (product.size / area))) / power
    correlation = float(np.mean(product)) / power + (1.0 / len(before) if lowered is None else lowered)
    return correlation > EVENTS.lag_sd * sd


def usable_values(change: Images, one: Filter, limit_dn: float, after: int) -> tuple[NDArray[np.bool_], Array]:
    """Return which values are far from every pulse above a limit, and the heights of these pulses.

    Starting with the brightest value, each pulse claims its surroundings.

    `one`: filter whose output is compared with the limit, DN; `after`: exposures after such a pulse that are excluded
    too.
    """
    value = one.within(change, one.reach)
    usable, heights = np.ones(change.shape, bool), []
    places = np.argwhere(value > limit_dn)
    bright = value[tuple(places.T)]
    for index in np.argsort(-bright):
        frame, row, col = places[index] + (0, *one.reach)
        if not usable[frame, row, col]:
            continue
        heights.append(float(bright[index]))
        area = (slice(max(frame - after, 0), frame + after + 1),
                slice(max(row - 2 * one.high, 0), row + 2 * one.high + 1),
                slice(max(col - len(one.columns), 0), col + len(one.columns) + 1))  # fmt: skip
        usable[area] = False
    return usable, np.array(heights)


def fits_filters(frames: DarkFrames, least: int) -> bool:
    """Return whether images have enough rows and columns inside the margin of the widest filters."""
    reach = common_reach(boxes(3, stride=1, exposures=2, lag=False))
    return all(size - 2 * far >= least for size, far in zip(frames.changes[0].shape[1:], reach, strict=True))
