"""Dark frames made ready for looking at single pulses: what changes in time, without pixels that flicker."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.events_filters import Filter
from charact.noise.fields import exposures
from labdata.frames import FrameStack

Array = NDArray[np.float64]

# So many frames and pixel values are enough for any law, and more would only take time.
MOST_FRAMES, MOST_VALUES = 64, 4_000_000
# A pixel far brighter than its own mean so often that chance does it in one frame of a thousand is no pulse's.
BRIGHT, CHANCE = 6.0, 1e-3
# Correlation of successive exposures that is beyond so many standard errors and so large is light that stays.
SEEN, LEAST_CORRELATION = 5.0, 0.01


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
    frames
        Frames used.
    """

    changes: tuple[NDArray[np.float32], ...]
    stride: int
    row_pitch: float
    defects: float
    still: float
    full: float
    frames: int


def dark_frames(stack: FrameStack, context: Context) -> DarkFrames:
    """Split fields, take each pixel's mean away, and put pixels that flicker at rest."""
    frames = min(len(stack), MOST_FRAMES)
    shots = exposures(_middle(stack, frames), 0, frames, interlaced=context.interlaced)
    changes, bad, pixels, still = [], 0, 0, []
    for parity in np.unique(shots.parity):
        image = shots.image[shots.parity == parity]
        still.append(float(np.mean(image[1:] == image[:-1])))
        change = image - image.mean(axis=0)
        change -= np.median(change, axis=(1, 2), keepdims=True)
        flickering = _flickering(change)
        change[:, flickering] = 0.0
        bad, pixels = bad + int(flickering.sum()), pixels + flickering.size
        changes.append(change)
    full_scale_dn = context.full_scale_dn if context.full_scale_dn is not None else stack.full_scale_dn
    return DarkFrames(changes=tuple(changes), stride=len(changes), row_pitch=context.pitch_ratio * shots.row_step,
                      defects=bad / pixels, still=float(np.mean(still)), frames=frames,
                      full=_full(stack.data[:frames], full_scale_dn))  # fmt: skip


def _middle(stack: FrameStack, frames: int) -> FrameStack:
    """The first frames, of large ones the middle; its first row is an even one, so that fields stay what they are."""
    rows, cols = stack.data.shape[1:]
    share = min(1.0, np.sqrt(MOST_VALUES / (frames * rows * cols)))
    high, wide = max(1, int(share * rows)), max(1, int(share * cols))
    row, col = (rows - high) // 4 * 2, (cols - wide) // 2
    return FrameStack(data=stack.data[:frames, row : row + high, col : col + wide],
                      frame_number=stack.frame_number[:frames])  # fmt: skip


def spread(values: NDArray) -> float:
    """Return the standard deviation of the noise under the pulses, from the lower half of the values."""
    sample = values.ravel()[:: max(1, values.size // 400_000)]
    low, middle = np.quantile(sample, [0.15866, 0.5])
    return max(float(middle - low), 1e-6)


def _flickering(change: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Pixels that are bright far more often than pulses that fall anywhere make them."""
    from scipy.special import gammaincc

    # One ion event moves a pixel's mean, but not its median.
    above = change - np.median(change, axis=0)
    often = np.count_nonzero(above > BRIGHT * spread(change), axis=0)
    expected = max(float(np.mean(often)), 1e-3)
    # Pulses of pixels side by side are the same: robust against the few pixels that make the mean.
    expected = max(min(expected, float(np.quantile(often, 0.9)) + 1e-3, len(change) - 1.0), 1e-3 * len(change))
    chance = 1.0 - gammaincc(np.maximum(often, 1), expected)
    return (often > 1) & (chance * often.size < CHANCE) & (often > 2.0 * expected)


def _full(data: NDArray, full_scale_dn: float | None) -> float:
    """Share at the highest code of the values that stand out as much as the brightest thousandth."""
    if full_scale_dn is None:
        return 0.0
    return float(np.mean(data >= full_scale_dn)) / 1e-3


def usable_without(change: NDArray[np.float32], one: Filter, limit_dn: float, reach: tuple[int, int], after: int
                   ) -> tuple[NDArray[np.bool_], Array]:  # fmt: skip
    """Return which values lie far from every pulse above a limit, and the largest value of each of those.

    Parameters
    ----------
    one
        Filter whose output is compared with the limit, DN.
    reach
        Rows and columns around such a pulse that it spoils.
    after
        Exposures after it that it spoils as well.
    """
    from scipy.ndimage import label, maximum_filter

    rows, cols = len(one.rows) // 2, len(one.columns) // 2
    value = np.pad(one.of(change), ((0, 0), (rows, rows), (cols, cols)))
    above = value > limit_dn
    if not above.any():
        return np.ones(change.shape, bool), np.empty(0)
    # Neighbouring pixels and the following exposures belong to one pulse.
    joined = np.asarray(maximum_filter(above, size=(3, 5, 5)), bool)
    number, count = label(joined, structure=np.ones((3, 3, 3)))  # type: ignore[misc]
    heights = np.zeros(count + 1)
    np.maximum.at(heights, np.asarray(number, np.int64)[above], value[above])
    size = (2 * after + 1, 2 * reach[0] + 1, 2 * reach[1] + 1)
    spoilt = maximum_filter(above, size=size)
    return ~np.asarray(spoilt, bool), heights[1:]


def recentred(change: NDArray[np.float32], usable: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return exposures without each pixel's mean over the values that count."""
    count = np.maximum(usable.sum(axis=0), 1)
    return change - (np.where(usable, change, 0.0).sum(axis=0) / count).astype(np.float32)


def lingers(change: NDArray[np.float32], one: Filter) -> bool:
    """Return whether successive exposures of the same rows hold light in common."""
    value = one.of(change).astype(np.float64)
    # One pulse counts once, however bright.
    limit = 12.0 * spread(value)
    value = np.clip(value, -limit, limit)
    value -= value.mean(axis=0)
    product = value[1:] * value[:-1]
    power = float(np.mean(value**2))
    area = float(sum(np.abs(one.rows)) * np.sum(np.asarray(one.columns) > 0))
    sd = float(np.sqrt(np.mean(product**2) / (product.size / (2.0 * area)))) / power
    correlation = float(np.mean(product)) / power + 1.0 / len(change)
    return correlation > max(SEEN * sd, LEAST_CORRELATION)
