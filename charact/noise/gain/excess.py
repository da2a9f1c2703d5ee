"""Excess noise of a multiplying register: slope of variance over signal = K g F^2, K g the gain per electron before it.

The register multiplies at random, which adds as much noise again as the light has: F^2 = 2 at high gain.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from labdata.conditions import Conditions
from labdata.solid_state import excess_noise_factor

# Gain from which the heights of one electron are exponential, see `labdata.solid_state.excess_noise_factor`: F^2 lies
# within 5 % of 2.
EXPONENTIAL_FROM = 20.0
# Stages of a register that nobody described: those of real ones (Robbins & Hadwen: 400 to 600) and no limit.
FEWEST_STAGES = 400.0


@dataclass(frozen=True, kw_only=True)
class Excess:
    """What a slope is divided by.

    Parameters
    ----------
    factor
        F^2 of the register; 1 for none.
    relative_sd
        Relative standard deviation of it.
    note
        Where it comes from; None for none.
    """

    factor: float = 1.0
    relative_sd: float = 0.0
    note: str | None = None

    def divide(self, slope: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
        """Return draws of the gain per electron from those of the slope."""
        if self.note is None:
            return slope
        chance = np.random.default_rng([seed, 18]).standard_normal(len(slope))
        return slope / (self.factor * np.exp(self.relative_sd * chance))


def excess_of(conditions: Conditions, context: Context) -> Excess:
    """Return the excess noise factor of the register, from its gain as the session states it, else as described."""
    gain, register = conditions.em_gain, context.register
    if context.sensor is not None or (gain is None and register is None):
        return Excess()
    source = f"em_gain {gain:g} of the session" if gain is not None else ""
    if gain is None and register is not None:
        gain, source = float(register.em_gain), f"em_gain {float(register.em_gain):g} of the description"
    if gain is None or gain <= 1.0:
        return Excess()
    # Between many equal stages and heights of one electron that are exponential: 1 or 2 % apart.
    least = excess_noise_factor(gain, FEWEST_STAGES if register is None else register.stages)
    factor, half = 0.5 * (2.0 + least), 0.5 * (2.0 - least)
    if gain < EXPONENTIAL_FROM:
        factor, half = excess_noise_factor(gain), excess_noise_factor(gain) - least
    note = (
        f"per electron before the multiplying register: variance over signal is K F2, and F2 = {factor:.4g} "
        f"({source}; Robbins & Hadwen 2003) is divided out"
    )
    return Excess(factor=factor, relative_sd=half / factor, note=note)
