"""What every BRDF offers; directions are unit vectors away from the surface, in a frame whose z is its normal."""

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray


class Brdf(Protocol):
    """Bidirectional reflectance distribution function of a surface that is the same in all azimuths.

    Notes
    -----
    f(i, o) = f(o, i), and int f cos(i) di <= 1 for every o: held by tests for each BRDF here. A direction at or below
    the surface gives zero.
    """

    def value(
        self, incoming: NDArray[np.floating], outgoing: NDArray[np.floating], wavelength_nm: ArrayLike
    ) -> NDArray[np.float64]:
        """Return f, sr-1, shape (band, ray).

        Parameters
        ----------
        incoming
            Directions to the light, shape (ray, 3).
        outgoing
            Directions to the eye, shape (ray, 3).
        wavelength_nm
            Wavelengths, shape (band,), nm.
        """
        ...

    def sample(
        self, outgoing: NDArray[np.floating], rng: np.random.Generator
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Draw one direction to the light for each direction to the eye.

        Parameters
        ----------
        outgoing
            Directions to the eye, shape (ray, 3).
        rng
            Source of chance.

        Returns
        -------
        incoming
            Directions, shape (ray, 3); a few may fall below the surface, where `value` is zero.
        density
            Their probability densities, sr-1, shape (ray,): the same as `pdf` says.
        """
        ...

    def pdf(self, incoming: NDArray[np.floating], outgoing: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the probability density of `sample`, sr-1, shape (ray,)."""
        ...

    def albedo(self, outgoing: NDArray[np.floating], wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Return the share of light from a uniform sky that goes to the eye, int f cos(i) di, shape (band, ray)."""
        ...
