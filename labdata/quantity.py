"""Measurable quantities: names, units and titles, and the conversion of spatial frequency."""

from dataclasses import dataclass

from labdata.errors import BadInput


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A measurable quantity of the command-line contract."""

    units: tuple[str, ...]  #: Allowed units; the first is the default
    title: str  #: Title in reports


def _entry(title: str, *units: str) -> Quantity:
    return Quantity(units=units, title=title)


QUANTITIES: dict[str, Quantity] = {
    "mtf50": _entry("MTF50: frequency at which the MTF falls to 0.5", "cy/px"),
    "mtf10": _entry("MTF10: frequency at which the MTF falls to 0.1", "cy/px"),
    "mtf": _entry("MTF at the stated frequency", "1"),
    "post_gain_mtf50": _entry("Post-gain MTF50", "cy/px"),
    "post_gain_mtf": _entry("Post-gain MTF at the stated frequency", "1"),
    "white_noise_fraction": _entry(
        "White-noise fraction of the light-induced noise power at zero frequency", "1"
    ),
    "edge_angle": _entry("Edge angle relative to the pixel grid", "deg"),
    "system_gain": _entry("System gain K (variance method)", "DN/e-"),
    "gain_curvature": _entry("Change of variance over signal up to the brightest flat", "%"),
    "photoelectron_gain": _entry("Photoelectron gain k", "DN/pe"),
    "detected_photoelectron_gain": _entry(
        "Mean pulse height of detected photoelectrons, k/p", "DN"
    ),
    "covariance_gain": _entry("Covariance gain K + kF²", "DN"),
    "blur_factor": _entry("Blur factor: temporal variance / summed covariance", "1"),
    "read_noise": _entry("Read noise", "DN", "e-"),
    "excess_noise_factor": _entry("Excess noise factor F²", "1"),
    "ebi": _entry("Equivalent background illumination", "pe/s/px", "lm/cm2"),
    "snr": _entry("SNR per pixel", "1"),
    "snr_area": _entry("SNR of an area mean", "1"),
    "minimum_illumination": _entry("Minimum illumination (pixel SNR = 1)", "lux", "photons/px"),
    "minimum_illumination_area": _entry("Minimum illumination (area SNR = 1)", "lux", "photons/px"),
    "tube_snr": _entry("Image-intensifier SNR (108 µlx, 0.2 mm spot, 10 Hz)", "1"),
    "limiting_resolution": _entry("Limiting resolution at the photocathode", "lp/mm"),
    "figure_of_merit": _entry("Figure of merit: limiting resolution times tube SNR", "lp/mm"),
    "mrc": _entry("Minimum resolvable contrast at the stated frequency", "1"),
    "conversion_gain": _entry("Conversion gain K (white-noise floor)", "DN/e-"),
    "pulse_gain": _entry("Pulse gain kF²", "DN"),
    "pulse_height_factor": _entry(
        "Normalised second moment of the pulse-height distribution, pF²", "1"
    ),
    "snr_max": _entry("Largest signal-to-noise ratio", "1"),
    "dynamic_range": _entry("Dynamic range", "1"),
    "noise_t": _entry("3-D noise σ_t: frame bounce", "DN", "K"),
    "noise_v": _entry("3-D noise σ_v: fixed row noise", "DN", "K"),
    "noise_h": _entry("3-D noise σ_h: fixed column noise", "DN", "K"),
    "noise_tv": _entry("3-D noise σ_tv: temporal row noise", "DN", "K"),
    "noise_th": _entry("3-D noise σ_th: temporal column noise", "DN", "K"),
    "noise_vh": _entry("3-D noise σ_vh: fixed-pattern noise", "DN", "K"),
    "noise_tvh": _entry("3-D noise σ_tvh: random spatio-temporal noise", "DN", "K"),
    "sitf": _entry("Signal transfer SiTF at the background temperature", "DN/K"),
    "netd": _entry("Noise-equivalent temperature difference NETD", "mK"),
    "mrtd": _entry("Minimum resolvable temperature difference MRTD (objective)", "K"),
    "quantum_efficiency": _entry("Quantum efficiency", "%"),
    "dark_signal": _entry("Dark signal", "DN", "e-", "e-/s"),
    "defect_pixels": _entry("Defective pixels", "px"),
    "dark_current": _entry("Dark current", "DN/s", "e-/s"),
    "dark_doubling_temperature": _entry("Dark-current doubling temperature", "K"),
    "saturation": _entry("Saturation level (variance peak)", "DN"),
    "gain_exponent": _entry("Exponent of gain against the control variable", "1"),
    "gain_doubling": _entry("Control-word increment that doubles the gain", "count"),
    "gain_slope": _entry("Slope of measured against stated gain", "dB/dB"),
    "gain_knee": _entry(
        "Gain at which scintillation noise equals read noise", "V", "count", "dB", "1", "DN"
    ),
    "mcp_saturation": _entry("MCP saturation: asymptotic signal (strip-current limit)", "DN"),
    "relative_excess_noise_factor": _entry(
        "Excess noise factor F² relative to the reference setting", "1"
    ),
    "responsivity": _entry("Responsivity", "DN/photon", "DN/lx s", "DN/lx"),
    "saturation_capacity": _entry("Saturation capacity", "e-"),
    "dsnu": _entry("Dark signal non-uniformity", "e-", "DN"),
    "prnu": _entry("Photoresponse non-uniformity", "%"),
    "linearity_error": _entry("Linearity error", "%"),
    "halo_diameter": _entry("Halo diameter (outer edge, blur removed)", "px"),
    "halo_fraction": _entry("Halo fraction of the total signal", "1"),
    "halo_plateau": _entry("Halo plateau per unit source signal", "1/px2"),
    "halo_rim": _entry("Halo rim-to-plateau ratio", "1"),
    "mcp_saturation_density": _entry(
        "Recorded signal per pixel at which the MCP gain has halved", "DN"
    ),
    "core_compression": _entry("Core compression: signal relative to an unsaturated MCP", "1"),
    "veiling_glare": _entry("Veiling glare: uniformly spread fraction of the source signal", "%"),
    "encircled_radius_50": _entry("Encircled-energy radius, 50 %", "px"),
    "encircled_radius_90": _entry("Encircled-energy radius, 90 %", "px"),
    "bloom_diameter": _entry("Bloom diameter at half of full scale", "px"),
    "bloom_diameter_background": _entry("Bloom diameter at twice the background", "px"),
    "bloom_diameter_clip": _entry("Bloom diameter at full scale", "px"),
    "bloom_ellipticity": _entry("Bloom axis ratio (minor/major) at half full scale", "1"),
    "saturated_area": _entry("Area at full scale", "px", "mm2", "mrad2"),
    "streak_length": _entry("Blooming streak length", "px"),
    "streak_level": _entry("Blooming streak signal above dark", "DN"),
    "smear_fraction": _entry("Smear fraction of the column signal", "1"),
    "background_depression": _entry(
        "Background depression relative to the lowest source level", "dB"
    ),
    "recovery_time_10": _entry("Recovery time to 10 % after source-off", "s"),
    "recovery_time_1": _entry("Recovery time to 1 % after source-off", "s"),
    "surface_temperature": _entry(
        "Surface temperature: mean over the area of one object and material", "C"
    ),
    "fused_noise": _entry(
        "Noise of the fused picture: median standard deviation over the display range", "1"
    ),
    "fused_share": _entry(
        "Share of a band in the contrast of objects of the fused picture, median", "1"
    ),
    "fused_filled_area": _entry("Area of the fused picture that lacks a band", "1"),
    "fusion_error": _entry(
        "Restoration error of the fused picture over the spread of the truth", "%"
    ),
}

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
