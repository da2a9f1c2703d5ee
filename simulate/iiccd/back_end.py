"""The digital back end: every pixel's charge digitised for itself, without a video signal between."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.iiccd.stage_image import StageImage


@dataclass(frozen=True, kw_only=True)
class Unfiltered:
    """A line that is read pixel by pixel: what a video filter is where there is none."""

    def impulse_response(self, length: int = 1) -> NDArray[np.float64]:
        """Return 1 and zeros, shape (length,)."""
        return np.eye(1, length)[0]

    def transfer(self, frequency_cy_per_px: NDArray[np.floating]) -> NDArray[np.complex128]:
        """Return 1 at every frequency."""
        return np.ones(np.shape(frequency_cy_per_px), np.complex128)


@dataclass(frozen=True, kw_only=True)
class DigitalBackEnd:
    """Amplifier and digitiser of one pixel after the other.

    Parameters
    ----------
    conversion_gain_dn_per_e
        DN per electron at the output, behind any multiplication.
    black_level_dn
        Level without charge, DN.
    bit_depth
        Bits of the digitiser, at most 16.
    gamma
        Exponent y = x^gamma of the signal above black, relative to full scale, dimensionless.
    gain
        Factor of the automatic gain, dimensionless.
    """

    conversion_gain_dn_per_e: float
    black_level_dn: float
    bit_depth: int
    gamma: float = 1.0
    gain: float = 1.0
    low_pass: Unfiltered = Unfiltered()
    name: str = "video"
    takes: str = "charge"
    emits: str = "DN"

    def __post_init__(self) -> None:
        refuse_impossible_digitiser(self.bit_depth, self.gamma)

    @property
    def full_scale_dn(self) -> int:
        """Highest code, DN."""
        return 2**self.bit_depth - 1

    def mean(self, light: StageImage) -> StageImage:
        """Return the level, DN, neither rounded nor clipped at the ends of the scale."""
        signal = light.values * np.float32(self.conversion_gain_dn_per_e * self.gain)
        return light.with_values(
            apply_gamma(signal, self.gamma, self.full_scale_dn - self.black_level_dn) + np.float32(self.black_level_dn)
        )

    def draw(self, light: StageImage, rng: np.random.Generator) -> StageImage:
        """Return whole DN between 0 and full scale, uint8 or uint16."""
        return light.with_values(digitise(self.mean(light).values, self.bit_depth))


def refuse_impossible_digitiser(bit_depth: int, gamma: float) -> None:
    """Refuse more than sixteen bits, fewer than one, and a gamma that is not positive."""
    if not 1 <= bit_depth <= 16:
        raise BadInput(f"bit_depth must lie in 1..16, got {bit_depth}")
    if not gamma > 0.0:
        raise BadInput(f"gamma must be positive, got {gamma:g}")


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
