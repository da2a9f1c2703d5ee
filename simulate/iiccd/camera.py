"""The intensified camera: a sensor description turned into a chain of stages, and the chain run field by field."""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import count

import numpy as np
from numpy.typing import NDArray

from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.sensor import Sensor
from simulate.iiccd import photons
from simulate.iiccd.ccd import Ccd
from simulate.iiccd.chain import Chain
from simulate.iiccd.grid import Grid, padded_grid
from simulate.iiccd.light import Light
from simulate.iiccd.microchannel import MicrochannelPlate
from simulate.iiccd.optics import Optics
from simulate.iiccd.phosphor import Afterglow, Phosphor, lingering
from simulate.iiccd.photocathode import Photocathode, ProximityGap
from simulate.iiccd.pixels import Collection, Scan
from simulate.iiccd.taper import Taper
from simulate.iiccd.transfer import FibreTaper, Halo, Lens, TubeShare, VideoFilter
from simulate.iiccd.video import Video

# The picture of a target is needed this far beyond the frame: the halo reaches 23 pixels.
SCENE_MARGIN_PX = 40
DRAW_MARGIN_PX = 10
# Dark current is stated at this temperature.
DARK_REFERENCE_C = 25.0


@dataclass(frozen=True)
class IntensifiedCamera:
    """An image-intensified camera built from its description.

    Automatic gain and brightness control are off, as they are for any measurement.

    Parameters
    ----------
    sensor
        The description; its values are taken as the truth.
    """

    sensor: Sensor

    @property
    def interlaced(self) -> bool:
        """Whether a frame is two fields exposed one after the other."""
        return self.sensor.video.interlaced

    @property
    def fields_per_frame(self) -> int:
        """Exposures in one frame."""
        return 2 if self.interlaced else 1

    @property
    def field_s(self) -> float:
        """Time from one exposure to the next, s."""
        return 1.0 / float(self.sensor.video.field_rate_hz)

    @property
    def frame_s(self) -> float:
        """Time from one frame to the next, s."""
        return self.field_s * self.fields_per_frame

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of a frame."""
        return self.sensor.ccd.rows, self.sensor.ccd.columns

    @property
    def specimen(self) -> int:
        """Seed of the fixed patterns, which belong to the sensor of this name."""
        return zlib.crc32(self.sensor.name.encode())

    @cached_property
    def cells(self) -> Grid:
        """Cells on which photoelectrons are drawn, two per pixel."""
        return self._grid(2, DRAW_MARGIN_PX)

    @cached_property
    def scene_cells(self) -> Grid:
        """Cells on which the scene arrives, four per pixel."""
        return self._grid(4, SCENE_MARGIN_PX)

    def _grid(self, per_pixel: int, margin: int) -> Grid:
        ccd, demagnification = self.sensor.ccd, float(self.sensor.taper.demagnification)
        # Field integration sums rows r and r + 1, so the chip has one row more than the frame.
        return padded_grid(
            ccd.rows + (1 if self.interlaced else 0),
            ccd.columns,
            per_pixel=per_pixel,
            margin=margin,
            pitch_x_mm=float(ccd.pitch_x_um) * demagnification * 1e-3,
            pitch_y_mm=float(ccd.pitch_y_um) * demagnification * 1e-3,
        )

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

    def chain(self, conditions: Conditions) -> Chain:
        """Return the whole chain under conditions; its light is in photons per s and cell, see `photocathode`."""
        return Chain(
            (
                self._optics(),
                self.photocathode(conditions),
                self._gap(),
                self._plate(conditions),
                self._phosphor(),
                self._taper(),
                Collection(row_pairs=self.interlaced),
                self.afterglow(conditions),
                Scan(interlaced=self.interlaced),
                self._ccd(conditions),
                self._video(),
            )
        )

    def photocathode(self, conditions: Conditions) -> Photocathode:
        """Return the photocathode; photons are referred to the wavelength where its efficiency peaks."""
        table = self.sensor.photocathode.wavelength_nm
        return Photocathode(
            quantum_efficiency=float(photons.quantum_efficiency(self.sensor, table).max()),
            gate_s=self.gate_s(conditions),
            ebi_per_s_cm2=photons.ebi_per_s_cm2(self.sensor, conditions.temperature_c),
        )

    def afterglow(self, conditions: Conditions) -> Afterglow:
        """Return the decay of the screen."""
        phosphor = self.sensor.phosphor
        return Afterglow(
            fast_fraction=float(phosphor.fast_fraction),
            fast_decay_ms=float(phosphor.fast_decay_ms),
            slow_decay_ms=float(phosphor.slow_decay_ms),
            gate_s=self.gate_s(conditions),
            field_s=self.field_s,
        )

    def _optics(self) -> Optics:
        optics = self.sensor.optics
        blur = Lens(aberration_blur_um=float(optics.aberration_blur_um), f_number=float(optics.f_number))
        return Optics(blur=blur, veiling_glare_fraction=float(optics.veiling_glare_fraction))

    def _share(self, share: float) -> TubeShare:
        tube = self.sensor.tube
        return TubeShare(
            share=share,
            frequency_lp_per_mm=float(tube.mtf_frequency_lp_per_mm),
            exponent=float(tube.mtf_exponent),
        )

    def _gap(self) -> ProximityGap:
        cathode = self.sensor.photocathode
        halo = Halo(
            fraction=float(cathode.halo_fraction),
            gap_mm=float(cathode.gap_mm),
            elastic_share=float(cathode.halo_elastic_share),
        )
        spread = self._share(1.0 - float(self.sensor.tube.post_gain_share))
        return ProximityGap(spread=spread, halo=halo, grid=self.cells)

    def _plate(self, conditions: Conditions) -> MicrochannelPlate:
        plate = self.sensor.microchannel_plate
        per_electron = float(self.sensor.phosphor.photons_per_electron)
        strip = float(plate.strip_current_ua_per_cm2) * float(plate.saturation_fraction) * 1e-6
        gain = photons.photons_per_photoelectron(self.sensor) / per_electron
        return MicrochannelPlate(
            detection_probability=float(plate.detection_probability),
            pulse_height_shape=float(plate.pulse_height_shape),
            gain=gain * photons.voltage_factor(self.sensor, conditions.mcp_v),
            saturation_e_per_s_cm2=strip / photons.ELEMENTARY_CHARGE_C,
            field_s=self.field_s,
            ion_events_per_s_cm2=float(plate.ion_event_rate_per_s_cm2),
            ion_event_size_pe=float(plate.ion_event_size_pe),
            gate_s=self.gate_s(conditions),
        )

    def _phosphor(self) -> Phosphor:
        return Phosphor(
            photons_per_electron=float(self.sensor.phosphor.photons_per_electron),
            spread=self._share(float(self.sensor.tube.post_gain_share)),
            gain_nonuniformity=float(self.sensor.phosphor.gain_nonuniformity),
            specimen=self.specimen,
        )

    def _taper(self) -> Taper:
        taper = self.sensor.taper
        blur = FibreTaper(
            fibre_pitch_um=float(taper.fibre_pitch_um),
            interface_lp_per_mm=float(taper.interface_mtf_lp_per_mm),
            demagnification=float(taper.demagnification),
        )
        return Taper(
            transmission=float(taper.transmission),
            blur=blur,
            pattern_contrast=float(taper.pattern_contrast),
            pattern_pitch_um=float(taper.pattern_pitch_um),
            line_um=float(taper.fibre_pitch_um),
            demagnification=float(taper.demagnification),
        )

    def _ccd(self, conditions: Conditions) -> Ccd:
        ccd = self.sensor.ccd
        warmer = 0.0 if conditions.temperature_c is None else conditions.temperature_c - DARK_REFERENCE_C
        dark = float(ccd.dark_current_e_per_s) * 2.0 ** (warmer / float(ccd.dark_current_doubling_k))
        return Ccd(
            quantum_efficiency=float(ccd.quantum_efficiency),
            full_well_e=float(ccd.full_well_e),
            antibloom_ratio=float(ccd.antibloom_ratio),
            dark_e=dark * self.field_s * (2 if self.interlaced else 1),
            read_noise_e=float(ccd.read_noise_e),
            prnu=float(ccd.prnu),
            smear_fraction=float(ccd.smear_fraction),
            interlaced=self.interlaced,
            specimen=self.specimen,
        )

    def _video(self) -> Video:
        video = self.sensor.video
        low_pass = VideoFilter(
            bandwidth_mhz=float(video.bandwidth_mhz),
            pixel_clock_mhz=float(video.pixel_clock_mhz),
            order=video.filter_order,
        )
        return Video(
            low_pass=low_pass,
            conversion_gain_dn_per_e=float(video.conversion_gain_dn_per_e),
            black_level_dn=float(video.black_level_dn),
            gamma=float(video.gamma),
            bit_depth=video.bit_depth,
        )

    def mean_frame(self, at_plate: Light, conditions: Conditions) -> NDArray[np.float32]:
        """Return the noiseless frame of a steady scene, shape (row, col), DN.

        Parameters
        ----------
        at_plate
            Expected photoelectrons at the plate per cell and exposure, on `cells`.
        conditions
            Gate, voltage and temperature.
        """
        pixels = self._screen(conditions).mean(at_plate)
        steady = pixels.with_values(np.repeat(pixels.values[None], self.fields_per_frame, axis=0))
        return self._readout(conditions).mean(steady).values[0]

    def frames(
        self, at_plate: Light, conditions: Conditions, *, seed: int, first_frame: int = 0
    ) -> Iterator[NDArray[np.unsignedinteger]]:
        """Yield the frames of a steady scene, one after the other, shape (row, col), DN; never ends.

        A frame depends on the seed and its own number alone: the fields that it still glows from are drawn again,
        whichever frame comes first. Pulses are drawn on cells one row high; what those blur away of the scene is added
        without noise, so that frames average to `mean_frame`.
        """
        readout, glow = self._readout(conditions), self.afterglow(conditions)
        coarse = at_plate.in_whole_rows()
        finer = self._screen(conditions).mean(at_plate).values - self._screen(conditions).mean(coarse).values
        screen = self._screen(conditions)
        screen = Chain((self._plate(conditions).under_load(at_plate, parts=2), *screen.stages[1:]))
        halves = coarse.with_values(np.repeat(0.5 * coarse.values[None], 2, axis=0))
        remembered = glow.memory + self.fields_per_frame
        recent = np.empty((remembered, 2, *self.shape), np.float32)
        field = self.fields_per_frame * first_frame - glow.memory
        for frame in count(first_frame):
            while field < self.fields_per_frame * (frame + 1):
                recent[field % remembered] = screen.draw(halves, _field_rng(seed, field)).values
                field += 1
            order = np.arange(field - remembered, field) % remembered
            shown = lingering(recent, glow.halves, order) + finer
            yield readout.draw(Light(values=shown), np.random.default_rng([seed, 1, frame])).values[0]

    def _screen(self, conditions: Conditions) -> Chain:
        return self.chain(conditions).part("microchannel plate", "pixels")

    def _readout(self, conditions: Conditions) -> Chain:
        return self.chain(conditions).part("scan", "video")


def _field_rng(seed: int, field: int) -> np.random.Generator:
    # Fields before the first frame, whose light it still shows, have numbers below zero; seeds may not.
    return np.random.default_rng([seed, 0, field + 1024])
