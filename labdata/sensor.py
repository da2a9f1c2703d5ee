"""Sensor description of an image-intensified camera, stage by stage."""

from dataclasses import dataclass, field, replace

from labdata.calibration import GainTable
from labdata.camera_description import (
    Description,
    Draws,
    Parameter,
    must_be_an_efficiency_table,
)
from labdata.errors import BadInput, check, check_range
from labdata.limits import TubeLimits


@dataclass(frozen=True, kw_only=True)
class Optics:
    """Lens. Lengths at the photocathode, or at the chip of a camera without a tube."""

    f_number: Parameter
    transmission: Parameter
    aberration_blur_um: Parameter  #: s of the MTF exp(-2 (pi f s)^2)
    veiling_glare_fraction: Parameter
    focal_length_mm: Parameter
    vignetting_fraction: Parameter  #: of the light, lost at the picture's corner beyond cos^4
    distortion_fraction: Parameter  #: radial, at the picture's corner; positive is pincushion
    focal_shift_um: Parameter  #: how far 925 nm focuses behind 500 nm; linear in wavelength
    focus_nm: Parameter  #: wavelength of best focus

    def __post_init__(self) -> None:
        check(
            self,
            positive="f_number focal_length_mm focus_nm",
            fraction="transmission veiling_glare_fraction vignetting_fraction",
            not_negative="aberration_blur_um",
        )
        check_range(self, -0.5, 0.5, "distortion_fraction")


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


@dataclass(frozen=True, kw_only=True)
class Ccd:
    """CCD, interline or frame-transfer."""

    columns: int
    rows: int
    pitch_x_um: Parameter
    pitch_y_um: Parameter
    #: fill factor included, at the phosphor's peak; without a tube, the table's highest
    quantum_efficiency: Parameter
    full_well_e: Parameter  #: of one pixel as read
    read_noise_e: Parameter
    dark_current_e_per_s: Parameter  #: per pixel at 25 C
    dark_current_doubling_k: Parameter
    prnu: Parameter  #: relative standard deviation
    smear_fraction: Parameter  #: of the overexposed pixel, for a spot one tenth of the picture high
    #: overexposure that the drain carries off, in full wells; 1 is no drain
    antibloom_ratio: Parameter
    dsnu_e: Parameter  #: standard deviation of the fixed dark pattern, per exposure at 25 C

    def __post_init__(self) -> None:
        check(
            self,
            one_or_more="columns rows",
            positive="pitch_x_um pitch_y_um full_well_e dark_current_doubling_k quantum_efficiency",
            fraction="quantum_efficiency smear_fraction",
            not_negative="read_noise_e dark_current_e_per_s prnu dsnu_e antibloom_ratio",
        )


@dataclass(frozen=True, kw_only=True)
class Video:
    """Read-out and digitiser; of an analog camera, the video between them. A digital one has no
    bandwidth.
    """

    interlaced: bool
    field_rate_hz: Parameter  #: exposures per second; a progressive camera has one field a frame
    gamma: Parameter
    automatic_gain: bool  #: what the camera can do; whether it was on belongs to the session
    bit_depth: int
    black_level_dn: Parameter
    #: K, DN per electron at the output, behind any multiplication
    conversion_gain_dn_per_e: Parameter
    lines: int | None = None  #: of a frame, the blanked ones counted
    pixel_clock_mhz: Parameter | None = None
    bandwidth_mhz: Parameter | None = None
    filter_order: int | None = None
    aperture_correction_db: Parameter | None = None  #: boost at 4.5 MHz
    resolution_horizontal_tvl: Parameter | None = None  #: television lines per picture height
    resolution_vertical_tvl: Parameter | None = None
    output_vpp: Parameter | None = None
    impedance_ohm: Parameter | None = None
    setup_ire: Parameter | None = None  #: black above blanking
    sensitivity_lux: Parameter | None = None  #: as the maker states it
    signal_to_noise_db: Parameter | None = None
    automatic_gain_range_db: Parameter | None = None
    automatic_gain_s: Parameter | None = None  #: time constant
    sync_jitter_ns: Parameter | None = None  #: standard deviation of a line's start
    line_noise_dn: Parameter | None = None  #: standard deviation of an offset common to a line

    def __post_init__(self) -> None:
        check(self, positive="field_rate_hz gamma conversion_gain_dn_per_e")
        check_range(self, 1, 16, "bit_depth")
        given = [name for name in _ANALOG if getattr(self, name) is not None]
        if self.digital and given:
            raise BadInput(
                f"a camera without bandwidth_mhz must have no analog video, got {', '.join(given)}"
            )
        if not self.digital and len(given) < len(_ANALOG):
            missing = [name for name in _ANALOG if getattr(self, name) is None]
            raise BadInput(
                f"a camera with bandwidth_mhz must have all its analog video, got no "
                f"{', '.join(missing)}"
            )
        if self.automatic_gain and None in (self.automatic_gain_range_db, self.automatic_gain_s):
            raise BadInput(
                "a camera with automatic_gain must have automatic_gain_range_db and "
                "automatic_gain_s"
            )
        check(
            self,
            positive="bandwidth_mhz pixel_clock_mhz automatic_gain_s",
            not_negative="sync_jitter_ns line_noise_dn automatic_gain_range_db",
            one_or_more="filter_order",
        )

    @property
    def digital(self) -> bool:
        """Whether the charge is digitised pixel by pixel, without a video signal between."""
        return self.bandwidth_mhz is None

    @property
    def low_pass(self) -> tuple[float, float, int] | None:
        """Bandwidth in MHz, pixel clock in MHz and order of the video's low pass; None of a digital
        camera.
        """
        if self.bandwidth_mhz is None or self.pixel_clock_mhz is None or self.filter_order is None:
            return None
        return float(self.bandwidth_mhz), float(self.pixel_clock_mhz), self.filter_order


# What the simulated video of an analog camera cannot do without, and a digital camera cannot have.
_ANALOG = (
    "lines",
    "pixel_clock_mhz",
    "filter_order",
    "aperture_correction_db",
    "sync_jitter_ns",
    "line_noise_dn",
)


@dataclass(frozen=True, kw_only=True)
class Sensor(Description):
    """An image-intensified camera.

    `float(sensor.ccd.pitch_x_um)` is a number; `sensor.ccd.pitch_x_um.source` says where it comes
    from.
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
    limits: TubeLimits = field(default_factory=TubeLimits)
    gain_table: GainTable | None = None  #: calibration of this very tube, where there is one
    draws: Draws = field(default_factory=Draws)
    notes: tuple[str, ...] = ()

    def with_phosphor(self, phosphor: Phosphor) -> "Sensor":
        """Return the same tube with another screen, see `labdata.phosphors.load_phosphor`.

        Notes
        -----
        A luminous gain holds for the tube's own screen. What stays is the number of screen photons
        per photoelectron, G/(K_lm E_ph) / (S/e), so that G goes as K_lm E_ph of the screen: the
        plate makes up for a dimmer phosphor, its electron gain goes as one over the photons per
        electron, and its strip current limits it sooner. Only where the new screen's photons per
        electron were measured ("sheet" or "fitted") does the plate keep its electron gain and G
        goes with them too. Blur and the CCD's efficiency stay; a calibration of the old screen's
        gain is left out.
        """
        lumens = _lumens_per_photon(phosphor) / _lumens_per_photon(self.phosphor)
        brighter = float(phosphor.photons_per_electron) / float(self.phosphor.photons_per_electron)
        measured = phosphor.photons_per_electron.standing in ("sheet", "fitted")
        factors = {
            "tube.luminous_gain": lumens * (brighter if measured else 1.0),
            "microchannel_plate.electron_gain": 1.0 if measured else 1.0 / brighter,
        }
        known, words = self.parameters(), f"; scaled from {self.phosphor.name} to {phosphor.name}"
        changed = self.with_parameters(
            {path: known[path].times(factor, words) for path, factor in factors.items()}
        )
        kept = "electron gain of the plate" if measured else "photons per photoelectron"
        note = f"Screen changed from {self.phosphor.name} to {phosphor.name}; the {kept} stayed."
        draws, notes = self.draws.without_phosphor(factors), (*self.notes, note)
        return replace(changed, phosphor=phosphor, gain_table=None, draws=draws, notes=notes)


def _lumens_per_photon(phosphor: Phosphor) -> float:
    """Luminous efficacy times photon energy, lm s per photon up to the elementary charge."""
    return float(phosphor.luminous_efficacy_lm_per_w) * float(phosphor.photon_energy_ev)
