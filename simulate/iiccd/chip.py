"""What a camera has by its chip: its frame, its fixed patterns' seed and the cells on which its light is carried."""

import zlib
from abc import ABC, abstractmethod
from functools import cached_property

from labdata.sensor import Sensor
from labdata.solid_state import SolidStateCamera
from simulate.iiccd.grid import Grid, grid_with_margin

# The picture of a target is needed this far beyond the frame: the halo reaches 23 pixels.
SCENE_MARGIN_PX = 40
DRAW_MARGIN_PX = 10
# Dark current is stated at this temperature.
DARK_REFERENCE_C = 25.0


class SensorGeometryCamera(ABC):
    """A camera with a chip, with a tube before it or without."""

    @property
    @abstractmethod
    def described(self) -> Sensor | SolidStateCamera:
        """Its description."""

    @property
    @abstractmethod
    def interlaced(self) -> bool:
        """Whether a frame is two fields exposed one after the other."""

    @property
    def demagnification(self) -> float:
        """Size of the picture where light arrives over its size on the chip, dimensionless."""
        return 1.0

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of a frame."""
        return self.described.ccd.rows, self.described.ccd.columns

    @property
    def specimen(self) -> int:
        """Seed of the fixed patterns, which belong to the camera of this name."""
        return zlib.crc32(self.described.name.encode())

    @cached_property
    def cells(self) -> Grid:
        """Cells on which photoelectrons are drawn or collected, two per pixel."""
        return self._grid(2, DRAW_MARGIN_PX)

    @cached_property
    def scene_cells(self) -> Grid:
        """Cells on which the scene arrives, four per pixel."""
        return self._grid(4, SCENE_MARGIN_PX)

    def _grid(self, per_pixel: int, margin: int) -> Grid:
        ccd, (rows, columns) = self.described.ccd, self.shape
        # Field integration sums rows r and r + 1, so the chip has one row more than the frame.
        return grid_with_margin(
            rows + (1 if self.interlaced else 0),
            columns,
            per_pixel=per_pixel,
            margin=margin,
            pitch_x_mm=float(ccd.pitch_x_um) * self.demagnification * 1e-3,
            pitch_y_mm=float(ccd.pitch_y_um) * self.demagnification * 1e-3,
        )
