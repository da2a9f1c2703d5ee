"""BRDF protocol, Lambertian BRDF, spectral reflectance, and sampling of the hemisphere.

Directions are unit vectors away from the surface, in a frame whose z axis is its normal.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata.errors import BadInput

Array = NDArray[np.floating]


class Brdf(Protocol):
    """Bidirectional reflectance distribution function of a surface that is the same in all azimuths.

    Notes
    -----
    f(i, o) = f(o, i), and int f cos(i) di <= 1 for every o. A direction at or below the surface gives zero.
    """

    def value(self, incoming: Array, outgoing: Array, wavelength_nm: ArrayLike) -> Array:
        """Return f for directions (ray, 3) to light and viewer at wavelengths (band,), sr-1, shape (band, ray)."""
        ...

    def sample(self, outgoing: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw a direction to the light for each direction (ray, 3) to the viewer; return them, and densities as `pdf`.

        Some may lie below the surface, where `value` is zero.
        """
        ...

    def pdf(self, incoming: Array, outgoing: Array) -> Array:
        """Return the probability density of `sample`, sr-1, shape (ray,)."""
        ...

    def albedo(self, outgoing: Array, wavelength_nm: ArrayLike) -> Array:
        """Return the fraction of a uniform sky's light that goes to the viewer, int f cos(i) di, shape (band, ray)."""
        ...


@dataclass(frozen=True, kw_only=True)
class Reflectance:
    """Fraction of light over wavelength, linear between the given values and constant outside."""

    wavelength_nm: tuple[float, ...] = (550.0,)  # wavelengths, ascending, nm; one makes a grey
    share: tuple[float, ...] = (0.0,)  # fraction at each, 0 to 1, dimensionless

    def __post_init__(self) -> None:
        if not self.wavelength_nm or len(self.wavelength_nm) != len(self.share):
            raise BadInput(
                f"a reflectance must have one share per wavelength, got {len(self.wavelength_nm)} wavelengths "
                f"and {len(self.share)} shares"
            )
        if any(b <= a for a, b in zip(self.wavelength_nm, self.wavelength_nm[1:], strict=False)):
            raise BadInput(f"a material's wavelengths must ascend, got {list(self.wavelength_nm)}")
        for share in self.share:
            if not 0.0 <= share <= 1.0:
                raise BadInput(f"a share of light must lie in [0, 1], got {share:g}")

    def at(self, wavelength_nm: ArrayLike) -> Array:
        """Return the fraction at wavelengths, dimensionless, shape (band,)."""
        return np.interp(np.atleast_1d(np.asarray(wavelength_nm, float)), self.wavelength_nm, self.share)


def grey(share: float) -> Reflectance:
    """Return the same reflectance at all wavelengths."""
    return Reflectance(share=(share,))


def both_above(incoming: Array, outgoing: Array) -> Array:
    """Return 1 where both directions lie above the surface and 0 elsewhere, shape (ray,)."""
    return ((incoming[:, 2] > 0.0) & (outgoing[:, 2] > 0.0)).astype(float)


def cosine_directions(count: int, rng: np.random.Generator) -> Array:
    """Draw directions with density cos/pi, shape (count, 3)."""
    square, turn = rng.random(count), 2.0 * np.pi * rng.random(count)
    radius = np.sqrt(square)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1.0 - square)])


def cosine_density(incoming: Array) -> Array:
    """Return cos/pi, sr-1, zero below the surface, shape (ray,)."""
    return np.maximum(incoming[:, 2], 0.0) / np.pi


def directions_at_cosine(cosine: Array) -> Array:
    """Return unit vectors (x, 0, z) with z given, shape (ray, 3)."""
    sine = np.sqrt(np.maximum(1.0 - np.square(cosine), 0.0))
    return np.asarray(np.column_stack([sine, np.zeros_like(sine), cosine]), float)


class CosineSampled:
    """Sampling by the cosine law, for BRDFs without a lobe."""

    def sample(self, outgoing: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw directions and return them with their densities."""
        drawn = cosine_directions(len(outgoing), rng)
        return drawn, cosine_density(drawn)

    def pdf(self, incoming: Array, outgoing: Array) -> Array:
        """Return cos(i) / pi."""
        return cosine_density(incoming)


@dataclass(frozen=True, kw_only=True)
class Lambert(CosineSampled):
    """Lambert's law, f = rho / pi."""

    reflectance: Reflectance

    def value(self, incoming: Array, outgoing: Array, wavelength_nm: ArrayLike) -> Array:
        """Return f, sr-1, shape (band, ray)."""
        return self.reflectance.at(wavelength_nm)[:, None] / np.pi * both_above(incoming, outgoing)

    def albedo(self, outgoing: Array, wavelength_nm: ArrayLike) -> Array:
        """Return rho, shape (band, ray)."""
        return self.reflectance.at(wavelength_nm)[:, None] * np.ones(len(outgoing))
