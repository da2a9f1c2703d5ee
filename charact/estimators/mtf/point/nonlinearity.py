"""Nonlinear camera response from the noise of a spot, which grows with the light if linear.

A response S = c L^g gives a variance of S proportional to S^(2 - 1/g): an extra power 1 - 1/g of
the light.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from charact.estimators.mtf.point.spot_light import SpotLight
from charact.estimators.mtf.point.thresholds import ACCURACY, LIMITS
from charact.frames.thresholds import CLIPPING
from labdata import Array

# Extra powers of the light in the noise: response exponents from 0.4 to 2.5.
POWERS = np.array([-1.5, -1.2, -0.9, -0.7, -0.5, -0.35, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3, 0.45, 0.6])
FINE_POWERS = np.linspace(POWERS[0], POWERS[-1], 421)


@dataclass(frozen=True, kw_only=True)
class SpotNonlinearity:
    """Nonlinearity of a response from the noise of a spot."""

    # Root of twice the gain in ln likelihood over a linear response, standard deviations
    significance: float
    power: float  # Likeliest extra power of the light in the noise
    exponents: tuple[
        float, float
    ]  # Range of response exponents, within 0.4 to 2.5, that the noise does not exclude

    @property
    def is_nonlinear(self) -> bool:
        """Whether the noise excludes a linear response."""
        return (
            self.significance > LIMITS.nonlinear_sd and abs(self.power) > LIMITS.min_nonlinear_power
        )

    @property
    def effect(self) -> str:
        """Effect of the likeliest response on MTF50."""
        exponent = 1.0 / (1.0 - self.power)
        mtf_percent = 100.0 * (np.sqrt(exponent) - 1.0)
        return (
            f"the noise indicates a response of exponent {exponent:.2g}, which changes MTF50 "
            f"by about {mtf_percent:+.0f} %"
        )

    @property
    def note(self) -> str:
        """Range of responses that the noise does not exclude, and their effect on MTF50."""
        low, high = self.exponents
        return (
            f"The camera response is assumed linear; the noise permits exponents from {low:.2g} "
            f"to {high:.2g}. An exponent g multiplies MTF50 by about sqrt(g), and by more with a "
            "halo or a tail."
        )


def fit_nonlinearity(profile: Array) -> SpotNonlinearity:
    """Return the nonlinearity from ln likelihood at `POWERS`; if all are equal none is excluded."""
    fine = CubicSpline(POWERS, profile)(FINE_POWERS)
    best = int(np.argmax(fine))
    gain = 2.0 * (fine[best] - np.interp(0.0, FINE_POWERS, fine))
    likely_powers = FINE_POWERS[fine > fine[best] - 0.5 * LIMITS.nonlinear_sd**2]
    return SpotNonlinearity(
        significance=float(np.sqrt(max(gain, 0.0))),
        power=float(FINE_POWERS[best]),
        exponents=(1.0 / (1.0 - float(likely_powers[0])), 1.0 / (1.0 - float(likely_powers[-1]))),
    )


def chance_of_less_noise(spot: SpotLight, ceiling_dn: float | None) -> float:
    """Return the probability that a linear camera shows as little temporal noise under light as a
    spot; 1 where its frames cannot tell.

    Notes
    -----
    Photons only add noise: of n lit pixels and K frames, the sum of squares over the variance
    d + g L is chi squared of n (K - 1) degrees of freedom at most, d the dark variance and g at
    least that of a dark noise of `LIMITS.max_dark_e` electrons.
    """
    from scipy.special import chdtr

    dark, free = spot.dark, len(spot.frames) - 1
    if not free or dark.correlation.size > 1 or dark.read_dn**2 < LIMITS.min_variance_dn2:
        return 1.0
    frames, full_dn = spot.frames[:, spot.disc], np.inf if ceiling_dn is None else ceiling_dn
    is_whole = frames.max(axis=0) < CLIPPING.full_fraction * full_dn
    light = np.where(is_whole, (spot.mean - spot.level)[spot.disc], 0.0)
    law = replace(dark, gain_dn=dark.read_dn / LIMITS.max_dark_e)
    variance = frames.var(axis=0, ddof=1, dtype=np.float64)
    parts = [light > level * light.max() for level in LIMITS.lit_levels]
    chances = [
        chdtr(free * np.count_nonzero(lit), free * np.sum((variance / law.variance(light))[lit]))
        for lit in parts
    ]
    return len(chances) * float(min(chances))


def power_log_likelihoods(samples: Array, mean: Array, pulses: Array, dark: Array) -> Array:
    """Return ln likelihood of each of `POWERS`, maximised over the size of the noise.

    `samples`: independent deviations, each of the noise of one frame, shape (sample, pixel), DN;
    `mean`: light in every pixel, DN; `pulses`, `dark`: covariance of a frame's light under a linear
    response and of its dark noise, shape (pixel, pixel).

    Notes
    -----
    A common factor of all pixels, flicker of the source, is excluded. Too few pixels give no
    information: all powers are equally likely.
    """
    lit = np.flatnonzero(mean > ACCURACY.min_light_fraction * np.max(mean, initial=0.0))
    if lit.size < 6:
        return np.zeros(POWERS.size)
    light = mean[lit] / mean.max()
    aside = np.linalg.svd(light[None])[2][1:]
    root = np.linalg.inv(np.linalg.cholesky(aside @ dark[np.ix_(lit, lit)] @ aside.T)) @ aside
    white = samples[:, lit] @ root.T
    return np.array(
        [
            _likeliest(white, root * light ** (0.5 * power), pulses[np.ix_(lit, lit)])
            for power in POWERS
        ]
    )


def _likeliest(white: Array, root: Array, pulses: Array) -> float:
    """Return ln likelihood of whitened samples at the likeliest size of the pulses."""
    values, vectors = np.linalg.eigh(root @ pulses @ root.T)
    values = np.maximum(values, 0.0)
    square, count = np.sum((white @ vectors) ** 2, axis=0), len(white)
    size = 1.0
    for _ in range(8):
        variance = 1.0 + size * values
        part = size * values / variance
        slope = 0.5 * np.sum((square / variance - count) * part)
        size *= np.exp(
            np.clip(slope / max(0.5 * count * float(np.sum(part**2)), 1e-300), -1.0, 1.0)
        )
    variance = 1.0 + size * values
    return float(-0.5 * np.sum(square / variance + count * np.log(variance)))
