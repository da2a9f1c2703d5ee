"""Infrared imager: the stages of its description as one chain, from radiance to frames in DN."""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count as numbers
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata import BadInput, Camera, Conditions
from simulate.arrays import Array
from simulate.camera.chain import Chain, Stage, stages_with_section
from simulate.camera.scanner import (
    NOISE_BANDWIDTH,
    FrameAverage,
    LineNoise,
    LineScan,
    Narcissus,
    noise_equivalent_radiance,
)
from simulate.camera.stage_image import StageImage
from simulate.camera.thermal_arrays import (
    BolometerNoise,
    BolometerPattern,
    PhotonNoise,
    ThermalLag,
    TwoPointCorrection,
)
from simulate.camera.thermal_lens import KELVIN, Optics, Slot
from simulate.camera.thresholds import LIMITS
from simulate.radiance.geometry.viewpoint import Viewpoint
from simulate.radiance.spectrum import band_photon_radiance, band_radiance

# Temperature at which noise is stated, and of the spectrum within a bin and a band, K.
STATED_K = 300.0


@dataclass(frozen=True, kw_only=True)
class Digitiser(Stage, slot=Slot.DIGITISER, section="video", takes="corrected signal", emits="DN"):
    """Gain and level, then bits: one code is the span over 2^bits; values beyond are clipped."""

    effects: ClassVar = {"quantisation": {"quantised": False}}
    black: float  # signal of code 0
    full: float  # signal of code 2^bits
    bits: int
    quantised: bool = True

    @classmethod
    def of(cls, camera: Any, conditions: Conditions) -> Self:
        """Return the digitiser at level and span of the video, or over the well of an array."""
        video, cooled = camera.description.video, camera.description.cooled_array
        if cooled is not None:
            full = LIMITS.full_scale_of_well * float(cooled.full_well_e)
            return cls(black=0.0, full=full, bits=video.bit_depth)
        level_k, half = float(video.level_c) + KELVIN, 0.5 * float(video.span_k)
        black, full = (float(camera.signal_of(level_k + side)) for side in (-half, half))
        return cls(black=black, full=full, bits=video.bit_depth)

    def mean(self, light: StageImage) -> StageImage:
        codes = 2**self.bits
        dn = np.clip(
            (light.values - self.black) * (codes / (self.full - self.black)), 0.0, codes - 1.0
        )
        if not self.quantised:
            return light.with_values(dn.astype(np.float32))
        return light.with_values(np.rint(dn).astype(np.uint8 if self.bits <= 8 else np.uint16))


# Stages in the order of the light. An imager has those whose section its description has.
STAGES: tuple[type[Stage], ...] = (
    Optics,
    Narcissus,
    FrameAverage,
    LineScan,
    ThermalLag,
    LineNoise,
    BolometerNoise,
    PhotonNoise,
    BolometerPattern,
    TwoPointCorrection,
    Digitiser,
)


@dataclass(frozen=True)
class ThermalImager:
    """An infrared imager built from its description, whose values are taken as the truth.

    Its signal is linear in the radiance of the scene: the radiance within the band, W m-2 sr-1, or,
    of a cooled array, electrons of an exposure. Emission of its own lens is left out.

    Examples
    --------
    >>> from labdata.sensors import load_camera
    >>> camera = ThermalImager(load_camera("vox-lwir-640"))
    >>> round(1e3 * camera.netd_k())
    40
    """

    description: Camera
    left_out: frozenset[str] = frozenset()  # names of effects, see `effects`
    has_tube = False

    def __post_init__(self) -> None:
        if unknown := self.left_out - set(self.effects):
            raise BadInput(
                f"an effect must be one of {', '.join(self.effects)}, got "
                f"{', '.join(sorted(unknown))}"
            )

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects that may be left out."""
        return tuple(dict.fromkeys(name for stage in self._stages for name in stage.effects))

    def without(self, *effects: str) -> "ThermalImager":
        """Return the camera without some effects."""
        return replace(self, left_out=self.left_out | set(effects))

    def with_span(self, level_c: float, span_k: float) -> "ThermalImager":
        """Return the camera at another level, C, and span, K; a cooled array has neither."""
        if self.description.cooled_array is not None:
            raise BadInput(
                f"level and span need an imager that has them, got {self.description.name!r}"
            )
        description = self.description.with_values(
            {"video.level_c": level_c, "video.span_k": span_k}
        )
        return replace(self, description=description)

    @property
    def pattern_seed(self) -> int:
        """Seed of the fixed patterns, which belong to the imager of this name."""
        return zlib.crc32(self.description.name.encode())

    @property
    def frame_s(self) -> float:
        """Time from one frame to the next, s."""
        rate_hz = float(self.description.video.field_rate_hz)
        return self._averaged * self.description.fields / rate_hz

    @property
    def _averaged(self) -> int:
        """Frames of which one is the mean."""
        scanner = self.description.scanner
        return (
            1 if scanner is None or "frame averaging" in self.left_out else scanner.averaged_frames
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of a frame."""
        return self.description.shape

    @property
    def band_um(self) -> tuple[float, float]:
        """Ends of the spectral band."""
        return float(self.description.band.short_um), float(self.description.band.long_um)

    @property
    def pitch_mrad(self) -> tuple[float, float]:
        """Angle between rows and between columns, mrad."""
        return self.description.pitch_mrad

    def viewpoint(
        self,
        position_m: tuple[float, float, float],
        forward: tuple[float, float, float],
        *,
        oversample: int = 1,
    ) -> Viewpoint:
        """Return pose and lens of the cells of a picture; a scanner's are equal steps of angle, an
        array's of slope.
        """
        rows, columns = (side * oversample for side in self.shape)
        row_pitch, col_pitch = (1e-3 * pitch / oversample for pitch in self.pitch_mrad)
        # Equal angles: r' = r - r^3 / 3 of the slope r at the corner.
        corner = np.hypot(0.5 * rows * row_pitch, 0.5 * columns * col_pitch)
        distortion = -(corner**2) / 3.0 if self.description.scanner is not None else 0.0
        return Viewpoint(
            position_m=position_m,
            forward=forward,
            shape=(rows, columns),
            focal_px=(1.0 / col_pitch, 1.0 / row_pitch),
            distortion_fraction=distortion,
        )

    @property
    def _electrons(self) -> float | None:
        """Electrons of an exposure for a photon radiance of 1 s-1 m-2 sr-1; None where the signal
        is radiance.
        """
        array, optics = self.description.cooled_array, self.description.optics
        if array is None:
            return None
        solid_angle = np.pi / (4.0 * float(optics.f_number) ** 2 + 1.0)
        area, time_s = (float(array.pitch_um) * 1e-6) ** 2, float(array.integration_ms) * 1e-3
        return (
            area
            * solid_angle
            * float(optics.transmission)
            * float(array.quantum_efficiency)
            * time_s
        )

    def signal_of(self, temperature_k: ArrayLike) -> Array:
        """Return the signal of black bodies of temperatures, K: W m-2 sr-1 in the band, or
        electrons.
        """
        if self._electrons is None:
            return band_radiance(*self.band_um, temperature_k)
        return self._electrons * band_photon_radiance(*self.band_um, temperature_k)

    def signal_slope(self, temperature_k: float = STATED_K) -> float:
        """Return the derivative of `signal_of` with temperature, per K."""
        low, high = self.signal_of(np.array([temperature_k - 0.01, temperature_k + 0.01]))
        return float(high - low) / 0.02

    def responses(self, bin_edges_um: ArrayLike) -> Array:
        """Return the signal for a radiance of 1 W m-2 sr-1 in each spectral bin, shape (bin,).

        A bin has the spectrum of a black body of 300 K within: exact for that one whatever the bins
        are.
        """
        edges, (short, long) = np.asarray(bin_edges_um, float), self.band_um
        if (
            edges.ndim != 1
            or edges.size < 2
            or not (np.diff(edges) > 0.0).all()
            or not edges[0] > 0.0
        ):
            raise BadInput(
                f"edges of spectral bins must be positive and ascend, got {edges.tolist()}"
            )
        if edges[0] > short + 1e-9 or edges[-1] < long - 1e-9:
            raise BadInput(
                f"spectral bins must hold the band {short:g} to {long:g} um, got {edges[0]:g} to "
                f"{edges[-1]:g} um"
            )
        band_edges = np.clip(edges, short, long)
        band_integral = band_radiance if self._electrons is None else band_photon_radiance
        bin_signal = np.where(
            band_edges[1:] > band_edges[:-1],
            band_integral(band_edges[:-1], band_edges[1:], STATED_K),
            0.0,
        )
        return (
            (self._electrons or 1.0) * bin_signal / band_radiance(edges[:-1], edges[1:], STATED_K)
        )

    def signal(self, radiance: Array, bin_edges_um: ArrayLike) -> Array:
        """Return the signal of each cell of a radiance (..., row, col, bin), W m-2 sr-1 in each
        bin.
        """
        response, radiance = self.responses(bin_edges_um), np.asarray(radiance)
        if radiance.ndim < 3 or radiance.shape[-1] != response.size:
            raise BadInput(
                f"a radiance must have the axes (row, col, bin) with {response.size} bins, got "
                f"shape {radiance.shape}"
            )
        if not np.isfinite(radiance).all() or radiance.min() < 0.0:
            raise BadInput("radiances must be finite and not negative, got some that are not")
        return radiance @ response.astype(radiance.dtype)

    def netd_k(self, temperature_k: float = STATED_K) -> float:
        """Return the noise-equivalent temperature difference before a background, K, of the
        temporal noise of a pixel.

        White noise alone: of a scanner without 1/f and clamp, its frames averaged, of an array
        without rows, columns and quantisation.
        """
        return self.sigma(temperature_k) / self._averaged**0.5 / self.signal_slope(temperature_k)

    def sigma(self, temperature_k: float = STATED_K) -> float:
        """Return the standard deviation of white temporal noise, in units of the signal."""
        description = self.description
        if description.scanner is not None:
            return noise_equivalent_radiance(
                description, NOISE_BANDWIDTH * float(description.scanner.bandwidth_mhz) * 1e6
            )
        if description.bolometer is not None:
            return float(description.bolometer.netd_mk) * 1e-3 * self.signal_slope()
        assert description.cooled_array is not None
        return float(
            np.hypot(
                np.sqrt(self.signal_of(temperature_k)), float(description.cooled_array.read_noise_e)
            )
        )

    @cached_property
    def _stages(self) -> tuple[Stage, ...]:
        """All stages with all effects, in the order of the light."""
        kinds = stages_with_section(STAGES, self.description)
        return tuple(kind.of(self, Conditions()) for kind in kinds)

    @cached_property
    def chain(self) -> tuple[Chain, Chain]:
        """The stages up to the noise, and from there on, without the effects that are left out."""
        stages = tuple(stage.without(self.left_out) for stage in self._stages)
        noise_index = next(i for i, stage in enumerate(stages) if stage.slot == Slot.NOISE)
        return Chain(stages[:noise_index]), Chain(stages[noise_index:])

    def frames(
        self,
        radiance: Array,
        bin_edges_um: ArrayLike,
        *,
        seed: int,
        count: int | None = None,
        first_frame: int = 0,
    ) -> Iterator[NDArray]:
        """Yield frames of a scene of known radiance, shape (row, col), DN.

        Parameters
        ----------
        radiance
            Radiance in each spectral bin, averaged over cells, shape (row, col, bin) of a static
            scene or (frame, row, col, bin), W m-2 sr-1. A whole number of cells on each side of a
            pixel: of four nothing of the transfer of an f/1 lens is lost. The scene goes on beyond
            the frame as it ends there.
        bin_edges_um
            Edges of the bins, shape (bin + 1,); they must hold the band.
        seed
            Seed of the run. A frame depends on it and on its own number alone.
        count
            Number of frames; None: without end, or all of the radiance's.
        first_frame
            Number of the first frame; its time counts from the last shutter.
        """
        return self.frames_of_signal(
            self.signal(radiance, bin_edges_um), seed=seed, count=count, first_frame=first_frame
        )

    def frames_of_signal(
        self, signal: Array, *, seed: int, count: int | None = None, first_frame: int = 0
    ) -> Iterator[NDArray]:
        """Yield frames of cells of a signal (see `signal_of`), (row, col) or (frame, row, col),
        else as `frames`.
        """
        noiseless, noisy = self.chain
        light = noiseless.mean(StageImage(values=np.asarray(signal)))
        is_moving = light.values.ndim == 3
        if is_moving and not len(light.values) >= (count or 0):
            raise BadInput(
                f"a sequence must have the {count} frames that are asked for, got "
                f"{len(light.values)}"
            )
        frame_count = len(light.values) if is_moving and count is None else count
        for number in numbers(first_frame):
            if frame_count is not None and number - first_frame >= frame_count:
                return
            frame_light = (
                light.with_values(light.values[number - first_frame]) if is_moving else light
            )
            stages = (
                replace(stage, time_s=number * self.frame_s)
                if isinstance(stage, BolometerPattern)
                else stage
                for stage in noisy.stages
            )
            yield (
                Chain(tuple(stages))
                .draw(frame_light, np.random.default_rng([seed, 1, number]))
                .values
            )

    def view_target(
        self,
        blackbody_c: float,
        background_c: float | None = None,
        share: Array | None = None,
        *,
        seed: int,
        count: int,
        first_frame: int = 0,
    ) -> NDArray:
        """Return frames of a black body, alone or behind a plate, shape (frame, row, col), DN.

        Parameters
        ----------
        blackbody_c
            Temperature of the black body.
        background_c
            Temperature of the plate before it, which is black too; needed with a share.
        share
            Share of each cell that shows the black body, see `targets`; None: all of the frame.
        """
        signal = self.signal_of(blackbody_c + KELVIN) * np.ones(self.shape)
        if share is not None:
            if background_c is None:
                raise BadInput("a plate before a black body must have a temperature, got none")
            plate = float(self.signal_of(background_c + KELVIN))
            signal = plate + (float(self.signal_of(blackbody_c + KELVIN)) - plate) * np.asarray(
                share, float
            )
        return np.stack(
            list(self.frames_of_signal(signal, seed=seed, count=count, first_frame=first_frame))
        )
