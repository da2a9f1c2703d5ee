"""Video: low pass along lines, black level, gamma and digitiser; a digital camera has no low pass."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.iiccd.stage_image import StageImage
from simulate.iiccd.transfer import VideoFilter


@dataclass(frozen=True, kw_only=True)
class NoFilter:
    """Filter of a camera whose pixels are digitised one by one, without a video signal."""

    def impulse_response(self, length: int = 1) -> NDArray[np.float64]:
        """Return 1 and zeros, shape (length,)."""
        return np.eye(1, length)[0]

    def transfer(self, frequency_cy_per_px: NDArray[np.floating]) -> NDArray[np.complex128]:
        """Return 1 at every frequency."""
        return np.ones(np.shape(frequency_cy_per_px), np.complex128)


@dataclass(frozen=True, kw_only=True)
class Video:
    """Amplifier, low pass and digitiser.

    Parameters
    ----------
    conversion_gain_dn_per_e
        DN per electron of charge.
    black_level_dn
        Level without charge, DN.
    bit_depth
        Bits of the digitiser, at most 16.
    low_pass
        Filter along lines.
    gamma
        Exponent y = x^gamma of the signal above black, relative to full scale, dimensionless.
    gain
        Factor of the automatic gain, which acts on signal and noise alike, dimensionless.
    sync_jitter_px
        Standard deviation of the start of a line, pixels.
    line_noise_dn
        Standard deviation of an offset common to a line, DN.
    """

    conversion_gain_dn_per_e: float
    black_level_dn: float
    bit_depth: int
    low_pass: VideoFilter | NoFilter = NoFilter()
    gamma: float = 1.0
    gain: float = 1.0
    sync_jitter_px: float = 0.0
    line_noise_dn: float = 0.0
    name: str = "video"
    takes: str = "charge"
    emits: str = "DN"

    def __post_init__(self) -> None:
        if not 1 <= self.bit_depth <= 16:
            raise BadInput(f"bit_depth must lie in 1..16, got {self.bit_depth}")
        if not self.gamma > 0.0:
            raise BadInput(f"gamma must be positive, got {self.gamma:g}")
        # A parabola through three pixels describes shifts well below a pixel only.
        if not 0.0 <= self.sync_jitter_px <= 0.5:
            raise BadInput(f"sync_jitter_px must lie between 0 and 0.5, got {self.sync_jitter_px:g}")
        if not self.line_noise_dn >= 0.0:
            raise BadInput(f"line_noise_dn must not be negative, got {self.line_noise_dn:g}")

    @property
    def full_scale_dn(self) -> int:
        """Highest code, DN."""
        return 2**self.bit_depth - 1

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
            late = self.sync_jitter_px * rng.standard_normal((*signal.shape[:-1], 1), dtype=np.float32)
            signal = shift_lines(signal, late)
        level = self._level(signal)
        if self.line_noise_dn > 0.0:
            level += np.float32(self.line_noise_dn) * rng.standard_normal((*level.shape[:-1], 1), dtype=np.float32)
        return light.with_values(digitise(level, self.bit_depth))

    def _level(self, signal: NDArray[np.float32]) -> NDArray[np.float32]:
        signal = signal * np.float32(self.conversion_gain_dn_per_e * self.gain)
        return apply_gamma(signal, self.gamma, self.full_scale_dn - self.black_level_dn) + np.float32(
            self.black_level_dn
        )


def apply_gamma(signal: NDArray[np.float32], gamma: float, span_dn: float) -> NDArray[np.float32]:
    """Return y = x^gamma of a signal above black, relative to the span between black and full scale."""
    if gamma == 1.0:
        return signal
    span = np.float32(span_dn)
    return span * np.sign(signal) * np.abs(signal / span) ** np.float32(gamma)


def digitise(level_dn: NDArray[np.float32], bit_depth: int) -> NDArray[np.unsignedinteger]:
    """Return whole DN between 0 and full scale, uint8 up to eight bits and uint16 beyond."""
    whole = np.rint(level_dn)
    np.clip(whole, 0, 2**bit_depth - 1, out=whole)
    return whole.astype(np.uint8 if bit_depth <= 8 else np.uint16)


def shift_lines(lines: NDArray[np.float32], late_px: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return lines (..., col) delayed by less than a pixel, (..., 1), by a parabola through three pixels."""
    slope = 0.5 * (_neighbour(lines, 1) - _neighbour(lines, -1))
    return (lines - late_px * slope + np.float32(0.5) * late_px**2 * _bend(lines)).astype(np.float32)


def _bend(lines: NDArray[np.float32]) -> NDArray[np.float32]:
    return (_neighbour(lines, 1) - np.float32(2.0) * lines + _neighbour(lines, -1)).astype(np.float32)


def _neighbour(lines: NDArray[np.float32], step: int) -> NDArray[np.float32]:
    """Lines shifted by one pixel, with their ends repeated."""
    moved = np.roll(lines, -step, axis=-1)
    moved[..., -1 if step > 0 else 0] = lines[..., -1 if step > 0 else 0]
    return moved


def filter_lines(lines: NDArray, impulse_response: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return lines (..., col) after a causal filter; the first pixel is repeated before the line."""
    significant = np.flatnonzero(np.abs(impulse_response) > 1e-7)
    taps = impulse_response[: significant[-1] + 1].astype(np.float32)
    lead = len(taps) - 1
    padded = np.concatenate([np.repeat(lines[..., :1], lead, axis=-1), lines], axis=-1).astype(np.float32)
    columns = lines.shape[-1]
    total = taps[0] * padded[..., lead : lead + columns]
    for n in range(1, len(taps)):
        total += taps[n] * padded[..., lead - n : lead - n + columns]
    return total
