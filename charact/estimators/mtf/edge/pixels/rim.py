"""A closed edge: the rim of a disc, as of CT phantoms and spheres, in place of a straight line.

The rim is r(t) = sum_k a_k cos k t + b_k sin k t about its centre, k up to 4. A displaced rim
changes the value of a pixel at distance d, of profile m, by m'(d) times its change of radius; that
and the level and slopes of the light on both sides are fitted to the pixels near it.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.edge.pixels.line import EdgeLine
from charact.estimators.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.estimators.mtf.mean_frame import OrientedFrame

Array = NDArray[np.float64]

HARMONICS = np.arange(1, 5)
# Slope of a piece half way between the axes of the pixels, which stands for all directions.
SLOPE = float(np.tan(np.pi / 8.0))


def _waves(turn: Array) -> Array:
    """Return 1, cos k t and sin k t, shape (2 k + 1, ...)."""
    phase = np.multiply.outer(HARMONICS, turn)
    return np.concatenate([np.ones((1, *turn.shape)), np.cos(phase), np.sin(phase)])


@dataclass(frozen=True, kw_only=True)
class Rim(EdgeLine):
    """A closed edge about a centre.

    Parameters
    ----------
    row, col
        Its centre, px.
    radii
        Amplitudes of its harmonics: mean, cosines and sines, px.
    inside
        1 where it is bright inside, -1 where it is dark.
    position, slope
        Those of a piece that stands for all directions.
    """

    row: float
    col: float
    radii: Array
    inside: int
    position: float = 0.0
    slope: float = SLOPE

    def _polar(self, shape: tuple[int, int], pitch_ratio: float) -> tuple[Array, Array]:
        """Return distance from the centre, px, and direction of every pixel, rad."""
        down = (np.arange(shape[0])[:, None] - self.row) * pitch_ratio
        right = np.arange(shape[1])[None, :] - self.col
        return np.hypot(down, right), np.arctan2(down, right)

    def distance(self, shape: tuple[int, int], pitch_ratio: float) -> Array:
        """Return the distance of every pixel along the normal, positive on the bright side, px."""
        radius, turn = self._polar(shape, pitch_ratio)
        _, cosines, sines = np.split(_waves(turn), [1, 1 + HARMONICS.size])
        orders = HARMONICS[:, None, None]
        _, on_cosines, on_sines = np.split(self.radii, [1, 1 + HARMONICS.size])
        turning = np.tensordot(on_sines, orders * cosines, 1)
        turning -= np.tensordot(on_cosines, orders * sines, 1)
        gap = np.tensordot(self.radii, _waves(turn), 1) - radius
        return self.inside * gap / np.hypot(1.0, turning / self.radii[0])


def find_rim(picture: OrientedFrame) -> Rim | None:
    """Return the rim of the one disc of a picture, bright or dark; None: there is none, or there is
    something else.
    """
    import cv2

    smooth = cv2.blur(picture.value, (3, 3))
    coarse = max(1, min(smooth.shape) // 128)
    low, high = np.quantile(smooth[::coarse, ::coarse], (0.02, 0.98))
    is_bright = (smooth > 0.5 * (low + high)).astype(np.uint8)
    for inside in (1, -1):
        mask = is_bright if inside > 0 else 1 - is_bright
        count, label, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
        if count < 2:
            continue
        largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
        row, col = np.nonzero(label == largest)
        rim = Rim(
            row=float(row.mean()),
            col=float(col.mean()),
            radii=np.append(np.sqrt(row.size * picture.pitch_ratio / np.pi), np.zeros(8)),
            inside=inside,
        )
        if not _is_alone(picture, rim):
            continue
        for _ in range(ACCURACY.rim_iterations):
            rim, scatter_px = _refined(picture, rim)
        if _is_alone(picture, rim) and scatter_px < THRESHOLDS.rim_scatter_px:
            return rim
    return None


def _refined(picture: OrientedFrame, rim: Rim) -> tuple[Rim, float]:
    """Return a rim corrected to first order, and the scatter of its sectors about it, px."""
    shape, pitch_ratio, reach_px = picture.value.shape, picture.pitch_ratio, ACCURACY.rim_reach_px
    distance, turn = rim.distance(shape, pitch_ratio), rim._polar(shape, pitch_ratio)[1]
    near = np.abs(distance) < reach_px
    value, distance, turn = picture.value[near], distance[near], turn[near]
    cell = np.floor(2.0 * (distance + reach_px)).astype(np.int64)
    mean = np.bincount(cell, value) / np.maximum(np.bincount(cell), 1)
    at = 0.5 * np.arange(mean.size) + 0.25 - reach_px
    profile = np.interp(distance, at, mean)
    steep = np.interp(distance, at, np.gradient(mean, at))
    waves, level = _waves(turn), (profile - mean[0]) / ((mean[-1] - mean[0]) or 1.0)
    light = waves[[0, 1, 1 + HARMONICS.size]]
    design = np.concatenate([rim.inside * steep * waves, level * light, (1.0 - level) * light])
    residual = value - profile
    fitted = np.linalg.lstsq(design.T, residual, rcond=None)[0]
    sector = ((turn / np.pi + 1.0) * 0.5 * ACCURACY.rim_sectors).astype(np.int64)
    power = np.maximum(np.bincount(sector, steep**2), 1e-300)
    shifts = np.bincount(sector, steep * (residual - fitted @ design)) / power
    radii = rim.radii + fitted[: rim.radii.size]
    return replace(rim, radii=radii), float(np.std(shifts))


def _is_alone(picture: OrientedFrame, rim: Rim) -> bool:
    """Return whether a rim is about round, stands clear of the frame's ends, and both its sides are
    even.
    """
    radius, margin_px = float(rim.radii[0]), ACCURACY.rim_reach_px
    rows, cols = picture.value.shape
    if (
        not radius > 2.0 * margin_px
        or np.abs(rim.radii[1:]).sum() > THRESHOLDS.rim_ovality * radius
    ):
        return False
    down = min(rim.row, rows - 1 - rim.row) * picture.pitch_ratio
    if min(down, rim.col, cols - 1 - rim.col) < radius + margin_px:
        return False
    distance = rim.distance(picture.value.shape, picture.pitch_ratio)
    low, middle_low, middle_high, high = np.concatenate(
        [
            np.quantile(picture.value[side], (0.03, 0.97))
            for side in (distance < -margin_px, distance > margin_px)
        ]
    )
    step = 0.5 * (middle_high + high - low - middle_low)
    return bool(max(middle_low - low, high - middle_high) < THRESHOLDS.rim_value_range * step)
