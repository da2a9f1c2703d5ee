"""Stages of a thermal scanner: narcissus, line scan with its electronics, noise of detector and
clamp, averaging.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from labdata import BadInput, Camera, Conditions
from simulate.arrays import Array, Mask
from simulate.camera.chain import Stage, values_of
from simulate.camera.stage_image import StageImage
from simulate.camera.thermal_lens import KELVIN, Slot
from simulate.camera.thresholds import LIMITS

# Noise bandwidth of one pole over its 3 dB frequency.
NOISE_BANDWIDTH = 0.5 * np.pi


@dataclass(frozen=True, kw_only=True)
class ScanTiming:
    """Motion of a resonant mirror, x(t) = A sin(2 pi f t), and the samples of its lines.

    The field of view is swept in the share u of a half period, so that A = (field / 2) / sin(pi u /
    2).
    """

    field_mrad: float
    samples: int
    mirror_hz: float
    active_fraction: float
    linearised: bool

    @classmethod
    def of(cls, camera: Any) -> Self:
        """Return the timing of a scanner."""
        field_mrad = camera.pitch_mrad[1] * camera.shape[1]
        return values_of(cls, camera.description.scanner, field_mrad=field_mrad)

    @property
    def active_s(self) -> float:
        """Time of an active line, s."""
        return self.active_fraction * self.line_s

    @property
    def line_s(self) -> float:
        """Time from one line to the next, s."""
        return 0.5 / self.mirror_hz

    @property
    def amplitude_mrad(self) -> float:
        """Amplitude of the sweep, mrad."""
        return 0.5 * self.field_mrad / np.sin(0.5 * np.pi * self.active_fraction)

    @cached_property
    def sample_s(self) -> Array:
        """Times of the samples from the middle of the line, shape (sample,), s, in the order of the
        sweep.
        """
        fractions = (np.arange(self.samples) + 0.5) / self.samples - 0.5
        if not self.linearised:
            return fractions * self.active_s
        return np.arcsin(fractions * self.field_mrad / self.amplitude_mrad) / (
            2.0 * np.pi * self.mirror_hz
        )


def is_scanned_left(rows: int) -> Mask:
    """Return whether rows of a frame of two fields are scanned to the left, shape (row,); fields
    begin to the right.
    """
    return (np.arange(rows) // 2) % 2 == 1


@dataclass(frozen=True, kw_only=True)
class Narcissus(
    Stage,
    slot=Slot.NARCISSUS,
    section="scanner",
    takes="signal of pixels",
    emits="signal of pixels",
):
    """Offset by the cold detector that sees itself in the lens, most on the axis: -depth (1 - (r /
    R)^2).

    r is the angle from the axis and R that of the corners. The shape is assumed: the first term of
    a radial offset.
    """

    effects: ClassVar = {"narcissus": {"depth": 0.0}}
    depth: float  # in units of the signal
    fields_mrad: tuple[float, float]  # of view, down and along

    @classmethod
    def of(cls, camera: Any, conditions: Conditions) -> Self:
        (rows, columns), (row_pitch, col_pitch) = camera.shape, camera.pitch_mrad
        return cls(
            depth=float(camera.description.scanner.narcissus_k or 0.0) * camera.signal_slope(),
            fields_mrad=(rows * row_pitch, columns * col_pitch),
        )

    def mean(self, light: StageImage) -> StageImage:
        if not self.depth:
            return light
        rows, cols = light.values.shape[-2:]
        row_angle, col_angle = (
            ((np.arange(n) + 0.5) / n - 0.5) * field
            for n, field in zip((rows, cols), self.fields_mrad, strict=True)
        )
        square = (row_angle[:, None] ** 2 + col_angle**2) / (
            0.25 * (self.fields_mrad[0] ** 2 + self.fields_mrad[1] ** 2)
        )
        return light.with_values(light.values - self.depth * (1.0 - square))


@dataclass(frozen=True, kw_only=True)
class FrameAverage(
    Stage, slot=Slot.AVERAGE, section="scanner", takes="signal of pixels", emits="signal of pixels"
):
    """Means of successive frames of a moving scene; their noise is averaged by `LineNoise`."""

    effects: ClassVar = {"frame averaging": {"averaged": 1}}
    averaged: int

    @classmethod
    def of(cls, camera: Any, conditions: Conditions) -> Self:
        return cls(averaged=camera.description.scanner.averaged_frames)

    def mean(self, light: StageImage) -> StageImage:
        if light.values.ndim < 3 or self.averaged == 1:
            return light
        frames = len(light.values)
        if frames % self.averaged:
            raise BadInput(
                f"a sequence must have a multiple of the {self.averaged} frames averaged, got "
                f"{frames}"
            )
        return light.with_values(
            light.values.reshape(-1, self.averaged, *light.values.shape[1:]).mean(axis=1)
        )


@dataclass(frozen=True, kw_only=True)
class LineScan(
    Stage, slot=Slot.SCAN, section="scanner", takes="signal of pixels", emits="signal of samples"
):
    """Scan of lines to the right and to the left through the electronics: one pole, AC coupling,
    sampling clock.

    The coupling is a high pass that starts at the zero of each line, the black body seen in the
    turn. Samples make up for the delay of the pole, 1 / (2 pi bandwidth); the clock error comes on
    top.
    """

    effects: ClassVar = {
        "electronics bandwidth": {"bandwidth_hz": np.inf},
        "AC coupling": {"coupling_hz": 0.0},
        "clock error": {"clock_error_s": 0.0},
    }
    timing: ScanTiming
    bandwidth_hz: float
    coupling_hz: float
    clock_error_s: float
    reference: float  # signal of the black body seen in the turn

    @classmethod
    def of(cls, camera: Any, conditions: Conditions) -> Self:
        section = camera.description.scanner
        return cls(
            timing=ScanTiming.of(camera),
            bandwidth_hz=1e6 * float(section.bandwidth_mhz),
            coupling_hz=float(section.coupling_hz),
            clock_error_s=1e-9 * float(section.clock_error_ns),
            reference=float(camera.signal_of(float(section.reference_c) + KELVIN)),
        )

    def mean(self, light: StageImage) -> StageImage:
        values = np.asarray(light.values, float)
        leftward = is_scanned_left(values.shape[-2])
        samples = np.empty((*values.shape[:-1], self.timing.samples))
        samples[..., ~leftward, :] = self._sweep(values[..., ~leftward, :])
        samples[..., leftward, :] = self._sweep(values[..., leftward, ::-1])[..., ::-1]
        return light.with_values(samples)

    def _sweep(self, cells: Array) -> Array:
        """Samples of lines (..., cell) in the order of the sweep."""
        from scipy.interpolate import CubicSpline
        from scipy.signal import lfilter

        timing = self.timing
        pole_s = 1.0 / (2.0 * np.pi * self.bandwidth_hz)
        step_s = timing.active_s / LIMITS.line_steps
        lead_steps = int(np.ceil(LIMITS.lead * pole_s / step_s)) if pole_s else 0
        margin = int(np.ceil((pole_s + abs(self.clock_error_s)) / step_s)) + 1
        time_s = (
            np.arange(-lead_steps - margin, LIMITS.line_steps + margin + 1)
        ) * step_s - 0.5 * timing.active_s
        middles = ((np.arange(cells.shape[-1]) + 0.5) / cells.shape[-1] - 0.5) * timing.field_mrad
        angle = timing.amplitude_mrad * np.sin(2.0 * np.pi * timing.mirror_hz * time_s)
        signal = CubicSpline(middles, cells - self.reference, axis=-1)(
            np.clip(angle, middles[0], middles[-1])
        )
        if pole_s:
            # The mean of two steps makes the delay that of the pole.
            decay = np.exp(-step_s / pole_s)
            gain = 0.5 * (1.0 - decay)
            start = (1.0 - gain) * signal[..., :1]
            signal = lfilter([gain, gain], [1.0, -decay], signal, axis=-1, zi=start)[0]
        if self.coupling_hz:
            half_phase = np.pi * self.coupling_hz * step_s
            coupled = lfilter(
                [1.0, -1.0], [1.0 + half_phase, half_phase - 1.0], signal[..., lead_steps:], axis=-1
            )
            signal = np.concatenate([signal[..., :lead_steps], coupled], axis=-1)
        # Linear between steps, which are shorter than a tenth of the dwell.
        step = (timing.sample_s + pole_s + self.clock_error_s - time_s[0]) / step_s
        index = np.floor(step).astype(int)
        fraction = step - index
        return (
            signal[..., index] * (1.0 - fraction)
            + signal[..., index + 1] * fraction
            + self.reference
        )


def noise_equivalent_radiance(imager: Camera, noise_hz: float) -> float:
    r"""Return the noise of a scanner's detector as radiance of the scene, W m-2 sr-1.

    Notes
    -----
    .. math:: \sigma_L = \frac{4 N^2 \sqrt{\Delta f}}{\pi \sqrt{A_d} \tau D^*}

    With :math:`\pi dL/dT = dM/dT` this is the noise-equivalent temperature difference
    :math:`4 N^2 \sqrt{\Delta f} / (\sqrt{A_d} \tau D^* dM/dT)` (Lloyd, Thermal Imaging Systems,
    1975, chapter 5).
    """
    scanner, optics = imager.scanner, imager.optics
    assert scanner is not None
    detector_cm = float(scanner.detector_um) * 1e-4
    watt_per_cm2 = 4.0 * float(optics.f_number) ** 2 * np.sqrt(noise_hz) / detector_cm
    return (
        1e4
        * watt_per_cm2
        / (np.pi * float(optics.transmission) * float(scanner.detectivity_cm_hz_per_w))
    )


@dataclass(frozen=True, kw_only=True)
class LineNoise(
    Stage, slot=Slot.NOISE, section="scanner", takes="signal of samples", emits="corrected signal"
):
    """White and 1/f noise of the detector behind the electronics, and the noise of each line's
    clamp.

    Notes
    -----
    White noise of density n0 behind one pole of f_c has the variance n0 pi f_c / 2 and a
    correlation exp(-2 pi f_c t), so that samples at the edge of a sine sweep, which are farther
    apart in time, correlate over a smaller angle. 1/f noise has the density n0 f_k / f. Lines of
    length T among others over a time D then vary by n0 f_k ln(D / T); as it is drawn for a frame at
    a time, from one cycle a frame on, lines of a frame vary by 2 % less. A clamp of m samples, far
    enough apart to be independent, adds 1/m of the white variance and removes what 1/f noise is
    common to the line and the turn before it. The mean of n frames, independent of each other, has
    1/n of all of it.
    """

    effects: ClassVar = {
        "white noise": {"white": 0.0},
        "1/f noise": {"knee_hz": 0.0},
        "line clamp": {"clamp_samples": 0},
        "frame averaging": {"averaged": 1},
    }
    timing: ScanTiming
    field_rate_hz: float
    bandwidth_hz: float
    coupling_hz: float
    knee_hz: float
    clamp_samples: int
    sigma: float  # standard deviation of white noise in one sample
    white: float = 1.0  # factor of white noise
    averaged: int = 1  # frames

    @classmethod
    def of(cls, camera: Any, conditions: Conditions) -> Self:
        section = camera.description.scanner
        return cls(
            timing=ScanTiming.of(camera),
            field_rate_hz=float(camera.description.video.field_rate_hz),
            bandwidth_hz=1e6 * float(section.bandwidth_mhz),
            coupling_hz=float(section.coupling_hz),
            knee_hz=float(section.knee_hz),
            clamp_samples=section.clamp_samples,
            sigma=camera.sigma(),
            averaged=section.averaged_frames,
        )

    def mean(self, light: StageImage) -> StageImage:
        return light

    def draw(self, light: StageImage, rng: np.random.Generator) -> StageImage:
        rows = light.values.shape[-2]
        noise = self.white * self._white(rng, rows)
        clamp = (
            self.white
            * rng.standard_normal(rows)
            / np.sqrt(max(self.clamp_samples, 1))
            * bool(self.clamp_samples)
        )
        if self.knee_hz:
            line_flicker, clamp_flicker = self._flicker(rng, rows)
            noise += line_flicker
            clamp = clamp + clamp_flicker * bool(self.clamp_samples)
        noise -= clamp[:, None]
        leftward = is_scanned_left(rows)
        noise[leftward] = noise[leftward, ::-1]
        return light.with_values(light.values + self.sigma / np.sqrt(self.averaged) * noise)

    def _white(self, rng: np.random.Generator, rows: int) -> Array:
        """White noise behind the pole at the samples of lines, of variance 1, shape (row,
        sample).
        """
        noise = rng.standard_normal((self.timing.samples, rows))
        correlations = np.exp(-2.0 * np.pi * self.bandwidth_hz * np.diff(self.timing.sample_s))
        for j, r in enumerate(correlations, 1):
            noise[j] = r * noise[j - 1] + np.sqrt(1.0 - r * r) * noise[j]
        return noise.T

    def _flicker(self, rng: np.random.Generator, rows: int) -> tuple[Array, Array]:
        """1/f noise of samples (row, sample) and its mean over the turn before each line, (row,);
        white noise is 1.
        """
        timing = self.timing
        lines = round(2.0 / (timing.line_s * self.field_rate_hz))
        count, step_s = lines * LIMITS.values_per_line, timing.line_s / LIMITS.values_per_line
        hz = np.fft.rfftfreq(count, step_s)[1:]
        density = (
            self.knee_hz
            / hz
            / (1.0 + (hz / self.bandwidth_hz) ** 2)
            / (1.0 + (self.coupling_hz / hz) ** 2)
        )
        density /= NOISE_BANDWIDTH * self.bandwidth_hz
        normal = rng.standard_normal((2, hz.size))
        # A one-sided density: each bin of width 1 / (count step) has the variance density times
        # width.
        amplitude = 0.5 * count * np.sqrt(density / (count * step_s))
        series = np.fft.irfft(np.append(0.0, amplitude * (normal[0] + 1j * normal[1])), count)
        # The second field begins half a frame later.
        start = (np.arange(rows) // 2) * timing.line_s + (
            np.arange(rows) % 2
        ) * 0.5 * lines * timing.line_s
        step = (start[:, None] + 0.5 * timing.line_s + timing.sample_s) / step_s
        index = np.floor(step).astype(int)
        fraction = step - index
        active = series[index % count] * (1.0 - fraction) + series[(index + 1) % count] * fraction
        half = 0.5 * (1.0 - timing.active_fraction) * LIMITS.values_per_line
        turn_steps = np.round(start / step_s)[:, None].astype(int) + np.arange(
            -round(half), round(half)
        )
        return active, series[turn_steps % count].mean(axis=1)
