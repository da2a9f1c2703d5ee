"""Transforms of everything that spreads a point: pixel, core, wing, halo; each 1 at frequency 0.

Light is worked out as a Hankel transform, L(r) = 2 pi int T(f) J0(2 pi f r) f df, by Gauss-Legendre quadrature: exact
for what is smooth, and dense at low frequencies, where tails have their cusp.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# High enough for the sharpest core allowed, and nodes enough for the farthest ring.
HIGHEST_CY_PER_PX = 1.25
NODES = 300
# Log-arguments and orders at which the transform of Moffat wings is tabulated.
ARGUMENTS = np.linspace(-10.0, 4.0, 1400)
ORDERS = np.linspace(0.02, 3.2, 160)


@lru_cache(maxsize=1)
def _quadrature() -> tuple[Array, Array]:
    at, weight = np.polynomial.legendre.leggauss(NODES)
    return 0.5 * HIGHEST_CY_PER_PX * (at + 1.0), 0.5 * HIGHEST_CY_PER_PX * weight


def frequencies() -> Array:
    """Frequencies of the transforms, cycles per column pitch."""
    return _quadrature()[0]


def onto_nodes(node_px: Array) -> Array:
    """Return the matrix that takes transforms to light at radii, shape (frequency, node)."""
    from scipy.special import j0

    frequency, weight = (one[:, None] for one in _quadrature())
    return 2.0 * np.pi * frequency * weight * j0(2.0 * np.pi * frequency * node_px)


@lru_cache(maxsize=4)
def pixel(pitch_ratio: float) -> Array:
    """Transform of the pixel's aperture, averaged over all directions, shape (frequency,)."""
    angle = (np.arange(64) + 0.5) * (np.pi / 128)
    across, along = np.cos(angle)[:, None] * frequencies(), pitch_ratio * np.sin(angle)[:, None] * frequencies()
    return (np.sinc(across) * np.sinc(along)).mean(axis=0)


def gaussian(variance_px2: Array) -> Array:
    """exp(-2 pi^2 s^2 f^2), shape (draw, frequency)."""
    return np.exp(-2.0 * np.pi**2 * variance_px2[:, None] * frequencies() ** 2)


def tube(cut_off: Array, exponent: Array) -> Array:
    """exp(-(f/fc)^n), an image tube's (Johnson, SPIE 1979), shape (draw, frequency)."""
    return np.exp(-((frequencies() / cut_off[:, None]) ** exponent[:, None]))


def moffat(radius_px: Array, exponent: Array) -> Array:
    """Transform of (1 + (r/a)^2)^-b, 2^(2-b)/Gamma(b-1) u^(b-1) K_(b-1)(u), u = 2 pi a f, shape (draw, frequency)."""
    order, log_argument = exponent - 1.0, np.log(2.0 * np.pi * radius_px[:, None] * frequencies())
    row, weight = _four(ORDERS, order)
    lines = np.einsum("dr,dra->da", weight, _moffat_table()[row])
    place, share = _four(ARGUMENTS, np.minimum(log_argument, ARGUMENTS[-1]))
    out = sum(share[..., one] * np.take_along_axis(lines, place[..., one], axis=1) for one in range(4))
    return np.where(log_argument < ARGUMENTS[-1], out, 0.0)


@lru_cache(maxsize=1)
def _moffat_table() -> Array:
    from scipy.special import gamma, kv

    order, u = ORDERS[:, None], np.exp(ARGUMENTS)
    return 2.0 ** (1.0 - order) / gamma(order) * u**order * kv(order, u)


def _four(even: Array, value: Array) -> tuple[NDArray[np.intp], Array]:
    """Four neighbours on an even grid and their weights in a cubic through them, shape (.., 4)."""
    at = (value - even[0]) / (even[1] - even[0])
    first = np.clip(at.astype(np.intp) - 1, 0, len(even) - 4)
    t = at - first
    weight = np.stack([-(t - 1) * (t - 2) * (t - 3) / 6, t * (t - 2) * (t - 3) / 2, -t * (t - 1) * (t - 3) / 2,
                       t * (t - 1) * (t - 2) / 6], axis=-1)  # fmt: skip
    return first[..., None] + np.arange(4), weight


def disc(diameter_px: Array, elastic: Array) -> Array:
    """Transform of electrons that bounced off the plate, shape (draw, frequency).

    Those that keep their energy fall with the density 1/sqrt(1 - x^2) at the share x of the halo's radius, those that
    keep an even share of it with arccos(x)/x: sin(u)/u and Si(u)/u, u = pi f D (physics of the gap: range 2 d e sin 2t,
    cosine law).
    """
    from scipy.special import sici

    u = np.pi * diameter_px[:, None] * frequencies()
    return elastic[:, None] * np.sinc(u / np.pi) + (1.0 - elastic[:, None]) * sici(u)[0] / u
