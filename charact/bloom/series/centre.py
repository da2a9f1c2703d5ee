"""Where a source is, from all levels at once: rings about the right place have no one-sided rest."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from charact.bloom.series.rings import geometry_of

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ITERATIONS = 3
REACH_PX = 40
LEAST_RINGS = 6
# Farthest that a place may move in all, px: a source is found to a pixel or two before.
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
    """Move a place so that the light of all images is even about it.

    Parameters
    ----------
    images
        Mean frame of every level, shape (row, col) each, DN.
    row, col
        Where the source is about, px.
    pitch_ratio
        Row pitch over column pitch.
    full_dn
        Highest code; pixels near it say nothing of the side they are on.
    spoiled
        Pixels of each image to leave out.

    Notes
    -----
    A place wrong by d leaves -L'(r) (d . e_r) of the light L; the steepest rings, which are those beside the cut core,
    tell d best. Gauss-Newton, each pixel weighted as if its noise went as the root of its light.
    """
    first = row, col
    for _ in range(ITERATIONS):
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
    """How far the place is off, column pitches."""
    normal, right = np.zeros((2, 2)), np.zeros(2)
    for image, mask in zip(images, spoiled, strict=True):
        geometry = geometry_of(image.shape, row, col, pitch_ratio=pitch_ratio, spoiled=mask, reach_px=REACH_PX)
        if len(geometry.radius_px) < LEAST_RINGS:
            return 0.0, 0.0
        direction = np.stack([np.cos(geometry.pixel_angle), np.sin(geometry.pixel_angle)])
        value = geometry.pixels(image[None])[0]
        floor = float(np.median(value))
        mean = geometry.means(value)
        slope = np.interp(geometry.pixel_radius_px, geometry.radius_px, np.gradient(mean, geometry.radius_px))
        light = np.interp(geometry.pixel_radius_px, geometry.radius_px, mean)
        whole = geometry.largest(value) < 0.9 * full_dn
        use = np.repeat(whole, geometry.count.astype(int))
        # Rings averaged over a pixel's width hide how light bends inside them: the innermost say nothing.
        weight = use / (1.0 + np.maximum(light - floor, 0.0))
        design = -slope * direction
        # Rings that the border cuts take part of the shift for their mean.
        design = design - np.repeat(geometry.means(design), geometry.count.astype(int), axis=1)
        normal += (design * weight) @ design.T
        right += (design * weight) @ (value - light)
    if np.linalg.det(normal) <= 0:
        return 0.0, 0.0
    across, down = np.linalg.solve(normal, right)
    return float(np.clip(across, -1.0, 1.0)), float(np.clip(down, -1.0, 1.0))
