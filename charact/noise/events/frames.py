"""Dark frames made ready for looking at single pulses: what changes in time, without pixels that flicker."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.events.filters import MIDDLE, Filter, boxes, common_reach
from charact.noise.stack.exposure_order import exposures
from labdata.frames import FrameStack

Array = NDArray[np.float64]
Images = NDArray[np.float32]

# So many frames and pixel values are enough for any law, and more would only take time; so few for a first look.
MOST_FRAMES, MOST_VALUES, QUICK_VALUES = 64, 4_000_000, 600_000
# A pixel far brighter than its own mean so often that chance does it in one frame of a thousand is no pulse's.
BRIGHT, CHANCE = 6.0, 1e-3
# Correlation of exposures that is beyond so many standard errors is light that stays.
SEEN = 2.5
# Third moment of filtered pixels, in standard errors, below which noise alone explains it, unless more than this share
# of them is so many times the noise.
SKEWED, OUTSTANDING, OUT = 3.0, 2e-5, 6.0
# Values that tell a spread.
SAMPLE = 60_000
# Side of the blocks whose scatter gives standard errors, px.
BLOCK_PX = 16


@dataclass(frozen=True, kw_only=True)
class DarkFrames:
    """Dark exposures without their fixed pattern.

    Parameters
    ----------
    changes
        What changes in time, for the exposures of each set of rows, shape (exposure, row, col), DN.
    stride
        Exposures from one of the same rows to the next.
    row_pitch
        From row to row of an exposure, in column pitches.
    defects
        Share of the pixels that flicker by themselves; they are set to nothing.
    still
        Share of the values that are the same in the next exposure of the same rows.
    full
        Share of the bright values that are at the highest code.
    """

    changes: tuple[Images, ...]
    stride: int
    row_pitch: float
    defects: float
    still: float
    full: float

    def filters(self, step: int, *, lag: bool) -> tuple[Filter, ...]:
        """Return filters for a spot of some `step` pixels."""
        return boxes(step, stride=self.stride, exposures=len(self.changes[0]), lag=lag)

    def without_mean(self, usable: list[NDArray[np.bool_]]) -> "DarkFrames":
        """Return the same with each pixel's mean taken over the values that count."""
        changes = []
        for change, good in zip(self.changes, usable, strict=True):
            count = np.maximum(good.sum(axis=0), 1)
            changes.append(change - (np.where(good, change, 0.0).sum(axis=0) / count).astype(np.float32))
        return replace(self, changes=tuple(changes))


def dark_frames(stack: FrameStack, context: Context, most_values: int = MOST_VALUES) -> DarkFrames:
    """Split fields, take each pixel's mean away, and put pixels that flicker at rest."""
    frames = min(len(stack), MOST_FRAMES)
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
    """The first frames, of large ones the middle; its first row is an even one, so that fields stay what they are."""
    rows, cols = stack.data.shape[1:]
    share = min(1.0, np.sqrt(most_values / (frames * rows * cols)))
    high, wide = max(1, int(share * rows)), max(1, int(share * cols))
    row, col = (rows - high) // 4 * 2, (cols - wide) // 2
    return FrameStack(data=stack.data[:frames, row : row + high, col : col + wide],
                      frame_number=stack.frame_number[:frames])  # fmt: skip


def spread(values: NDArray) -> float:
    """Return the standard deviation of the noise under the pulses, from the lower half of the values."""
    sample = values.ravel()[:: max(1, values.size // SAMPLE)]
    low, middle = np.quantile(sample, [0.15866, 0.5])
    return max(float(middle - low), 1e-6)


def _flickering(change: Images) -> NDArray[np.bool_]:
    """Pixels that are bright far more often than pulses that fall anywhere make them."""
    from scipy.special import gammaincc

    often = np.count_nonzero(change > BRIGHT * spread(change), axis=0)
    expected = max(float(np.mean(often)), 1e-3)
    # Pulses of pixels side by side are the same: robust against the few pixels that make the mean.
    expected = max(min(expected, float(np.quantile(often, 0.9)) + 1e-3, len(change) - 1.0), 1e-3 * len(change))
    suspect = (often > 1) & (often > 2.0 * expected)
    suspect[suspect] = (1.0 - gammaincc(often[suspect], expected)) * often.size < CHANCE
    return suspect


def _full(data: NDArray, full_scale_dn: float | None) -> float:
    """Share at the highest code of the values that stand out as much as the brightest thousandth."""
    if full_scale_dn is None:
        return 0.0
    return float(np.mean(data >= full_scale_dn)) / 1e-3


def filter_exposures(frames: DarkFrames) -> list[Array]:
    """Return what the filter of a small spot makes of the exposures of each set of rows."""
    one = frames.filters(1, lag=False)[MIDDLE]
    return [one.within(change, one.reach).astype(np.float64) for change in frames.changes]


def has_pulses(frames: DarkFrames) -> bool:
    """Tell whether filtered pixels are skewed towards the bright side, as pulses make them."""
    parts, out = [], []
    for value in filter_exposures(frames):
        noise = spread(value)
        out.append(float(np.mean(value > OUT * noise)))
        limit = 20.0 * noise
        cubes = np.clip(value, -limit, limit) ** 3
        rows, cols = (size // BLOCK_PX * BLOCK_PX for size in cubes.shape[1:])
        blocks = cubes[:, :rows, :cols].reshape(len(cubes), rows // BLOCK_PX, BLOCK_PX, cols // BLOCK_PX, BLOCK_PX)
        parts.append(blocks.sum(axis=(2, 4)).ravel())
    total = np.concatenate(parts)
    # The sides of bright pulses are dark, and few bright ones make no skewness.
    return max(out) > OUTSTANDING or float(total.mean()) > SKEWED * float(total.std()) / np.sqrt(len(total))


@dataclass(frozen=True, kw_only=True)
class ImageLagCorrelation:
    """Where light of one exposure is seen again.

    Parameters
    ----------
    across
        In the other field that follows at once.
    later
        Two exposures on.
    """

    across: bool
    later: bool


def image_lag_correlation(frames: DarkFrames) -> ImageLagCorrelation:
    """Tell where pulses are seen again."""
    one, values = frames.filters(1, lag=False)[MIDDLE], filter_exposures(frames)
    if frames.stride == 1:
        return ImageLagCorrelation(across=False, later=_is_correlated(values[0][:-2], values[0][2:], one))
    even, odd = values
    across = any(_is_correlated(*pair, one, lowered=0.0) for pair in ((even, odd), (odd[:-1], even[1:])))
    return ImageLagCorrelation(across=across, later=any(_is_correlated(value[:-1], value[1:], one) for value in values))


def _is_correlated(before: Array, after: Array, one: Filter, lowered: float | None = None) -> bool:
    """Tell whether pixels vary together from one set of exposures to another.

    The mean over the exposures that was taken away has lowered the correlation; by one over their number if None.
    """
    # One pulse counts once, however bright.
    limit = 12.0 * spread(before)
    before, after = (np.clip(value, -limit, limit) for value in (before, after))
    before, after = before - before.mean(axis=0), after - after.mean(axis=0)
    product = before * after
    power = float(np.mean(before**2))
    # Values within the box of the filter, and its video neighbours, are not independent.
    area = 2.0 * one.high * one.broad
    sd = float(np.sqrt(np.mean(product**2) / (product.size / area))) / power
    correlation = float(np.mean(product)) / power + (1.0 / len(before) if lowered is None else lowered)
    return correlation > SEEN * sd


def usable_values(change: Images, one: Filter, limit_dn: float, after: int) -> tuple[NDArray[np.bool_], Array]:
    """Return which values lie far from every pulse above a limit, and the largest value of each of those.

    The brightest value is a pulse, and all around it are its own; then the brightest of the rest, and so on.

    Parameters
    ----------
    one
        Filter whose output is compared with the limit, DN.
    after
        Exposures after such a pulse that it spoils as well.
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
    """Tell whether images leave so many rows and columns inside the reach of the widest filters."""
    reach = common_reach(boxes(3, stride=1, exposures=2, lag=False))
    return all(size - 2 * far >= least for size, far in zip(frames.changes[0].shape[1:], reach, strict=True))
