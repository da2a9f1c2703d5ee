"""Units of spatial frequency and their conversion from cycles per pixel."""

from labdata.errors import BadInput

FREQUENCY_UNITS = (
    "cy/px",
    "lp/mm",
    "lp/mm-cathode",
    "tvl/ph",
    "lw/ph",
    "cy/in",
    "cy/mrad",
    "cy/arcmin",
)


ARCMIN_MRAD = 0.2908882  # One arc minute, mrad


def convert_frequency(
    frequency_cy_per_px: float,
    unit: str,
    *,
    pitch_um: float | None = None,
    picture_height_px: float | None = None,
    focal_length_mm: float | None = None,
    demagnification: float | None = None,
) -> float:
    """Convert a spatial frequency from cycles per pixel to one of `FREQUENCY_UNITS`.

    Parameters
    ----------
    pitch_um
        Pixel pitch along the frequency's direction, um; for lp/mm at detector and cathode, cy/in
        and angles.
    picture_height_px
        Picture height in the same pitches, px; for television lines and line widths per picture
        height, two a cycle.
    focal_length_mm
        Focal length, mm; for cy/mrad and cy/arcmin.
    demagnification
        Length at the photocathode over its image's at the detector, dimensionless; for lp/mm at the
        cathode, and for angles of a camera that has one. None: the lens forms its image on the
        detector.
    """

    def need(name: str) -> float:
        if (length := lengths[name]) is None or not length > 0:
            raise BadInput(f"{unit} needs a positive {name}, got {length}")
        return length

    lengths = {
        "pitch_um": pitch_um,
        "picture_height_px": picture_height_px,
        "focal_length_mm": focal_length_mm,
        "demagnification": demagnification,
    }
    if unit == "cy/px":
        return frequency_cy_per_px
    if unit == "lp/mm":
        return frequency_cy_per_px / need("pitch_um") * 1e3
    if unit == "lp/mm-cathode":
        return frequency_cy_per_px / (need("pitch_um") * need("demagnification")) * 1e3
    if unit == "cy/in":
        return frequency_cy_per_px / need("pitch_um") * 25.4e3
    if unit in ("tvl/ph", "lw/ph"):
        return 2.0 * frequency_cy_per_px * need("picture_height_px")
    if unit in ("cy/mrad", "cy/arcmin"):
        image_um = need("pitch_um") * (1.0 if demagnification is None else demagnification)
        per_mrad = frequency_cy_per_px * need("focal_length_mm") / image_um
        return per_mrad if unit == "cy/mrad" else per_mrad * ARCMIN_MRAD
    raise BadInput(f"a frequency unit must be one of {', '.join(FREQUENCY_UNITS)}, got {unit!r}")
