"""Darks of a camera with a tube: the noise between pulses, and light of pulses too weak to be
seen.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.fitting import predicted_quantities as predicted
from charact.fitting.thresholds import DARK_ERRORS, DARKS
from charact.fitting.tube_ions import DETECTED, SHAPE, IonEvents, moment_below, square_below
from charact.fitting.tube_light import field_products
from charact.observables import Values
from charact.observables.silicon import warmth
from charact.observables.stack_level import StackLevel
from labdata import Array, Mask
from labdata.camera.description import Camera


@dataclass(frozen=True, kw_only=True)
class Darks:
    """Frames of a dark, what is quiet in them, and how its pulses are expected to look."""

    data: NDArray[np.float32]  # shape (frame, row, col), DN
    level: StackLevel
    sensor: Camera
    level_dn: float  # mean of the quiet pixels before rounding, DN
    noise_dn: float  # their standard deviation before rounding, DN
    noise_relative_sd: float  # relative error of that by the pulses among them
    quiet: Mask  # pixels without a pulse near by, shape (frame, row, col)
    ions: IonEvents

    @property
    def is_coarse(self) -> bool:
        """Whether the noise is so small that rounding is no noise of its own."""
        return self.noise_dn <= DARK_ERRORS.coarse_dn

    def warmth(self, values: Values) -> Array:
        """Return dark current over that at 25 C, shape (n,)."""
        return warmth(values, self.level.conditions)

    def gain(self, values: Values) -> Array:
        """Return the signal of a photoelectron, shape (n,), DN."""
        return predicted.photoelectron_gain(values, self.level.mcp_v)

    def background(self, values: Values) -> Array:
        """Return the mean signal of the background illumination, shape (n,), DN."""
        return self.gain(values) * predicted.background_rate(values) * self.level.gate_s

    def light_below_threshold(self, values: Values) -> Array:
        """Return the fraction of the background illumination that falls on quiet pixels, shape
        (n,).
        """
        hidden = moment_below(values[SHAPE], 1.0, self._unseen(values), 1)
        return np.minimum(hidden + DARK_ERRORS.wing, 1.0)

    def variance_below_threshold(self, values: Values) -> Array:
        """Return the variance of the pulses that are hidden by the noise, shape (n,), DN^2."""
        hidden = square_below(values[SHAPE], self._unseen(values))
        event = self.gain(values) * predicted.excess_noise_factor(values)
        blur, decay = self._spread(values)
        return hidden * event * self.background(values) * blur * decay

    def _unseen(self, values: Values) -> Array:
        """Return the heights, in mean detected pulses, below which a pulse is hidden by the noise,
        shape (n,).
        """
        blur, decay = self._spread(values)
        peak = self.gain(values) / values[DETECTED] * 2.0 * blur * np.sqrt(decay)
        return max(DARKS.pulse_dn, DARKS.pulse_sd * self.noise_dn) / np.maximum(peak, 1e-9)

    def _spread(self, values: Values) -> tuple[Array, Array]:
        """Return the fractions of a pulse's variance that blur and decay leave in a pixel."""
        blur = predicted.pulse_covariance(values, ((0.0, 0.0),))[:, 0]
        return blur, field_products(values, self.level.gate_s, 1)[:, 0]


def darks_of(ions: IonEvents) -> Darks | None:
    """Return the frames of a dark and what is quiet in them, or None where its noise cannot be
    located.
    """
    from scipy.ndimage import maximum_filter

    data = ions.data
    first = quiet_noise(data.ravel())
    if first is None:
        return None
    pulse = data >= first[0] + max(DARKS.pulse_dn, DARKS.pulse_sd * first[1])
    quiet = maximum_filter(pulse, size=(1, *DARKS.pulse_reach)) == 0
    noise = quiet_noise(data[quiet]) if quiet.mean() > DARKS.least_quiet else None
    # Pulses among all pixels raise their noise by up to a seventh, among quiet ones by some
    # percent.
    noise, relative_sd = (noise, 0.03) if noise else (first, 0.15)
    return Darks(
        data=data,
        level=ions.level,
        sensor=ions.sensor,
        level_dn=noise[0],
        noise_dn=noise[1],
        noise_relative_sd=relative_sd,
        quiet=quiet,
        ions=ions,
    )


def thresholds_of(values: NDArray[np.floating]) -> tuple[float, float] | None:
    """Return two levels between grey values that locate the lower side and the middle of the noise,
    DN.
    """
    codes, counts = np.unique(values, return_counts=True)
    counts_below = np.cumsum(counts)
    fine = counts.max() < DARKS.fine_fraction * values.size
    least_below = DARKS.fine_below[0] * values.size if fine else float(DARKS.least_count)
    most_below = (DARKS.fine_below[1] if fine else DARKS.most_below) * values.size
    low, high = (
        np.searchsorted(counts_below, least_below),
        np.searchsorted(counts_below, most_below, side="right") - 1,
    )
    return (float(codes[low]) + 0.5, float(codes[high]) + 0.5) if high > low else None


def quiet_noise(values: NDArray[np.floating]) -> tuple[float, float] | None:
    """Return level and standard deviation before rounding of normal noise, from its lower side, DN.

    The fraction below a level c between grey values is the normal distribution at (c - level)/sd,
    rounded or not. Pulses only raise values. None of noise that reaches no second grey value.
    """
    levels = thresholds_of(values)
    if levels is None:
        return None
    return level_and_sd(np.array([float(np.mean(values < level)) for level in levels]), levels)


def level_and_sd(fractions_below: Array, levels: tuple[float, float]) -> tuple[float, float]:
    """Return level and standard deviation of normal noise from the fractions below two levels,
    shape (2,), DN.
    """
    from scipy.special import ndtri

    low, high = ndtri(fractions_below)
    sd = (levels[1] - levels[0]) / (high - low)
    return float(levels[0] - low * sd), float(sd)
