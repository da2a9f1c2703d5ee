"""Detection of point sources: light that is steady over frames, unlike single bright events."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.point.thresholds import ACCURACY, LIMITS
from charact.frames.robust import robust_sd
from labdata import Array, Mask
from labdata.measurement import Result, make_refusal


@dataclass(frozen=True, kw_only=True)
class DetectedSource:
    """A detected source."""

    # row, col: brightest smoothed pixel
    row: int
    col: int
    neighbours: tuple[
        tuple[int, int], ...
    ] = ()  # Rows and columns of the other peaks in the region, px


class PointRefusal(NamedTuple):
    """Why no point is measured, and the flag."""

    reason: str
    flag: str = "no-target"


def refuse_all(common: dict[str, Any], reason: str, flag: str = "no-target") -> Result:
    """Return the refusal of all quantities."""
    return Result(
        measurements=tuple(
            make_refusal(name, "cy/px", reason, flags=(flag,), orientation_deg=angle, **common)
            for angle in (0.0, 90.0)
            for name in ("mtf50", "mtf10")
        )
    )


def detect_source(data: NDArray, pitch_ratio: float) -> DetectedSource | PointRefusal:
    """Find the brightest steady source of frames (frame, row, col).

    Notes
    -----
    The median over frames of the smoothed frames excludes single bright events. A source must
    exceed its robust spatial scatter.
    """
    smooth = _smooth_frames(data)
    steady = np.median(smooth, axis=0)
    level = float(np.median(steady))
    row, col = (int(index) for index in np.unravel_index(int(np.argmax(steady)), steady.shape))
    spread = _spread(steady[_surroundings(steady.shape, row, col, pitch_ratio)], level, data)
    height = float(steady[row, col]) - level
    # Neighbours that cover much of the region raise its scatter; the lower quantiles show the
    # background.
    low, high = (float(quantile) for quantile in np.quantile(steady, ACCURACY.background_quantiles))
    bare, over = (
        max((high - low) / ACCURACY.background_quantile_sd, _least_spread(data)),
        float(steady[row, col]) - high,
    )
    if (
        height < LIMITS.clear_height * LIMITS.min_height_sd * spread
        and over > LIMITS.min_height_sd * bare
    ):
        similar_peaks = _peaks(
            steady, high, max(LIMITS.min_height_sd * bare, LIMITS.min_relative_height * over)
        )
        if (
            sum(
                bool(_steadiness(smooth[:, *at] - high, bare) >= LIMITS.min_steadiness_sd)
                for at in similar_peaks
            )
            > LIMITS.min_crowd
        ):
            level, spread, height = high, bare, over
    if height < LIMITS.min_height_sd * spread:
        stands = (
            f"{round_down(height / spread):.1f} standard deviations; at least "
            f"{LIMITS.min_height_sd:g} are required"
        )
        crowd = (
            "; neighbours or a nonuniform background interfere"
            if over > LIMITS.min_height_sd * bare
            else ""
        )
        return PointRefusal(f"no target: the brightest spot is {stands}{crowd}")
    min_height_dn = max(LIMITS.min_height_sd * spread, LIMITS.min_other_height * height)
    (row, col), *peaks = _peaks(steady, level, min_height_dn)
    steadiness = float(_steadiness(smooth[:, row, col] - level, spread))
    if steadiness < LIMITS.min_steadiness_sd:
        needed = f"at least {LIMITS.min_steadiness_sd:g} are required"
        stands = f"{round_down(steadiness):.1f} standard uncertainties over the frames; {needed}"
        return PointRefusal(f"no target: the brightest spot is {stands}")
    steady_ones = tuple(
        at
        for at in peaks
        if _steadiness(smooth[:, *at] - level, spread) >= LIMITS.min_steadiness_sd
    )
    return DetectedSource(row=row, col=col, neighbours=steady_ones)


def _peaks(steady: Array, level: float, min_height_dn: float) -> list[tuple[int, int]]:
    """Return the intended source and the other peaks above a level, from high to low.

    A peak on the flank of another, without a saddle between them, is part of it.
    """
    from scipy import ndimage

    highest = ndimage.maximum_filter(steady, size=5)
    rows, cols = np.nonzero((steady == highest) & (steady - level >= min_height_dn))
    order = np.argsort(-steady[rows, cols], kind="stable")[:100]
    peaks = list(zip(rows[order].tolist(), cols[order].tolist(), strict=True))
    centre = 0.5 * (np.array(steady.shape) - 1.0)
    bright = [
        peak
        for peak in peaks
        if steady[peak] - level > LIMITS.min_relative_height * (steady[peaks[0]] - level)
    ]
    separation = {
        peak: min(
            [
                LIMITS.isolated_px,
                *(float(np.hypot(*np.subtract(peak, o))) for o in peaks if o != peak),
            ]
        )
        for peak in bright
    }
    row, col = min(
        bright, key=lambda peak: (-separation[peak], float(np.hypot(*(np.array(peak) - centre))))
    )
    distinct = [
        peak
        for peak in peaks
        if np.hypot(peak[0] - row, peak[1] - col) >= LIMITS.min_peak_distance_px
        and _saddle(steady, peak, (row, col)) - level
        < LIMITS.max_saddle * min(steady[peak] - level, steady[row, col] - level)
    ]
    # The brightest part of a blend is the source.
    cluster = [
        peak
        for peak in peaks
        if peak not in distinct
        and np.hypot(peak[0] - row, peak[1] - col) < LIMITS.min_peak_distance_px
    ]
    return [max(cluster, key=lambda peak: float(steady[peak])), *distinct]


def _saddle(steady: Array, peak: tuple[int, int], other: tuple[int, int]) -> float:
    """Return the lowest light on the line between two peaks."""
    steps = np.linspace(0.0, 1.0, 2 * LIMITS.min_peak_distance_px)[:, None]
    rows, cols = np.rint(np.array(peak) * (1.0 - steps) + np.array(other) * steps).astype(int).T
    return float(steady[rows, cols].min())


def _steadiness(over: Array, spread: float) -> Array:
    """Return the light (frame, ...) in standard uncertainties over the frames, infinite for fewer
    than three.
    """
    if len(over) < 3:
        return np.full(over.shape[1:], np.inf)
    return over.mean(axis=0) / np.maximum(over.std(axis=0, ddof=1), spread) * np.sqrt(len(over))


def round_down(significance: float) -> float:
    """Return a number rounded down to one decimal, so that 8.97 of 9 required is not printed as
    9.0.
    """
    return float(np.floor(10.0 * significance)) / 10.0


def source_signal(data: NDArray) -> float:
    """Return the signal of the brightest steady source of frames (frame, row, col), DN summed over
    frames.

    Three frames suffice for the median that leaves out single bright events.
    """
    steady = np.median(_smooth_frames(data[:: max(1, len(data) // 3)][:3]), axis=0)
    return len(data) * float(steady.max() - np.median(steady))


def _smooth_frames(data: NDArray) -> Array:
    """Return every frame smoothed, shape (frame, row, col), DN; single precision suffices and is
    twice as fast.
    """
    from scipy import ndimage

    smooth = [ndimage.gaussian_filter(frame.astype(np.float32), 1.2) for frame in data]
    return np.stack(smooth)  # pyright: ignore[reportReturnType]


def _spread(steady: Array, level: float, data: NDArray) -> float:
    """Return the standard deviation of the smoothed background, at least that hidden by
    quantisation.
    """
    if steady.size < LIMITS.min_background_pixels:
        return np.inf
    scatter = robust_sd(steady, level)
    # Pulses have an upper tail that the median absolute deviation misses: use the highest per
    # mille.
    tail = (float(np.quantile(steady, 0.999)) - level) / 3.1 if steady.size > 20000 else 0.0
    return max(scatter, tail, _least_spread(data))


def _least_spread(data: NDArray) -> float:
    """Return the smallest standard deviation of a smoothed background, DN."""
    return LIMITS.min_background_sd_dn if data.dtype.kind in "ui" else 1e-12


def _surroundings(shape: tuple[int, int], row: int, col: int, pitch_ratio: float) -> Mask:
    """Return the pixels beyond the surroundings of a position; in a small image the most distant
    quarter.
    """
    rows, cols = np.ogrid[: shape[0], : shape[1]]
    distance = np.hypot(cols - col, (rows - row) * pitch_ratio)
    return distance > min(LIMITS.surroundings_px, 0.75 * float(distance.max()))
