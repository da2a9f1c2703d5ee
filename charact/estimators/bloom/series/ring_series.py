"""Ring series of a session's point stacks: common source centre, contaminated pixels excluded."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from charact.estimators.bloom.column_artefacts import column_artefact_mask, run_through
from charact.estimators.bloom.defects import bad_pixels
from charact.estimators.bloom.point_stack import PointStack
from charact.estimators.bloom.series.likelihood import RingSeries, series_of
from charact.estimators.bloom.series.rings import (
    ADJACENT_RINGS,
    LevelRings,
    geometry_of,
    level_of,
    noise_of,
)
from charact.estimators.bloom.thresholds import Unmeasurable
from charact.method import Context
from labdata import Array, Mask, Session

# Maximum correction of a position, px: a source is located to a pixel or two before.
FARTHEST_PX = 3.0


def refine_centre(
    images: Sequence[Array],
    row: float,
    col: float,
    *,
    pitch_ratio: float,
    full_dn: float,
    spoiled: Sequence[Mask],
) -> tuple[float, float]:
    """Refine a source position so that the residuals of all images are symmetric.

    `images`: mean frame of every stack, shape (row, col) each, DN; `row`, `col`: approximate
    position of the source, px; `pitch_ratio`: row pitch over column pitch; `full_dn`: full scale,
    DN; clipped rings are excluded; `spoiled`: pixels of each image to exclude. A position error d
    leaves the residual -L'(r) (d . e_r) of the signal L; the steepest rings, next to the clipped
    core, determine d best. Gauss-Newton, with pixel weights for photon noise.
    """
    first = row, col
    for _ in range(3):
        across, down = _step(images, row, col, pitch_ratio, full_dn, spoiled)
        row, col = row + down / pitch_ratio, col + across
        if abs(row - first[0]) > FARTHEST_PX or abs(col - first[1]) > FARTHEST_PX:
            return first
    return row, col


def _step(
    images: Sequence[Array],
    row: float,
    col: float,
    pitch_ratio: float,
    full_dn: float,
    spoiled: Sequence[Mask],
) -> tuple[float, float]:
    """Offset of the position, column pitches."""
    normal, right = np.zeros((2, 2)), np.zeros(2)
    for image, mask in zip(images, spoiled, strict=True):
        geometry = geometry_of(
            image.shape, row, col, pitch_ratio=pitch_ratio, spoiled=mask, reach_px=40
        )
        if len(geometry.radius_px) < 6:
            return 0.0, 0.0
        direction = np.stack([np.cos(geometry.pixel_angle), np.sin(geometry.pixel_angle)])
        value = geometry.pixels(image[None])[0]
        floor = float(np.median(value))
        mean = geometry.means(value)
        slope = np.interp(
            geometry.pixel_radius_px, geometry.radius_px, np.gradient(mean, geometry.radius_px)
        )
        light = np.interp(geometry.pixel_radius_px, geometry.radius_px, mean)
        is_unclipped = geometry.largest(value) < 0.9 * full_dn
        use = np.repeat(is_unclipped, geometry.count.astype(int))
        # Averages over a pixel's width hide the curvature of the innermost rings.
        weight = use / (1.0 + np.maximum(light - floor, 0.0))
        design = -slope * direction
        # The mean of rings cropped by the border includes part of the shift.
        design = design - np.repeat(geometry.means(design), geometry.count.astype(int), axis=1)
        normal += (design * weight) @ design.T
        right += (design * weight) @ (value - light)
    if np.linalg.det(normal) <= 0:
        return 0.0, 0.0
    across, down = np.linalg.solve(normal, right)
    return float(np.clip(across, -1.0, 1.0)), float(np.clip(down, -1.0, 1.0))


# Minimum number of rings of a series.
LEAST_RINGS = 14


def one_place(spots: tuple[PointStack, ...]) -> tuple[PointStack, ...]:
    """Return the stacks with the most common source position; the clearest one's where several are
    equally common.
    """

    def neighbours(spot: PointStack) -> tuple[PointStack, ...]:
        return tuple(
            other for other in spots if np.hypot(other.row - spot.row, other.col - spot.col) < 2.0
        )

    return max(
        (neighbours(spot) for spot in spots),
        key=lambda group: (len(group), max(other.significance for other in group)),
    )


def build_ring_series(
    session: Session, spots: tuple[PointStack, ...], *, context: Context
) -> tuple[RingSeries, tuple[PointStack, ...]]:
    """Return the ring series of the stacks of one source position, and these at it; else
    Unmeasurable.
    """
    group = one_place(spots)
    clearest = max(group, key=lambda spot: spot.significance)
    shapes = {spot.image.shape for spot in group}
    if len(shapes) > 1:
        raise Unmeasurable(
            f"stacks of one source must have frames of one size, got {sorted(shapes)}"
        )
    full = min(spot.full_scale_dn for spot in group)
    aside = nearer_to_others(group, clearest, context.pitch_ratio)
    masks = [column_artefact_mask(spot, context) | aside for spot in group]
    bad = [bad_pixels(session.stack(spot.label), spot.image.shape) for spot in group]
    row, col = refine_centre(
        [spot.image for spot in group],
        clearest.row,
        clearest.col,
        pitch_ratio=context.pitch_ratio,
        full_dn=full,
        spoiled=[mask | defects for mask, defects in zip(masks, bad, strict=True)],
    )
    levels = _levels(session, group, masks, bad, (row, col), full, context)
    ring_count = min(len(level.mean_dn) for level in levels)
    if ring_count < LEAST_RINGS:
        raise Unmeasurable(
            f"the source must lie {LEAST_RINGS} px or more inside the frame, got {ring_count}"
        )
    noise = noise_of(levels, dark_dn=min(spot.dark_dn for spot in group))
    series = series_of(levels, noise, full_dn=full)
    return series, tuple(replace(spot, row=row, col=col) for spot in group)


def nearer_to_others(group: tuple[PointStack, ...], source: PointStack, pitch_ratio: float) -> Mask:
    """Pixels closer to another source of any stack than to this one, shape (row, col)."""
    rows, cols = np.indices(source.image.shape)

    def apart(row: float, col: float) -> Array:
        return np.hypot((rows - row) * pitch_ratio, cols - col)

    mask, source_distance = np.zeros(source.image.shape, bool), apart(source.row, source.col)
    for other in (other for spot in group for other in spot.other_sources):
        mask |= apart(other.row, other.col) < source_distance
    return mask


def _levels(
    session: Session,
    group: tuple[PointStack, ...],
    masks: list[Mask],
    bad: list[Mask],
    centre: tuple[float, float],
    full_dn: float,
    context: Context,
) -> tuple[LevelRings, ...]:
    """Rings of every stack without contaminated pixels."""
    entries = {entry.label: entry for entry in session.of_kind("point")}
    of_place = partial(geometry_of, group[0].image.shape, *centre, pitch_ratio=context.pitch_ratio)
    full_geometry = of_place(spoiled=None)
    out = []
    for spot, mask, defects in zip(group, masks, bad, strict=True):
        lost = mask | defects
        geometry = of_place(spoiled=lost) if lost.any() else full_geometry
        level = level_of(spot.label, entries[spot.label].read().data, geometry, full_dn=full_dn)
        upright = _upright_px(spot.image, centre, full_dn, context.pitch_ratio)
        out.append(level.without_core(upright) if mask.any() or upright > 0 else level)
    return tuple(out)


def _upright_px(
    image: Array, centre: tuple[float, float], full_dn: float, pitch_ratio: float
) -> float:
    """Radius of a core that overflow has made higher than wide, column pitches; 0 where it is
    round.
    """
    row, col = round(centre[0]), round(centre[1])
    cut = image >= 0.98 * full_dn
    if not cut[row, col]:
        return 0.0
    height = run_through(cut[:, col], row).sum() * pitch_ratio
    width = float(run_through(cut[row], col).sum())
    return min(height / 2.0, 8.0) + ADJACENT_RINGS if height > width + 2.0 else 0.0
