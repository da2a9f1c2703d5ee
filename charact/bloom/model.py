"""What a point source looks like through an image tube: a blurred core, a halo disc with a sharp edge, a pedestal.

Photoelectrons that bounce off the microchannel plate fly at most twice the gap far: those that keep their energy fill
a disc four gaps wide with a bright rim, those that lose some of it fall nearer (densities 1/sqrt(1 - x^2) and
arccos(x)/x at the radius x times the halo's). Their transforms are sin(u)/u and Si(u)/u with u = pi f D.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NAMES = ("halo_diameter", "elastic_share", "core_frequency", "core_exponent", "core_spread")
UNITS = ("px", "1", "cy/px", "1", "px2")
HIGHEST_CY_PER_PX = 0.8
STEPS = 256
# Radii inside a ring one pixel wide at which the profile is taken and averaged.
INSIDE = (-1 / 3, 0.0, 1 / 3)


@dataclass(frozen=True, kw_only=True)
class Optics:
    """Radial transforms for given rings: `to_rings` takes a transfer function (.., frequency) to (.., ring)."""

    frequency: Array
    to_rings: Array


def optics_of(radius_px: Array) -> Optics:
    """Prepare the Hankel transform onto rings of the given mean radii."""
    from scipy.special import j0

    step = HIGHEST_CY_PER_PX / STEPS
    frequency = np.asarray((np.arange(STEPS) + 0.5) * step, np.float64)
    kernel = np.zeros((STEPS, len(radius_px)))
    weight = np.zeros(len(radius_px))
    for offset in INSIDE:
        radius = np.maximum(radius_px + offset, 0.05)
        kernel += 2 * np.pi * frequency[:, None] * step * j0(2 * np.pi * frequency[:, None] * radius) * radius
        weight += radius
    return Optics(frequency=frequency, to_rings=kernel / weight)


def _sine_integral_table() -> tuple[Array, Array]:
    from scipy.special import sici

    u = np.linspace(1e-6, 800.0, 80001)
    return u, sici(u)[0]


_TABLE: list[tuple[Array, Array]] = []


def halo_transfer(frequency: Array, diameter: Array, elastic: Array) -> Array:
    """Return the transform of the halo, 1 at frequency 0, shape (draw, frequency)."""
    if not _TABLE:
        _TABLE.append(_sine_integral_table())
    u = np.pi * diameter[:, None] * frequency
    spread = np.interp(u, *_TABLE[0]) / u
    return elastic[:, None] * np.sinc(u / np.pi) + (1.0 - elastic[:, None]) * spread


def core_transfer(frequency: Array, cut_off: Array, exponent: Array, spread: Array) -> Array:
    """Return exp(-(f/fc)^n - 2 pi^2 f^2 s^2), tube and apertures, shape (draw, frequency); `spread` is s^2."""
    tube = (frequency / cut_off[:, None]) ** exponent[:, None]
    return np.exp(-tube - 2.0 * np.pi**2 * spread[:, None] * frequency**2)


def shapes(parameters: Array, optics: Optics) -> tuple[Array, Array]:
    """Return core and blurred halo, both of unit volume, shape (draw, ring)."""
    diameter, elastic, cut_off, exponent, spread = parameters.T
    core = core_transfer(optics.frequency, cut_off, exponent, spread)
    halo = core * halo_transfer(optics.frequency, diameter, elastic)
    return core @ optics.to_rings, halo @ optics.to_rings
