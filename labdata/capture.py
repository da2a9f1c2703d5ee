"""What passes between a camera and whoever records it: settings asked and read back, and frames with their numbers."""

from dataclasses import dataclass

from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.frames import read_only


@dataclass(frozen=True, kw_only=True)
class CameraSettings:
    """Settings of a camera; None leaves a setting as it is.

    Parameters
    ----------
    rows, columns
        Size of the picture, px.
    pixel_format
        GenICam name such as "Mono8" or "Mono16".
    exposure_s
        Exposure of one field or frame, s.
    gain_db
        Gain behind the sensor, dB (a camera with a raw gain counts it in its own steps).
    frame_rate_hz
        Frames per second, Hz.
    """

    rows: int | None = None
    columns: int | None = None
    pixel_format: str | None = None
    exposure_s: float | None = None
    gain_db: float | None = None
    frame_rate_hz: float | None = None

    def __post_init__(self) -> None:
        for name in ("rows", "columns", "exposure_s", "frame_rate_hz"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise BadInput(f"{name} of a camera must be positive, got {value:g}")


@dataclass(frozen=True, kw_only=True)
class Frame:
    """One whole frame as the camera sent it.

    Parameters
    ----------
    pixels
        Pixel values, shape (row, col), DN. Made read-only.
    number
        The camera's own running number; a gap is a lost frame.
    time_s
        The camera's own time stamp, s.
    """

    pixels: NDArray
    number: int
    time_s: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "pixels", read_only(self.pixels))
