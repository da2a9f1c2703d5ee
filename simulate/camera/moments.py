"""Moments of the pulses of a chain behind a tube."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simulate.camera.chain import Chain, Slot
from simulate.camera.stage_image import StageImage
from simulate.camera.transfer import StageBlur


@dataclass(frozen=True)
class PulseMoments:
    """Gain, spread over exposures, and filter of the pulses of a chain, nothing saturated."""

    chain: Chain

    @cached_property
    def gain_e(self) -> float:
        """CCD electrons per photoelectron, the undetected counted."""
        optical = float(self.chain[Slot.PHOSPHOR].photons_per_electron) * float(
            self.chain[Slot.TAPER].transmission
        )
        return self.chain[Slot.MCP].gain * (optical * self.chain[Slot.CCD].quantum_efficiency)

    @cached_property
    def blurs(self) -> tuple[StageBlur, ...]:
        """Blurs behind the gain, the pixels' aperture left out."""
        return (
            self.chain.between(Slot.PHOSPHOR, Slot.TAPER)
            .mean(StageImage(values=np.zeros((1, 1))))
            .pending_blurs
        )

    @cached_property
    def shares(self) -> NDArray[np.floating]:
        """Fractions of a pulse's light emitted in its own field and in later ones, shape (pulse,
        field).
        """
        return self.chain[Slot.DECAY].pulse_shares

    @cached_property
    def decay(self) -> tuple[float, float]:
        """Factors by which phosphor decay reduces the second and third moment of a pulse."""
        return float(np.mean(np.sum(self.shares**2, axis=1))), float(
            np.mean(np.sum(self.shares**3, axis=1))
        )

    @cached_property
    def next_field(self) -> float:
        """Mean product of the fractions of consecutive fields."""
        return float(np.mean(np.sum(self.shares[:, 1:] * self.shares[:, :-1], axis=1)))

    @cached_property
    def white(self) -> float:
        """Factor by which the line filter reduces the variance of white noise, as of the charge's
        own shot noise.
        """
        return float(
            np.sum(np.asarray(self.chain[Slot.VIDEO].low_pass.impulse_response(), float) ** 2)
        )
