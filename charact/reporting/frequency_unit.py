"""Display unit of spatial frequency, with the lengths that it needs."""

import math
from dataclasses import dataclass

from labdata import BadInput, Camera, Measurement
from labdata.camera import SCAN_DIRECTIONS
from labdata.frequency import ARCMIN_MRAD, FREQUENCY_UNITS, convert_frequency

# Lengths that a unit needs.
NEEDS: dict[str, tuple[str, ...]] = {
    "lp/mm": ("pitch_um",),
    "lp/mm-cathode": ("pitch_um", "demagnification"),
    "cy/in": ("pitch_um",),
    "cy/mrad": ("pitch_um", "focal_length_mm"),
    "cy/arcmin": ("pitch_um", "focal_length_mm"),
}
ANGLES = ("cy/mrad", "cy/arcmin")
PICTURE_HEIGHTS = ("tvl/ph", "lw/ph")


def unit_title(unit: str) -> str:
    """Return the words of a unit on a page."""
    return "lp/mm at cathode" if unit == "lp/mm-cathode" else unit


@dataclass(frozen=True, kw_only=True)
class FrequencyUnit:
    """Display unit of spatial frequency (one of `FREQUENCY_UNITS`) with the lengths it needs.

    Raises BadInput if the unit is unknown, or a length is not positive or missing.

    Examples
    --------
    >>> FrequencyUnit(unit="lp/mm", pitch_x_um=10.0)(0.25)
    (25.0, 'lp/mm')
    """

    unit: str = "cy/px"  #: One of `FREQUENCY_UNITS`
    pitch_x_um: float | None = None  #: Pitch of columns, µm
    pitch_y_um: float | None = None  #: Pitch of rows, µm; None: that of the columns
    rows: int | None = None  #: Rows of a frame
    focal_length_mm: float | None = None  #: Focal length, mm
    demagnification: float | None = None  #: Length at the photocathode over length at the detector
    #: Angle between rows and between columns, in place of lengths
    pitch_mrad: tuple[float, float] | None = None
    two_way: bool = False  #: Whether edges are of every second line, of one direction of a scan

    def __post_init__(self) -> None:
        lengths = {
            "pitch_um": self.pitch_x_um,
            "focal_length_mm": self.focal_length_mm,
            "demagnification": self.demagnification,
        }
        for name, length in lengths.items():
            if length is not None and not (math.isfinite(length) and length > 0):
                raise BadInput(f"`{name}` must be positive, got {length:g}")
        needs = () if self.pitch_mrad and self.unit in ANGLES else NEEDS.get(self.unit, ())
        if missing := [name for name in needs if lengths[name] is None]:
            lengths_needed = " and ".join(f"`{name}`" for name in missing)
            raise BadInput(
                f"`units` {self.unit} needs a positive {lengths_needed}, or a sensor description "
                "(`sensor`, or sensor in session.toml)"
            )
        if self.unit not in FREQUENCY_UNITS:
            raise BadInput(
                f"a frequency unit must be one of {', '.join(FREQUENCY_UNITS)}, got {self.unit!r}"
            )

    @classmethod
    def of(
        cls,
        sensor: Camera | None,
        *,
        unit: str,
        rows: int | None = None,
        sample_pitch_px: int = 1,
        pitch_um: float | None = None,
        demagnification: float | None = None,
        focal_length_mm: float | None = None,
    ) -> "FrequencyUnit":
        """Return a unit whose missing lengths come from a description; samples lie
        `sample_pitch_px` pixels apart.
        """
        pitch_y_um = pitch_um
        if sensor is not None and sensor.is_thermal:
            array, lens_mm = sensor.array, sensor.optics.focal_length_mm
            pitch_um = float(array.pitch_um) if pitch_um is None and array is not None else pitch_um
            return cls(
                unit=unit,
                pitch_x_um=pitch_um,
                rows=rows,
                demagnification=demagnification,
                focal_length_mm=float(lens_mm)
                if focal_length_mm is None and lens_mm is not None
                else focal_length_mm,
                pitch_mrad=None if focal_length_mm else sensor.pitch_mrad,
                two_way=sensor.scanner is not None,
            )
        if sensor is not None:
            if pitch_um is None:
                pitch_um, pitch_y_um = float(sensor.ccd.pitch_x_um), float(sensor.ccd.pitch_y_um)
            if demagnification is None and sensor.has_tube:
                demagnification = float(sensor.taper.demagnification) / float(
                    sensor.tube.magnification
                )
            if focal_length_mm is None:
                focal_length_mm = float(sensor.optics.focal_length_mm)
        pitch_x_um, pitch_y_um = (
            None if pitch is None else sample_pitch_px * pitch for pitch in (pitch_um, pitch_y_um)
        )
        return cls(
            unit=unit,
            pitch_x_um=pitch_x_um,
            pitch_y_um=pitch_y_um,
            rows=rows,
            focal_length_mm=focal_length_mm,
            demagnification=demagnification,
        )

    def __call__(
        self, frequency_cy_per_px: float, measurement: Measurement | None = None
    ) -> tuple[float, str]:
        """Return the frequency of a measurement in this unit, and the unit."""
        by_rows = measurement is not None and counts_rows(measurement)
        lines = tuple(f"lines {direction}" for direction in SCAN_DIRECTIONS)
        if (
            self.two_way
            and by_rows
            and measurement is not None
            and (measurement.stack or "").endswith(lines)
        ):
            frequency_cy_per_px *= 0.5
        if self.pitch_mrad and self.unit in ANGLES:
            per_mrad = frequency_cy_per_px / self.pitch_mrad[0 if by_rows else 1]
            return per_mrad * (1.0 if self.unit == "cy/mrad" else ARCMIN_MRAD), self.unit
        pitch_y_um = self.pitch_y_um or self.pitch_x_um
        ratio = 1.0 if not self.pitch_x_um or not pitch_y_um else pitch_y_um / self.pitch_x_um
        height = None if self.rows is None else self.rows * (1.0 if by_rows else ratio)
        value = convert_frequency(
            frequency_cy_per_px,
            self.unit,
            pitch_um=pitch_y_um if by_rows else self.pitch_x_um,
            picture_height_px=height,
            focal_length_mm=self.focal_length_mm,
            demagnification=self.demagnification,
        )
        return value, self.unit


def counts_rows(measurement: Measurement) -> bool:
    """Return whether a measurement's cycles per pixel are cycles per row pitch.

    Edge methods and the MRTD of an edge count pixels of the axis nearest to the edge's normal; all
    others count column pitches.
    """
    normal = measurement.orientation_deg
    return (
        measurement.method.startswith(("edge", "objective-mrtd"))
        and normal is not None
        and 45.0 < normal % 180.0 < 135.0
    )
