"""Automatic gain (AGC) and automatic brightness control (ABC): control laws from one state to the next.

They act at different places. The tube's brightness control lowers the MCP's gain, before the CCD: fewer electrons per
photoelectron, the same photoelectrons, so the shot noise stays while electronics weigh more. The camera's automatic
gain multiplies charge and noise alike, after the noise. The state, a factor, is carried by the caller.
"""

from dataclasses import dataclass

import numpy as np

from labdata.errors import BadInput

# Set point of automatic gain as a fraction of the range above black: a typical image is darker than half white.
SET_LEVEL = 0.4


@dataclass(frozen=True, kw_only=True)
class AutomaticState:
    """State of both controls: factors of MCP gain and video gain, dimensionless, initially 1."""

    brightness: float = 1.0
    gain: float = 1.0


@dataclass(frozen=True, kw_only=True)
class AutomaticGain:
    """Automatic gain of the camera, controlled by the mean level above black.

    Parameters
    ----------
    set_level_dn
        Set point of the mean level above black, DN.
    range_db
        Highest over lowest gain, 20 log10; the lowest is 1.
    time_constant_s
        Time in which an error of the level falls to 1/e.
    step_s
        Time from one reading of the meter to the next, s.

    Notes
    -----
    g <- clip(g [1 + a (set - S)/set], 1, 10^(range/20)), a = 1 - exp(-step/tau).
    """

    set_level_dn: float
    range_db: float
    time_constant_s: float
    step_s: float

    def __post_init__(self) -> None:
        for name in ("set_level_dn", "time_constant_s", "step_s"):
            if not getattr(self, name) > 0.0:
                raise BadInput(f"{name} must be positive, got {getattr(self, name):g}")
        if not self.range_db >= 0.0:
            raise BadInput(f"range_db must not be negative, got {self.range_db:g}")

    @property
    def highest(self) -> float:
        """Highest gain, dimensionless."""
        return 10.0 ** (self.range_db / 20.0)

    def next(self, state: float, level_dn: float) -> float:
        """Return the gain after a field whose mean level above black, at gain `state`, was `level_dn`."""
        step = -np.expm1(-self.step_s / self.time_constant_s)
        return float(np.clip(state * (1.0 + step * (1.0 - level_dn / self.set_level_dn)), 1.0, self.highest))


@dataclass(frozen=True, kw_only=True)
class BrightnessControl:
    """Automatic brightness control of the tube, controlled by the mean phosphor current.

    Parameters
    ----------
    limit_e_per_s_cm2
        Limit of the mean output of the MCP, electrons per s and cm2.
    attack_s
        Time constant, s.
    step_s
        Time from one reading to the next, s.

    Notes
    -----
    g <- min(1, g (limit/J)^a), a = 1 - exp(-step/tau): ln J approaches ln limit with the time constant, from any
    overload. Below the limit the gain is given back as fast.
    """

    limit_e_per_s_cm2: float
    attack_s: float
    step_s: float

    def __post_init__(self) -> None:
        for name in ("limit_e_per_s_cm2", "attack_s", "step_s"):
            if not getattr(self, name) > 0.0:
                raise BadInput(f"{name} must be positive, got {getattr(self, name):g}")

    def next(self, state: float, output_e_per_s_cm2: float) -> float:
        """Return the MCP's gain factor after a field whose mean output, at factor `state`, was this."""
        if not output_e_per_s_cm2 > 0.0:
            return 1.0
        step = -np.expm1(-self.step_s / self.attack_s)
        return float(min(1.0, state * (self.limit_e_per_s_cm2 / output_e_per_s_cm2) ** step))
