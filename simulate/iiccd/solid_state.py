"""Camera without a tube: CCD or EMCCD."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count

import numpy as np
from numpy.typing import NDArray

from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.solid_state import SolidStateCamera
from simulate.iiccd.ccd import Ccd, Register
from simulate.iiccd.chain import Chain
from simulate.iiccd.grid import DARK_REFERENCE_C, Grid, SensorGeometryCamera
from simulate.iiccd.lens import Optics, RadiometricLens
from simulate.iiccd.pixels import Collection
from simulate.iiccd.stage_image import NoiselessStage, StageImage
from simulate.iiccd.transfer import Lens
from simulate.iiccd.video import Video


@dataclass(frozen=True, kw_only=True)
class Silicon(NoiselessStage):
    """Photosensitive chip behind an electronic shutter.

    Parameters
    ----------
    quantum_efficiency
        Photoelectrons per photon at the wavelength to which the photons have been referred, dimensionless.
    exposure_s
        Time the shutter is open, s.
    grid
        Cells on which the chip's pixels collect, half as many per pixel as those of the light.

    Notes
    -----
    Takes photons per second and cell, emits the expected photoelectrons per exposure and cell. Photoelectrons collected
    in a well are drawn there, `simulate.iiccd.ccd`: independent photons are Poisson in number, and so are those that a
    blur before detection has displaced.
    """

    quantum_efficiency: float
    exposure_s: float
    grid: Grid
    name: str = "silicon"
    takes: str = "photons"
    emits: str = "photoelectrons in the chip"

    def __post_init__(self) -> None:
        if not 0.0 < self.quantum_efficiency <= 1.0:
            raise BadInput(f"quantum_efficiency must lie in (0, 1], got {self.quantum_efficiency:g}")
        if not self.exposure_s > 0.0:
            raise BadInput(f"exposure_s must be positive, got {self.exposure_s:g}")

    def mean(self, light: StageImage) -> StageImage:
        """Return photoelectrons per exposure and cell, pending blurs applied."""
        counted = light.values * np.asarray(self.quantum_efficiency * self.exposure_s, light.values.dtype)
        return light.with_values(counted).resample_to(self.grid)


@dataclass(frozen=True)
class SiliconCamera(SensorGeometryCamera):
    """A CCD or EMCCD camera built from its description.

    Its methods are those of `simulate.iiccd.camera.IntensifiedCamera`; its light "at the MCP input" is photoelectrons
    in the chip. No stage remembers earlier frames.

    Parameters
    ----------
    description
        The description; its values are taken as the truth.
    """

    description: SolidStateCamera

    @property
    def camera_description(self) -> SolidStateCamera:
        """The description."""
        return self.description

    @property
    def is_interlaced(self) -> bool:
        """Always False: these cameras are progressive."""
        return False

    @property
    def frame_s(self) -> float:
        """Time from one frame to the next, s."""
        return 1.0 / float(self.description.video.field_rate_hz)

    def exposure_s(self, conditions: Conditions) -> float:
        """Time the shutter is open in one frame, s: the whole frame unless the conditions say less."""
        given = [
            seconds
            for seconds in (conditions.exposure_s, None if conditions.gate_ns is None else conditions.gate_ns * 1e-9)
            if seconds is not None
        ]
        shortest = min(given, default=self.frame_s)
        if not 0.0 < shortest <= self.frame_s * 1.001:
            raise BadInput(
                f"an exposure must be positive and at most one frame, {self.frame_s:.6g} s, got {shortest:g} s"
            )
        return min(shortest, self.frame_s)

    def em_gain(self, conditions: Conditions) -> float:
        """Gain of the register: that of the conditions, by default its maximum; tube gain is rejected."""
        if conditions.mcp_v is not None or conditions.gain_control is not None:
            raise BadInput(
                f"mcp_v and gain_control must be left out of a camera without a tube, "
                f"got {conditions.mcp_v} and {conditions.gain_control}"
            )
        highest = float(self.description.register.em_gain)
        if conditions.em_gain is None:
            return highest
        if not 1.0 <= conditions.em_gain <= highest:
            raise BadInput(f"em_gain must lie between 1 and the camera's {highest:g}, got {conditions.em_gain:g}")
        return conditions.em_gain

    def lens(self, magnification: float = 0.0) -> RadiometricLens:
        """Return the lens for scenes of known radiance."""
        silicon = self.description.silicon
        detector = silicon.wavelength_nm, silicon.quantum_efficiency
        return RadiometricLens.of(
            self.description.optics, detector, self.scene_cells, magnification=magnification, row_pairs=False
        )

    def chain(self, conditions: Conditions) -> Chain:
        """Return the whole chain under conditions; its light is in photons per s and cell.

        Photons are referred to the wavelength at which the silicon detects best, see `RadiometricLens`.
        """
        optics = self.description.optics
        blur = Lens(aberration_blur_um=float(optics.aberration_blur_um), f_number=float(optics.f_number))
        return Chain(
            (
                Optics(blur=blur, veiling_glare_fraction=float(optics.veiling_glare_fraction)),
                self.silicon(conditions),
                Collection(row_pairs=False, takes="photoelectrons in the chip", emits="photoelectrons in the wells"),
                self._ccd(conditions),
                self.register(conditions),
                self.video(conditions),
            )
        )

    def silicon(self, conditions: Conditions) -> Silicon:
        """Return the chip that detects."""
        return Silicon(
            quantum_efficiency=max(self.description.silicon.quantum_efficiency),
            exposure_s=self.exposure_s(conditions),
            grid=self.cells,
        )

    def _warmth(self, conditions: Conditions) -> float:
        """Dark current over that at the temperature at which it is stated."""
        warmer = 0.0 if conditions.temperature_c is None else conditions.temperature_c - DARK_REFERENCE_C
        return float(2.0 ** (warmer / float(self.description.ccd.dark_current_doubling_k)))

    def _dark_e(self, conditions: Conditions) -> float:
        per_s = float(self.description.ccd.dark_current_e_per_s) * self._warmth(conditions)
        return per_s * self.exposure_s(conditions)

    def _ccd(self, conditions: Conditions) -> Ccd:
        ccd = self.description.ccd
        return Ccd(
            quantum_efficiency=1.0,
            full_well_e=float(ccd.full_well_e),
            antibloom_ratio=float(ccd.antibloom_ratio),
            dark_e=self._dark_e(conditions),
            dsnu_e=float(ccd.dsnu_e) * self._warmth(conditions),
            prnu=float(ccd.prnu),
            smear_fraction=float(ccd.smear_fraction),
            clamped=False,
            pattern_seed=self.pattern_seed,
            takes="photoelectrons in the wells",
            emits="charge in the wells",
        )

    def register(self, conditions: Conditions) -> Register:
        """Return the register with dark charge and clock-induced charge."""
        register = self.description.register
        return Register(
            gain=self.em_gain(conditions),
            stages=register.stages,
            pulse_height_shape=float(register.pulse_height_shape),
            clock_induced_e=float(register.clock_induced_e),
            read_noise_e=float(self.description.ccd.read_noise_e),
            dark_e=self._dark_e(conditions),
        )

    def video(self, conditions: Conditions) -> Video:
        """Return the digitiser; automatic controls are rejected."""
        if conditions.automatic_gain or conditions.brightness_control:
            raise BadInput(f"automatic controls must be off, as {self.description.name!r} has none; got one on")
        video = self.description.video
        return Video(
            gain=10.0 ** ((conditions.camera_gain_db or 0.0) / 20.0),
            conversion_gain_dn_per_e=float(video.conversion_gain_dn_per_e),
            black_level_dn=float(video.black_level_dn),
            gamma=float(video.gamma),
            bit_depth=video.bit_depth,
        )

    def mcp_input(self, photons_per_s: StageImage, conditions: Conditions) -> StageImage:
        """Return the expected photoelectrons in the chip, per cell of `cells` and exposure, of photons on it."""
        return self.silicon(conditions).mean(photons_per_s)

    def photoelectrons(self, photons_per_s: StageImage, conditions: Conditions) -> StageImage:
        """Return the expected photoelectrons in the chip, per cell of `scene_cells` and exposure."""
        silicon = self.silicon(conditions)
        return photons_per_s.with_values(
            photons_per_s.values * np.float32(silicon.quantum_efficiency * silicon.exposure_s)
        )

    def to_mcp_input(self, photoelectrons: StageImage, conditions: Conditions) -> StageImage:
        """Return the expected photoelectrons on `cells` from those of one exposure on `scene_cells`."""
        return photoelectrons.resample_to(self.cells)

    def mean_frame(self, in_chip: StageImage, conditions: Conditions) -> NDArray[np.float32]:
        """Return the noiseless frame of expected photoelectrons on `cells`, shape (row, col), DN."""
        return self.chain(conditions).between("pixels", "video").mean(in_chip).values

    def frames(
        self, in_chip: StageImage, conditions: Conditions, *, seed: int, first_frame: int = 0
    ) -> Iterator[NDArray[np.unsignedinteger]]:
        """Yield the frames of a static scene, shape (row, col), DN; never ends.

        A frame depends on the seed and its own number alone.
        """
        chain = self.chain(conditions)
        pixels = chain.between("pixels", "ccd").without("ccd").mean(in_chip)
        readout = chain.between("ccd", "video")
        for frame in count(first_frame):
            yield readout.draw(pixels, np.random.default_rng([seed, 1, frame])).values
