"""Video: low pass along lines, black level, gamma and digitiser; a digital camera has no low
pass.
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from labdata.camera.chip import gain_at_no_signal
from labdata.conditions import Conditions
from labdata.errors import check, check_range
from simulate.arrays import Array, Array32
from simulate.camera.chain import Slot, Stage, values_of
from simulate.camera.grid import ACCURACY, CameraFrame
from simulate.camera.readout_noise import draw_interference, draw_row_offsets
from simulate.camera.stage_image import StageImage

_OF_READOUT = (
    "row_noise_dn2",
    "row_noise_exponent",
    "interference_dn2",
    "interference_x_cy_per_px",
    "interference_y_cy_per_px",
    "compression_fraction",
)
# Transfer of the filter below which a pattern behind it is not restored before it.
LEAST_TRANSFER = 0.1
# Where the boost of aperture correction is stated.
CORRECTED_MHZ = 4.5


@dataclass(frozen=True, kw_only=True)
class VideoFilter:
    """Butterworth low pass on the staircase of the pixel clock, sampled once a clock: a causal
    digital filter.

    Notes
    -----
    A pixel's value is held for one clock period T; the digitiser samples at the period's end. With
    the step response s(t) of the analog filter the sampled impulse response is h[n] = s((n + 1) T)
    - s(n T). Aperture correction adds what a line differs from the mean of itself one clock before
    and one after, 1 + 2 c (1 - cos(2 pi f T)): the MTF may then exceed 1. Its delay line holds the
    image back by one clock.
    """

    # Of the low pass.
    bandwidth_mhz: float
    pixel_clock_mhz: float
    order: int
    aperture_correction_db: float = 0.0  # boost at `CORRECTED_MHZ`; 0 is none

    @classmethod
    def of(cls, video: Any) -> Self | None:
        """Return the filter of a described video; None of a digital camera."""
        if video.low_pass is None:
            return None
        bandwidth_mhz, clock_mhz, order = video.low_pass
        return cls(
            bandwidth_mhz=bandwidth_mhz,
            pixel_clock_mhz=clock_mhz,
            order=order,
            aperture_correction_db=float(video.aperture_correction_db or 0.0),
        )

    def step_response(self, time_clocks: Array) -> Array:
        """Step response at times in clock periods, dimensionless; 0 before the step, 1 long after
        it.
        """
        rate = 2.0 * np.pi * self.bandwidth_mhz / self.pixel_clock_mhz
        index = np.arange(self.order)
        poles = rate * np.exp(1j * np.pi * (2 * index + self.order + 1) / (2 * self.order))
        differences = poles[:, None] - poles[None, :] + np.eye(self.order)
        residues = rate**self.order / np.prod(differences, axis=1) / poles
        time = np.maximum(np.asarray(time_clocks, float), 0.0)
        response = 1.0 + np.real(np.sum(residues * np.exp(poles * time[..., None]), axis=-1))
        return np.where(np.asarray(time_clocks) > 0, response, 0.0)

    def impulse_response(self, length: int = 32) -> Array:
        """Sampled impulse response h, shape (length,), two longer with aperture correction, summing
        to 1.
        """
        response = np.diff(self.step_response(np.arange(length + 1.0)))
        response = response / response.sum()
        if self.aperture_correction_db == 0.0:
            return response
        side_tap = 0.5 * (10.0 ** (self.aperture_correction_db / 20.0) - 1.0)
        side_tap /= 1.0 - np.cos(2.0 * np.pi * CORRECTED_MHZ / self.pixel_clock_mhz)
        return np.convolve(response, [-side_tap, 1.0 + 2.0 * side_tap, -side_tap])

    def transfer(self, frequency_cy_per_px: Array) -> NDArray[np.complex128]:
        """Complex transfer along a line at frequencies in cycles per pixel, 1 at zero."""
        impulse = self.impulse_response()
        phase = np.multiply.outer(np.asarray(frequency_cy_per_px, float), np.arange(len(impulse)))
        return np.exp(-2j * np.pi * phase) @ impulse.astype(np.complex128)


@dataclass(frozen=True, kw_only=True)
class NoFilter:
    """Filter of a camera whose pixels are digitised one by one, without a video signal."""

    def impulse_response(self, length: int = 1) -> NDArray[np.float64]:
        """Return 1 and zeros, shape (length,)."""
        return np.eye(1, length)[0]

    def transfer(self, frequency_cy_per_px: Array) -> NDArray[np.complex128]:
        """Return 1 at every frequency."""
        return np.ones(np.shape(frequency_cy_per_px), np.complex128)


@dataclass(frozen=True, kw_only=True)
class Video(Stage, slot=Slot.VIDEO, section="video", quantity="DN", takes="charge", emits="DN"):
    """Amplifier, low pass and digitiser."""

    conversion_gain_dn_per_e: float  # DN per electron of charge
    black_level_dn: float  # level without charge, DN
    bit_depth: int  # bits of the digitiser, at most 16
    low_pass: VideoFilter | NoFilter = NoFilter()  # filter along lines
    # exponent y = x^gamma of the signal above black, relative to full scale, dimensionless
    gamma: float = 1.0
    # factor of the automatic gain, which acts on signal and noise alike, dimensionless
    gain: float = 1.0
    sync_jitter_px: float = 0.0  # standard deviation of the start of a line, pixels
    line_noise_dn: float = 0.0  # standard deviation of an offset common to a line, DN
    # Of a digital read-out, see `labdata.camera.chip.Readout`.
    row_noise_dn2: float = 0.0
    row_noise_exponent: float = 0.0
    interference_dn2: float = 0.0
    interference_x_cy_per_px: float = 0.5
    interference_y_cy_per_px: float = 0.5
    compression_fraction: float = 0.0
    # Of a camera whose maps are known, shape (row, col), DN: levels of pixels above black, and
    # standard deviations of noise that others lack.
    offset_dn: Array32 | None = field(default=None, compare=False)
    noise_dn: Array32 | None = field(default=None, compare=False)
    effects: ClassVar = {
        "line jitter": {"sync_jitter_px": 0.0},
        "row noise": {"line_noise_dn": 0.0},
    }

    @classmethod
    def of(cls, camera: CameraFrame, conditions: Conditions) -> Self:
        """Return the video with its digitiser, or the digitiser alone of a camera without video.

        The camera's gain in the conditions, dB, multiplies charge and noise alike.
        """
        video = camera.description.video
        low_pass, jitter_px = VideoFilter.of(video) or NoFilter(), 0.0
        if isinstance(low_pass, VideoFilter):
            jitter_px = float(video.sync_jitter_ns or 0.0) * 1e-3 * low_pass.pixel_clock_mhz
        gain = 10.0 ** ((conditions.camera_gain_db or 0.0) / 20.0)
        readout = camera.description.readout
        readout_values = {
            name: float(getattr(readout, name)) for name in _OF_READOUT if readout is not None
        }
        return values_of(
            cls,
            video,
            low_pass=low_pass,
            gain=gain,
            sync_jitter_px=jitter_px,
            offset_dn=camera.specimen.offset_dn,
            noise_dn=camera.specimen.noise_dn,
            **readout_values,
        )

    def __post_init__(self) -> None:
        check_range(self, 1, 16, "bit_depth")
        # A parabola through three pixels describes shifts well below a pixel only.
        check_range(self, 0.0, 0.5, "sync_jitter_px")
        check(self, positive="gamma", not_negative="line_noise_dn")

    @property
    def full_scale_dn(self) -> int:
        """Highest code, DN."""
        return 2**self.bit_depth - 1

    @property
    def taps(self) -> tuple[float, ...]:
        """The impulse response along a line as it matters, (tap,)."""
        taps = self.low_pass.impulse_response()
        return tuple(
            float(tap)
            for tap in taps[: np.flatnonzero(np.abs(taps) > ACCURACY.min_filter_tap)[-1] + 1]
        )

    def mean(self, light: StageImage) -> StageImage:
        """Return the level, DN, neither rounded nor clipped."""
        signal = filter_lines(light.values, self.low_pass.impulse_response())
        if self.sync_jitter_px > 0.0:
            signal += np.float32(0.5 * self.sync_jitter_px**2) * _bend(signal)
        return light.with_values(self._level(signal))

    def draw(self, light: StageImage, rng: np.random.Generator) -> StageImage:
        """Return whole DN between 0 and full scale, uint8 or uint16."""
        signal = filter_lines(light.values, self.low_pass.impulse_response())
        if self.sync_jitter_px > 0.0:
            delay = self.sync_jitter_px * rng.standard_normal(
                (*signal.shape[:-1], 1), dtype=np.float32
            )
            signal = shift_lines(signal, delay)
        level = self._level(signal)
        if self.line_noise_dn > 0.0:
            level += np.float32(self.line_noise_dn) * rng.standard_normal(
                (*level.shape[:-1], 1), dtype=np.float32
            )
        self._add_readout_noise(level, rng)
        if self.noise_dn is not None:
            level += self.noise_dn * rng.standard_normal(level.shape, dtype=np.float32)
        return light.with_values(
            np.clip(np.rint(level), 0, self.full_scale_dn).astype(self.code_type)
        )

    def _add_readout_noise(self, level: Array32, rng: np.random.Generator) -> None:
        """Add offsets of rows and interference to frames (..., row, col), each frame its own."""
        rows, columns = level.shape[-2:]
        for frame in level.reshape(-1, rows, columns):
            if self.row_noise_dn2 > 0.0:
                frame += draw_row_offsets(rng, rows, self.row_noise_dn2, self.row_noise_exponent)
            if self.interference_dn2 > 0.0:
                fx, fy = self.interference_x_cy_per_px, self.interference_y_cy_per_px
                frame += draw_interference(rng, (rows, columns), self.interference_dn2, fx, fy)

    def _level(self, signal: Array32) -> Array32:
        signal = signal * np.float32(self.conversion_gain_dn_per_e * self.gain)
        if self.compression_fraction != 0.0:
            signal *= np.float32(gain_at_no_signal(1.0, self.compression_fraction))
            signal -= np.float32(self.compression_fraction / self.full_scale_dn) * signal**2
        if self.gamma != 1.0:
            span = np.float32(self.full_scale_dn - self.black_level_dn)
            signal = span * np.sign(signal) * np.abs(signal / span) ** np.float32(self.gamma)
        black = np.float32(self.black_level_dn)
        return signal + (black if self.offset_dn is None else black + self.offset_dn)

    def charge_of_offsets(self) -> Array32 | np.float32:
        """Return the charge of pixels, e-, that the filter and the amplifier make their offsets."""
        if self.offset_dn is None:
            return np.float32(0.0)
        per_e = np.float32(self.conversion_gain_dn_per_e * self.gain)
        return before_filter(self.offset_dn, self.low_pass) / per_e

    @property
    def code_type(self) -> type[np.unsignedinteger]:
        """Type of the codes: 8 bits or 16."""
        return np.uint8 if self.bit_depth <= 8 else np.uint16

    def bounds(self, budget: Any) -> dict[str, float]:
        """Return the influence of line jitter and line noise; an effect of analog video.

        A shift within a pixel averages neighbours: the variance of white noise falls by 3/2 late^2.
        """
        if not isinstance(self.low_pass, VideoFilter):
            return {}
        n, shift = budget.mean_pe, self.sync_jitter_px
        padded = np.pad(n, ((0, 0), (1, 1)), mode="edge")
        left, right = n - padded[:, :-2], padded[:, 2:] - n
        steepest = np.maximum(np.abs(left), np.abs(right))
        shift_influence = budget.of_white((shift * steepest * budget.charge_e) ** 2)
        average_influence = budget.of_white(1.5 * shift**2 * budget.variance)
        return {
            "line jitter": max(
                shift_influence + average_influence, budget.of_mean(0.5 * shift**2 * (right - left))
            ),
            "row noise": budget.of_white(budget.line_noise_e**2),
        }


def before_filter(image: Array32, low_pass: VideoFilter | NoFilter) -> Array32:
    """Return the image, shape (row, col), that the video filter makes the given one."""
    if isinstance(low_pass, NoFilter):
        return image
    frequency = np.fft.rfftfreq(image.shape[1])
    transfer = low_pass.transfer(frequency)
    size = np.abs(transfer)
    transfer *= np.maximum(size, LEAST_TRANSFER) / np.maximum(size, 1e-12)
    return np.fft.irfft(np.fft.rfft(image) / transfer, image.shape[1]).astype(np.float32)


def shift_lines(lines: Array32, late_px: Array32) -> Array32:
    """Return lines (..., col) delayed by less than a pixel, (..., 1), by a parabola through three
    pixels.
    """
    slope = 0.5 * (_neighbour(lines, 1) - _neighbour(lines, -1))
    return (lines - late_px * slope + np.float32(0.5) * late_px**2 * _bend(lines)).astype(
        np.float32
    )


def _bend(lines: Array32) -> Array32:
    return (_neighbour(lines, 1) - np.float32(2.0) * lines + _neighbour(lines, -1)).astype(
        np.float32
    )


def _neighbour(lines: Array32, step: int) -> Array32:
    """Lines shifted by one pixel, with their ends repeated."""
    shifted = np.roll(lines, -step, axis=-1)
    shifted[..., -1 if step > 0 else 0] = lines[..., -1 if step > 0 else 0]
    return shifted


def filter_lines(lines: NDArray, impulse_response: Array) -> Array32:
    """Return lines (..., col) after a causal filter; the first pixel is repeated before the
    line.
    """
    taps = impulse_response[: np.flatnonzero(np.abs(impulse_response) > 1e-7)[-1] + 1].astype(
        np.float32
    )
    lead, columns = len(taps) - 1, lines.shape[-1]
    padded = np.concatenate([np.repeat(lines[..., :1], lead, axis=-1), lines], axis=-1).astype(
        np.float32
    )
    total = taps[0] * padded[..., lead : lead + columns]
    for n in range(1, len(taps)):
        total += taps[n] * padded[..., lead - n : lead - n + columns]
    return total
