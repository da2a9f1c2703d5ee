"""Light of a point source on the sensor in closed form: core, wing, and halo of electrons that bounced.

Each is a density of volume 1 on the plane, per square column pitch. A ring blurred by a Gaussian is
exp(-(r - a)^2 / 2 s^2) I0e(r a / s^2) / 2 pi s^2; a halo is a sum of rings, a Moffat wing a sum of Gaussians.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Rings that make up a halo: enough for a blur of a hundredth of its diameter.
RINGS = 200
# Gaussians that make up a Moffat wing where it blurs a halo, and the least weight of those left out on either side.
GAUSSIANS, LEAST_WEIGHT = 48, 1e-8
# Standard deviations beyond which a Gaussian is nothing.
NOTHING = 8.0


def gaussian(radius_px: Array, sigma_px: float) -> Array:
    """Return the density of a Gaussian, 1/px2."""
    return np.exp(-0.5 * (radius_px / sigma_px) ** 2) / (2.0 * np.pi * sigma_px**2)


def moffat(radius_px: Array, scale_px: float, exponent: float) -> Array:
    """Return the density (b - 1) / (pi a^2) (1 + r^2/a^2)^-b of a Moffat wing, 1/px2; b > 1."""
    return (exponent - 1.0) / (np.pi * scale_px**2) * (1.0 + (radius_px / scale_px) ** 2) ** -exponent


def moffat_as_gaussians(scale_px: float, exponent: float) -> tuple[Array, Array]:
    """Return standard deviations and weights of the Gaussians whose sum is a Moffat wing, shape (gaussian,).

    With t from a gamma law of shape b - 1, the Gaussian of variance a^2 / 2t is on average the wing.
    """
    from scipy.special import gamma

    shape = exponent - 1.0
    log_t = np.linspace(np.log(LEAST_WEIGHT) / shape, np.log(30.0), GAUSSIANS)
    weight = np.exp(shape * log_t - np.exp(log_t)) / gamma(shape)
    return scale_px / np.sqrt(2.0 * np.exp(log_t)), weight / weight.sum()


def moffat_blurred(radius_px: Array, scale_px: float, exponent: float, sigma_px: float) -> Array:
    """Return the density of a Moffat wing blurred by a Gaussian, 1/px2."""
    widths, weights = moffat_as_gaussians(scale_px, exponent)
    variance = widths**2 + sigma_px**2
    return np.exp(-0.5 * np.divide.outer(radius_px**2, variance)) @ (weights / (2.0 * np.pi * variance))


@lru_cache
def _nodes(count: int) -> tuple[Array, Array]:
    return np.polynomial.legendre.leggauss(count)


def halo_rings(diameter_px: float, elastic_share: float, count: int = RINGS) -> tuple[Array, Array]:
    """Return radii and weights of the rings that make up a halo, px and dimensionless, shape (ring,).

    `diameter_px`: outer diameter, four gaps between photocathode and plate; `elastic_share`: share of the halo's
    electrons that keep their energy; the others keep any part of it alike; `count`: number of rings. With x = 2r/D,
    electrons that leave by the cosine law land with the density 1/sqrt(1 - x^2) if they keep their energy, and
    arccos(x)/x if it is uniform. In the angle of x = sin(angle) the weight of their rings is sin(angle) and (pi/2 -
    angle) cos(angle): nothing is singular.
    """
    angle, weight = _angles(count, 0.0, 0.5 * np.pi)
    return 0.5 * diameter_px * np.sin(angle), weight * _weight(angle, elastic_share)


def halo_share_between(first: float, last: float, elastic_share: float) -> float:
    """Return the share of a halo's light between two radii, each a share of the halo's own."""
    angle, weight = _angles(RINGS, float(np.arcsin(first)), float(np.arcsin(last)))
    return float(weight @ _weight(angle, elastic_share))


def _angles(count: int, first: float, last: float) -> tuple[Array, Array]:
    """Angles and weights of the quadrature by Gauss and Legendre."""
    node, weight = _nodes(count)
    half = 0.5 * (last - first)
    return first + half * (node + 1.0), half * weight


def _weight(angle: Array, elastic_share: float) -> Array:
    """Light of a halo per angle."""
    return elastic_share * np.sin(angle) + (1.0 - elastic_share) * (0.5 * np.pi - angle) * np.cos(angle)


def rings_blurred(radius_px: Array, rings: tuple[Array, Array], sigma_px: float) -> Array:
    """Return the density at some radii of rings blurred by a Gaussian, 1/px2."""
    from scipy.special import i0e

    at, weight = rings
    out = np.zeros(len(radius_px))
    near = radius_px < at.max() + NOTHING * sigma_px
    apart = np.subtract.outer(radius_px[near], at) / sigma_px
    blurred = np.exp(-0.5 * apart**2) * i0e(np.multiply.outer(radius_px[near], at) / sigma_px**2)
    out[near] = blurred @ weight / (2.0 * np.pi * sigma_px**2)
    return out


def halo_blurred(radius_px: Array, rings: tuple[Array, Array], blurs: Sequence[tuple[float, float]]) -> Array:
    """Return the density of a halo blurred by a sum of Gaussians, each a standard deviation and a weight."""
    return np.sum([weight * rings_blurred(radius_px, rings, sigma) for sigma, weight in blurs], axis=0)
