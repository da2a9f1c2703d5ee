"""How much more air a slanting ray crosses than one straight up."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

EARTH_RADIUS_KM = 6370.0
OZONE_HEIGHT_KM = 22.0


def airmass(elevation_deg: ArrayLike) -> NDArray[np.float64]:
    """Return the relative air mass, dimensionless: 1 at the zenith, 37.9 at the horizon and for all below it.

    Notes
    -----
    1 / (sin h + 0.50572 (h + 6.07995)^-1.6364), h in degrees (Kasten and Young, Appl. Opt. 28, 4735, 1989).
    """
    elevation = np.maximum(np.asarray(elevation_deg, float), 0.0)
    return 1.0 / (np.sin(np.deg2rad(elevation)) + 0.50572 * (elevation + 6.07995) ** -1.6364)


def ozone_mass(elevation_deg: ArrayLike) -> NDArray[np.float64]:
    """Return the relative mass of a layer of ozone 22 km up, dimensionless (Bird and Riordan 1984, eq. 2-10)."""
    sine = np.sin(np.deg2rad(np.maximum(np.asarray(elevation_deg, float), 0.0)))
    relative = OZONE_HEIGHT_KM / EARTH_RADIUS_KM
    return (1.0 + relative) / np.sqrt(np.square(sine) + 2.0 * relative)
