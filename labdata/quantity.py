"""What can be measured: the name, units and meaning of every quantity, and the conversion of spatial frequency."""

from dataclasses import dataclass

from labdata.errors import BadInput


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A measurable quantity of the command-line contract.

    Parameters
    ----------
    units
        The units a measurement of it may carry; the first is the usual one.
    title
        How a report names it.
    """

    units: tuple[str, ...]
    title: str


def _entry(title: str, *units: str) -> Quantity:
    return Quantity(units=units, title=title)


QUANTITIES: dict[str, Quantity] = {
    "mtf50": _entry("Frequency where the MTF is 0.5", "cy/px"),
    "mtf10": _entry("Frequency where the MTF is 0.1", "cy/px"),
    "mtf": _entry("Modulation transfer at one frequency", "1"),
    "post_gain_mtf50": _entry("Frequency where the MTF after the gain is 0.5", "cy/px"),
    "post_gain_mtf": _entry("Modulation transfer after the gain at one frequency", "1"),
    "white_noise_share": _entry("Share of the white floor in the light's noise at frequency 0", "1"),
    "edge_angle": _entry("Angle of the edge to the pixel grid", "deg"),
    "system_gain": _entry("System gain K, from the variance", "DN/e-"),
    "photoelectron_gain": _entry("Gain k per photoelectron", "DN/pe"),
    "detected_photoelectron_gain": _entry("Mean pulse height of detected events, k/p", "DN"),
    "covariance_gain": _entry("Covariance gain K + kF²", "DN"),
    "blur_factor": _entry("Blur factor: variance over covariance sum", "1"),
    "read_noise": _entry("Read noise", "DN", "e-"),
    "excess_noise_factor": _entry("Excess noise factor F²", "1"),
    "ebi": _entry("Equivalent background illumination", "pe/s/px", "lm/cm2"),
    "snr": _entry("Signal-to-noise ratio of a pixel", "1"),
    "snr_area": _entry("Signal-to-noise ratio of the mean of an area", "1"),
    "minimum_illumination": _entry("Light at which a pixel's signal is its noise", "lux", "photons/px"),
    "minimum_illumination_area": _entry("Light at which an area's signal is its noise", "lux", "photons/px"),
    "tube_snr": _entry("Signal-to-noise ratio of the tube at 108 µlx, 0.2 mm, 10 Hz", "1"),
    "conversion_gain": _entry("Conversion gain K, from the white floor of the noise", "DN/e-"),
    "pulse_gain": _entry("Gain of the pulses kF²", "DN"),
    "pulse_height_factor": _entry("Mean square of pulse heights over their squared mean, pF²", "1"),
    "snr_max": _entry("Largest signal-to-noise ratio", "1"),
    "dynamic_range": _entry("Dynamic range", "1"),
    "noise_t": _entry("3-D noise: frame to frame", "DN"),
    "noise_v": _entry("3-D noise: row to row", "DN"),
    "noise_h": _entry("3-D noise: column to column", "DN"),
    "noise_tv": _entry("3-D noise: rows, changing", "DN"),
    "noise_th": _entry("3-D noise: columns, changing", "DN"),
    "noise_vh": _entry("3-D noise: fixed pattern", "DN"),
    "noise_tvh": _entry("3-D noise: random", "DN"),
    "quantum_efficiency": _entry("Quantum efficiency", "%"),
    "dark_signal": _entry("Dark signal", "DN", "e-", "e-/s"),
    "defect_pixels": _entry("Defective pixels", "px"),
    "dark_current": _entry("Dark current", "DN/s", "e-/s"),
    "dark_doubling_temperature": _entry("Warming that doubles the dark current", "K"),
    "saturation": _entry("Saturation level (variance peak)", "DN"),
    "gain_exponent": _entry("Exponent of the gain against what sets it", "1"),
    "gain_doubling": _entry("Step of the control word that doubles the gain", "count"),
    "gain_slope": _entry("Measured over stated gain, both in decibels", "dB/dB"),
    "gain_knee": _entry("Knee where read noise gives way to scintillation", "V", "count", "dB", "1", "DN"),
    "plate_saturation": _entry("Signal towards which a plate that tires bends", "DN"),
    "relative_excess_noise_factor": _entry("Excess noise factor F² over that of one setting", "1"),
    "responsivity": _entry("Signal over light", "DN/photon", "DN/lx s", "DN/lx"),
    "saturation_capacity": _entry("Saturation capacity", "e-"),
    "dsnu": _entry("Dark signal non-uniformity", "e-", "DN"),
    "prnu": _entry("Photoresponse non-uniformity", "%"),
    "linearity_error": _entry("Linearity error", "%"),
    "halo_diameter": _entry("Halo diameter, outer edge before blur", "px"),
    "halo_fraction": _entry("Share of all light that lands in the halo", "1"),
    "halo_plateau": _entry("Level of the halo over the source's whole light", "1/px2"),
    "halo_rim": _entry("Level of the halo's rim over its plateau", "1"),
    "plate_saturation_density": _entry("Density of light, as recorded, at which the plate's gain has halved", "DN"),
    "core_compression": _entry("Light behind the plate over that of a plate at rest", "1"),
    "veiling_glare": _entry("Share of the source's light spread evenly over the frame", "%"),
    "encircled_radius_50": _entry("Radius that holds half of a source's light", "px"),
    "encircled_radius_90": _entry("Radius that holds nine tenths of a source's light", "px"),
    "bloom_diameter": _entry("Bloom diameter at half of full scale", "px"),
    "bloom_diameter_background": _entry("Bloom diameter at twice the background", "px"),
    "bloom_diameter_clip": _entry("Bloom diameter at the highest code", "px"),
    "bloom_ellipticity": _entry("Minor over major axis of the bloom at half of full scale", "1"),
    "saturated_area": _entry("Area at the highest code", "px", "mm2", "mrad2"),
    "streak_length": _entry("Length of the bright column", "px"),
    "streak_level": _entry("Level of the overflowing column over dark", "DN"),
    "smear_fraction": _entry("Share of a column's light that smears over the column", "1"),
    "background_depression": _entry("Fall of the background below that of the faintest level", "dB"),
    "recovery_time_10": _entry("Time after the source goes out until 10 % of its light is left", "s"),
    "recovery_time_1": _entry("Time after the source goes out until 1 % of its light is left", "s"),
}

FREQUENCY_UNITS = ("cy/px", "lp/mm", "lp/mm-cathode", "tvl/ph", "cy/mrad")


def convert_frequency(
    frequency_cy_per_px: float,
    unit: str,
    *,
    pitch_um: float | None = None,
    picture_height_px: float | None = None,
    focal_length_mm: float | None = None,
    demagnification: float | None = None,
) -> float:
    """Convert a spatial frequency from cycles per pixel to another unit.

    Parameters
    ----------
    frequency_cy_per_px
        Frequency at the detector, cycles per pixel.
    unit
        One of `FREQUENCY_UNITS`.
    pitch_um
        Pixel pitch along the frequency's direction, um; needed for lp/mm at detector and cathode and for cy/mrad.
    picture_height_px
        Picture height in the same pitches, px; needed for television lines per picture height (two lines a cycle).
    focal_length_mm
        Focal length, mm; needed for cy/mrad.
    demagnification
        Length at the photocathode over its image's at the detector, dimensionless; needed for lp/mm at the cathode,
        and for cy/mrad of a camera that has one. None: the lens forms its image on the detector.

    Raises
    ------
    BadInput
        If the unit is unknown or a length that it needs is missing.
    """
    if unit == "cy/px":
        return frequency_cy_per_px
    if unit == "lp/mm":
        return frequency_cy_per_px / _require_length(pitch_um, "pitch_um", unit) * 1e3
    if unit == "lp/mm-cathode":
        cathode_um = _require_length(pitch_um, "pitch_um", unit) * _require_length(
            demagnification, "demagnification", unit
        )
        return frequency_cy_per_px / cathode_um * 1e3
    if unit == "tvl/ph":
        return 2.0 * frequency_cy_per_px * _require_length(picture_height_px, "picture_height_px", unit)
    if unit == "cy/mrad":
        image_um = _require_length(pitch_um, "pitch_um", unit) * (1.0 if demagnification is None else demagnification)
        return frequency_cy_per_px * _require_length(focal_length_mm, "focal_length_mm", unit) / image_um
    raise BadInput(f"a frequency unit must be one of {', '.join(FREQUENCY_UNITS)}, got {unit!r}")


def _require_length(length: float | None, name: str, unit: str) -> float:
    if length is None or not length > 0:
        raise BadInput(f"{unit} needs a positive {name}, got {length}")
    return length
