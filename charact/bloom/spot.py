"""Where the point source is, how bright it stands against its surroundings, and how far it blooms."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from labdata.conditions import Conditions
from labdata.frames import FrameStack
from labdata.session import Session, StackEntry

Array = NDArray[np.float64]

# Standard errors by which the smoothed source must stand above its surroundings.
DETECTED = 8.0
# Width of the smoothing that finds it, px.
SMOOTHING_PX = 1.5
# Width of its near surroundings, in widths of the smoothing.
SURROUNDINGS = 3.0
# Share of full scale from which on noise is cut by the highest code.
LINEAR_SHARE = 0.75


@dataclass(frozen=True, kw_only=True)
class Spot:
    """One stack of a point source.

    Parameters
    ----------
    label, conditions
        As in the session.
    image
        Mean of its frames, shape (row, col), DN.
    frames
        Number of frames.
    dark_dn, full_scale_dn
        Level without light and highest code.
    dark_known
        Whether the level without light was measured or recorded.
    row, col
        Centre, px.
    significance
        Height of the smoothed source above its surroundings in their standard deviations.
    frame_bloom_px, frame_streak_px
        Bloom diameter and streak length of single frames, shape (frame,), px.
    bloom_px, streak_px
        Those of the mean frame.
    touches_border
        Whether the bloom runs into the frame's border.
    """

    label: str
    conditions: Conditions
    image: Array
    frames: int
    dark_dn: float
    full_scale_dn: float
    dark_known: bool
    row: float
    col: float
    significance: float
    frame_bloom_px: Array
    frame_streak_px: Array
    bloom_px: float
    streak_px: float
    touches_border: bool


def read_spots(session: Session, *, context: Context) -> tuple[Spot, ...]:
    """Read every point stack, one at a time, twice: the stacks agree on where the source is before it is measured."""
    darks = [(entry.conditions, float(entry.read().data.mean(dtype=np.float64))) for entry in session.of_kind("dark")]
    entries = sorted(session.of_kind("point"), key=lambda entry: entry.conditions.illuminance_lux or 0.0)
    places = [_place(entry) for entry in entries]
    spots: list[Spot] = []
    for done, (entry, place) in enumerate(zip(entries, places, strict=True)):
        context.progress(f"blooming of {entry.label}", done / len(entries))
        same = [other for other, one in zip(places, entries, strict=True) if one.target.region == entry.target.region]
        spots.append(_spot(entry, entry.read(), _dark_of(entry.conditions, darks), place, _agreed(same), context))
    return tuple(spots)


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where one stack shows a point source, and how clearly."""

    row: float
    col: float
    significance: float


def _place(entry: StackEntry) -> Place:
    """Find the source of one stack."""
    image = entry.read().data.mean(axis=0, dtype=np.float64)
    row, col, significance = _find(image, entry.target.region)
    row, col = _centroid(image, row, col)
    return Place(row=row, col=col, significance=significance)


def _agreed(places: list[Place]) -> Place | None:
    """The place in the stack that shows it most clearly, which is neither faint nor a saturated blob."""
    best = max(places, key=lambda place: place.significance)
    return best if best.significance > 2 * DETECTED else None


def _full_scale(stack: FrameStack, context: Context) -> float:
    """Highest code: as told, as recorded, else the highest value seen."""
    told = context.full_scale_dn if context.full_scale_dn is not None else stack.full_scale_dn
    return told if told is not None else float(stack.data.max())


def _dark_of(conditions: Conditions, darks: list[tuple[Conditions, float]]) -> float | None:
    """Mean of the dark whose settings agree in most."""
    if not darks:
        return None
    names = ("mcp_v", "camera_gain_db", "gate_ns", "exposure_s")
    return max(darks, key=lambda d: sum(getattr(d[0], n) == getattr(conditions, n) for n in names))[1]


def _spot(entry: StackEntry, stack: FrameStack, dark: float | None, own: Place, agreed: Place | None,
          context: Context) -> Spot:  # fmt: skip
    """Statistics of one stack."""
    image = stack.data.mean(axis=0, dtype=np.float64)
    full = _full_scale(stack, context)
    recorded = dark if dark is not None else stack.black_level_dn
    level = float(np.median(image)) if recorded is None else recorded
    row, col = (own.row, own.col) if agreed is None else (agreed.row, agreed.col)
    threshold = level + 0.5 * (full - level)
    single = [extent(frame, row, col, threshold, context.pitch_ratio)[:2] for frame in stack.data]
    bloom, streak, touches = extent(image, row, col, threshold, context.pitch_ratio)
    return Spot(
        label=entry.label,
        conditions=entry.conditions,
        image=image,
        frames=len(stack),
        dark_dn=level,
        full_scale_dn=full,
        dark_known=recorded is not None,
        row=row,
        col=col,
        significance=own.significance,
        frame_bloom_px=np.array([bloom for bloom, _ in single]),
        frame_streak_px=np.array([streak for _, streak in single]),
        bloom_px=bloom,
        streak_px=streak,
        touches_border=touches,
    )


def _find(image: Array, region) -> tuple[float, float, float]:
    """Pixel that stands out most from its near surroundings, and by how much over what others do."""
    from scipy import ndimage

    smooth = ndimage.gaussian_filter(image, SMOOTHING_PX)
    contrast = smooth - ndimage.gaussian_filter(image, SURROUNDINGS * SMOOTHING_PX)
    window = np.zeros(image.shape, bool)
    if region is None:
        window[:] = True
    else:
        row, col, height, width = region
        window[row : row + height, col : col + width] = True
    index = int(np.argmax(np.where(window, contrast, -np.inf)))
    row, col = divmod(index, image.shape[1])
    spread = 1.4826 * float(np.median(np.abs(contrast - np.median(contrast))))
    # Rounding leaves a background without noise: its steps are the least spread.
    return float(row), float(col), float(contrast[row, col] / max(spread, 0.05))


def _centroid(image: Array, row: float, col: float, reach: int = 6) -> tuple[float, float]:
    """Centroid of what is brighter than half the peak around a pixel."""
    first_row, first_col = max(0, int(row) - reach), max(0, int(col) - reach)
    cut = image[first_row : int(row) + reach + 1, first_col : int(col) + reach + 1]
    floor = float(np.median(image))
    weight = np.clip(cut - (floor + 0.5 * (cut.max() - floor)), 0.0, None)
    if weight.sum() <= 0:
        return row, col
    rows, cols = np.indices(cut.shape)
    total = weight.sum()
    return first_row + float((rows * weight).sum() / total), first_col + float((cols * weight).sum() / total)


def extent(image: NDArray, row: float, col: float, threshold: float, pitch_ratio: float) -> tuple[float, float, bool]:
    """Return bloom diameter, streak length and whether the bloom meets the border.

    Parameters
    ----------
    image
        Frame, shape (row, col), DN.
    row, col
        Centre of the source, px.
    threshold
        Level of the contour, DN.
    pitch_ratio
        Row pitch over column pitch.

    Returns
    -------
    bloom_px, streak_px, touches
        Diameter of the circle of equal area to the connected region at or above the threshold, in column pitches;
        rows of the source's column at or above it; both 0 where the source does not reach the threshold.
    """
    from scipy import ndimage

    above = np.asarray(image) >= threshold
    centre = round(row), round(col)
    labels = ndimage.label(above)[0]  # pyright: ignore[reportIndexIssue]
    near = labels[max(0, centre[0] - 3) : centre[0] + 4, max(0, centre[1] - 3) : centre[1] + 4]
    if not near.any():
        return 0.0, 0.0, False
    found = np.bincount(near[near > 0]).argmax()
    region = labels == found
    border = region[0].any() or region[-1].any() or region[:, 0].any() or region[:, -1].any()
    diameter = 2.0 * np.sqrt(float(region.sum()) * pitch_ratio / np.pi)
    return float(diameter), float(above[:, centre[1]].sum()), bool(border)
