"""Half-moon plate before a black body, as the share of each cell that shows the body."""

import numpy as np
from numpy.typing import NDArray

from simulate.camera import ThermalImager

Array = NDArray[np.floating]


def half_moon(
    camera: ThermalImager,
    *,
    tilt_deg: float = 5.0,
    right_of_mrad: float = 0.0,
    oversample: int = 4,
) -> Array:
    """Return the share of cells right of a straight edge, shape (row, col) of the oversampled
    frame.

    Parameters
    ----------
    tilt_deg
        Angle of the edge from the vertical; positive leans to the right at the top; 90 is a level
        edge, the body below.
    right_of_mrad
        Distance of the edge from the axis.
    oversample
        Cells on each side of a pixel.

    Notes
    -----
    Exact: the area of a rectangle cut by a line is the second integral of two boxes across the
    line.
    """
    sides = np.array(camera.pitch_mrad) / oversample
    rows, columns = (side * oversample for side in camera.shape)
    down = ((np.arange(rows) + 0.5) - 0.5 * rows)[:, None] * sides[0]
    right = ((np.arange(columns) + 0.5) - 0.5 * columns) * sides[1]
    cos, sin = np.cos(np.deg2rad(tilt_deg)), np.sin(np.deg2rad(tilt_deg))
    distance = right * cos + down * sin - right_of_mrad
    # An edge along the cells is blunted by a thousandth of a cell.
    wide, narrow = (
        max(side, 1e-3 * min(sides)) for side in (sides[1] * abs(cos), sides[0] * abs(sin))
    )
    near, far = 0.5 * abs(wide - narrow), 0.5 * (wide + narrow)
    distance = np.clip(distance, -far, far)

    def ramp(x: Array) -> Array:
        return 0.5 * np.maximum(x, 0.0) ** 2

    whole = (
        ramp(distance + far) - ramp(distance + near) - ramp(distance - near) + ramp(distance - far)
    )
    return np.clip(whole / (wide * narrow), 0.0, 1.0)
