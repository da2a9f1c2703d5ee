"""Plates before a black body: half-moon edge and four-bar target, as the share of each cell that
shows the body.
"""

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.camera.thermal_imager import ThermalImager

Array = NDArray[np.floating]
# Height over width of a bar of the four-bar target (STANAG 4349).
BAR_ASPECT = 7.0


def _cells(camera: ThermalImager, oversample: int) -> tuple[Array, Array, Array]:
    """Angles of the middles of cells from the axis, mrad: down (row, 1) and right (col,), and the
    sides of a cell.
    """
    if oversample < 1:
        raise BadInput(f"oversample must be at least 1, got {oversample}")
    sides = np.array(camera.pitch_mrad) / oversample
    rows, columns = (side * oversample for side in camera.shape)
    return (
        ((np.arange(rows) + 0.5) - 0.5 * rows)[:, None] * sides[0],
        ((np.arange(columns) + 0.5) - 0.5 * columns) * sides[1],
        sides,
    )


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
    down, right, sides = _cells(camera, oversample)
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


def four_bars(
    camera: ThermalImager,
    frequency_cy_per_mrad: float,
    *,
    level: bool = False,
    oversample: int = 4,
) -> Array:
    """Return the share of cells in the slots of a four-bar target, 7:1, shape (row, col) of the
    oversampled frame.

    Parameters
    ----------
    frequency_cy_per_mrad
        Bars over an angle; a bar is half a cycle wide.
    level
        Whether bars lie level instead of upright.
    oversample
        Cells on each side of a pixel.
    """
    if not frequency_cy_per_mrad > 0.0:
        raise BadInput(f"frequency_cy_per_mrad must be positive, got {frequency_cy_per_mrad:g}")
    down, right, sides = _cells(camera, oversample)
    bar = 0.5 / frequency_cy_per_mrad

    def covered(middle: Array, side: float, low: float, high: float) -> Array:
        return (
            np.clip(
                np.minimum(middle + 0.5 * side, high) - np.maximum(middle - 0.5 * side, low),
                0.0,
                None,
            )
            / side
        )

    across, along = (
        ((down, sides[0]), (right, sides[1])) if level else ((right, sides[1]), (down, sides[0]))
    )
    slots = sum(covered(*across, (2 * n - 3.5) * bar, (2 * n - 2.5) * bar) for n in range(4))
    return slots * covered(*along, -0.5 * BAR_ASPECT * bar, 0.5 * BAR_ASPECT * bar)
