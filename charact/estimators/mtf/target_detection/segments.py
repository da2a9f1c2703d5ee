"""Straight segments of edges: connected pixels whose gradients point the same way, and the line
through them.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.target_detection.smoothed_mean_frame import Gradient
from charact.estimators.mtf.target_detection.thresholds import ACCURACY, THRESHOLDS

MIN_LENGTH_PX = 16.0


@dataclass(frozen=True, kw_only=True)
class Segment:
    """A straight piece of an edge."""

    # row, col: its middle, px
    row: float
    col: float
    # Direction from dark to bright, from the columns' direction towards higher rows, rad
    normal_rad: float
    length_px: float  # Extent along the edge, px
    # Standard deviation of the gradient's profile across, the smoothing included, px
    width_px: float
    scale_px: float  # Smoothing it was found at, px
    slope_dn: float  # Median gradient along its middle, DN per px
    weight: float  # Sum of the significance of its pixels

    @property
    def blur_px(self) -> float:
        """Standard deviation of the edge's own blur, px."""
        return float(np.sqrt(max(self.width_px**2 - self.scale_px**2, 0.49)))

    def along(self, row: NDArray, col: NDArray) -> NDArray:
        """Return the distance of places from the middle along the edge, px."""
        return (row - self.row) * np.cos(self.normal_rad) - (col - self.col) * np.sin(
            self.normal_rad
        )

    def across(self, row: NDArray, col: NDArray) -> NDArray:
        """Return the distance of places from the line towards the bright side, px."""
        return (col - self.col) * np.cos(self.normal_rad) + (row - self.row) * np.sin(
            self.normal_rad
        )

    def ends(self) -> NDArray[np.float64]:
        """Return (row, col) of both ends, shape (2, 2), px."""
        half = 0.5 * self.length_px * np.array([np.cos(self.normal_rad), -np.sin(self.normal_rad)])
        middle = np.array([self.row, self.col])
        return np.stack([middle - half, middle + half])

    def cut(self, margin_px: float) -> tuple[slice, slice]:
        """Return the rows and columns within a margin of the segment."""
        low = np.maximum(np.floor(self.ends().min(axis=0) - margin_px), 0).astype(int).tolist()
        high = (np.ceil(self.ends().max(axis=0) + margin_px).astype(int) + 1).tolist()
        return slice(low[0], high[0]), slice(low[1], high[1])


def segments_of(field: Gradient) -> list[Segment]:
    """Return the straight segments of a gradient, heaviest first; each pixel belongs to one."""
    candidates = sorted(_candidates(field), key=lambda candidate: -candidate[0].size)
    claimed = np.zeros(field.modulus.shape, bool)
    segments = []
    for row, col in candidates:
        free = ~claimed[row, col]
        if np.count_nonzero(free) < 0.5 * row.size:
            continue
        segment = _fit_segment(field, row[free], col[free])
        if segment is not None:
            segments.append(segment)
        claimed[row, col] = True
    return _join(segments)


def _candidates(field: Gradient) -> list[tuple[NDArray, NDArray]]:
    """Return rows and cols of connected pixels of one direction that hold a seed and are long
    enough.
    """
    import cv2

    member = field.significance > THRESHOLDS.member_sd
    if not (field.significance > THRESHOLDS.seed_sd).any():
        return []
    rows, cols = np.nonzero(member)
    angle = np.arctan2(field.down[rows, cols], field.right[rows, cols])
    candidates = []
    for direction in np.arange(ACCURACY.n_directions) * 2.0 * np.pi / ACCURACY.n_directions:
        aligned = np.cos(angle - direction) > np.cos(np.deg2rad(28.0))
        mask = np.zeros(member.shape, np.uint8)
        mask[rows[aligned], cols[aligned]] = 1
        count, *found_in, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
        label, stats = (np.asarray(part, np.int64) for part in found_in)
        diagonal = np.hypot(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT])
        seeded = np.zeros(count, bool)
        seeded[label[field.significance > THRESHOLDS.seed_sd]] = True
        for number in np.flatnonzero(seeded & (diagonal >= MIN_LENGTH_PX)):
            if number:
                first_col, top, width, height = stats[number, :4]
                members = np.nonzero(
                    label[top : top + height, first_col : first_col + width] == number
                )
                candidates.append((members[0] + top, members[1] + first_col))
    return candidates


def _fit_segment(field: Gradient, row: NDArray, col: NDArray) -> Segment | None:
    """Return the line through pixels weighted by their gradient; None if too short, too few or
    curved.
    """
    if row.size < MIN_LENGTH_PX:
        return None
    modulus = field.modulus[row, col].astype(float)
    weight = modulus / modulus.sum()
    middle = np.array([weight @ row, weight @ col])
    offsets = np.stack([row - middle[0], col - middle[1]])
    # Across the long axis, to where the picture brightens.
    across_col, across_row = np.linalg.eigh((offsets * weight) @ offsets.T)[1][:, 1] * (1.0, -1.0)
    rise = across_col * (weight @ field.right[row, col]) + across_row * (
        weight @ field.down[row, col]
    )
    sign = 1.0 if rise >= 0 else -1.0
    normal = float(np.arctan2(sign * across_row, sign * across_col))
    segment = Segment(
        row=float(middle[0]),
        col=float(middle[1]),
        normal_rad=normal,
        length_px=0.0,
        width_px=0.0,
        scale_px=field.scale_px,
        slope_dn=0.0,
        weight=float(field.significance[row, col].sum()),
    )
    along, across = segment.along(row, col), segment.across(row, col)
    low, high = np.quantile(along, (0.005, 0.995))
    length = float(high - low)
    if length < MIN_LENGTH_PX:
        return None
    bow = _bow_px(along, across, modulus)
    if bow > max(THRESHOLDS.max_bow * length, THRESHOLDS.min_bow_px):
        return None
    length_px = (
        length
        if bow < THRESHOLDS.used_bow_px
        else length * float(np.sqrt(THRESHOLDS.used_bow_px / bow))
    )
    shift = 0.5 * (low + high)
    placed = replace(
        segment,
        row=segment.row + shift * float(np.cos(normal)),
        col=segment.col - shift * float(np.sin(normal)),
        length_px=length_px,
    )
    slope, width = _profile(placed, field)
    return None if not width > 0 else replace(placed, width_px=width, slope_dn=slope)


def _profile(segment: Segment, field: Gradient) -> tuple[float, float]:
    """Return the height and the standard deviation of the mean gradient across a segment, DN per px
    and px.
    """
    half_width_px = 3.0 * segment.scale_px + 3.0
    cut = segment.cut(half_width_px)
    rise = (
        np.cos(segment.normal_rad) * field.right[cut] + np.sin(segment.normal_rad) * field.down[cut]
    )
    row, col = np.ogrid[
        cut[0].start : cut[0].start + rise.shape[0], cut[1].start : cut[1].start + rise.shape[1]
    ]
    across = segment.across(row, col)
    on_line = (np.abs(segment.along(row, col)) < 0.4 * segment.length_px) & (
        np.abs(across) < half_width_px
    )
    total = float(rise[on_line].sum())
    core = on_line & (np.abs(across) < 1.0)
    if not total > 0 or not core.any():
        return 0.0, 0.0
    variance = float((rise[on_line] * across[on_line] ** 2).sum()) / total
    return float(rise[core].mean()), float(np.sqrt(max(variance, segment.scale_px**2)))


def _bow_px(along: NDArray, across: NDArray, weight: NDArray) -> float:
    """Return the bow of a piece over its length: that of the parabola through the middle of its
    gradient.
    """
    cell = np.floor((along - along.min()) / 2.0).astype(int)
    total = np.bincount(cell, weight)
    cell_offset = np.bincount(cell, weight * across) / np.maximum(total, 1e-12)
    well_filled = total > 0.3 * np.median(total)
    if np.count_nonzero(well_filled) < 6:
        return 0.0
    curvature = float(
        np.polyfit(2.0 * np.arange(cell.max() + 1.0)[well_filled], cell_offset[well_filled], 2)[0]
    )
    return abs(curvature) * float(np.ptp(along)) ** 2 / 4.0


def _join(segments: list[Segment]) -> list[Segment]:
    """Join pieces that lie on one line with hardly a gap: noise had parted them."""
    parts = sorted(segments, key=lambda segment: -segment.length_px)
    joined: list[Segment] = []
    while parts:
        segment = parts.pop(0)
        while True:
            partner = next((other for other in parts if _same_line(segment, other)), None)
            if partner is None:
                break
            parts.remove(partner)
            segment = _union(segment, partner)
        joined.append(segment)
    return joined


def _same_line(segment: Segment, other: Segment) -> bool:
    if np.cos(segment.normal_rad - other.normal_rad) < np.cos(np.deg2rad(4.0)):
        return False
    row, col = other.ends().T
    along = segment.along(row, col)
    gap = max(abs(float(along.mean())) - 0.5 * (segment.length_px + float(np.ptp(along))), 0.0)
    allowed = 1.5 + 0.02 * gap
    return gap < ACCURACY.gap_px and bool(
        np.all(np.abs(segment.across(row, col)) < allowed + 0.05 * other.length_px)
    )


def _union(segment: Segment, other: Segment) -> Segment:
    """Return the segment between the outer ends of two."""
    ends = np.concatenate([segment.ends(), other.ends()])
    along = segment.along(*ends.T)
    first, last = ends[np.argmin(along)], ends[np.argmax(along)]
    row, col = 0.5 * (first + last)
    weight = segment.weight / (segment.weight + other.weight)
    return replace(
        segment,
        row=float(row),
        col=float(col),
        normal_rad=float(np.arctan2(-(last - first)[1], (last - first)[0])),
        length_px=float(np.hypot(*(last - first))),
        slope_dn=weight * segment.slope_dn + (1.0 - weight) * other.slope_dn,
        weight=segment.weight + other.weight,
    )
