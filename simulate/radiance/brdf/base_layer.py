"""What a layer does not send back reaches a matt base: reciprocal, and losing nothing between the two."""

import numpy as np
from numpy.typing import NDArray


def base_value(
    first_in: NDArray[np.floating],
    first_out: NDArray[np.floating],
    first_mean: NDArray[np.floating] | float,
    base: NDArray[np.floating],
) -> NDArray[np.float64]:
    """Return the BRDF of the base under a first layer, sr-1.

    Parameters
    ----------
    first_in, first_out
        Albedo of the first layer towards light and eye, dimensionless.
    first_mean
        Its cosine-weighted mean, dimensionless.
    base
        Reflectance of the base, dimensionless.

    Notes
    -----
    rho (1 - E(i)) (1 - E(o)) / (pi (1 - E_mean)) (Kelemen and Szirmay-Kalos, Eurographics 2001): its albedo is
    rho (1 - E(o)), so with rho = 1 all light comes back.
    """
    return base * (1.0 - first_in) * (1.0 - first_out) / (np.pi * (1.0 - first_mean))
