"""From a session's point stacks to the rings of one series."""

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from charact.bloom.column_artefacts import column_artefact_mask
from charact.bloom.defects import bad_pixels
from charact.bloom.point_stack import PointStack
from charact.bloom.series.centre import refine_centre
from charact.bloom.series.levels import ADJACENT_RINGS, LevelRings, level_of, noise_of
from charact.bloom.series.likelihood import RingSeries, series_of
from charact.bloom.series.rings import geometry_of
from charact.method import Context
from labdata.session import Session

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Stacks whose sources lie farther apart than this are not one series, px.
SAME_PLACE_PX = 2.0
# Rings that a series needs, and the most that are fitted: halos of up to 1.1 mm at the cathode end well inside them.
LEAST_RINGS, MOST_RINGS = 14, 64
# A core counts as cut from this share of the highest code; overflow makes it higher than wide by so much, and from so
# far on a streak is seen as one.
CUT, HIGHER_PX, FARTHEST_UPRIGHT_PX = 0.98, 2.0, 8.0


def one_place(spots: tuple[PointStack, ...]) -> tuple[PointStack, ...]:
    """Return the stacks of the place that most of them share, the clearest one's where places are shared alike."""

    def near(spot: PointStack) -> tuple[PointStack, ...]:
        return tuple(one for one in spots if np.hypot(one.row - spot.row, one.col - spot.col) < SAME_PLACE_PX)

    return max((near(spot) for spot in spots), key=lambda group: (len(group), max(one.significance for one in group)))


def build_ring_series(
    session: Session, spots: tuple[PointStack, ...], *, context: Context
) -> tuple[RingSeries, tuple[PointStack, ...]] | str:
    """Average stacks of one place over rings about it.

    Returns
    -------
    tuple or str
        The series with the stacks in it, about where they all lie; or why there is none, as a sentence.
    """
    group = one_place(spots)
    clearest = max(group, key=lambda one: one.significance)
    shapes = {one.image.shape for one in group}
    if len(shapes) > 1:
        return f"stacks of one source must have frames of one size, got {sorted(shapes)}"
    full = min(one.full_scale_dn for one in group)
    aside = nearer_to_others(group, clearest, context.pitch_ratio)
    masks = [column_artefact_mask(one, context) | aside for one in group]
    bad = [bad_pixels(session.stack(one.label), one.image.shape) for one in group]
    row, col = refine_centre([one.image for one in group], clearest.row, clearest.col, pitch_ratio=context.pitch_ratio,
                       full_dn=full, spoiled=[one | other for one, other in zip(masks, bad, strict=True)])  # fmt: skip
    levels = _levels(session, group, masks, bad, (row, col), full, context)
    whole = min(len(level.mean_dn) for level in levels)
    if whole < LEAST_RINGS:
        return f"the source must lie {LEAST_RINGS} px or more inside the frame, got {whole}"
    noise = noise_of(levels, dark_dn=min(one.dark_dn for one in group))
    series = series_of(levels, noise, full_dn=full, rings=min(MOST_RINGS, whole))
    return series, tuple(replace(one, row=row, col=col) for one in group)


def nearer_to_others(group: tuple[PointStack, ...], own: PointStack, pitch_ratio: float) -> Mask:
    """Pixels that are nearer to another source than to this one, shape (row, col); any stack may show it."""
    rows, cols = np.indices(own.image.shape)

    def apart(row: float, col: float) -> Array:
        return np.hypot((rows - row) * pitch_ratio, cols - col)

    mask, here = np.zeros(own.image.shape, bool), apart(own.row, own.col)
    for other in (other for one in group for other in one.others):
        mask |= apart(other.row, other.col) < here
    return mask


def _levels(
    session: Session, group: tuple[PointStack, ...], masks: list[Mask], bad: list[Mask], place: tuple[float, float],
    full_dn: float, context: Context,
) -> tuple[LevelRings, ...]:  # fmt: skip
    """Rings of every stack, each without the pixels that something else makes bright there."""
    entries = {entry.label: entry for entry in session.of_kind("point")}
    of_place = partial(geometry_of, group[0].image.shape, *place, pitch_ratio=context.pitch_ratio)
    whole = of_place(spoiled=None)
    out = []
    for one, mask, defects in zip(group, masks, bad, strict=True):
        lost = mask | defects
        geometry = of_place(spoiled=lost) if lost.any() else whole
        level = level_of(one.label, entries[one.label].read().data, geometry, full_dn=full_dn)
        upright = _upright_px(one.image, place, full_dn, context.pitch_ratio)
        out.append(level.without_core(upright) if mask.any() or upright > 0 else level)
    return tuple(out)


def _upright_px(image: Array, place: tuple[float, float], full_dn: float, pitch_ratio: float) -> float:
    """How far a core reaches that is cut higher than wide, as overflow does, column pitches; 0 where it is round."""
    row, col = round(place[0]), round(place[1])
    cut = image >= CUT * full_dn
    high, wide = _run(cut[:, col], row) * pitch_ratio, float(_run(cut[row], col))
    return min(high / 2.0, FARTHEST_UPRIGHT_PX) + ADJACENT_RINGS if high > wide + HIGHER_PX else 0.0


def _run(line: NDArray[np.bool_], at: int) -> int:
    """Length of the run of true values through a place."""
    if not line[at]:
        return 0
    ends = np.flatnonzero(~np.concatenate([[False], line, [False]]))
    return int(ends[ends > at + 1][0] - ends[ends <= at][-1] - 1) if len(ends) else 0
