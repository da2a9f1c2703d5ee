"""The frequency unit that people asked for: converted for each measurement, whose pixels are columns or rows."""

from dataclasses import dataclass

import numpy as np

from labdata.errors import BadInput
from labdata.measurement import Measurement
from labdata.quantity import FREQUENCY_UNITS, convert_frequency

# What must be given for a length that a unit needs.
REMEDY = {
    "pitch_um": "--pitch-um or --sensor",
    "demagnification": "--demagnification or --sensor",
    "focal_length_mm": "--focal-length-mm or --sensor",
}


@dataclass(frozen=True, kw_only=True)
class FrequencyUnit:
    """A unit of spatial frequency with the lengths that it needs.

    Parameters
    ----------
    unit
        One of `labdata.quantity.FREQUENCY_UNITS`.
    pitch_x_um, pitch_y_um
        Pitch of columns and of rows, um; rows without a pitch of their own have that of the columns.
    rows
        Rows of a frame.
    focal_length_mm
        Focal length of the lens, mm.
    demagnification
        Length at the photocathode over its image's at the detector, dimensionless.

    Raises
    ------
    BadInput
        If the unit is unknown, a length is not positive, or one that the unit needs is missing.
    """

    unit: str = "cy/px"
    pitch_x_um: float | None = None
    pitch_y_um: float | None = None
    rows: int | None = None
    focal_length_mm: float | None = None
    demagnification: float | None = None

    def __post_init__(self) -> None:
        given = {
            "--pitch-um": self.pitch_x_um,
            "--focal-length-mm": self.focal_length_mm,
            "--demagnification": self.demagnification,
        }
        for name, length in given.items():
            if length is not None and not (np.isfinite(length) and length > 0):
                raise BadInput(f"{name} must be positive, got {length:g}")
        needs = {
            "lp/mm": ("pitch_um",),
            "lp/mm-cathode": ("pitch_um", "demagnification"),
            "cy/mrad": ("pitch_um", "focal_length_mm"),
        }
        held = {
            "pitch_um": self.pitch_x_um,
            "demagnification": self.demagnification,
            "focal_length_mm": self.focal_length_mm,
        }
        missing = [name for name in needs.get(self.unit, ()) if held[name] is None]
        if missing:
            remedies = " and ".join(REMEDY[name] for name in missing)
            raise BadInput(f"--units {self.unit} needs a positive {' and '.join(missing)}: give {remedies}")
        if self.unit not in FREQUENCY_UNITS:
            raise BadInput(f"a frequency unit must be one of {', '.join(FREQUENCY_UNITS)}, got {self.unit!r}")

    def __call__(self, frequency_cy_per_px: float, measurement: Measurement | None = None) -> tuple[float, str]:
        """Return a frequency of a measurement in the unit, and the unit."""
        by_rows = measurement is not None and counts_rows(measurement)
        pitch_y_um = self.pitch_y_um or self.pitch_x_um
        ratio = 1.0 if not self.pitch_x_um or not pitch_y_um else pitch_y_um / self.pitch_x_um
        height = None if self.rows is None else self.rows * (1.0 if by_rows else ratio)
        value = convert_frequency(
            frequency_cy_per_px, self.unit, pitch_um=pitch_y_um if by_rows else self.pitch_x_um,
            picture_height_px=height, focal_length_mm=self.focal_length_mm, demagnification=self.demagnification,
        )  # fmt: skip
        return value, self.unit


def counts_rows(measurement: Measurement) -> bool:
    """Return whether a measurement's cycles per pixel are cycles per row pitch.

    Edge methods count the pixels of the axis that the edge's normal is nearer to; all others count column pitches,
    rows scaled by the pitch ratio.
    """
    normal = measurement.orientation_deg
    return measurement.method.startswith("edge") and normal is not None and 45.0 < normal % 180.0 < 135.0
