"""How round a bloom is."""

import numpy as np

from charact.bloom.extent import Extent
from labdata.measurement import Interval

# Fewer pixels than this have no shape.
FEWEST = 12
# Sectors of a shallow contour scatter less than its axes do; and no fit of a smooth contour is rounder than this.
WIDER, LEAST_SD = 1.3, 0.004


def ellipticity(extent: Extent, *, row_pitch: float) -> tuple[float, Interval, Interval] | None:
    """Return minor over major axis of a region with its 68 and 95 % intervals; None where it is too small.

    Parameters
    ----------
    extent
        The region.
    row_pitch
        Row pitch over column pitch.

    Notes
    -----
    A contour tells the axes without pixels: those of an ellipse whose squared radius has the second harmonic
    1 + e cos 2(phi - phi_0) are as 1 - e/2 to 1 + e/2. Noise alone gives a positive e, so its mean square is taken off.
    Regions with a streak or another source have the axes of the ellipse of equal second moments.
    """
    if extent.region.sum() < FEWEST:
        return None
    if extent.contour is not None and not extent.pulled:
        oval = float(np.hypot(*extent.contour.oval))
        sd = float(np.hypot(WIDER * extent.contour.oval_sd, LEAST_SD))
        centre = float(np.sqrt(max(oval**2 - sd**2, 0.0)))
        return _around(centre, sd)
    from skimage import measure

    found = measure.regionprops(extent.region.astype(np.uint8), spacing=(row_pitch, 1.0))[0]
    major = float(found.axis_major_length)
    value = float(found.axis_minor_length) / major if major > 0 else 1.0
    # A row of pixels more or less at either end.
    sd = (0.5 + value * 0.5) / max(major, 1.0)
    low, high = ((value - k * sd, min(value + k * sd, 1.0)) for k in (0.994, 1.96))
    return value, low, high


def _around(oval: float, sd: float) -> tuple[float, Interval, Interval]:
    """Ratio of the axes for a second harmonic, and the intervals that its error leaves; never above 1."""

    def ratio(e: float) -> float:
        return (1.0 - 0.5 * max(e, 0.0)) / (1.0 + 0.5 * max(e, 0.0))

    low, high = ((ratio(oval + k * sd), ratio(oval - k * sd)) for k in (0.994, 1.96))
    return ratio(oval), low, high
