"""Excess noise of a multiplying register."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.thresholds import GAIN
from labdata.conditions import Conditions
from labdata.solid_state import excess_noise_factor


@dataclass(frozen=True, kw_only=True)
class Excess:
    """Excess noise factor of a register.

    Parameters
    ----------
    factor
        F^2; 1 without a register.
    relative_sd
        Relative standard deviation of F^2.
    note
        Source of the value; None without a register.
    """

    factor: float = 1.0
    relative_sd: float = 0.0
    note: str | None = None

    def divide(self, slope: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
        """Return draws of the gain per electron: slope over F^2."""
        if self.note is None:
            return slope
        chance = np.random.default_rng([seed, 18]).standard_normal(len(slope))
        return slope / (self.factor * np.exp(self.relative_sd * chance))


def excess_of(conditions: Conditions, context: Context) -> Excess:
    """Return the excess noise factor of the register, from the stated gain or else the described one."""
    gain, register = conditions.em_gain, context.register
    if context.sensor is not None or (gain is None and register is None):
        return Excess()
    source = f"em_gain {gain:g} of the session" if gain is not None else ""
    if gain is None and register is not None:
        gain, source = float(register.em_gain), f"em_gain {float(register.em_gain):g} of the description"
    if gain is None or gain <= 1.0:
        return Excess()
    # Between many equal stages and exponential pulse heights, which differ by 1 or 2 %.
    least = excess_noise_factor(gain, GAIN.min_stages if register is None else register.stages)
    factor, half = 0.5 * (2.0 + least), 0.5 * (2.0 - least)
    if gain < GAIN.exponential_gain:
        factor, half = excess_noise_factor(gain), excess_noise_factor(gain) - least
    note = (
        f"per electron before the multiplying register: variance over signal is K F2, and F2 = {factor:.4g} "
        f"({source}; Robbins & Hadwen 2003) is divided out"
    )
    return Excess(factor=factor, relative_sd=half / factor, note=note)
