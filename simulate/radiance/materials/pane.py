"""A thin pane: what it mirrors and lets through, by Fresnel at both faces and absorption between them."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulate.radiance.brdf.fresnel import dielectric, dielectric_polarised

# Cosine of the most grazing angle that is told from 90 degrees.
GRAZING = 1e-6


def clearest(refractive_index: float) -> float:
    """Return the transmittance at normal incidence of a pane that absorbs nothing, dimensionless."""
    face = float(dielectric(1.0, refractive_index))
    return (1.0 - face) / (1.0 + face)


def internal_transmittance(transmittance: ArrayLike, refractive_index: float) -> NDArray[np.float64]:
    """Return what the glass leaves between the faces, once straight across, by a pane's transmittance.

    Notes
    -----
    T = (1 - r)^2 t / (1 - r^2 t^2) at normal incidence, r the reflectance of a face, solved for t.
    """
    through, face = np.asarray(transmittance, float), float(dielectric(1.0, refractive_index))
    once = (1.0 - face) ** 2
    return 2.0 * through / (once + np.sqrt(once**2 + 4.0 * (face * through) ** 2))


def pane_shares(
    cosine: NDArray[np.floating], transmittance: NDArray[np.floating], refractive_index: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the shares of unpolarised light that a pane mirrors and lets through, each of shape (ray, band).

    Parameters
    ----------
    cosine
        Of the angles of incidence, shape (ray,).
    transmittance
        Of the pane at normal incidence, shape (band,).
    refractive_index
        Of the glass.

    Notes
    -----
    All reflections between the faces are added up without interference (Born and Wolf, Principles of Optics, 7.6, for
    light less coherent than the pane is thick): for each polarisation T = (1 - r)^2 t / (1 - r^2 t^2), R = r (1 + t T),
    with t to the power of 1/cos of the angle in the glass. What is neither is absorbed.
    """
    steep = np.clip(np.abs(cosine), GRAZING, 1.0)
    inside = np.sqrt(1.0 - (1.0 - steep**2) / refractive_index**2)
    left = internal_transmittance(transmittance, refractive_index)[None] ** (1.0 / inside)[:, None]
    mirrored, through = np.zeros(left.shape), np.zeros(left.shape)
    for polarised in dielectric_polarised(steep, refractive_index):
        face = polarised[:, None]
        passed = (1.0 - face) ** 2 * left / (1.0 - (face * left) ** 2)
        through += 0.5 * passed
        mirrored += 0.5 * face * (1.0 + left * passed)
    return mirrored, through
