"""The picture that a plan asks of its camera, once for all steps: part of the sensor, pixel format and trigger."""

from dataclasses import dataclass

from labdata.capture import PIXEL_BITS
from labdata.errors import BadInput


@dataclass(frozen=True, kw_only=True)
class FrameFormat:
    """What is asked of a camera beyond the exposure and gain of each step; None leaves it to the sensor's description.

    Parameters
    ----------
    rows, columns
        Size of the picture, px; by default the whole sensor.
    first_row, first_column
        Where on the sensor the picture begins, px.
    pixel_format
        Such as "Mono12" or "Mono12p", for a camera that does not send the 8 or 16 bits a pixel asked by default.
    trigger
        "off": frames follow one another freely; else the camera's name of what triggers each, such as "Line1".
    """

    rows: int | None = None
    columns: int | None = None
    first_row: int | None = None
    first_column: int | None = None
    pixel_format: str | None = None
    trigger: str | None = None

    def __post_init__(self) -> None:
        for name, least in (("rows", 1), ("columns", 1), ("first_row", 0), ("first_column", 0)):
            value = getattr(self, name)
            if value is not None and value < least:
                raise BadInput(f"{name} of a picture must be at least {least}, got {value}")
        if self.pixel_format is not None and self.pixel_format not in PIXEL_BITS:
            raise BadInput(f"pixel_format must be one of {', '.join(PIXEL_BITS)}, got {self.pixel_format!r}")
