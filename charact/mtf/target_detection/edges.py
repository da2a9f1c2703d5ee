"""The straight edges of a frame that are good enough to measure, each with the region that shows it alone."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.mtf.mean_frame import Region
from charact.mtf.target_detection.clear_rectangle import ClearRectangle, clear_rectangle
from charact.mtf.target_detection.gradient import Gradient, gradient
from charact.mtf.target_detection.segments import Segment, segments_of
from charact.mtf.target_detection.smoothed_mean_frame import mean_frame_of
from labdata.frames import FrameStack

# Smoothing at which edges are looked for, px: fine ones where the noise allows, coarse ones out of strong noise.
SCALES_PX = (1.4, 2.8, 5.6)
# What else is in the way is looked for up to this one, or the one at which the edge itself shows.
FOREIGN_SCALE_PX = 2.8
# A coarser scale is taken where the finer one shows less than this share of the length in one piece.
IN_ONE_PIECE = 0.85
# Significance along cells of so many px at which a finer scale would have found a straight edge itself.
SHOWN, SHOWN_PX = 8.0, 3.0
# Bars: edges of alternating sense, this much nearer than long and evenly spaced.
BAR_ASPECT, BAR_EVENNESS = 0.35, 0.35


@dataclass(frozen=True, kw_only=True)
class DetectedEdge:
    """An edge found in a frame.

    Parameters
    ----------
    region
        ROW, COL, HEIGHT, WIDTH that holds the edge, its plateaus and nothing else, px.
    orientation_deg
        Direction of its normal from the row direction, degrees in [0, 180).
    worth
        Rows of the region, less where plateaus are short: what orders edges, px.
    """

    region: Region
    orientation_deg: float
    worth: float


def find_edges(pictures: NDArray | FrameStack) -> tuple[DetectedEdge, ...]:
    """Find the straight edges of a frame that can be measured.

    Parameters
    ----------
    pictures
        Picture (row, col), stack (frame, row, col) or frames; a stack is averaged.

    Returns
    -------
    tuple of FoundEdge
        Best first. Bars, bent edges and edges without room for their plateaus are not among them; an edge that others
        meet is cut where they begin.

    Notes
    -----
    Pixels whose smoothed gradient stands 4 standard deviations out of the noise and points one way grow together; a
    region of them is an edge if a straight line describes it over 24 px and more and both sides stay clear of any other
    gradient for 4 standard deviations of its blur and 8 px at least. The growing follows Grompone von Gioi et al.,
    doi:10.5201/ipol.2012.gjmr-lsd; the noise is read off the picture instead of taken as white.
    """
    picture, whole_codes = mean_frame_of(pictures)
    scales = [scale for scale in SCALES_PX if min(picture.shape) > 8 * scale]
    fields = [gradient(picture, scale, whole_codes=whole_codes) for scale in scales]
    if not fields:
        return ()
    segments = _of_all_scales(fields)
    found: list[tuple[Segment, ClearRectangle]] = []
    for segment in segments:
        if not _is_bar(segment, segments):
            finest = max(FOREIGN_SCALE_PX, segment.scale_px)
            clear = clear_rectangle(segment, [field for field in fields if field.scale_px <= finest])
            if clear is not None:
                found.append((segment, clear))
    best_first = sorted(found, key=lambda pair: -pair[1].worth)
    kept: list[tuple[Segment, ClearRectangle]] = []
    for segment, clear in best_first:
        if not any(_same_edge(segment, clear, *other) for other in kept):
            kept.append((segment, clear))
    return tuple(
        DetectedEdge(
            region=clear.region, orientation_deg=float(np.rad2deg(segment.normal_rad)) % 180.0, worth=clear.worth
        )
        for segment, clear in kept
    )


def _of_all_scales(fields: list[Gradient]) -> list[Segment]:
    """Return segments of all scales, each from the finest that shows most of its length in one piece."""
    kept: list[Segment] = []
    for number, field in enumerate(fields):
        for segment in segments_of(field):
            if any(
                _shows(finer, segment) for finer in fields[:number] if finer.scale_px < segment.scale_px
            ) and not any(_covers(segment, other) for other in kept):
                continue
            finer = [other for other in kept if _covers(segment, other)]
            if max((other.length_px for other in finer), default=0.0) < IN_ONE_PIECE * segment.length_px:
                kept = [other for other in kept if not any(other is one for one in finer)]
                kept.append(segment)
    return kept


def _shows(finer: Gradient, segment: Segment) -> bool:
    """Return whether a finer scale shows all of a segment, so that it must be straight there too."""
    low = np.maximum(np.floor(segment.ends().min(axis=0) - 3.0 * segment.scale_px), 0).astype(int)
    high = np.ceil(segment.ends().max(axis=0) + 3.0 * segment.scale_px).astype(int)
    significance = finer.significance[low[0] : high[0], low[1] : high[1]]
    row = np.arange(low[0], low[0] + significance.shape[0])[:, None]
    col = np.arange(low[1], low[1] + significance.shape[1])[None, :]
    along = segment.along(row, col)
    near = (np.abs(segment.across(row, col)) < 2.0 * segment.scale_px) & (np.abs(along) < 0.5 * segment.length_px)
    cell = ((along[near] + 0.5 * segment.length_px) / SHOWN_PX).astype(int)
    shown = np.zeros(int(segment.length_px / SHOWN_PX) + 1, bool)
    shown[cell[significance[near] > SHOWN]] = True
    return float(shown.mean()) > 0.9


def _covers(coarse: Segment, fine: Segment) -> bool:
    """Return whether a segment of a finer scale lies on a coarse one."""
    near = abs(float(coarse.across(np.array(fine.row), np.array(fine.col)))) < 2.0 * coarse.scale_px
    beside = abs(float(coarse.along(np.array(fine.row), np.array(fine.col)))) < 0.5 * coarse.length_px
    return near and beside and np.cos(coarse.normal_rad - fine.normal_rad) > np.cos(np.deg2rad(15.0))


def _is_bar(segment: Segment, segments: Iterable[Segment]) -> bool:
    """Return whether a segment is one of three or more evenly spaced edges of alternating sense, nearer than long."""
    sides: dict[float, list[float]] = {1.0: [], -1.0: []}
    same: list[float] = []
    for other in segments:
        if other is segment or abs(np.cos(segment.normal_rad - other.normal_rad)) < np.cos(np.deg2rad(8.0)):
            continue
        along = abs(float(segment.along(np.array(other.row), np.array(other.col))))
        across = float(segment.across(np.array(other.row), np.array(other.col)))
        if along > 0.4 * segment.length_px or not 1.0 < abs(across) < 2.2 * BAR_ASPECT * segment.length_px:
            continue
        if np.cos(segment.normal_rad - other.normal_rad) < 0:
            sides[float(np.sign(across))].append(abs(across))
        else:
            same.append(abs(across))
    near = [min(distances, default=np.inf) for distances in sides.values()]
    spacing = min(near)
    if spacing > BAR_ASPECT * segment.length_px:
        return False
    return any(abs(distance / spacing - 1.0) < BAR_EVENNESS for distance in near if distance > spacing) or any(
        abs(distance / (2.0 * spacing) - 1.0) < BAR_EVENNESS for distance in same
    )


def _same_edge(segment: Segment, clear: ClearRectangle, other: Segment, others: ClearRectangle) -> bool:
    """Return whether two segments lie on one line and their regions meet."""
    if np.cos(segment.normal_rad - other.normal_rad) < np.cos(np.deg2rad(10.0)):
        return False
    sides = (
        min(clear.region[k] + clear.region[k + 2], others.region[k] + others.region[k + 2])
        - max(clear.region[k], others.region[k])
        for k in (0, 1)
    )
    across = abs(float(other.across(np.array(segment.row), np.array(segment.col))))
    return all(side > 0 for side in sides) and across < 3.0 + 2.0 * segment.scale_px
