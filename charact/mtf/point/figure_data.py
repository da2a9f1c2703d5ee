"""Figure data of a point source."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.mtf.point.source_window import Window

Array = NDArray[np.float64]

# Shift of faint light by rounding from which it is said, DN.
MIN_REPORTED_SHIFT_DN = 0.02


def rounding_note(window: Window) -> list[str]:
    """Return a note where quantisation may shift faint light."""
    most = float(np.exp(-2.0 * np.pi**2 * window.quiet_sd**2) / np.pi)
    if most < MIN_REPORTED_SHIFT_DN:
        return []
    return [
        f"Rounding to whole codes may shift faint light and its level by up to {most:.2f} DN: "
        "the fit allows for it, and its model is drawn with what the pixels say of that."
    ]


def source_figure_data(
    window: Window, place: tuple[float, float], core_dn: Array, rings_dn: Array, **fitted: float
) -> dict[str, Any]:
    """Return mean frame, model and the lines through the source's centre, as figure data.

    Parameters
    ----------
    place
        Column and row of the source from the centre of the window, column pitches.
    core_dn, rings_dn
        Model of the core, shape (row, col), and of the rings, shape (ring,), DN.
    fitted
        Numbers of the fit that are printed: light, level, chi squared.
    """
    x_px, y_px = place
    row, col = int(np.argmin(np.abs(window.y - y_px))), int(np.argmin(np.abs(window.x - x_px)))
    return {
        "figure": "point-profile",
        "column_px": (window.x - x_px).tolist(),
        "row_px": (window.y - y_px).tolist(),
        "value_dn": window.core.tolist(),
        "model_dn": core_dn.tolist(),
        "used": window.keep.tolist(),
        "along_row_dn": window.core[row].tolist(),
        "along_row_model_dn": core_dn[row].tolist(),
        "along_column_dn": window.core[:, col].tolist(),
        "along_column_model_dn": core_dn[:, col].tolist(),
        "ring_px": window.ring_px.mean(axis=1).tolist(),
        "ring_dn": window.ring_dn.tolist(),
        "ring_sd_dn": np.sqrt(window.ring_variance).tolist(),
        "ring_model_dn": rings_dn.tolist(),
        **fitted,
    }
