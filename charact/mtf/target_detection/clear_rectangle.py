"""The widest upright rectangle around a segment that shows nothing but its edge."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.mtf.mean_frame import Region
from charact.mtf.target_detection.gradient import Gradient
from charact.mtf.target_detection.segments import Segment

# Significance from which a gradient belongs to something, and the share of the edge's own slope below which one that
# points the same way is the edge's own tail.
FOREIGN, OWN_TAIL = 6.5, 0.08
OWN_DIRECTION_DEG = 35.0
# Plateaus: the least that tells a level, in px and in the edge's blur, and the most that is of use.
MIN_REACH_PX, MIN_REACH_BLURS, MAX_REACH_PX = 8.0, 4.0, 64.0
MIN_ROWS = 24
# Rows are worth as much as plateaus up to about this reach.
USEFUL_REACH_PX = 12.0
CUTS = 12


@dataclass(frozen=True, kw_only=True)
class ClearRectangle:
    """A rectangle that holds one edge.

    Parameters
    ----------
    region
        ROW, COL, HEIGHT, WIDTH, px.
    rows
        Extent along the edge's nearer axis, px.
    reach_px
        Shorter of its plateaus, px.
    """

    region: Region
    rows: int
    reach_px: float

    @property
    def worth(self) -> float:
        """What the rectangle is worth to a measurement: rows, less where plateaus are short."""
        return self.rows * self.reach_px / (self.reach_px + USEFUL_REACH_PX)


def clear_rectangle(segment: Segment, fields: list[Gradient]) -> ClearRectangle | None:
    """Return the most useful clear rectangle around a segment; None if none holds an edge and its plateaus."""
    upright = abs(np.cos(segment.normal_rad)) >= abs(np.sin(segment.normal_rad))
    box = _surroundings(segment, fields[0].modulus.shape)
    foreign = _foreign(segment, fields, box)
    row, col = segment.row - box[0], segment.col - box[1]
    if not upright:
        foreign, row, col = foreign.T, col, row
    slope = -np.tan(segment.normal_rad) if upright else -1.0 / np.tan(segment.normal_rad)
    found = _best_rectangle(foreign, row, col, float(slope), segment, upright)
    if found is None:
        return None
    (top, left, height, width), reach = found
    region = (top, left, height, width) if upright else (left, top, width, height)
    return ClearRectangle(
        region=(box[0] + region[0], box[1] + region[1], region[2], region[3]), rows=height, reach_px=reach
    )


def _surroundings(segment: Segment, shape: tuple[int, ...]) -> tuple[int, int, int, int]:
    """Return first and one past the last row and col that matter: (top, left, bottom, right)."""
    ends = segment.ends()
    low = np.floor(ends.min(axis=0) - MAX_REACH_PX - 2.0).astype(int)
    high = np.ceil(ends.max(axis=0) + MAX_REACH_PX + 3.0).astype(int)
    return max(int(low[0]), 0), max(int(low[1]), 0), min(int(high[0]), shape[0]), min(int(high[1]), shape[1])


def _foreign(segment: Segment, fields: list[Gradient], box: tuple[int, int, int, int]) -> NDArray[np.bool_]:
    """Return which pixels show something else, widened by the blur it stands in."""
    import cv2

    cut = (slice(box[0], box[2]), slice(box[1], box[3]))
    row, col = np.arange(box[0], box[2])[:, None], np.arange(box[1], box[3])[None, :]
    across = np.abs(segment.across(row, col))
    cosine, sine = np.cos(segment.normal_rad), np.sin(segment.normal_rad)
    foreign = np.zeros(across.shape, bool)
    for field in fields:
        aligned = cosine * field.right[cut] + sine * field.down[cut]
        alike = aligned > np.cos(np.deg2rad(OWN_DIRECTION_DEG)) * field.modulus[cut]
        width = float(np.hypot(segment.blur_px, field.scale_px))
        slope = segment.slope_dn * segment.width_px / width
        own = alike & ((across < 3.0 * width + 1.0) | (field.modulus[cut] < OWN_TAIL * slope))
        foreign |= (field.significance[cut] > FOREIGN) & ~own
    widened = 2 * round(1.0 + segment.blur_px) + 1
    return cv2.dilate(foreign.astype(np.uint8), np.ones((widened, widened), np.uint8)) > 0


def _best_rectangle(
    foreign: NDArray[np.bool_], row: float, col: float, slope: float, segment: Segment, upright: bool
) -> tuple[Region, float] | None:
    """Return the most useful clear rectangle of an upright edge through (row, col), and its shorter reach."""
    rows, cols = foreign.shape
    total = np.zeros((rows + 1, cols + 1), np.int32)
    total[1:, 1:] = foreign.cumsum(0).cumsum(1)
    half = 0.5 * segment.length_px * abs(np.cos(segment.normal_rad) if upright else np.sin(segment.normal_rad))
    spare = segment.blur_px + segment.scale_px
    first = 0 if row - half < 3.0 + spare else int(np.ceil(row - half + spare))
    last = rows if row + half > rows - 4.0 - spare else int(np.floor(row + half - spare))
    least = max(MIN_REACH_PX, MIN_REACH_BLURS * segment.blur_px)
    best: tuple[float, Region, float] | None = None
    for top in np.unique(np.linspace(first, max(first, last - MIN_ROWS), CUTS).astype(int)):
        for bottom in np.unique(np.linspace(top + MIN_ROWS, max(top + MIN_ROWS, last), CUTS).astype(int)):
            if bottom > last:
                continue
            ends = col + slope * (np.array([top, bottom - 1]) - row)
            empty = total[bottom] - total[top]
            left = _reach(empty[::-1], cols - 1 - float(ends.min()))
            right = _reach(empty, float(ends.max()))
            reach = min(left, right)
            if reach < least:
                continue
            worth = (bottom - top) * reach / (reach + USEFUL_REACH_PX)
            if best is None or worth > best[0]:
                low = int(np.ceil(ends.min() - min(left, MAX_REACH_PX)))
                high = int(np.floor(ends.max() + min(right, MAX_REACH_PX))) + 1
                low, high = max(low, 0), min(high, cols)
                if empty[high] - empty[low] == 0:
                    best = (worth, (int(top), low, int(bottom - top), high - low), float(reach))
    return None if best is None else best[1:]


def _reach(empty: NDArray, start: float) -> float:
    """Return how far beyond a column the running count of foreign pixels stays the same, px."""
    begin = int(np.floor(start))
    if begin < 0 or begin >= len(empty) - 1:
        return 0.0
    changed = np.flatnonzero(empty[begin:] != empty[begin])
    last = begin + int(changed[0]) - 2 if changed.size else len(empty) - 2
    return max(last - start, 0.0)
