"""The video chain: a causal low pass along the lines, black level, gamma and whole digital numbers."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.iiccd.light import Light
from simulate.iiccd.transfer import VideoFilter


@dataclass(frozen=True, kw_only=True)
class Video:
    """Amplifier, low pass and digitiser.

    Parameters
    ----------
    low_pass
        The filter along lines.
    conversion_gain_dn_per_e
        DN per electron of charge.
    black_level_dn
        Level without charge, DN.
    gamma
        Exponent y = x^gamma of the signal above black, relative to full scale, dimensionless.
    bit_depth
        Bits of the digitiser.
    """

    low_pass: VideoFilter
    conversion_gain_dn_per_e: float
    black_level_dn: float
    gamma: float
    bit_depth: int
    name: str = "video"
    takes: str = "charge"
    emits: str = "DN"

    def __post_init__(self) -> None:
        if not 1 <= self.bit_depth <= 16:
            raise BadInput(f"bit_depth must lie in 1..16, got {self.bit_depth}")
        if not self.gamma > 0.0:
            raise BadInput(f"gamma must be positive, got {self.gamma:g}")

    @property
    def full_scale_dn(self) -> int:
        """Highest code, DN."""
        return 2**self.bit_depth - 1

    def mean(self, light: Light) -> Light:
        """Return the level, DN, neither rounded nor clipped at the ends of the scale."""
        return light.with_values(self._level(light.values))

    def draw(self, light: Light, rng: np.random.Generator) -> Light:
        """Return whole DN between 0 and full scale, uint8 or uint16."""
        codes = np.rint(self._level(light.values))
        np.clip(codes, 0, self.full_scale_dn, out=codes)
        return light.with_values(codes.astype(np.uint8 if self.bit_depth <= 8 else np.uint16))

    def _level(self, charge: NDArray) -> NDArray[np.float32]:
        signal = filtered(charge, self.low_pass.impulse_response()) * np.float32(self.conversion_gain_dn_per_e)
        if self.gamma != 1.0:
            span = np.float32(self.full_scale_dn - self.black_level_dn)
            signal = span * np.sign(signal) * np.abs(signal / span) ** np.float32(self.gamma)
        return signal + np.float32(self.black_level_dn)


def filtered(lines: NDArray, impulse_response: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return lines (..., col) through a causal filter; before its first pixel a line is like its first pixel."""
    significant = np.flatnonzero(np.abs(impulse_response) > 1e-7)
    taps = impulse_response[: significant[-1] + 1].astype(np.float32)
    lead = len(taps) - 1
    padded = np.concatenate([np.repeat(lines[..., :1], lead, axis=-1), lines], axis=-1).astype(np.float32)
    columns = lines.shape[-1]
    total = taps[0] * padded[..., lead : lead + columns]
    for n in range(1, len(taps)):
        total += taps[n] * padded[..., lead - n : lead - n + columns]
    return total
