"""Illuminated edge: its line, and the mean signal of strips parallel to it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.estimators.bloom.thresholds import Unmeasurable
from charact.frames.clipping import is_cut
from labdata import Array, Mask

# Minimum number of rows along a straight edge.
LEAST_ROWS = 24
# Parts of the edge whose scatter gives standard errors, and maximum distance of correlated strips.
PARTS, LAGS = 12, 6


@dataclass(frozen=True, kw_only=True)
class LitEdgeLine:
    """Straight edge: column `at` + `slope` * row of the frame, or of the transposed frame for an
    edge along a row.

    `upright`: whether the edge runs along columns; `side`: 1 where the dark side has the higher
    column, else -1; `at`, `slope`: column at row 0, and columns per row; `first`, `last`: first and
    last row, without ends that lie in the frame; `room_px`: distance of the border on the dark
    side, column pitches; `ends_px`: omitted length at the nearer end inside the frame, column
    pitches; inf without one; `width_px`: distance of the opposite edge, column pitches; inf where
    it is outside the frame.
    """

    upright: bool
    side: int
    at: float
    slope: float
    first: int
    last: int
    room_px: float
    ends_px: float
    width_px: float

    @property
    def dark_px(self) -> float:
        """Width of the dark side that is used, column pitches."""
        # Farthest strip on the dark side, px.
        return float(min(self.room_px, 90))

    def distance(self, shape: tuple[int, int], pitch_ratio: float) -> Array:
        """Distance of every pixel from the edge, positive on the dark side, column pitches, shape
        (row, col).
        """
        rows, cols = np.indices(shape if self.upright else shape[::-1], float)
        across, along = (1.0, pitch_ratio) if self.upright else (pitch_ratio, 1.0)
        slope = self.slope * across / along
        out = self.side * across * (cols - self.at - self.slope * rows) / np.hypot(1.0, slope)
        return out if self.upright else out.T


@dataclass(frozen=True, kw_only=True)
class Strips:
    """Mean signal by distance from an edge.

    `label`: label of the stack. `distance_px`: mean distance of each strip from the line, positive
    on the dark side, column pitches, shape (strip,). `mean_dn`, `sd_dn`: mean and its standard
    error, shape (strip,), DN. `correlation`: correlation of strips 1, 2, ... apart, shape (lag,).
    `unclipped`: strips that are not clipped, shape (strip,). `cut`: whether the illuminated side
    reaches full scale. `least_light_dn`: minimum signal of the illuminated side, DN above dark:
    full scale where it is clipped, else 0.
    """

    label: str
    distance_px: Array
    mean_dn: Array
    sd_dn: Array
    correlation: Array
    unclipped: Mask
    cut: bool
    least_light_dn: float = 0.0

    def covariance(self) -> Array:
        """Covariance of the unclipped strips, shape (unclipped, unclipped), DN^2."""
        strip_numbers = np.flatnonzero(self.unclipped)
        padded = np.concatenate([[1.0], self.correlation, np.zeros(len(self.unclipped))])
        values, vectors = np.linalg.eigh(
            padded[np.abs(np.subtract.outer(strip_numbers, strip_numbers))]
        )
        lifted = (vectors * np.maximum(values, 0.05)) @ vectors.T
        sd = self.sd_dn[self.unclipped]
        return lifted * np.outer(sd, sd)


def edge_line(image: NDArray, level_dn: float, pitch_ratio: float) -> LitEdgeLine:
    """Return the straight edge of the illuminated area, at a threshold, with most dark room; else
    Unmeasurable.
    """
    from scipy import ndimage

    labels = np.asarray(ndimage.label(image >= level_dn)[0])  # pyright: ignore[reportIndexIssue]
    if not labels.any():
        raise Unmeasurable("no area of the frame is illuminated")
    lit = labels == np.bincount(labels[labels > 0]).argmax()
    sides = [
        _side(frame, mask, level_dn, upright=upright, side=side, pitch_ratio=pitch_ratio)
        for upright, frame, mask in ((True, image, lit), (False, image.T, lit.T))
        for side in (1, -1)
    ]
    lines = [line for line in sides if line is not None]
    if not lines:
        raise Unmeasurable(f"the illuminated area has no straight edge of {LEAST_ROWS} px or more")
    return max(
        lines, key=lambda line: min(line.room_px, line.ends_px, 1.0 * (line.last - line.first))
    )


def _side(
    image: NDArray,
    lit: Mask,
    level: float,
    *,
    upright: bool,
    side: int,
    pitch_ratio: float,
) -> LitEdgeLine | None:
    """The edge on one side of an illuminated area."""
    crossing, opposite = _crossings(image, lit, level, side), _crossings(image, lit, level, -side)
    rows = np.flatnonzero(np.isfinite(crossing))
    if len(rows) < LEAST_ROWS:
        return None
    slope, at = _line(rows.astype(float), crossing[rows])
    line_rows = rows[np.abs(crossing[rows] - at - slope * rows) < 1.0]
    if len(line_rows) < max(LEAST_ROWS, 0.6 * len(rows)):
        return None
    slope, at = np.polyfit(line_rows.astype(float), crossing[line_rows], 1)
    across, along = (1.0, pitch_ratio) if upright else (pitch_ratio, 1.0)
    height, width = image.shape
    is_end_inside = [line_rows[0] > 2, line_rows[-1] < height - 3]
    # Near an end inside the frame, the halo receives less than half a plane: a quarter is omitted.
    left_out = int(0.25 * (line_rows[-1] - line_rows[0]))
    first, last = (
        line_rows[0] + is_end_inside[0] * left_out,
        line_rows[-1] - is_end_inside[1] * left_out,
    )
    end_positions = at + slope * np.array([first, last])
    room = float((width - 1 - end_positions.max()) if side > 0 else end_positions.min())
    widths = side * (crossing[line_rows] - opposite[line_rows])
    cosine = 1.0 / np.hypot(1.0, slope * across / along)
    return LitEdgeLine(
        upright=upright,
        side=side,
        at=float(at),
        slope=float(slope),
        first=int(first),
        last=int(last),
        room_px=room * across * cosine,
        ends_px=left_out * along if any(is_end_inside) else float("inf"),
        width_px=float(np.median(widths)) * across * cosine
        if np.isfinite(widths).mean() > 0.5
        else float("inf"),
    )


def _crossings(image: NDArray, lit: Mask, level: float, side: int) -> Array:
    """Column at which each row leaves the illuminated area on one side; NaN where it does not."""
    values, mask = (image, lit) if side > 0 else (image[:, ::-1], lit[:, ::-1])
    width = values.shape[1]
    last = width - 1 - np.argmax(mask[:, ::-1], axis=1)
    ok = mask.any(axis=1) & (last < width - 3)
    at = np.where(ok, last, 0)
    rows = np.arange(len(at))
    inner, outer = (
        values[rows, at].astype(float),
        values[rows, np.minimum(at + 1, width - 1)].astype(float),
    )
    out = np.where(ok, at + (inner - level) / np.maximum(inner - outer, 1e-9), np.nan)
    return out if side > 0 else width - 1 - out


def _line(x: Array, y: Array) -> tuple[float, float]:
    """Slope and intercept by medians of pairs half the data apart."""
    half = len(x) // 2
    slope = float(np.median((y[half:] - y[: len(y) - half]) / (x[half:] - x[: len(x) - half])))
    return slope, float(np.median(y - slope * x))


def strips_of(
    image: NDArray,
    line: LitEdgeLine,
    *,
    label: str,
    dark_dn: float,
    full_dn: float,
    pitch_ratio: float,
) -> Strips:
    """Average a frame over strips one column pitch wide along an edge.

    Standard errors come from the scatter of parts of the edge, which includes correlated noise.
    """
    distance = line.distance((image.shape[0], image.shape[1]), pitch_ratio)
    along = np.indices(image.shape)[0 if line.upright else 1]
    lit = min(70, 0.5 * line.width_px)
    within_strips = (
        (along >= line.first) & (along <= line.last) & (distance > -lit) & (distance < line.dark_px)
    )
    strip = np.floor(distance[within_strips]).astype(int)
    strip -= strip.min()
    part = np.minimum(
        (along[within_strips] - line.first) * PARTS // (line.last - line.first + 1), PARTS - 1
    )
    value, count, cell = image[within_strips].astype(float), strip.max() + 1, strip * PARTS + part
    cells = np.bincount(cell, minlength=count * PARTS).reshape(count, PARTS)
    sums = np.bincount(cell, value, minlength=count * PARTS).reshape(count, PARTS)
    top = np.zeros(count)
    np.maximum.at(top, strip, value)
    is_complete = cells.min(axis=1) >= 1
    span = slice(int(np.argmax(is_complete)), count - int(np.argmax(is_complete[::-1])))
    cells, sums = np.maximum(cells[span], 1), sums[span]
    total = cells.sum(axis=1)
    mean = sums.sum(axis=1) / total
    where = np.bincount(strip, distance[within_strips], minlength=count)[span] / total
    part_residuals = sums / cells - mean[:, None]
    variance = smooth_variance((part_residuals**2).sum(axis=1) / (PARTS - 1) / PARTS, 0.08)
    over = is_cut(mean, top[span], dark_dn, full_dn)
    unclipped = np.ones(len(mean), bool)
    if over.any():
        unclipped[: int(np.flatnonzero(over)[-1]) + 1] = False
    return Strips(
        label=label,
        distance_px=where,
        mean_dn=mean,
        sd_dn=np.maximum(np.sqrt(variance), 1e-3),
        correlation=_correlation(part_residuals, where),
        unclipped=unclipped,
        cut=bool(over.any()),
        least_light_dn=full_dn - dark_dn if over.any() else 0.0,
    )


def smooth_variance(variance: Array, bias: float) -> Array:
    """Geometric mean over five neighbours, since each comes from few parts; `bias` is that of its
    logarithm.
    """
    padded = np.pad(np.log(np.maximum(variance, 1e-8)), 2, mode="edge")
    return np.exp(np.convolve(padded, np.full(5, 0.2), mode="valid") + bias)


def _correlation(part_residuals: Array, distance: Array) -> Array:
    """Correlation of the parts' residuals between strips on the dark side."""
    outer = part_residuals[distance > 4.0]
    outer = outer / np.maximum(np.sqrt((outer**2).mean(axis=1, keepdims=True)), 1e-12)
    if len(outer) <= LAGS + 4:
        return np.zeros(LAGS)
    return np.array(
        [
            float(np.clip((outer[lag:] * outer[:-lag]).mean(), 0.0, 0.95))
            for lag in range(1, LAGS + 1)
        ]
    )
