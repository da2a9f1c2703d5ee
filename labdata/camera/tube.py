"""Sections of a camera description: stages of an image intensifier tube, and its limits."""

from dataclasses import dataclass, field, fields
from typing import Any

from labdata.camera.parameters import Parameter, must_be_an_efficiency_table
from labdata.errors import BadInput, check, check_range

# ruff: noqa: RUF009 - `_cautious` returns a field.


@dataclass(frozen=True, kw_only=True)
class Photocathode:
    """Photocathode and the proximity gap behind it."""

    material: str
    wavelength_nm: tuple[float, ...]
    relative_quantum_efficiency: tuple[float, ...]  #: scaled to the luminous sensitivity
    spectral_range_nm: tuple[float, float]  #: as the maker states it
    luminous_sensitivity_ua_per_lm: Parameter  #: at 2856 K
    ebi_lm_per_cm2: Parameter
    diameter_mm: Parameter
    gap_mm: Parameter
    gap_v: Parameter
    #: across the gap once the supply protects the cathode from a bright source
    bright_source_v: Parameter
    lateral_energy_ev: Parameter  #: mean energy of emission across the axis
    gap_resolution_lp_per_mm: Parameter  #: where the gap's own contrast is 3 %
    ebi_doubling_k: Parameter  #: warming that doubles the EBI
    ebi_temperature_c: Parameter  #: temperature at which the EBI is stated
    halo_fraction: Parameter  #: of the photoelectrons that land after an elastic or partial bounce
    #: of the halo electrons, keep their energy (rim); others: uniform in energy
    halo_elastic_share: Parameter
    gate_on_off_ratio: Parameter  #: light through the open gate over light through the shut one
    #: mean illuminance of the cathode that lowers gap_v to bright_source_v
    bright_source_lux: Parameter

    def __post_init__(self) -> None:
        must_be_an_efficiency_table(self.wavelength_nm, self.relative_quantum_efficiency)
        check(
            self,
            positive="luminous_sensitivity_ua_per_lm diameter_mm gap_mm gap_v bright_source_v "
            "lateral_energy_ev gap_resolution_lp_per_mm ebi_doubling_k bright_source_lux",
            not_negative="ebi_lm_per_cm2",
            fraction="halo_fraction halo_elastic_share",
        )
        check(self, one_or_more="gate_on_off_ratio")
        if not float(self.bright_source_v) <= float(self.gap_v):
            raise BadInput(
                f"bright_source_v must not exceed gap_v, got {float(self.bright_source_v):g} over "
                f"{float(self.gap_v):g}"
            )


@dataclass(frozen=True, kw_only=True)
class MicrochannelPlate:
    """Microchannel plate, or stack of plates, with its film; gain and pulse heights are those of
    the stack.
    """

    detection_probability: Parameter
    #: the factors of the detection probability: T (OAR + (1 - OAR) recovery)
    film_transmission: Parameter
    open_area_ratio: Parameter
    web_recovery: Parameter
    pulse_height_shape: Parameter  #: Polya k; 1 is exponential
    reference_v: Parameter  #: voltage at which the tube has its nominal luminous gain
    gain_exponent: Parameter  #: G = G0 (V / V0)^m
    electron_gain: Parameter  #: electrons out per electron in, at reference_v
    channel_pitch_um: Parameter
    resolution_lp_per_mm: Parameter  #: where the plate's own contrast is 3 %
    strip_current_ua_per_cm2: Parameter
    saturation_fraction: Parameter  #: a of G / (1 + j / (a j_strip))
    saturation_blur_um: Parameter  #: width of the neighbourhood whose current lowers the gain
    channel_recovery_ms: Parameter
    ion_event_rate_per_s_cm2: Parameter
    ion_event_size_pe: Parameter
    stages: int  #: plates in the stack
    #: counts of the gain's control word that raise the gain by gain_control_ratio
    gain_control_counts: Parameter
    gain_control_ratio: Parameter
    gain_control_reference: Parameter  #: counts at which the tube has its nominal luminous gain
    pattern_contrast: Parameter  #: depth of the plate's multi-fibre boundaries
    pattern_pitch_um: Parameter  #: of that pattern, at the cathode

    def __post_init__(self) -> None:
        check(
            self,
            fraction=(
                "detection_probability film_transmission open_area_ratio web_recovery "
                "pattern_contrast"
            ),
            positive="detection_probability pulse_height_shape reference_v electron_gain "
            "channel_pitch_um resolution_lp_per_mm pattern_pitch_um gain_control_counts "
            "strip_current_ua_per_cm2 saturation_fraction channel_recovery_ms",
            not_negative="gain_exponent saturation_blur_um gain_control_reference "
            "ion_event_rate_per_s_cm2 ion_event_size_pe",
            one_or_more="stages",
        )
        check_range(self, 0.1, 1e6, "pulse_height_shape")
        if not float(self.gain_control_ratio) > 1.0:
            raise BadInput(
                f"gain_control_ratio must exceed 1, got {float(self.gain_control_ratio):g}"
            )


@dataclass(frozen=True, kw_only=True)
class Tube:
    """Parameters of the complete tube."""

    name: str
    luminous_gain: Parameter  #: lm/lm (fL/fc), at reference_v
    limiting_resolution_lp_per_mm: Parameter
    mtf_frequency_lp_per_mm: Parameter  #: fc of exp(-(f/fc)^n), at the cathode
    mtf_exponent: Parameter  #: n
    post_gain_share: Parameter  #: share of the exponent (f/fc)^n that acts after the gain
    magnification: Parameter
    life_h: Parameter
    #: illuminance at the cathode above which the supply lowers the plate's voltage
    brightness_control_lux: Parameter
    brightness_control_s: Parameter  #: its attack time

    def __post_init__(self) -> None:
        check(
            self,
            positive="luminous_gain limiting_resolution_lp_per_mm mtf_frequency_lp_per_mm "
            "mtf_exponent magnification brightness_control_lux brightness_control_s",
            fraction="post_gain_share",
        )
        check_range(self, 0.0, 10.0, "mtf_exponent")


@dataclass(frozen=True, kw_only=True)
class Phosphor:
    """Screen."""

    name: str
    luminous_efficacy_lm_per_w: Parameter
    photon_energy_ev: Parameter
    peak_nm: Parameter
    width_nm: Parameter  #: full width at half maximum
    photons_per_electron: Parameter  #: out of the window, per electron that leaves the plate
    screen_kv: Parameter
    resolution_lp_per_mm: Parameter  #: where the screen's own contrast is 3 %
    fast_fraction: Parameter  #: of the light at the start of the decay
    fast_decay_ms: Parameter
    slow_decay_ms: Parameter
    gain_nonuniformity: Parameter  #: relative standard deviation

    def __post_init__(self) -> None:
        check(
            self,
            positive="luminous_efficacy_lm_per_w photon_energy_ev peak_nm width_nm "
            "photons_per_electron screen_kv resolution_lp_per_mm fast_decay_ms slow_decay_ms",
            fraction="fast_fraction",
            not_negative="gain_nonuniformity",
        )


@dataclass(frozen=True, kw_only=True)
class Taper:
    """Fibre-optic taper (or relay)."""

    demagnification: Parameter
    transmission: Parameter
    numerical_aperture: Parameter  #: the factors of the transmission: (NA / M)^2 core bulk
    core_fraction: Parameter
    bulk_transmission: Parameter
    fibre_pitch_um: Parameter  #: at the small end
    interface_mtf_lp_per_mm: Parameter  #: f0 of exp(-(f/f0)^2), at the detector
    pattern_contrast: Parameter  #: depth of the multi-fibre boundaries
    pattern_pitch_um: Parameter
    distortion_fraction: Parameter  #: at the corner
    shear_um: Parameter

    def __post_init__(self) -> None:
        check(
            self,
            positive="demagnification transmission numerical_aperture fibre_pitch_um "
            "interface_mtf_lp_per_mm pattern_pitch_um",
            fraction="transmission core_fraction bulk_transmission pattern_contrast",
            not_negative="shear_um",
        )
        check_range(self, -0.5, 0.5, "distortion_fraction")


_UNKNOWN = "nothing is known of this tube: "


def _cautious(value: float, reason: str) -> Any:
    """Return the field of a limit of an unknown tube."""
    return field(
        default_factory=lambda: Parameter(value=value, standing="default", source=_UNKNOWN + reason)
    )


@dataclass(frozen=True, kw_only=True)
class TubeLimits:
    """Limits of a tube; the source of each parameter gives the reason. The defaults suit an unknown
    tube.
    """

    #: Highest voltage across the microchannel plate, V
    mcp_v: Parameter = _cautious(900.0, "a single plate works at 500 to 900 V, never above 1000 V")
    #: Fastest rise of that voltage, V/s
    ramp_v_per_s: Parameter = _cautious(
        50.0, "small steps let a plate outgas; slower after storage"
    )
    gate_ns: Parameter = _cautious(2e7, "one field of 50 Hz video")  #: Longest gate, ns
    #: Largest fraction of the time that the gate may be open
    gate_duty: Parameter = _cautious(0.999, "a gate unit needs to recover between pulses")
    #: Brightest large area on the photocathode, lux, whatever the gain
    illuminance_lux: Parameter = _cautious(
        1e-2, "night sky with a moon; a supply protects its tube above this"
    )
    #: Brightest image of a pinhole on the photocathode, lux, whatever the gain
    point_illuminance_lux: Parameter = _cautious(
        10.0, "too small an area to strain the tube, but the cathode ages there"
    )
    #: Largest mean MCP output current density at the present gain and duty, without saturation,
    #: nA/cm2
    anode_na_per_cm2: Parameter = _cautious(
        100.0, "a tenth of a strip current of 1 uA/cm2 keeps the plate linear"
    )
    #: The same inside the image of a pinhole, where the MCP saturates far below it
    point_anode_na_per_cm2: Parameter = _cautious(
        3e6, "what 10 lux ask of a gain of 1000; the plate gives its strip current"
    )
    #: Charge through the phosphor at which the photocathode is expected to have aged, C/cm2; only a
    #: warning
    screen_charge_c_per_cm2: Parameter = _cautious(
        0.1, "uncoated plates age their cathodes within 0.1 to 1 C/cm2"
    )

    def __post_init__(self) -> None:
        check(self, positive=(item.name for item in fields(self)), fraction="gate_duty")
