"""Detection of point sources in a frame, separated from hot pixels and flashes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.mean_frame import Region
from charact.estimators.mtf.point.thresholds import LIMITS
from charact.estimators.mtf.target_detection.smoothed_mean_frame import (
    gaussian_blur,
    local_maximum,
    mean_frame_of,
)
from charact.estimators.mtf.target_detection.thresholds import ACCURACY, THRESHOLDS
from charact.frames.robust import robust_sd
from charact.frames.thresholds import CLIPPING
from labdata.frames import FrameStack

Array = NDArray[np.float32]

# Smoothing for the search, and the wider one that stands for the ground, px.
SMOOTHING_PX = 1.2


@dataclass(frozen=True, kw_only=True)
class SteadySpots:
    """Smoothed light over its ground."""

    # Frames, or means of as many as make few enough groups, shape (group, row, col), DN
    groups: Array
    # Their median over the median of the picture, shape (row, col), DN; of too few frames their
    # mean
    height: Array
    spread: float  # Standard deviation of the background, DN

    def stays(self, row: int, col: int) -> bool:
        """Tell whether light at a place stands out of its own changes from frame to frame."""
        if len(self.groups) < THRESHOLDS.min_steady_frames:
            return True
        over = self.groups[:, row, col]
        error = max(float(over.std(ddof=1)), self.spread) / np.sqrt(len(over))
        return bool(over.mean() >= LIMITS.min_steadiness_sd * error)

    def far_spread(self, positions: list[tuple[int, int]], apart_px: int) -> float:
        """Return the standard deviation that the background's far tail says, places and their
        surroundings left out.
        """
        bare = np.ones(self.height.shape, bool)
        for row, col in positions:
            bare[
                max(row - apart_px, 0) : row + apart_px + 1,
                max(col - apart_px, 0) : col + apart_px + 1,
            ] = False
        background = self.height[bare]
        # The quantile at 0.999 of a normal distribution.
        tail_sd = (
            float(np.quantile(background, 0.999)) / 3.0902 if background.size > 20_000 else 0.0
        )
        return max(self.spread, tail_sd)


def steady_light(
    pictures: NDArray | FrameStack, replaced: tuple[NDArray[np.bool_], Array]
) -> SteadySpots:
    """Return the steady light of a picture (row, col), stack or frames (frame, row, col).

    `replaced`: which pixels say nothing, shape (row, col), and what stands for them, DN.
    """
    data = pictures.data if isinstance(pictures, FrameStack) else np.asarray(pictures)
    data = data[None] if data.ndim == 2 else data
    count = min(len(data), 16) if len(data) >= THRESHOLDS.min_steady_frames else 1
    groups = np.stack(
        [
            _subtract_background(part.mean(axis=0, dtype=np.float32), replaced)
            for part in np.array_split(data, count)
        ]
    )
    height = np.median(groups, axis=0)
    middle = float(np.median(height))
    height = height - middle
    scatter = robust_sd(height, 0.0)
    # Quantile at 0.97 of a normal distribution.
    tail = float(np.quantile(height[::2, ::2], 0.97)) / 1.8808
    rounding = LIMITS.min_background_sd_dn if data.dtype.kind in "ui" else 0.0
    spread = max(scatter, tail, rounding, 1e-6 * float(np.ptp(height)))
    return SteadySpots(groups=groups - middle, height=height, spread=spread)


def _subtract_background(picture: Array, replaced: tuple[NDArray[np.bool_], Array]) -> Array:
    cleaned = np.where(*replaced, picture)
    return gaussian_blur(cleaned, SMOOTHING_PX) - gaussian_blur(cleaned, ACCURACY.background_px)


Array = NDArray[np.float32]

# Regions reach so far where nothing is in the way, and at least so far.
MIN_REACH_PX = 12


@dataclass(frozen=True, kw_only=True)
class DetectedPoint:
    """A point source found in a frame."""

    region: Region  # ROW, COL, HEIGHT, WIDTH that holds the source alone, px
    # row, col: centroid of its light, px
    row: float
    col: float
    # Height over the standard deviation of the smoothed background, that of its far tail where
    # pulses make it heavy
    significance: float
    saturated: bool  # Whether its core stands at full scale


def find_pinholes(
    pictures: NDArray | FrameStack, *, full_scale_dn: float | None = None
) -> tuple[DetectedPoint, ...]:
    """Find the point sources of a frame.

    Parameters
    ----------
    pictures
        Picture (row, col), stack (frame, row, col) or frames. Of three frames and more only light
        that stands in most of them counts: one flash of an intensifier is no source, and takes no
        room from one.
    full_scale_dn
        Highest code, DN; of frames that know it their own is taken.

    Returns
    -------
    tuple of FoundPoint
        Brightest first; sources nearer than 24 px to each other are left out, for each spoils the
        other's surroundings.

    Notes
    -----
    A square pixel shares a centred Gaussian spot of standard deviation s with its neighbours as
    (Phi(1.5/s) - Phi(0.5/s)) / (2 Phi(0.5/s) - 1) of the peak: 0.20 at s = 0.5 px. The four
    neighbours' mean is taken, so that a spot between pixels, whose brightest neighbour is as bright
    as itself, is never a hot pixel.
    """
    picture, _ = mean_frame_of(pictures)
    if full_scale_dn is None and isinstance(pictures, FrameStack):
        full_scale_dn = pictures.full_scale_dn
    if min(picture.shape) < 2 * MIN_REACH_PX + 1:
        return ()
    replaced = _hot_pixels(picture)
    light = steady_light(pictures, replaced)
    picture = np.where(*replaced, picture)
    positions, spread = _sources(light)
    spots = [
        (*spot, position)
        for position in positions
        if (spot := _spot(picture, position, full_scale_dn)) is not None
    ]
    pinholes = [
        DetectedPoint(
            region=region,
            row=row,
            col=col,
            saturated=saturated,
            significance=float(light.height[position]) / spread,
        )
        for row, col, saturated, position in spots
        if (region := _region(row, col, [spot[:2] for spot in spots], picture.shape)) is not None
    ]
    return tuple(sorted(pinholes, key=lambda point: -point.significance))


def _sources(light: SteadySpots) -> tuple[list[tuple[int, int]], float]:
    """Return where sources stand, brightest first, and the standard deviation that they stand out
    of, DN.
    """
    brightest = THRESHOLDS.min_source * float(light.height.max())
    likely = _peaks(light.height, max(LIMITS.min_height_sd * light.spread, brightest))
    likely = [position for position in likely if light.stays(*position)]
    spread = light.far_spread(likely, MIN_REACH_PX)
    return [
        position for position in likely if light.height[position] >= LIMITS.min_height_sd * spread
    ], spread


def _peaks(smooth: Array, min_height: float) -> list[tuple[int, int]]:
    """Return the middle of every spot above a height, highest first; a flat top is one spot."""
    size = 2 * round(2.0 * SMOOTHING_PX) + 1
    rows, cols = np.nonzero((smooth >= local_maximum(smooth, size, size)) & (smooth > min_height))
    order = np.argsort(-smooth[rows, cols])[:500]
    peaks: list[tuple[int, int]] = []
    for row, col in zip(rows[order].tolist(), cols[order].tolist(), strict=True):
        # A lesser peak on the flank of a higher one is its noise.
        neighbours = ((r, c) for r, c in peaks if np.hypot(row - r, col - c) < MIN_REACH_PX)
        if not any(smooth[row, col] < 0.25 * smooth[neighbour] for neighbour in neighbours):
            peaks.append((row, col))
    return peaks


def _hot_pixels(picture: Array) -> tuple[NDArray[np.bool_], Array]:
    """Return which pixels stand alone, their neighbours holding less than a share of their light,
    and these.
    """
    import cv2

    ground = np.asarray(cv2.medianBlur(picture, 5), np.float32)
    cross = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], np.float32) / 4.0
    around = np.asarray(
        cv2.filter2D(picture, -1, cross, borderType=cv2.BORDER_REFLECT_101), np.float32
    )
    over = picture - ground
    noise = robust_sd(over, 0.0)
    hot = (over > LIMITS.min_height_sd * noise) & (
        around - ground < THRESHOLDS.min_neighbours * over + noise
    )
    return hot, around


def _spot(
    picture: Array, position: tuple[int, int], full_scale_dn: float | None
) -> tuple[float, float, bool] | None:
    """Return centroid and saturation of a spot; None of a line or a blot."""
    row, col = position
    half_px = 6
    if not (
        half_px <= row < picture.shape[0] - half_px and half_px <= col < picture.shape[1] - half_px
    ):
        return None
    part = picture[row - half_px : row + half_px + 1, col - half_px : col + half_px + 1].astype(
        float
    )
    border = np.concatenate([part[0], part[-1], part[:, 0], part[:, -1]])
    light = part - float(np.median(border))
    core = np.where(light > 0.3 * light[4:-4, 4:-4].max(), light, 0.0)
    rows, cols = np.mgrid[: core.shape[0], : core.shape[1]]
    total = core.sum()
    centre = np.array([(core * rows).sum(), (core * cols).sum()]) / total
    offsets = np.stack([rows - centre[0], cols - centre[1]])
    moments = np.einsum("iyx,jyx,yx->ij", offsets, offsets, core) / total + np.eye(2) / 12.0
    minor, major = np.sqrt(np.linalg.eigvalsh(moments))
    if major > THRESHOLDS.max_axis_ratio * minor or major > 0.5 * half_px:
        return None
    full_dn = np.inf if full_scale_dn is None else CLIPPING.full_fraction * full_scale_dn
    saturated = bool(part.max() >= full_dn)
    return float(row - half_px + centre[0]), float(col - half_px + centre[1]), saturated


def _region(
    row: float, col: float, spots: list[tuple[float, float]], shape: tuple[int, ...]
) -> Region | None:
    """Return a square around a source up to half way to its nearest neighbour, None if that is too
    near.
    """
    gaps = [max(abs(row - r), abs(col - c)) for r, c in spots if (r, c) != (row, col)]
    half = int(min([48, *(0.5 * gap for gap in gaps)]))
    if half < MIN_REACH_PX:
        return None
    top, first_col = max(round(row) - half, 0), max(round(col) - half, 0)
    bottom, last_col = min(round(row) + half + 1, shape[0]), min(round(col) + half + 1, shape[1])
    return (
        (top, first_col, bottom - top, last_col - first_col)
        if min(bottom - top, last_col - first_col) > MIN_REACH_PX
        else None
    )
