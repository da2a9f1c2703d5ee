"""Edges as an intensified camera shows them, photoelectron by photoelectron."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.charact.estimators.mtf.photoelectron_targets import PhotoelectronTarget
from tests.truth.blur import TrueBlur, level_crossing
from tests.truth.edge import distance_across, edge_spread

Array = NDArray[np.floating]


@dataclass(frozen=True)
class _BeforePixel:
    """A blur without the pixel, usable where an edge's spread is asked for."""

    blur: TrueBlur

    def mtf(self, frequency_cy_per_px: Array, angle_deg: float) -> Array:
        """MTF at frequencies, the same in any direction."""
        return self.blur.before_pixel(frequency_cy_per_px)


@dataclass(frozen=True, kw_only=True)
class PulseEdge(PhotoelectronTarget):
    """A blurred step before an intensified camera.

    Parameters
    ----------
    offset_px
        Where the edge passes the middle of the frame, px along the normal.
    sagitta_px
        Bow of the edge over its length, px.
    """

    offset_px: float = 0.0
    sagitta_px: float = 0.0

    @property
    def truth_mtf50(self) -> float:
        """MTF50 along the edge's normal of the camera at rest, cycles per pixel."""
        return level_crossing(self.mtf, 0.5)

    def _illumination(self, row: Array, col: Array, moved_px: float) -> Array:
        distance = distance_across(
            row,
            col,
            (self.rows, self.cols),
            angle_deg=self.angle_deg,
            moved_px=moved_px,
            sagitta_px=self.sagitta_px,
        )
        distance = distance - self.offset_px
        spread: Any = edge_spread(_BeforePixel(self.blur), distance, self.angle_deg)  # pyright: ignore[reportArgumentType]
        return spread
