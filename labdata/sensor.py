"""The description of an image-intensified camera, stage by stage, every number with its range and source."""

from dataclasses import dataclass, field, fields, is_dataclass, replace

import numpy as np

from labdata.errors import BadInput
from labdata.parameter import Parameter


@dataclass(frozen=True, kw_only=True)
class Optics:
    """Lens. Lengths at the photocathode."""

    f_number: Parameter
    transmission: Parameter
    aberration_blur_um: Parameter  # s of the MTF exp(-2 (pi f s)^2)
    veiling_glare_fraction: Parameter
    focal_length_mm: Parameter


@dataclass(frozen=True, kw_only=True)
class Photocathode:
    """Photocathode and the proximity gap behind it."""

    material: str
    wavelength_nm: tuple[float, ...]
    relative_quantum_efficiency: tuple[float, ...]  # scaled to the luminous sensitivity
    spectral_range_nm: tuple[float, float]  # as the maker states it
    luminous_sensitivity_ua_per_lm: Parameter  # at 2856 K
    ebi_lm_per_cm2: Parameter
    diameter_mm: Parameter
    gap_mm: Parameter
    gap_v: Parameter
    bright_source_v: Parameter  # across the gap once the supply protects the cathode from a bright source
    lateral_energy_ev: Parameter  # mean energy of emission across the axis
    gap_resolution_lp_per_mm: Parameter  # where the gap's own contrast is 3 %
    ebi_doubling_k: Parameter  # warming that doubles the EBI
    ebi_temperature_c: Parameter  # temperature at which the EBI is stated
    halo_fraction: Parameter  # of the photoelectrons that land after an elastic or partial bounce
    halo_elastic_share: Parameter  # of the halo electrons, keep their energy (rim); others: uniform in energy


@dataclass(frozen=True, kw_only=True)
class MicrochannelPlate:
    """Microchannel plate with its film."""

    detection_probability: Parameter
    film_transmission: Parameter  # the factors of the detection probability: T (OAR + (1 - OAR) recovery)
    open_area_ratio: Parameter
    web_recovery: Parameter
    pulse_height_shape: Parameter  # Polya k; 1 is exponential
    reference_v: Parameter  # voltage at which the tube has its nominal luminous gain
    gain_exponent: Parameter  # G = G0 (V / V0)^m
    electron_gain: Parameter  # electrons out per electron in, at reference_v
    channel_pitch_um: Parameter
    resolution_lp_per_mm: Parameter  # where the plate's own contrast is 3 %
    strip_current_ua_per_cm2: Parameter
    saturation_fraction: Parameter  # a of G / (1 + j / (a j_strip))
    saturation_blur_um: Parameter  # width of the neighbourhood whose current lowers the gain
    channel_recovery_ms: Parameter
    ion_event_rate_per_s_cm2: Parameter
    ion_event_size_pe: Parameter


@dataclass(frozen=True, kw_only=True)
class Tube:
    """What is known of the tube only as a whole."""

    name: str
    luminous_gain: Parameter  # lm/lm (fL/fc), at reference_v
    limiting_resolution_lp_per_mm: Parameter
    mtf_frequency_lp_per_mm: Parameter  # fc of exp(-(f/fc)^n), at the cathode
    mtf_exponent: Parameter  # n
    post_gain_share: Parameter  # share of the exponent (f/fc)^n that acts after the gain
    magnification: Parameter
    life_h: Parameter
    brightness_control_lux: Parameter  # illuminance at the cathode above which the supply lowers the plate's voltage
    brightness_control_s: Parameter  # its attack time


@dataclass(frozen=True, kw_only=True)
class Phosphor:
    """Screen."""

    name: str
    luminous_efficacy_lm_per_w: Parameter
    photon_energy_ev: Parameter
    peak_nm: Parameter
    width_nm: Parameter  # full width at half maximum
    photons_per_electron: Parameter  # out of the window, per electron that leaves the plate
    screen_kv: Parameter
    resolution_lp_per_mm: Parameter  # where the screen's own contrast is 3 %
    fast_fraction: Parameter  # of the light at the start of the decay
    fast_decay_ms: Parameter
    slow_decay_ms: Parameter
    gain_nonuniformity: Parameter  # relative standard deviation


@dataclass(frozen=True, kw_only=True)
class Taper:
    """Fibre-optic taper (or relay)."""

    demagnification: Parameter
    transmission: Parameter
    numerical_aperture: Parameter  # the factors of the transmission: (NA / M)^2 core bulk
    core_fraction: Parameter
    bulk_transmission: Parameter
    fibre_pitch_um: Parameter  # at the small end
    interface_mtf_lp_per_mm: Parameter  # f0 of exp(-(f/f0)^2), at the detector
    pattern_contrast: Parameter  # depth of the multi-fibre boundaries
    pattern_pitch_um: Parameter
    distortion_fraction: Parameter  # at the corner
    shear_um: Parameter


@dataclass(frozen=True, kw_only=True)
class Ccd:
    """Interline CCD."""

    columns: int
    rows: int
    pitch_x_um: Parameter
    pitch_y_um: Parameter
    quantum_efficiency: Parameter  # fill factor included, at the phosphor's peak
    full_well_e: Parameter  # of one field pixel as read
    read_noise_e: Parameter
    dark_current_e_per_s: Parameter  # per pixel at 25 C
    dark_current_doubling_k: Parameter
    prnu: Parameter  # relative standard deviation
    smear_fraction: Parameter  # of the overexposed pixel, for a spot one tenth of the picture high
    antibloom_ratio: Parameter  # overexposure that the drain carries off, in full wells


@dataclass(frozen=True, kw_only=True)
class Video:
    """Read-out, video and digitiser."""

    interlaced: bool
    lines: int  # of a frame, the blanked ones counted
    field_rate_hz: Parameter
    pixel_clock_mhz: Parameter
    bandwidth_mhz: Parameter
    filter_order: int
    aperture_correction_db: Parameter  # boost at 4.5 MHz
    resolution_horizontal_tvl: Parameter  # television lines per picture height
    resolution_vertical_tvl: Parameter
    output_vpp: Parameter
    impedance_ohm: Parameter
    setup_ire: Parameter  # black above blanking
    sensitivity_lux: Parameter  # as the maker states it
    signal_to_noise_db: Parameter
    gamma: Parameter
    automatic_gain: bool  # what the camera can do; whether it was on belongs to the session
    automatic_gain_range_db: Parameter
    automatic_gain_s: Parameter  # time constant
    bit_depth: int
    black_level_dn: Parameter
    conversion_gain_dn_per_e: Parameter  # K, DN per CCD electron


@dataclass(frozen=True, kw_only=True)
class Draws:
    """Joint posterior draws of the fitted parameters, by path such as "tube.post_gain_share".

    Parameters
    ----------
    names
        Paths of the parameters.
    values
        Draws, one tuple per draw in the order of the names.
    """

    names: tuple[str, ...] = ()
    values: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        if any(len(row) != len(self.names) for row in self.values):
            raise BadInput(f"every draw must hold {len(self.names)} numbers, one for each name")


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """An image-intensified camera.

    `float(sensor.ccd.pitch_x_um)` is a number; `sensor.ccd.pitch_x_um.source` says where it comes from.
    """

    name: str
    optics: Optics
    photocathode: Photocathode
    microchannel_plate: MicrochannelPlate
    tube: Tube
    phosphor: Phosphor
    taper: Taper
    ccd: Ccd
    video: Video
    draws: Draws = field(default_factory=Draws)
    notes: tuple[str, ...] = ()

    def parameters(self) -> dict[str, Parameter]:
        """Every parameter by its path, such as "optics.f_number"."""
        return {
            f"{stage.name}.{item.name}": value
            for stage in fields(self)
            if is_dataclass(part := getattr(self, stage.name))
            for item in fields(part)
            if isinstance(value := getattr(part, item.name), Parameter)
        }

    def with_parameters(self, changes: dict[str, Parameter]) -> "Sensor":
        """Return a copy with parameters replaced by path."""
        if unknown := changes.keys() - self.parameters().keys():
            raise BadInput(f"a sensor parameter must be one of its stages' own, got {sorted(unknown)}")
        stages: dict[str, dict[str, Parameter]] = {}
        for path, parameter in changes.items():
            stage, name = path.split(".")
            stages.setdefault(stage, {})[name] = parameter
        return replace(self, **{stage: replace(getattr(self, stage), **named) for stage, named in stages.items()})

    def with_values(self, values: dict[str, float]) -> "Sensor":
        """Return a copy in which parameters have other values, exact, by path."""
        known = self.parameters()
        if unknown := values.keys() - known.keys():
            raise BadInput(f"a sensor parameter must be one of its stages' own, got {sorted(unknown)}")
        return self.with_parameters(
            {path: replace(known[path], value=float(value), low=None, high=None) for path, value in values.items()}
        )

    def draw(self, rng: np.random.Generator) -> "Sensor":
        """Return the sensor of one joint posterior draw; a sensor without draws is a BadInput."""
        if not self.draws.values:
            raise BadInput(f"the sensor {self.name!r} has no posterior draws; only a fitted sensor can be drawn")
        row = self.draws.values[int(rng.integers(len(self.draws.values)))]
        return self.with_values(dict(zip(self.draws.names, row, strict=True)))
