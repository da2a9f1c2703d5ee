"""Stages of the intensified camera with the values of its description."""

from dataclasses import dataclass

import numpy as np

from labdata.camera_description import Parameter
from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.sensor import Sensor
from simulate.iiccd import tube_photometry
from simulate.iiccd.automatic_controls import SET_LEVEL, AutomaticGain, BrightnessControl
from simulate.iiccd.ccd import Ccd
from simulate.iiccd.grid import DARK_REFERENCE_C, SensorGeometryCamera
from simulate.iiccd.lens import Optics, RadiometricLens
from simulate.iiccd.microchannel import MicrochannelPlate
from simulate.iiccd.phosphor import Phosphor, PhosphorDecay
from simulate.iiccd.photocathode import BrightSourceProtection, Photocathode, ProximityGap
from simulate.iiccd.taper import FibreGeometry, Taper
from simulate.iiccd.transfer import FibreTaper, HaloBlur, Lens, TubeShare, VideoFilter
from simulate.iiccd.video import NoFilter, Video


@dataclass(frozen=True)
class DescribedCamera(SensorGeometryCamera):
    """The stages of an image-intensified camera, each from its description.

    Parameters
    ----------
    sensor
        The description; its values are taken as the truth.
    geometry
        Whether the taper distorts and shears the image. The lab bench measures without: its targets are known on the
        frame.
    local_depletion
        Whether an MCP's gain falls place by place under its own load; otherwise all of the MCP falls alike.
    left_out
        Names of neglected effects, see `simulate.iiccd.effect_bounds`.
    """

    sensor: Sensor
    geometry: bool = False
    local_depletion: bool = False
    left_out: frozenset[str] = frozenset()

    def _unless(self, effect: str, value: Parameter | float) -> float:
        """The value of a retained effect, 0 for a neglected one."""
        return 0.0 if effect in self.left_out else float(value)

    @property
    def camera_description(self) -> Sensor:
        """The description."""
        return self.sensor

    @property
    def demagnification(self) -> float:
        """Size of the image on the photocathode over its size on the chip, dimensionless."""
        return float(self.sensor.taper.demagnification)

    @property
    def is_interlaced(self) -> bool:
        """Whether a frame is two fields exposed one after the other."""
        return self.sensor.video.interlaced

    @property
    def fields_per_frame(self) -> int:
        """Exposures in one frame."""
        return 2 if self.is_interlaced else 1

    @property
    def field_s(self) -> float:
        """Time from one exposure to the next, s."""
        return 1.0 / float(self.sensor.video.field_rate_hz)

    @property
    def frame_s(self) -> float:
        """Time from one frame to the next, s."""
        return self.field_s * self.fields_per_frame

    def gate_s(self, conditions: Conditions) -> float:
        """Time the gate is open in one exposure, s: the whole field unless the conditions say less."""
        if conditions.gate_ns is None:
            return self.field_s
        if not 0.0 < conditions.gate_ns <= self.field_s * 1e9 * 1.001:
            raise BadInput(
                f"gate_ns must be positive and at most one exposure, {self.field_s * 1e9:.6g} ns, "
                f"got {conditions.gate_ns:g}"
            )
        return min(conditions.gate_ns * 1e-9, self.field_s)

    def lens(self, magnification: float = 0.0) -> RadiometricLens:
        """Return the lens for scenes of known radiance; `optics` of the chain is for light stated at the cathode."""
        cathode = self.sensor.photocathode
        detector = cathode.wavelength_nm, cathode.relative_quantum_efficiency
        return RadiometricLens.of(
            self.sensor.optics, detector, self.scene_cells, magnification=magnification, row_pairs=self.is_interlaced
        )

    def optics(self) -> Optics:
        optics = self.sensor.optics
        blur = Lens(aberration_blur_um=float(optics.aberration_blur_um), f_number=float(optics.f_number))
        return Optics(blur=blur, veiling_glare_fraction=float(optics.veiling_glare_fraction))

    def photocathode(self, conditions: Conditions) -> Photocathode:
        """Return the photocathode; photons are referred to the wavelength where its efficiency peaks."""
        table = self.sensor.photocathode.wavelength_nm
        return Photocathode(
            quantum_efficiency=float(tube_photometry.quantum_efficiency(self.sensor, table).max()),
            gate_s=self.gate_s(conditions),
            ebi_per_s_cm2=self._unless(
                "dark emission", tube_photometry.ebi_per_s_cm2(self.sensor, conditions.temperature_c)
            ),
            on_off_ratio=float(self.sensor.photocathode.gate_on_off_ratio),
            field_s=self.field_s,
        )

    def gap(self, cathode_lux: float) -> ProximityGap:
        cathode = self.sensor.photocathode
        halo = HaloBlur(
            fraction=self._unless("halo", cathode.halo_fraction),
            gap_mm=float(cathode.gap_mm),
            elastic_share=float(cathode.halo_elastic_share),
        )
        spread = self._share(1.0 - float(self.sensor.tube.post_gain_share))
        protected = "bright-source protection" not in self.left_out
        protection = self.bright_source_protection().blur(cathode_lux) if protected else None
        return ProximityGap(spread=spread, halo=halo, grid=self.cells, protection=protection)

    def _share(self, share: float) -> TubeShare:
        tube = self.sensor.tube
        return TubeShare(
            share=share,
            frequency_lp_per_mm=float(tube.mtf_frequency_lp_per_mm),
            exponent=float(tube.mtf_exponent),
        )

    def bright_source_protection(self) -> BrightSourceProtection:
        """Return the bright-source protection of the cathode."""
        cathode = self.sensor.photocathode
        return BrightSourceProtection(
            gap_v=float(cathode.gap_v),
            protected_v=float(cathode.bright_source_v),
            protected_lux=float(cathode.bright_source_lux),
            gap_mm=float(cathode.gap_mm),
            lateral_energy_ev=float(cathode.lateral_energy_ev),
        )

    def fibre_geometry(self) -> FibreGeometry:
        taper = self.sensor.taper
        return FibreGeometry(
            distortion_fraction=float(taper.distortion_fraction),
            shear_um=float(taper.shear_um),
            pattern_pitch_um=float(taper.pattern_pitch_um),
            demagnification=float(taper.demagnification),
            pattern_seed=self.pattern_seed,
        )

    def mcp(self, conditions: Conditions) -> MicrochannelPlate:
        """Return the MCP at the voltage or control word of the conditions.

        Raises
        ------
        BadInput
            If the conditions set the MCP twice, or a gain that a tube does not have.
        """
        if conditions.em_gain is not None:
            raise BadInput(f"em_gain must be left out of a camera with a tube, got {conditions.em_gain:g}")
        plate = self.sensor.microchannel_plate
        per_electron = float(self.sensor.phosphor.photons_per_electron)
        strip = float(plate.strip_current_ua_per_cm2) * float(plate.saturation_fraction) * 1e-6
        gain = tube_photometry.photons_per_photoelectron(self.sensor) / per_electron
        return MicrochannelPlate(
            detection_probability=float(plate.detection_probability),
            pulse_height_shape=float(plate.pulse_height_shape),
            gain=gain * tube_photometry.gain_factor(self.sensor, conditions.mcp_v, conditions.gain_control),
            saturation_e_per_s_cm2=np.inf
            if "plate saturation" in self.left_out
            else strip / tube_photometry.ELEMENTARY_CHARGE_C,
            field_s=self.field_s,
            ion_events_per_s_cm2=self._unless("ion events", plate.ion_event_rate_per_s_cm2),
            ion_event_size_pe=float(plate.ion_event_size_pe),
            gate_s=self.gate_s(conditions),
            stages=plate.stages,
            pattern_contrast=self._unless("multi-fibre pattern", plate.pattern_contrast),
            pattern_pitch_um=float(plate.pattern_pitch_um),
            line_um=float(plate.channel_pitch_um),
            depletion_blur_um=float(plate.saturation_blur_um) if self._depletes_locally else None,
            recovery_ms=float(plate.channel_recovery_ms),
        )

    @property
    def _depletes_locally(self) -> bool:
        return self.local_depletion and "local depletion" not in self.left_out

    def phosphor(self) -> Phosphor:
        return Phosphor(
            photons_per_electron=float(self.sensor.phosphor.photons_per_electron),
            spread=self._share(float(self.sensor.tube.post_gain_share)),
            gain_nonuniformity=self._unless("screen mottle", self.sensor.phosphor.gain_nonuniformity),
            pattern_seed=self.pattern_seed,
        )

    def taper(self) -> Taper:
        taper = self.sensor.taper
        blur = FibreTaper(
            fibre_pitch_um=float(taper.fibre_pitch_um),
            interface_lp_per_mm=float(taper.interface_mtf_lp_per_mm),
            demagnification=float(taper.demagnification),
        )
        return Taper(
            transmission=float(taper.transmission),
            blur=blur,
            pattern_contrast=self._unless("chicken wire", taper.pattern_contrast),
            pattern_pitch_um=float(taper.pattern_pitch_um),
            # Fibres of both multi-fibres are squeezed where they meet.
            line_um=2.0 * float(taper.fibre_pitch_um),
            demagnification=float(taper.demagnification),
        )

    def afterglow(self, conditions: Conditions) -> PhosphorDecay:
        """Return the decay of the phosphor."""
        phosphor = self.sensor.phosphor
        return PhosphorDecay(
            fast_fraction=float(phosphor.fast_fraction),
            fast_decay_ms=self._unless("afterglow", phosphor.fast_decay_ms),
            slow_decay_ms=self._unless("afterglow", phosphor.slow_decay_ms),
            gate_s=self.gate_s(conditions),
            field_s=self.field_s,
        )

    def ccd(self, conditions: Conditions) -> Ccd:
        ccd = self.sensor.ccd
        warmer = 0.0 if conditions.temperature_c is None else conditions.temperature_c - DARK_REFERENCE_C
        warmth = 2.0 ** (warmer / float(ccd.dark_current_doubling_k))
        dark = float(ccd.dark_current_e_per_s) * warmth * self.field_s * (2 if self.is_interlaced else 1)
        return Ccd(
            quantum_efficiency=float(ccd.quantum_efficiency),
            full_well_e=np.inf if "overflow" in self.left_out else float(ccd.full_well_e),
            antibloom_ratio=float(ccd.antibloom_ratio),
            dark_e=self._unless("dark charge", dark),
            dsnu_e=self._unless("dark pattern", ccd.dsnu_e) * warmth,
            read_noise_e=self._unless("read noise", ccd.read_noise_e),
            prnu=self._unless("unequal pixels", ccd.prnu),
            smear_fraction=self._unless("smear", ccd.smear_fraction),
            interlaced=self.is_interlaced,
            pattern_seed=self.pattern_seed,
        )

    def video(self, conditions: Conditions | None = None) -> Video:
        """Return the video with its digitiser, or the digitiser alone of a camera without video.

        The camera's gain in the conditions, dB, multiplies charge and noise alike.
        """
        gain_db = None if conditions is None else conditions.camera_gain_db
        video = self.sensor.video
        low_pass, jitter_px = NoFilter(), 0.0
        if video.low_pass is not None:
            bandwidth_mhz, clock_mhz, order = video.low_pass
            low_pass = VideoFilter(
                bandwidth_mhz=bandwidth_mhz,
                pixel_clock_mhz=clock_mhz,
                order=order,
                aperture_correction_db=float(video.aperture_correction_db or 0.0),
            )
            jitter_px = self._unless("sync jitter", video.sync_jitter_ns or 0.0) * 1e-3 * clock_mhz
        return Video(
            low_pass=low_pass,
            conversion_gain_dn_per_e=float(video.conversion_gain_dn_per_e),
            black_level_dn=float(video.black_level_dn),
            gamma=float(video.gamma),
            bit_depth=video.bit_depth,
            gain=10.0 ** ((gain_db or 0.0) / 20.0),
            sync_jitter_px=jitter_px,
            line_noise_dn=self._unless("line noise", video.line_noise_dn or 0.0),
        )

    def automatic_gain(self, conditions: Conditions) -> AutomaticGain | None:
        """Return the camera's automatic gain; None where it is off or unknown.

        Raises
        ------
        BadInput
            If it was on and this camera has none.
        """
        video = self.sensor.video
        if not conditions.automatic_gain:
            return None
        if not video.automatic_gain or video.automatic_gain_range_db is None or video.automatic_gain_s is None:
            raise BadInput(f"automatic_gain must be off, as {self.sensor.name!r} has none; got on")
        return AutomaticGain(
            set_level_dn=SET_LEVEL * (2**video.bit_depth - 1 - float(video.black_level_dn)),
            range_db=float(video.automatic_gain_range_db),
            time_constant_s=float(video.automatic_gain_s),
            step_s=self.frame_s,
        )

    def brightness_control(self, conditions: Conditions) -> BrightnessControl | None:
        """Return the tube's brightness control; None where it is off or unknown.

        Its limit is the phosphor current that its illuminance draws at nominal gain.
        """
        if not conditions.brightness_control:
            return None
        tube = self.sensor.tube
        per_s_cm2 = float(tube.brightness_control_lux) * 1e-4 * tube_photometry.photoelectrons_per_lumen_s(self.sensor)
        return BrightnessControl(
            limit_e_per_s_cm2=self.mcp(Conditions()).gain * per_s_cm2,
            attack_s=float(tube.brightness_control_s),
            step_s=self.frame_s,
        )
