"""What the noise of a spot says of a camera's response: it grows as the light where that is straight.

A response S = c L^g makes the variance of S go as S^(2 - 1/g), by the power 1 - 1/g of the light off what pulses make.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

Array = NDArray[np.float64]

# Powers of the light by which noise may go off: exponents of the response from 0.4 to 2.5.
POWERS = np.array([-1.5, -1.2, -0.9, -0.7, -0.5, -0.35, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3, 0.45, 0.6])
FINE_POWERS = np.linspace(POWERS[0], POWERS[-1], 421)
# Standard deviations, and power, from which on a response is called curved: noise of few pulses scatters more widely
# than a Gaussian's.
SIGNIFICANT, MIN_POWER = 4.0, 0.1
# Pixels of less than this share of the brightest tell nothing of light, and as few as these tell no power.
LIT, MIN_PIXELS = 0.02, 6
ITERATIONS = 8


@dataclass(frozen=True, kw_only=True)
class SpotNonlinearity:
    """How curved a response may be by the noise of a spot.

    Parameters
    ----------
    significance
        Root of twice what ln likelihood gains over a straight response, standard deviations.
    power
        Likeliest power of the light by which noise goes off.
    exponents
        Bounds of the exponents, of those from 0.4 to 2.5, that the noise does not tell from the likeliest one.
    """

    significance: float
    power: float
    exponents: tuple[float, float]

    @property
    def is_nonlinear(self) -> bool:
        """Whether noise is that of no straight response."""
        return self.significance > SIGNIFICANT and abs(self.power) > MIN_POWER

    @property
    def effect(self) -> str:
        """Size of what the likeliest response does to an MTF50."""
        exponent = 1.0 / (1.0 - self.power)
        moved = 100.0 * (np.sqrt(exponent) - 1.0)
        return f"the noise is that of a response of exponent {exponent:.2g}, which moves MTF50 by about {moved:+.0f} %"

    @property
    def note(self) -> str:
        """What the noise leaves open, and what that does to an MTF."""
        low, high = self.exponents
        return (
            f"The response is taken as straight; of exponents from 0.4 to 2.5 the noise leaves {low:.2g} to {high:.2g} "
            "open. One of g makes MTF50 about sqrt(g) times what it is, and more where there is a halo or a tail."
        )


def fit_nonlinearity(profiles: list[Array]) -> SpotNonlinearity:
    """Return what the profiles of sources of one camera say together: none of them leave all exponents open."""
    fine = CubicSpline(POWERS, np.sum([np.zeros(POWERS.size), *profiles], axis=0))(FINE_POWERS)
    best = int(np.argmax(fine))
    gain = 2.0 * (fine[best] - np.interp(0.0, FINE_POWERS, fine))
    within = FINE_POWERS[fine > fine[best] - 0.5 * SIGNIFICANT**2]
    return SpotNonlinearity(
        significance=float(np.sqrt(max(gain, 0.0))),
        power=float(FINE_POWERS[best]),
        exponents=(1.0 / (1.0 - float(within[0])), 1.0 / (1.0 - float(within[-1]))),
    )


def power_log_likelihoods(samples: Array, mean: Array, pulses: Array, dark: Array) -> Array:
    """Return ln of the likelihood of each of `POWERS`, the size of the noise being the likeliest.

    Parameters
    ----------
    samples
        Independent deviations, each of the noise of one frame, shape (sample, pixel), DN.
    mean
        Light in every pixel, DN.
    pulses, dark
        Covariance of a frame's light under a straight response and of what is there without it, shape (pixel, pixel).

    Notes
    -----
    What all pixels share from frame to frame, a flickering source, is left aside. A few pixels tell nothing: all powers
    are as likely.
    """
    lit = np.flatnonzero(mean > LIT * np.max(mean, initial=0.0))
    if lit.size < MIN_PIXELS:
        return np.zeros(POWERS.size)
    light = mean[lit] / mean.max()
    aside = np.linalg.svd(light[None])[2][1:]
    root = np.linalg.inv(np.linalg.cholesky(aside @ dark[np.ix_(lit, lit)] @ aside.T)) @ aside
    white = samples[:, lit] @ root.T
    return np.array([_likeliest(white, root * light ** (0.5 * power), pulses[np.ix_(lit, lit)]) for power in POWERS])


def _likeliest(white: Array, root: Array, pulses: Array) -> float:
    """Return ln of the likelihood of whitened samples at the likeliest size of the pulses."""
    values, vectors = np.linalg.eigh(root @ pulses @ root.T)
    values = np.maximum(values, 0.0)
    square, count = np.sum((white @ vectors) ** 2, axis=0), len(white)
    size = 1.0
    for _ in range(ITERATIONS):
        variance = 1.0 + size * values
        part = size * values / variance
        slope = 0.5 * np.sum((square / variance - count) * part)
        size *= np.exp(np.clip(slope / max(0.5 * count * float(np.sum(part**2)), 1e-300), -1.0, 1.0))
    variance = 1.0 + size * values
    return float(-0.5 * np.sum(square / variance + count * np.log(variance)))
