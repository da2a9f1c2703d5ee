"""Survey of one stack: robust level and noise, quantisation step, outlying pixels."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from charact.estimators.noise.thresholds import SURVEY
from charact.frames.layout import lost_rows, profiles_of
from charact.frames.robust import NORMAL, robust_sd
from charact.frames.rounding import rounding_step
from charact.frames.session_layout import StackProfile
from charact.frames.thresholds import STACK
from labdata import Array, BadInput, StackEntry, open_lazy_stack


def common_step(steps: list[float | None]) -> float | None:
    """Return the common step of all stacks: the smallest that divides all; 0 if one is continuous;
    None if unknown.
    """
    known = [step for step in steps if step is not None]
    if not known:
        return None
    if min(known) == 0.0:
        return 0.0
    if all(step.is_integer() for step in known):
        return float(np.gcd.reduce(np.array(known, np.int64)))
    return min(known)


Places = NDArray[np.int64]
# Squares of larger values exceed single precision.
LARGEST_DN = 1e9


def _no_places() -> Places:
    return np.empty(0, np.int64)


@dataclass(frozen=True, kw_only=True)
class PixelSurvey(StackProfile):
    """Outlying pixels of one stack; positions are row times columns plus column."""

    # level_dn, sd_dn: median, and robust temporal standard deviation, DN
    level_dn: float
    sd_dn: float
    step_dn: float | None  # quantisation step, DN; 0 for continuous values, None if unknown
    # bright, faint: positions of pixels whose mean is far from the surrounding ones
    bright: Places = field(default_factory=_no_places)
    faint: Places = field(default_factory=_no_places)
    threshold_dn: float = 0.0  # distance threshold, DN
    # lower_counts, upper_counts: their numbers if each mean were 1 and 1.96 standard errors closer
    # to the surrounding ones, or farther
    lower_counts: tuple[int, int] = (0, 0)
    upper_counts: tuple[int, int] = (0, 0)
    # positions of pixels with outliers in some frames
    sudden: Places = field(default_factory=_no_places)
    # departure_dn, times, frame: for each such pixel the largest deviation, DN, the number of
    # outlying frames (at most 4), and the most outlying frame, -1 if unknown (pair)
    departure_dn: Array
    times: Places = field(default_factory=_no_places)
    frame: Places = field(default_factory=_no_places)
    # track, track_frame: pixels of tracks, several adjacent ones of one frame, and their frames
    track: Places = field(default_factory=_no_places)
    track_frame: Places = field(default_factory=_no_places)
    # sample, sample_place: deviations of a sample of values, DN, and their positions
    sample: NDArray[np.float32]
    sample_place: Places

    @property
    def pixels(self) -> int:
        """Pixels of a frame."""
        return self.size[0] * self.size[1]

    @property
    def is_large(self) -> bool:
        """Whether the images have enough pixels to tell outliers."""
        return self.pixels >= SURVEY.min_pixels and min(self.size) >= SURVEY.min_side_px

    @property
    def trials(self) -> int:
        """Independent chances of an outlier per pixel."""
        return 1 if self.frames == 2 else self.frames

    def tail_dn(self, without: NDArray[np.bool_]) -> float:
        """Return the extrapolated limit of the stack's tail, without some pixels, DN."""
        sizes = np.abs(self.sample[~without[self.sample_place]])
        if sizes.size < 100:
            return np.inf
        ranks = [int(sizes.size * (1.0 - chance)) for chance in SURVEY.tail_chances]
        nearer, farther = np.partition(sizes, ranks)[ranks]
        return max(
            float(farther + SURVEY.tail_decades * (farther - nearer)),
            SURVEY.sudden_sd * self.sd_dn,
        )


def survey_pixels(entry: StackEntry, *, means: bool) -> PixelSurvey:
    """Return the survey of a stack.

    Raises BadInput if the frames cannot be read or values are out of range.
    """
    stack = open_lazy_stack(entry)
    frames, rows, cols = stack.shape
    first = _pixel_rows(stack.frames(0, min(frames, 2)), entry)
    every = max(1, rows * cols // SURVEY.sample) | 1
    pixel = np.arange(0, rows * cols, every)
    values = first[:, pixel].astype(np.float64)
    change = values[-1] - values[0]
    change -= np.median(change)
    step = rounding_step([values])
    sd = _temporal_sd(change, step) / np.sqrt(2.0)
    common = {
        "label": entry.label,
        "kind": entry.kind,
        "size": (rows, cols),
        "frames": frames,
        "level_dn": float(np.median(values)),
        "step_dn": step,
        "sd_dn": sd,
        "sample": (change / np.sqrt(2.0)).astype(np.float32),
        "sample_place": pixel,
    }
    survey = PixelSurvey(**common, departure_dn=np.empty(0))
    if frames < 2 or not survey.is_large or sd <= 0:
        return survey
    blocks = (
        (at, _pixel_rows(stack.frames(at, min(at + STACK.block_frames, frames)), entry))
        for at in range(0, frames, STACK.block_frames)
    )
    lost = lost_rows(first.reshape(-1, rows, cols)) if frames == 2 else ()
    if frames == 2:
        outliers = _sudden_in_pair(first, sd, (rows, cols))
        highest, lowest = np.float32(np.maximum(*first)), np.float32(np.minimum(*first))
        total = highest + lowest
    else:
        extremes = _Extremes(rows * cols)
        for at, block in blocks:
            shift = _level_shifts(block[:, pixel].astype(np.float64) - values[0], sd)
            _extend(block, shift, at, *extremes.arrays)
            lost += lost_rows(block.reshape(-1, rows, cols), at)
        outliers = extremes.sudden(frames, sd, (rows, cols))
        total, highest, lowest = extremes.total, extremes.high, extremes.low
    common |= {
        "profiles": profiles_of(total.reshape(rows, cols) / np.float32(frames)),
        "lost": lost,
    }
    if means:
        # Means without their extreme value: one struck frame makes no bright pixel.
        trimmed_means = [(total - top) / np.float32(frames - 1) for top in (highest, lowest)]
        common |= _outlying_means(
            trimmed_means[0].reshape(rows, cols),
            trimmed_means[1].reshape(rows, cols),
            sd / np.sqrt(frames),
        )
    return PixelSurvey(**common, **outliers)


def _pixel_rows(data: NDArray, entry: StackEntry) -> NDArray:
    """Return frames as rows of pixels, of a type supported by the compiled loops."""
    flat = data.reshape(len(data), -1)
    if flat.dtype in (np.uint8, np.uint16):
        return flat
    largest = float(np.abs(flat).max())
    if largest > LARGEST_DN:
        raise BadInput(
            f"pixel values must lie below {LARGEST_DN:.0e} DN, got {largest:.3g}, in stack "
            f"{entry.label!r}; divide the frames by a constant"
        )
    return flat.astype(np.float32)


def _temporal_sd(change: Array, step: float | None) -> float:
    """Return a robust standard deviation, at least that of rounding."""
    size = np.abs(change)
    half, quantile95 = np.quantile(size, [0.5, 0.95])
    if quantile95 <= 0:
        return 0.0
    return float(max(NORMAL * half, quantile95 / 1.96, (step or 0.0) / np.sqrt(6.0)))


@njit(cache=True)
def _pair_departs(first, second, middle, limit, out):
    """Write the positions at which a pair differs by more than a limit; return their number."""
    count = 0
    for i in range(len(first)):
        change = float(second[i]) - float(first[i]) - middle
        if change > limit or change < -limit:
            if count < len(out):
                out[count] = i
            count += 1
    return count


def _sudden_in_pair(pair: NDArray, sd: float, size: tuple[int, int]) -> dict:
    """Return the pixels in which two frames differ."""
    middle = float(np.median(pair[1, ::7].astype(np.float64) - pair[0, ::7]))
    out = np.empty(int(SURVEY.max_fraction * pair.shape[1]) + 1, np.int64)
    limit = SURVEY.sudden_sd * sd * np.sqrt(2.0)
    count = _pair_departs(pair[0], pair[1], middle, limit, out)
    pixels = out[: min(count, len(out))]

    def departure(pixels: Places) -> Array:
        return np.abs(pair[1, pixels].astype(float) - pair[0, pixels] - middle) / np.sqrt(2.0)

    def unknown(pixels: Places) -> Places:
        return np.full(pixels.shape, -1)

    return {
        "sudden": pixels,
        "departure_dn": departure(pixels),
        "times": np.ones(len(pixels), np.int64),
        "frame": unknown(pixels),
        **_tracks(pixels, departure, unknown, size, sd),
    }


def _tracks(
    pixels: Places,
    departure: Callable[[Places], Array],
    frame: Callable[[Places], Places],
    size: tuple[int, int],
    sd: float,
) -> dict:
    """Return the pixels of tracks with their frames: outliers and their neighbours in that frame
    that depart by `SURVEY.track_sd`, and so on along the track; then all neighbours of these, whose
    share of the charge their noise hides.
    """
    rows, cols = size
    is_hit, is_track = (np.zeros((rows + 2, cols + 2), bool) for _ in range(2))
    known = pixels if len(pixels) <= SURVEY.max_tracks * rows * cols else _no_places()
    row, col = np.divmod(known, cols)
    step = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j])
    is_hit[row + 1, col + 1] = True

    def neighbours() -> tuple[tuple[Places, Places], Places, NDArray[np.bool_]]:
        around = row[:, None] + step[:, 0], col[:, None] + step[:, 1]
        clipped = np.clip(around[0], 0, rows - 1) * cols + np.clip(around[1], 0, cols - 1)
        is_inside = (np.clip(around, 0, [[[rows - 1]], [[cols - 1]]]) == around).all(axis=0)
        return around, clipped, is_inside

    while len(row):
        around, clipped, is_inside = neighbours()
        is_near = is_inside & (departure(clipped) > SURVEY.track_sd * sd)
        is_near &= frame(clipped) == frame(row * cols + col)[:, None]
        is_track[row + 1, col + 1] |= is_near.any(axis=1)
        is_new = is_near & ~is_hit[around[0] + 1, around[1] + 1]
        row, col = np.divmod(np.unique(clipped[is_new]), cols)
        is_hit[row + 1, col + 1] = True
    if 2 * np.count_nonzero(is_track) > np.count_nonzero(is_hit):
        # Where most are tracks, single outliers are parts of them that others cross.
        is_track = is_hit
    track = np.flatnonzero(is_track[1:-1, 1:-1])
    row, col = np.divmod(track, cols)
    _, clipped, is_inside = neighbours()
    rim_frame = np.broadcast_to(frame(track)[:, None], clipped.shape)[is_inside]
    rim = np.unique([clipped[is_inside], rim_frame], axis=1)
    rim = rim[:, ~np.isin(rim[0], track)]
    return {
        "track": np.concatenate([track, rim[0]]),
        "track_frame": np.concatenate([frame(track), rim[1]]),
    }


class _Extremes:
    """Two largest and two smallest values of every pixel, their frames, and the sum."""

    def __init__(self, pixels: int) -> None:
        self.total = np.zeros(pixels, np.float32)
        self.high, self.next_high = (np.full(pixels, -np.inf, np.float32) for _ in range(2))
        self.low, self.next_low = (np.full(pixels, np.inf, np.float32) for _ in range(2))
        self.high_at, self.low_at = np.zeros(pixels, np.int32), np.zeros(pixels, np.int32)

    @property
    def arrays(self) -> tuple:
        """All arrays, in the order of the loop's arguments."""
        return (
            self.total,
            self.high,
            self.next_high,
            self.low,
            self.next_low,
            self.high_at,
            self.low_at,
        )

    def sudden(self, frames: int, sd: float, size: tuple[int, int]) -> dict:
        """Return the pixels that deviate in some frames from the mean of the others."""
        middle = (self.total - self.high - self.low) / np.float32(frames - 2)
        sd *= float(np.sqrt(1.0 + 1.0 / (frames - 2)))
        limit = SURVEY.sudden_sd * sd
        up, down = self.high - middle, middle - self.low
        outliers = np.flatnonzero((up > limit) | (down > limit))
        pixels = outliers[: int(SURVEY.max_fraction * len(middle)) + 1]
        times = sum(
            (np.abs(extreme[pixels] - middle[pixels]) > limit).astype(np.int64)
            for extreme in (self.high, self.next_high, self.low, self.next_low)
        )

        def departure(pixels: Places) -> Array:
            return np.maximum(up[pixels], down[pixels]).astype(float)

        def frame(pixels: Places) -> Places:
            is_up = up[pixels] > down[pixels]
            return np.where(is_up, self.high_at[pixels], self.low_at[pixels]).astype(np.int64)

        tracks = _tracks(outliers, departure, frame, size, sd)
        track = tracks["track"]
        struck_again = self.next_high[track] - middle[track] > limit
        tracks["track_frame"] = np.where(struck_again, -1, tracks["track_frame"])
        return {
            "sudden": pixels,
            "departure_dn": departure(pixels),
            "times": np.asarray(times),
            "frame": frame(pixels),
            **tracks,
        }


def _level_shifts(changes: Array, sd: float) -> NDArray[np.float32]:
    """Return by how much the level of each frame differs from the first by more than the noise of a
    pixel, DN, from the changes of a sample, shape (frame, pixel); 0 of the others.
    """
    middle = np.median(changes, axis=1, keepdims=True)
    shift = middle[:, 0] + np.clip(changes - middle, -6.0 * sd, 6.0 * sd).mean(axis=1)
    return np.where(np.abs(shift) > sd, shift, 0.0).astype(np.float32)


@njit(cache=True)
def _extend(block, shift, at, total, high, next_high, low, next_low, high_at, low_at):
    """Add frames, in groups of pixels that fit the cache."""
    for start in range(0, block.shape[1], 4096):
        stop = min(start + 4096, block.shape[1])
        for t in range(block.shape[0]):
            for i in range(start, stop):
                value = np.float32(block[t, i]) - shift[t]
                total[i] += value
                if value > next_high[i]:
                    if value > high[i]:
                        next_high[i], high[i], high_at[i] = high[i], value, at + t
                    else:
                        next_high[i] = value
                if value < next_low[i]:
                    if value < low[i]:
                        next_low[i], low[i], low_at[i] = low[i], value, at + t
                    else:
                        next_low[i] = value


def _outlying_means(
    without_top: NDArray[np.float32], without_low: NDArray[np.float32], error: float
) -> dict:
    """Return the pixels whose mean is far from the surrounding median, row and column offsets
    removed.
    """
    with_low, with_top = _high_pass(without_top), _high_pass(without_low)
    size = 0.5 * (with_low + with_top).ravel()[::3]
    threshold = SURVEY.outlying_sd * max(robust_sd(size), error)

    def outliers_of(nearer_dn: float) -> int:
        limit = max(threshold + nearer_dn, 0.0)
        return int(np.count_nonzero((with_low > limit) | (with_top < -limit)))

    bright, faint = np.flatnonzero(with_low > threshold), np.flatnonzero(with_top < -threshold)
    if len(bright) + len(faint) > SURVEY.max_fraction * with_low.size:
        bright = faint = _no_places()
    return {
        "bright": bright,
        "faint": faint,
        "threshold_dn": threshold,
        "lower_counts": (outliers_of(error), outliers_of(1.96 * error)),
        "upper_counts": (outliers_of(-error), outliers_of(-1.96 * error)),
    }


def _high_pass(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return an image without shading and row and column offsets."""
    from cv2 import medianBlur

    residual = image - medianBlur(np.ascontiguousarray(image), 5)
    residual -= np.median(residual, axis=0, keepdims=True)
    residual -= np.median(residual, axis=1, keepdims=True)
    return residual
