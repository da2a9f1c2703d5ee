"""Measurable quantities: names, units, places in reports."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

Section = Literal["Resolution", "Gain and noise", "Infrared", "Halo and blooming"]


@dataclass(frozen=True, kw_only=True)
class StandardRow:
    """A quantity as EMVA 1288 Release 4.0 Linear (16 June 2021) calls and states it."""

    quantity: str = ""  #: Name of its quantity, in a sheet
    unit: str  #: Unit of the measurement
    name: str
    symbol: str
    clause: str  #: Equation or section
    element: tuple[str, str]  #: Part and name in the results of the EMVA 1288 group's program
    shown_unit: str = ""  #: Unit of the standard; "": that of the measurement
    convert: Callable[[float], float] = lambda value: value  #: Monotone, from the unit
    remark: str = ""  #: Which of two definitions it has
    detail: bool = False  #: Whether it stands on the sheet alone, not on the first page of a report


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A measurable quantity of the command-line contract."""

    units: tuple[str, ...]  #: Allowed units; the first is the default
    title: str  #: Title in reports
    section: Section | None = None  #: Section of a summary that it leads; None: in none
    better: Literal["higher", "lower"] | None = None  #: Direction of a better camera
    #: Rows of the EMVA 1288 sheet of a statistic that `labdata.data_sheet` does not list
    standard: tuple[StandardRow, ...] = ()


def _entry(title: str, *units: str, **more: Any) -> Quantity:
    return Quantity(units=units, title=title, **more)


class Catalogue(dict[str, Quantity]):
    """Quantities by name. A package may declare more when one is asked for that is not listed."""

    declare_more: Callable[[], object] | None = None  #: Adds them; is called once

    def __missing__(self, name: str) -> Quantity:
        if self.declare_more is None:
            raise KeyError(name)
        declare_more, self.declare_more = self.declare_more, None
        declare_more()
        return self[name]

    def get(self, name: str, default: Any = None) -> Any:
        """Return the quantity of a name, or a default."""
        try:
            return self[name]
        except KeyError:
            return default

    def __contains__(self, name: object) -> bool:
        return self.get(str(name)) is not None


# In the order in which a user looks for them.
QUANTITIES = Catalogue()
QUANTITIES |= {
    "mtf50": _entry(
        "MTF50: frequency at which the MTF falls to 0.5",
        "cy/px",
        section="Resolution",
        better="higher",
    ),
    "mtf10": _entry(
        "MTF10: frequency at which the MTF falls to 0.1",
        "cy/px",
        section="Resolution",
        better="higher",
    ),
    "mtf": _entry("MTF at the stated frequency", "1", section="Resolution", better="higher"),
    "sfr50": _entry("MTF50 of the conventional SFR of ISO 12233", "cy/px", section="Resolution"),
    "sfr50_difference": _entry(
        "MTF50 of the conventional SFR minus MTF50", "%", section="Resolution"
    ),
    "neq": _entry(
        "Noise-equivalent quanta at the stated frequency",
        "1/px",
        section="Resolution",
        better="higher",
    ),
    "detectability": _entry(
        "Detectability d' of the stated disc", "1", section="Resolution", better="higher"
    ),
    "best_focus": _entry("Focus at which MTF50 is highest", "mm", section="Resolution"),
    "limiting_resolution": _entry(
        "Limiting resolution at the photocathode", "lp/mm", section="Resolution", better="higher"
    ),
    "figure_of_merit": _entry(
        "Figure of merit: limiting resolution times tube SNR",
        "lp/mm",
        section="Resolution",
        better="higher",
    ),
    "mrc": _entry(
        "Minimum resolvable contrast at the stated frequency",
        "1",
        section="Resolution",
        better="lower",
    ),
    "post_gain_mtf50": _entry("Post-gain MTF50", "cy/px", section="Resolution"),
    "post_gain_mtf": _entry("Post-gain MTF at the stated frequency", "1"),
    "white_noise_fraction": _entry(
        "White-noise fraction of the light-induced noise power at zero frequency", "1"
    ),
    "edge_angle": _entry("Edge angle relative to the pixel grid", "deg", section="Resolution"),
    "system_gain": _entry(
        "System gain K (variance method)",
        "DN/e-",
        section="Gain and noise",
    ),
    "gain_curvature": _entry("Change of variance over signal up to the brightest flat", "%"),
    "covariance_gain": _entry("Covariance gain K + kF²", "DN", section="Gain and noise"),
    "conversion_gain": _entry(
        "Conversion gain K (white-noise floor)", "DN/e-", section="Gain and noise"
    ),
    "pulse_gain": _entry("Pulse gain kF²", "DN"),
    "pulse_height_factor": _entry(
        "Normalised second moment of the pulse-height distribution, pF²", "1"
    ),
    "photoelectron_gain": _entry("Photoelectron gain k", "DN/pe", section="Gain and noise"),
    "detected_photoelectron_gain": _entry(
        "Mean pulse height of detected photoelectrons, k/p", "DN", section="Gain and noise"
    ),
    "excess_noise_factor": _entry(
        "Excess noise factor F²", "1", section="Gain and noise", better="lower"
    ),
    "blur_factor": _entry(
        "Blur factor: temporal variance / summed covariance", "1", section="Gain and noise"
    ),
    "read_noise": _entry(
        "Read noise",
        "DN",
        "e-",
        section="Gain and noise",
        better="lower",
    ),
    "ebi": _entry(
        "Equivalent background illumination",
        "pe/s/px",
        "lm/cm2",
        section="Gain and noise",
        better="lower",
    ),
    "tube_snr": _entry(
        "Image-intensifier SNR (108 µlx, 0.2 mm spot, 10 Hz)",
        "1",
        section="Gain and noise",
        better="higher",
    ),
    "quantum_efficiency": _entry(
        "Quantum efficiency",
        "%",
        section="Gain and noise",
        better="higher",
    ),
    "dark_signal": _entry("Dark signal", "DN", "e-", "e-/s"),
    "defect_pixels": _entry(
        "Defective pixels",
        "px",
    ),
    "dark_current_from_variance": _entry("Dark current from the variance", "DN/s", "e-/s"),
    "sensitivity_threshold": _entry(
        "Absolute sensitivity threshold (temporal noise)", "photons/px", "e-"
    ),
    "saturation_exposure": _entry("Saturation exposure", "photons/px"),
    "saturation_capacity": _entry(
        "Saturation capacity",
        "e-",
        section="Gain and noise",
    ),
    "snr_max": _entry(
        "Largest signal-to-noise ratio",
        "1",
        section="Gain and noise",
        better="higher",
    ),
    "dynamic_range": _entry(
        "Dynamic range",
        "1",
        section="Gain and noise",
        better="higher",
    ),
    "saturation_exposure_full_scale": _entry("Exposure of 0.1 % full pixels", "photons/px"),
    "saturation_capacity_full_scale": _entry("Saturation capacity of 0.1 % full pixels", "e-"),
    "snr_max_full_scale": _entry("Largest SNR, saturation of 0.1 % full pixels", "1"),
    "dynamic_range_full_scale": _entry("Dynamic range, saturation of 0.1 % full pixels", "1"),
    "noise_t": _entry("3-D noise σ_t: frame bounce", "DN", "K"),
    "noise_v": _entry("3-D noise σ_v: fixed row noise", "DN", "K"),
    "noise_h": _entry("3-D noise σ_h: fixed column noise", "DN", "K"),
    "noise_tv": _entry("3-D noise σ_tv: temporal row noise", "DN", "K"),
    "noise_th": _entry("3-D noise σ_th: temporal column noise", "DN", "K"),
    "noise_vh": _entry("3-D noise σ_vh: fixed-pattern noise", "DN", "K"),
    "noise_tvh": _entry("3-D noise σ_tvh: random spatio-temporal noise", "DN", "K"),
    "minimum_illumination": _entry(
        "Minimum illumination (pixel SNR = 1)",
        "lux",
        "photons/px",
        section="Gain and noise",
    ),
    "minimum_illumination_area": _entry("Minimum illumination (area SNR = 1)", "lux", "photons/px"),
    "linearity_error": _entry(
        "Linearity error",
        "%",
        section="Gain and noise",
        better="lower",
    ),
    "linearity_error_min": _entry("Smallest deviation from linearity", "%"),
    "linearity_error_max": _entry("Largest deviation from linearity", "%"),
    **{
        f"{name}_1288{part}{suffix}": _entry(f"{title}{of_lines}{of_filter}", *units)
        for suffix, of_filter in (("", ""), ("_filtered", ", shading removed"))
        for name, title, units in (
            ("dsnu", "DSNU of EMVA 1288", ("e-", "DN")),
            ("prnu", "PRNU of EMVA 1288", ("%",)),
        )
        for part, of_lines in (
            ("", ""),
            ("_row", " of rows"),
            ("_column", " of columns"),
            ("_pixel", " of pixels"),
        )
    },
    "dsnu": _entry(
        "Dark signal non-uniformity",
        "e-",
        "DN",
        section="Gain and noise",
        better="lower",
    ),
    "prnu": _entry(
        "Photoresponse non-uniformity",
        "%",
        section="Gain and noise",
        better="lower",
    ),
    "dark_current": _entry(
        "Dark current",
        "DN/s",
        "e-/s",
        section="Gain and noise",
        better="lower",
    ),
    "dark_doubling_temperature": _entry(
        "Dark-current doubling temperature",
        "K",
    ),
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
    "responsivity": _entry(
        "Responsivity",
        "DN/photon",
        "DN/lx s",
        "DN/lx",
    ),
    "snr": _entry("SNR per pixel", "1", section="Gain and noise", better="higher"),
    "snr_area": _entry("SNR of an area mean", "1", better="higher"),
    "sitf": _entry(
        "Signal transfer SiTF at the background temperature", "DN/K", section="Infrared"
    ),
    "netd": _entry("Noise-equivalent temperature difference NETD", "mK", section="Infrared"),
    "mrtd": _entry(
        "Minimum resolvable temperature difference MRTD (objective)", "K", section="Infrared"
    ),
    "halo_diameter": _entry(
        "Halo diameter (outer edge, blur removed)",
        "px",
        section="Halo and blooming",
        better="lower",
    ),
    "halo_fraction": _entry(
        "Halo fraction of the total signal", "1", section="Halo and blooming", better="lower"
    ),
    "halo_plateau": _entry("Halo plateau per unit source signal", "1/px2", better="lower"),
    "halo_rim": _entry("Halo rim-to-plateau ratio", "1"),
    "mcp_saturation_density": _entry(
        "Recorded signal per pixel at which the MCP gain has halved", "DN"
    ),
    "core_compression": _entry("Core compression: signal relative to an unsaturated MCP", "1"),
    "veiling_glare": _entry("Veiling glare: uniformly spread fraction of the source signal", "%"),
    "encircled_radius_50": _entry("Encircled-energy radius, 50 %", "px"),
    "encircled_radius_90": _entry("Encircled-energy radius, 90 %", "px"),
    "bloom_diameter": _entry(
        "Bloom diameter at half of full scale", "px", section="Halo and blooming", better="lower"
    ),
    "bloom_diameter_background": _entry(
        "Bloom diameter at twice the background", "px", better="lower"
    ),
    "bloom_diameter_clip": _entry("Bloom diameter at full scale", "px", better="lower"),
    "bloom_ellipticity": _entry("Bloom axis ratio (minor/major) at half full scale", "1"),
    "saturated_area": _entry("Area at full scale", "px", "mm2", "mrad2"),
    "streak_length": _entry("Blooming streak length", "px", section="Halo and blooming"),
    "streak_level": _entry("Blooming streak signal above dark", "DN"),
    "smear_fraction": _entry(
        "Smear fraction of the column signal", "1", section="Halo and blooming"
    ),
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
