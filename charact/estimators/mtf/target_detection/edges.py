"""The straight edges of a frame that are good enough to measure, each with the region that shows it
alone.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.mean_frame import Region
from charact.estimators.mtf.target_detection.segments import Segment, segments_of
from charact.estimators.mtf.target_detection.smoothed_mean_frame import (
    Gradient,
    gradient,
    mean_frame_of,
)
from charact.estimators.mtf.target_detection.thresholds import ACCURACY, THRESHOLDS
from labdata.frames import FrameStack

# Smoothing at which edges are searched, px: fine ones where the noise allows, coarse ones in strong
# noise.
SCALES_PX = (1.4, 2.8, 5.6)


@dataclass(frozen=True, kw_only=True)
class DetectedEdge:
    """An edge found in a frame."""

    region: Region  # ROW, COL, HEIGHT, WIDTH that holds the edge, its plateaus and nothing else, px
    orientation_deg: float  # Direction of its normal from the row direction, degrees in [0, 180)
    worth: float  # Rows of the region, less where plateaus are short: what orders edges, px


def clear_rectangle(segment: Segment, fields: list[Gradient]) -> DetectedEdge | None:
    """Return the most useful clear rectangle around a segment; None if none holds an edge and its
    plateaus.
    """
    upright = abs(np.cos(segment.normal_rad)) >= abs(np.sin(segment.normal_rad))
    down, right = segment.cut(ACCURACY.max_plateau_px + 2.0)
    origin, shape = (down.start, right.start), fields[0].modulus.shape
    stop = min(down.stop, shape[0]), min(right.stop, shape[1])
    foreign = _foreign(segment, fields, (*origin, *stop))
    row, col = segment.row - origin[0], segment.col - origin[1]
    if not upright:
        foreign, row, col = foreign.T, col, row
    slope = -np.tan(segment.normal_rad) if upright else -1.0 / np.tan(segment.normal_rad)
    rectangle = _best_rectangle(foreign, row, col, float(slope), segment, upright)
    if rectangle is None:
        return None
    worth, (top, first_col, height, width) = rectangle
    top, first_col, height, width = (
        (top, first_col, height, width) if upright else (first_col, top, width, height)
    )
    return DetectedEdge(
        region=(origin[0] + top, origin[1] + first_col, height, width),
        worth=worth,
        orientation_deg=float(np.rad2deg(segment.normal_rad)) % 180.0,
    )


def _foreign(
    segment: Segment, fields: list[Gradient], box: tuple[int, int, int, int]
) -> NDArray[np.bool_]:
    """Return which pixels show something else, widened by the blur it stands in."""
    import cv2

    cut = (slice(box[0], box[2]), slice(box[1], box[3]))
    row, col = np.arange(box[0], box[2])[:, None], np.arange(box[1], box[3])[None, :]
    across = np.abs(segment.across(row, col))
    cosine, sine = np.cos(segment.normal_rad), np.sin(segment.normal_rad)
    foreign = np.zeros(across.shape, bool)
    for field in fields:
        aligned = cosine * field.right[cut] + sine * field.down[cut]
        parallel = aligned > np.cos(np.deg2rad(THRESHOLDS.own_direction_deg)) * field.modulus[cut]
        width = float(np.hypot(segment.blur_px, field.scale_px))
        slope = segment.slope_dn * segment.width_px / width
        on_edge = parallel & (
            (across < 3.0 * width + 1.0) | (field.modulus[cut] < THRESHOLDS.own_tail * slope)
        )
        foreign |= (field.significance[cut] > THRESHOLDS.foreign_sd) & ~on_edge
    widened = 2 * round(1.0 + segment.blur_px) + 1
    return cv2.dilate(foreign.astype(np.uint8), np.ones((widened, widened), np.uint8)) > 0


def _best_rectangle(
    foreign: NDArray[np.bool_],
    row: float,
    col: float,
    slope: float,
    segment: Segment,
    upright: bool,
) -> tuple[float, Region] | None:
    """Return worth and place of the most useful clear rectangle of an upright edge through (row,
    col).
    """
    rows, cols = foreign.shape
    total = np.zeros((rows + 1, cols + 1), np.int32)
    total[1:, 1:] = foreign.cumsum(0).cumsum(1)
    half = (
        0.5
        * segment.length_px
        * abs(np.cos(segment.normal_rad) if upright else np.sin(segment.normal_rad))
    )
    spare = segment.blur_px + segment.scale_px
    first = 0 if row - half < 3.0 + spare else int(np.ceil(row - half + spare))
    last = rows if row + half > rows - 4.0 - spare else int(np.floor(row + half - spare))
    min_width_px = max(THRESHOLDS.min_plateau_px, THRESHOLDS.min_plateau_blurs * segment.blur_px)
    best: tuple[float, Region] | None = None
    for top in np.unique(
        np.linspace(first, max(first, last - THRESHOLDS.min_edge_rows), ACCURACY.cuts).astype(int)
    ):
        for bottom in np.unique(
            np.linspace(
                top + THRESHOLDS.min_edge_rows,
                max(top + THRESHOLDS.min_edge_rows, last),
                ACCURACY.cuts,
            ).astype(int)
        ):
            if bottom > last:
                continue
            ends = col + slope * (np.array([top, bottom - 1]) - row)
            empty = total[bottom] - total[top]
            left_px = _reach(empty[::-1], cols - 1 - float(ends.min()))
            right_px = _reach(empty, float(ends.max()))
            width_px = min(left_px, right_px)
            if width_px < min_width_px:
                continue
            worth = (bottom - top) * width_px / (width_px + ACCURACY.plateau_scale_px)
            if best is None or worth > best[0]:
                low = int(np.ceil(ends.min() - min(left_px, ACCURACY.max_plateau_px)))
                high = int(np.floor(ends.max() + min(right_px, ACCURACY.max_plateau_px))) + 1
                low, high = max(low, 0), min(high, cols)
                if empty[high] - empty[low] == 0:
                    best = (float(worth), (int(top), low, int(bottom - top), high - low))
    return best


def _reach(empty: NDArray, start: float) -> float:
    """Return how far beyond a column the running count of foreign pixels stays the same, px."""
    begin = int(np.floor(start))
    if begin < 0 or begin >= len(empty) - 1:
        return 0.0
    changed = np.flatnonzero(empty[begin:] != empty[begin])
    last = begin + int(changed[0]) - 2 if changed.size else len(empty) - 2
    return max(last - start, 0.0)


def find_edges(pictures: NDArray | FrameStack) -> tuple[DetectedEdge, ...]:
    """Find the straight edges of a frame that can be measured.

    Parameters
    ----------
    pictures
        Picture (row, col), stack (frame, row, col) or frames; a stack is averaged.

    Returns
    -------
    tuple of FoundEdge
        Best first. Bars, bent edges and edges without room for their plateaus are not among them;
        an edge that others meet is cut where they begin.

    Notes
    -----
    Pixels whose smoothed gradient stands 4 standard deviations out of the noise and points one way
    grow together; a region of them is an edge if a straight line describes it over 24 px and more
    and both sides stay clear of any other gradient for 4 standard deviations of its blur and 8 px
    at least. The growing follows Grompone von Gioi et al., doi:10.5201/ipol.2012.gjmr-lsd; the
    noise is read off the picture instead of taken as white.
    """
    usable, _ = _sort_segments(pictures)
    return tuple(clear for _, clear in usable)


def find_unusable_edges(pictures: NDArray | FrameStack) -> tuple[tuple[Region, str], ...]:
    """Return the straight edges that `find_edges` leaves out: region of the edge itself, px, and
    why.
    """
    usable, unusable = _sort_segments(pictures)
    rows, cols = mean_frame_of(pictures)[0].shape
    out = []
    for segment, why in unusable:
        if segment.length_px >= THRESHOLDS.min_edge_rows and not any(
            _covers(segment, other) for other, _ in usable
        ):
            down, right = segment.cut(ACCURACY.outline_blurs * segment.blur_px)
            height, width = min(down.stop, rows) - down.start, min(right.stop, cols) - right.start
            out.append(((down.start, right.start, height, width), why))
    return tuple(out)


def _sort_segments(
    pictures: NDArray | FrameStack,
) -> tuple[list[tuple[Segment, DetectedEdge]], list[tuple[Segment, str]]]:
    """Return the segments that can be measured, best first, with their regions, and those that
    cannot, with why.
    """
    picture, whole_codes = mean_frame_of(pictures)
    scales = [scale for scale in SCALES_PX if min(picture.shape) > 8 * scale]
    fields = [gradient(picture, scale, whole_codes=whole_codes) for scale in scales]
    segments = _of_all_scales(fields)
    candidates: list[tuple[Segment, DetectedEdge]] = []
    unusable: list[tuple[Segment, str]] = []
    for segment in segments:
        if _is_bar(segment, segments):
            unusable.append((segment, "one of several bars"))
            continue
        finest = max(2.8, segment.scale_px)
        clear = clear_rectangle(segment, [field for field in fields if field.scale_px <= finest])
        if clear is None:
            unusable.append((segment, "no room next to it"))
        else:
            candidates.append((segment, clear))
    usable: list[tuple[Segment, DetectedEdge]] = []
    for segment, clear in sorted(candidates, key=lambda pair: -pair[1].worth):
        if not any(_same_edge(segment, clear, *other) for other in usable):
            usable.append((segment, clear))
    return usable, unusable


def _of_all_scales(fields: list[Gradient]) -> list[Segment]:
    """Return segments of all scales, each from the finest that shows most of its length in one
    piece.
    """
    segments: list[Segment] = []
    for number, field in enumerate(fields):
        for segment in segments_of(field):
            if any(
                _shows(finer, segment)
                for finer in fields[:number]
                if finer.scale_px < segment.scale_px
            ) and not any(_covers(segment, other) for other in segments):
                continue
            finer = [other for other in segments if _covers(segment, other)]
            if (
                max((other.length_px for other in finer), default=0.0)
                < THRESHOLDS.one_piece * segment.length_px
            ):
                segments = [
                    other for other in segments if not any(other is covered for covered in finer)
                ]
                segments.append(segment)
    return segments


def _shows(finer: Gradient, segment: Segment) -> bool:
    """Return whether a finer scale shows all of a segment, so that it must be straight there
    too.
    """
    cut = segment.cut(3.0 * segment.scale_px)
    significance = finer.significance[cut]
    rows, cols = significance.shape
    row, col = np.ogrid[cut[0].start : cut[0].start + rows, cut[1].start : cut[1].start + cols]
    along = segment.along(row, col)
    on_line = (np.abs(segment.across(row, col)) < 2.0 * segment.scale_px) & (
        np.abs(along) < 0.5 * segment.length_px
    )
    cell = ((along[on_line] + 0.5 * segment.length_px) / ACCURACY.finer_scale_cell_px).astype(int)
    shown = np.zeros(int(segment.length_px / ACCURACY.finer_scale_cell_px) + 1, bool)
    shown[cell[significance[on_line] > THRESHOLDS.finer_scale_sd]] = True
    return float(shown.mean()) > 0.9


def _covers(coarse: Segment, fine: Segment) -> bool:
    """Return whether a segment of a finer scale lies on a coarse one."""
    is_on_line = (
        abs(float(coarse.across(np.array(fine.row), np.array(fine.col)))) < 2.0 * coarse.scale_px
    )
    alongside = (
        abs(float(coarse.along(np.array(fine.row), np.array(fine.col)))) < 0.5 * coarse.length_px
    )
    return (
        is_on_line
        and alongside
        and np.cos(coarse.normal_rad - fine.normal_rad) > np.cos(np.deg2rad(15.0))
    )


def _is_bar(segment: Segment, segments: Iterable[Segment]) -> bool:
    """Return whether a segment is one of three or more evenly spaced edges of alternating sense,
    nearer than long.
    """
    sides: dict[float, list[float]] = {1.0: [], -1.0: []}
    same: list[float] = []
    for other in segments:
        if other is segment or abs(np.cos(segment.normal_rad - other.normal_rad)) < np.cos(
            np.deg2rad(8.0)
        ):
            continue
        along = abs(float(segment.along(np.array(other.row), np.array(other.col))))
        across = float(segment.across(np.array(other.row), np.array(other.col)))
        if (
            along > 0.4 * segment.length_px
            or not 1.0 < abs(across) < 2.2 * THRESHOLDS.bar_aspect * segment.length_px
        ):
            continue
        if np.cos(segment.normal_rad - other.normal_rad) < 0:
            sides[float(np.sign(across))].append(abs(across))
        else:
            same.append(abs(across))
    nearest = [min(distances, default=np.inf) for distances in sides.values()]
    spacing = min(nearest)
    if spacing > THRESHOLDS.bar_aspect * segment.length_px:
        return False
    return any(
        abs(distance / spacing - 1.0) < THRESHOLDS.bar_evenness
        for distance in nearest
        if distance > spacing
    ) or any(abs(distance / (2.0 * spacing) - 1.0) < THRESHOLDS.bar_evenness for distance in same)


def _same_edge(
    segment: Segment, clear: DetectedEdge, other: Segment, other_clear: DetectedEdge
) -> bool:
    """Return whether two segments lie on one line and their regions meet."""
    if np.cos(segment.normal_rad - other.normal_rad) < np.cos(np.deg2rad(10.0)):
        return False
    sides = (
        min(
            clear.region[k] + clear.region[k + 2], other_clear.region[k] + other_clear.region[k + 2]
        )
        - max(clear.region[k], other_clear.region[k])
        for k in (0, 1)
    )
    across = abs(float(other.across(np.array(segment.row), np.array(segment.col))))
    return all(side > 0 for side in sides) and across < 3.0 + 2.0 * segment.scale_px
