"""Light that leaks through the target beside its pinhole: background that rises with the light near the source alone.

Veiling glare is even over the frame, so its background rises as fast far from the source as beside it.
"""

import numpy as np
from numpy.typing import NDArray

from charact.bloom.point_stack import PointStack
from charact.bloom.series.derived_halo import glare
from labdata.flags import Finding

Array = NDArray[np.float64]

# Fewest pixels beyond the reach of a series, and how far other sources' own light reaches, px.
LEAST_PIXELS, OTHERS_PX = 200, 40.0
# Difference of both ratios in standard errors and over the larger one: glare of lenses falls slowly with distance.
DIFFERENT_SD, DIFFERENT = 4.0, 0.3
REMEDY = "a target that is opaque around its pinhole, or a series with the pinhole covered"


def find_leak(
    group: tuple[PointStack, ...], light: Array, reach_px: float, area_px2: float, beside: tuple[float, float]
) -> list[Finding]:
    """Return a finding where the background beside the source rises faster with its light than far from it does.

    Parameters
    ----------
    group
        Levels of one source.
    light
        Light of the source at each level, DN px^2, shape (level,).
    reach_px
        Distance up to which the background beside the source was fitted, column pitches.
    area_px2
        Area of the frame, column pitches squared.
    beside
        Light spread evenly over the frame over the light of the source by that background, and its standard error.
    """
    seen = [_far(one, reach_px) for one in group]
    if any(one is None for one in seen):
        return []
    level, sd = np.array(seen, float).T
    far = glare(light, level, sd, area_px2)
    if far is None or abs(beside[0] - far[0]) < DIFFERENT_SD * float(np.hypot(beside[1], far[1])):
        return []
    if abs(beside[0] - far[0]) < DIFFERENT * max(beside[0], far[0]):
        return []
    near_percent, far_percent = (100.0 * ratio / (1.0 + max(ratio, 0.0)) for ratio in (beside[0], far[0]))
    effect = (
        f"veiling_glare is {near_percent:.2g} % by the background within {reach_px:.0f} px of the source, "
        f"{far_percent:.2g} % by that beyond"
    )
    return [Finding(flag="model-misfit", effect=effect, remedy=REMEDY)]


def _far(spot: PointStack, reach_px: float) -> tuple[float, float] | None:
    """Return the median of the pixels far from all sources and its standard error, DN; None of too few."""
    rows, cols = np.ogrid[: spot.image.shape[0], : spot.image.shape[1]]
    far = np.hypot((rows - spot.row) * spot.row_pitch, cols - spot.col) > reach_px
    for other in spot.others:
        far &= np.hypot((rows - other.row) * spot.row_pitch, cols - other.col) > OTHERS_PX
    values = spot.image[far]
    if values.size < LEAST_PIXELS:
        return None
    median = float(np.median(values))
    spread = 1.4826 * float(np.median(np.abs(values - median)))
    # Neighbours share the noise of pulses: a quarter of the pixels counts. A median is 1.25 times as unsure as a mean.
    return median, max(1.2533 * 2.0 * spread / float(np.sqrt(values.size)), 1e-6)
