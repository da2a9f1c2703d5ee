"""Knee of noise against gain: equal read noise and scintillation noise.

At signal S, covariance gain C and blur factor B the variance is B C S = B C^2 n for n = S/C effective photoelectrons (n
unequal pulses count as n/F^2). It equals the squared read noise r^2 at C = r / sqrt(B n).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.noise.checks import QUANTISED_DN2
from charact.noise.sweep.gain_law import GainLaw
from charact.noise.sweep.settings import SweepSetting
from charact.noise.thresholds import SWEEP

Array = NDArray[np.float64]

# Signal of the stated knee, effective photoelectrons per pixel and exposure.
STATED_PE = 1.0


@dataclass(frozen=True, kw_only=True)
class Knee:
    """Gain of equal read noise and scintillation noise.

    Parameters
    ----------
    read_noise_dn
        Draws of the read noise without dark scintillation, shape (draw,), DN.
    gain_dn
        Draws of the covariance gain at the knee, shape (draw,), DN.
    place
        Draws of its position on the axis of the sweep, between -1/2 and 1/2 inside the sweep, shape (draw,).
    flags
        Flags of the read noise.
    """

    read_noise_dn: Array
    gain_dn: Array
    place: Array
    flags: tuple[str, ...] = ()


def knee_of(settings: tuple[SweepSetting, ...], law: GainLaw, *, seed: int) -> Knee | str:
    """Return the knee of a sweep, or the reason for refusal.

    Parameters
    ----------
    settings
        Settings, some with darks.
    law
        Law of the covariance gain.
    seed
        Seed of the draws.
    """
    rng = np.random.default_rng([seed, 9])
    dark = {s.dark: i for i, s in enumerate(settings) if s.dark_variance_dn2 is not None}
    if not dark:
        return "the knee needs darks at one setting at least: the read noise is unknown"
    own = [settings[i] for i in dark.values()]
    floor = _floor(law.settings[:, list(dark.values())], own, rng)
    if np.quantile(floor, 0.025) <= 0:
        return "dark scintillation at every setting hides the read noise and the knee"
    floor = np.maximum(floor, np.quantile(floor, 0.01).clip(1e-9))
    pulses = _pulses_at(floor, law)
    place = (np.log(pulses) - law.posterior["log_gain"]) / law.posterior["rise"]
    return Knee(read_noise_dn=np.sqrt(floor), gain_dn=pulses + law.electron_gain_dn, place=place, flags=_flags(own))


def outside_reason(knee: Knee) -> str | None:
    """Return the refusal of a knee outside the sweep, or None if inside."""
    middle = float(np.median(knee.place))
    if abs(middle) <= 0.5:
        return None
    low, high = np.quantile(knee.gain_dn, [0.025, 0.975])
    side, ruler = ("below", "scintillation outweighs") if middle < 0 else ("above", "read noise outweighs")
    other = "read noise" if middle < 0 else "scintillation"
    return (
        f"not reached in the sweep: {ruler} {other} at every setting at {STATED_PE:g} photoelectron per pixel; "
        f"the knee is where the covariance gain is {low:.3g} to {high:.3g} DN, {side} the sweep"
    )


def _pulses_at(floor_dn2: Array, law: GainLaw) -> Array:
    """Return draws of the pulse gain P, DN, at which (K + S P)(K + P) n is the squared read noise, K the electron
    gain."""
    left = np.exp(law.posterior["log_blur"]) if "log_blur" in law.posterior.names else np.ones(len(floor_dn2))
    half, electrons = 0.5 * (1.0 + left) * law.electron_gain_dn, law.electron_gain_dn
    root = np.sqrt(np.maximum(half**2 - left * (electrons**2 - floor_dn2 / STATED_PE), half**2))
    return np.maximum(root - half, 1e-6 * root) / left


def _floor(gain: Array, settings: list[SweepSetting], rng: np.random.Generator) -> Array:
    """Return draws of the dark variance at zero gain, shape (draw,), DN^2: D = r^2 + c C^2, c for scintillation."""
    variance = np.array([s.dark_variance_dn2 for s in settings], float)
    sd = np.hypot([s.dark_variance_sd_dn2 for s in settings], SWEEP.dark_model_sd * variance)
    drawn = variance + sd * rng.standard_normal(gain.shape)
    weight, square = 1.0 / sd**2, gain**2
    total, mean = weight.sum(), (drawn @ weight) / weight.sum()
    if len(settings) < 2:
        return mean
    away = square - (square @ weight)[:, None] / total
    slope = ((drawn * away) @ weight) / ((away**2) @ weight)
    return np.where(slope > 0, mean - slope * (square @ weight) / total, mean)


def _flags(dark: list[SweepSetting]) -> tuple[str, ...]:
    """Return the flags: one dark cannot separate scintillation; small noise is quantised."""
    flags = ("unlike-conditions",) if len(dark) < 2 else ()
    least = min(s.dark_variance_dn2 or 0.0 for s in dark)
    return flags + (("quantised",) if least < QUANTISED_DN2 else ())
