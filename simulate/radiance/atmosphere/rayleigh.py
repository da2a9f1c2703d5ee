"""Scattering by the molecules of air."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Height of a column of sea-level density that holds all air, km.
SCALE_HEIGHT_KM = 8.43
SEA_LEVEL_HPA = 1013.25


def rayleigh_depth(wavelength_nm: ArrayLike) -> NDArray[np.float64]:
    """Return the optical depth of the whole atmosphere straight up at sea level, dimensionless.

    Notes
    -----
    0.00864 L^-(3.916 + 0.074 L + 0.05/L), L in um (Leckner, Solar Energy 20, 143, 1978, after Froehlich and Shaw).
    """
    micrometre = np.asarray(wavelength_nm, float) * 1e-3
    return 0.00864 * micrometre ** -(3.916 + 0.074 * micrometre + 0.05 / micrometre)


def rayleigh_per_km(wavelength_nm: ArrayLike) -> NDArray[np.float64]:
    """Return the extinction coefficient of sea-level air, per km."""
    return rayleigh_depth(wavelength_nm) / SCALE_HEIGHT_KM
