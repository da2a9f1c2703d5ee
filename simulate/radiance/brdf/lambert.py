"""A matt surface: equally bright from everywhere."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulate.radiance.brdf.directions import both_above, cosine_density, cosine_directions
from simulate.radiance.materials.reflectance import Reflectance


@dataclass(frozen=True, kw_only=True)
class Lambert:
    """Lambert's law, f = rho / pi.

    Parameters
    ----------
    reflectance
        rho over wavelength.
    """

    reflectance: Reflectance

    def value(
        self, incoming: NDArray[np.floating], outgoing: NDArray[np.floating], wavelength_nm: ArrayLike
    ) -> NDArray[np.float64]:
        """Return f, sr-1, shape (band, ray)."""
        return self.reflectance.at(wavelength_nm)[:, None] / np.pi * both_above(incoming, outgoing)

    def sample(
        self, outgoing: NDArray[np.floating], rng: np.random.Generator
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Draw directions by the cosine law and return them with their densities."""
        drawn = cosine_directions(len(outgoing), rng)
        return drawn, cosine_density(drawn)

    def pdf(self, incoming: NDArray[np.floating], outgoing: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return cos(i) / pi."""
        return cosine_density(incoming)

    def albedo(self, outgoing: NDArray[np.floating], wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Return rho, shape (band, ray)."""
        return self.reflectance.at(wavelength_nm)[:, None] * np.ones(len(outgoing))
