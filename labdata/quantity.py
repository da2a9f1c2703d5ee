"""Measurable quantities: names, units, places in reports."""

from collections.abc import Callable
from dataclasses import dataclass
from math import log10
from typing import Any, Literal

Section = Literal["Resolution", "Gain and noise", "Infrared", "Halo and blooming"]

VARIANCE_PEAK = (
    "saturation is the peak of the temporal variance, as in Release 3.1; Release 4.0 takes the "
    "exposure at which 0.1 to 0.2 % of the pixels show the largest value"
)
NO_HIGH_PASS = (
    "the standard removes shading by a high-pass filter (8.1) and states row, column "
    "and pixel parts"
)


def _decibel(ratio: float) -> float:
    return 20.0 * log10(ratio)


@dataclass(frozen=True, kw_only=True)
class StandardRow:
    """A quantity as EMVA 1288 Release 4.0 Linear (16 June 2021) calls and states it."""

    order: int  #: Place in the sheet
    quantity: str = ""  #: Name of its quantity, in a sheet
    unit: str  #: Unit of the measurement
    name: str
    symbol: str
    clause: str  #: Equation or section
    element: tuple[str, str]  #: Part and name in the results of the EMVA 1288 group's program
    shown_unit: str = ""  #: Unit of the standard; "": that of the measurement
    convert: Callable[[float], float] = lambda value: value  #: Monotone, from the unit
    departure: str = ""  #: Why the value is not to standard; "": it is


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A measurable quantity of the command-line contract."""

    units: tuple[str, ...]  #: Allowed units; the first is the default
    title: str  #: Title in reports
    section: Section | None = None  #: Section of a summary that it leads; None: in none
    better: Literal["higher", "lower"] | None = None  #: Direction of a better camera
    standard: tuple[StandardRow, ...] = ()  #: Rows of the EMVA 1288 sheet


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
        standard=(
            StandardRow(
                order=2,
                unit="DN/e-",
                name="System gain",
                symbol="K",
                clause="eq. 50",
                element=("sensitivity", "K"),
            ),
            StandardRow(
                order=3,
                unit="DN/e-",
                name="Inverse of the system gain",
                symbol="1/K",
                clause="eq. 50",
                element=("sensitivity", "inverse_K"),
                shown_unit="e-/DN",
                convert=lambda gain: 1.0 / gain,
            ),
        ),
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
        standard=(
            StandardRow(
                order=4,
                unit="e-",
                name="Temporal dark noise",
                symbol="σ_d",
                clause="eq. 53",
                element=("sensitivity", "sigma_d"),
            ),
            StandardRow(
                order=5,
                unit="DN",
                name="Temporal dark noise",
                symbol="σ_y.dark",
                clause="eq. 53",
                element=("sensitivity", "sigma_y_dark"),
            ),
        ),
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
        standard=(
            StandardRow(
                order=0,
                unit="%",
                name="Quantum efficiency",
                symbol="η",
                clause="eq. 52",
                element=("sensitivity", "QE"),
            ),
        ),
    ),
    "dark_signal": _entry("Dark signal", "DN", "e-", "e-/s"),
    "defect_pixels": _entry(
        "Defective pixels",
        "px",
        standard=(
            StandardRow(
                order=17,
                unit="px",
                name="Defect pixels",
                symbol="",
                clause="8.8",
                element=("defect_pixel", "defects"),
                departure=(
                    "counted by the rule in the notes; the standard leaves the threshold to the "
                    "application"
                ),
            ),
        ),
    ),
    "saturation_capacity": _entry(
        "Saturation capacity",
        "e-",
        section="Gain and noise",
        standard=(
            StandardRow(
                order=9,
                unit="e-",
                name="Saturation capacity",
                symbol="μ_e.sat",
                clause="2.7, 6.6",
                element=("sensitivity", "u_e_sat"),
                departure=VARIANCE_PEAK,
            ),
        ),
    ),
    "snr_max": _entry(
        "Largest signal-to-noise ratio",
        "1",
        section="Gain and noise",
        better="higher",
        standard=(
            StandardRow(
                order=6,
                unit="1",
                name="Largest signal-to-noise ratio",
                symbol="SNR_max",
                clause="2.6",
                element=("sensitivity", "SNR_max"),
                departure=VARIANCE_PEAK,
            ),
            StandardRow(
                order=7,
                unit="1",
                name="Largest signal-to-noise ratio",
                symbol="SNR_max.dB",
                clause="2.6",
                element=("sensitivity", "SNR_max_dB"),
                shown_unit="dB",
                convert=_decibel,
                departure=VARIANCE_PEAK,
            ),
        ),
    ),
    "dynamic_range": _entry(
        "Dynamic range",
        "1",
        section="Gain and noise",
        better="higher",
        standard=(
            StandardRow(
                order=10,
                unit="1",
                name="Dynamic range",
                symbol="DR",
                clause="eq. 28",
                element=("sensitivity", "DR"),
                departure=VARIANCE_PEAK,
            ),
            StandardRow(
                order=11,
                unit="1",
                name="Dynamic range",
                symbol="DR_dB",
                clause="eq. 28",
                element=("sensitivity", "DR_dB"),
                shown_unit="dB",
                convert=_decibel,
                departure=VARIANCE_PEAK,
            ),
        ),
    ),
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
        standard=(
            StandardRow(
                order=8,
                unit="photons/px",
                name="Absolute sensitivity threshold",
                symbol="μ_p.min",
                clause="eq. 26",
                element=("sensitivity", "u_p_min"),
                shown_unit="photons",
                departure="pixel non-uniformity counts as noise here",
            ),
        ),
    ),
    "minimum_illumination_area": _entry("Minimum illumination (area SNR = 1)", "lux", "photons/px"),
    "linearity_error": _entry(
        "Linearity error",
        "%",
        section="Gain and noise",
        better="lower",
        standard=(
            StandardRow(
                order=12,
                unit="%",
                name="Linearity error",
                symbol="LE",
                clause="6.9, eq. 63",
                element=("linearity", "LE"),
                departure=(
                    "levels from 5 to 70 % of saturation and a line through the origin; the "
                    "standard takes 5 to 95 % and a line with an offset"
                ),
            ),
        ),
    ),
    "dsnu": _entry(
        "Dark signal non-uniformity",
        "e-",
        "DN",
        section="Gain and noise",
        better="lower",
        standard=(
            StandardRow(
                order=15,
                unit="e-",
                name="Dark signal non-uniformity",
                symbol="DSNU_1288",
                clause="eq. 66",
                element=("spatial", "DSNU1288"),
                departure=NO_HIGH_PASS,
            ),
        ),
    ),
    "prnu": _entry(
        "Photoresponse non-uniformity",
        "%",
        section="Gain and noise",
        better="lower",
        standard=(
            StandardRow(
                order=16,
                unit="%",
                name="Photoresponse non-uniformity",
                symbol="PRNU_1288",
                clause="eq. 67",
                element=("spatial", "PRNU1288"),
                departure=NO_HIGH_PASS,
            ),
        ),
    ),
    "dark_current": _entry(
        "Dark current",
        "DN/s",
        "e-/s",
        section="Gain and noise",
        better="lower",
        standard=(
            StandardRow(
                order=13,
                unit="e-/s",
                name="Dark current",
                symbol="μ_I.mean",
                clause="7.1, eq. 29",
                element=("dark_current", "u_I_mean"),
            ),
        ),
    ),
    "dark_doubling_temperature": _entry(
        "Dark-current doubling temperature",
        "K",
        standard=(
            StandardRow(
                order=14,
                unit="K",
                name="Doubling temperature of the dark current",
                symbol="T_d",
                clause="3.2",
                element=("dark_current", "T_d"),
            ),
        ),
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
        standard=(
            StandardRow(
                order=1,
                unit="DN/photon",
                name="Responsivity",
                symbol="R",
                clause="eq. 49",
                element=("sensitivity", "R"),
            ),
        ),
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
