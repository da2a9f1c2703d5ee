"""What a smooth face between air and something else reflects, by Fresnel's equations."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def dielectric(cosine: ArrayLike, refractive_index: float) -> NDArray[np.float64]:
    """Return the reflectance of unpolarised light on glass, water, lacquer; cosine of the angle from the normal."""
    parallel, perpendicular = dielectric_polarised(cosine, refractive_index)
    return 0.5 * (parallel + perpendicular)


def dielectric_polarised(cosine: ArrayLike, refractive_index: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the reflectances of light polarised parallel and perpendicular to the plane of incidence."""
    cos_in = np.clip(np.asarray(cosine, float), 0.0, 1.0)
    cos_on = np.sqrt(1.0 - (1.0 - cos_in**2) / refractive_index**2)
    parallel = (refractive_index * cos_in - cos_on) / (refractive_index * cos_in + cos_on)
    perpendicular = (cos_in - refractive_index * cos_on) / (cos_in + refractive_index * cos_on)
    return parallel**2, perpendicular**2


def conductor(cosine: ArrayLike, refractive_index: float, extinction: float) -> NDArray[np.float64]:
    """Return the reflectance of unpolarised light on a metal of index n + i k, for cosines from the normal."""
    cos_in = np.clip(np.asarray(cosine, float), 0.0, 1.0).astype(complex)
    index = refractive_index + 1j * extinction
    cos_on = np.sqrt(1.0 - (1.0 - cos_in**2) / index**2)
    parallel = (index * cos_in - cos_on) / (index * cos_in + cos_on)
    perpendicular = (cos_in - index * cos_on) / (cos_in + index * cos_on)
    return 0.5 * (np.abs(parallel) ** 2 + np.abs(perpendicular) ** 2)


def schlick_rise(cosine: ArrayLike) -> NDArray[np.float64]:
    """Return (1 - cosine)^5: a metal of normal reflectance F0 has about F0 + (1 - F0) (1 - cosine)^5 (Schlick 1994)."""
    return (1.0 - np.clip(np.asarray(cosine, float), 0.0, 1.0)) ** 5
