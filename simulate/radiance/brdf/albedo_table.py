"""The light that a layer sends back, over the direction of the eye: a table and its cosine-weighted mean."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from labdata.frames import read_only
from simulate.radiance.brdf import fresnel, microfacet
from simulate.radiance.brdf.directions import directions_at_cosine

NODES, STRATA = 96, 64
# Steep facets are rare and lose their light: quantiles crowd towards them by this power.
TAIL_POWER = 4


@dataclass(frozen=True, eq=False)
class AlbedoTable:
    """Directional albedo over the cosine of the eye's angle, linear between nodes.

    Parameters
    ----------
    cosine, albedo
        Nodes from 0 to 1, and values, both of shape (node,).
    """

    cosine: NDArray[np.float64]
    albedo: NDArray[np.float64]

    def at(self, outgoing: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the albedo towards directions (ray, 3), shape (ray,)."""
        return np.interp(outgoing[:, 2], self.cosine, self.albedo)

    @property
    def mean(self) -> float:
        """2 int E mu dmu of the broken line, exactly."""
        low, high = self.cosine[:-1], self.cosine[1:]
        first, last = self.albedo[:-1], self.albedo[1:]
        piece = (high - low) / 6.0 * (first * (2.0 * low + high) + last * (low + 2.0 * high))
        return float(2.0 * piece.sum())


@lru_cache(maxsize=64)
def specular_albedo(roughness: float) -> AlbedoTable:
    """Return the albedo of a rough face whose facets reflect all: the rest is light that hits more than one facet."""
    return _rough_albedo(roughness, np.ones_like)


@lru_cache(maxsize=64)
def schlick_albedo(roughness: float) -> AlbedoTable:
    """Return the albedo of a rough face whose facets reflect (1 - cos)^5."""
    return _rough_albedo(roughness, fresnel.schlick_rise)


@lru_cache(maxsize=64)
def dielectric_albedo(roughness: float, refractive_index: float) -> AlbedoTable:
    """Return the albedo of a rough face of glass, of light that hits one facet."""
    return _rough_albedo(roughness, lambda cosine: fresnel.dielectric(cosine, refractive_index))


def _rough_albedo(roughness: float, reflectance: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> AlbedoTable:
    """Integrate over the facets that the eye sees: each sends on its reflectance times the chance of a free way."""
    # Nodes crowd at grazing angles, where the albedo changes most.
    cosine = np.linspace(0.0, 1.0, NODES) ** 2
    cosine[0] = 1e-5
    middle, edge = (np.arange(STRATA) + 0.5) / STRATA, np.arange(STRATA + 1) / STRATA
    quantile, weight = 1.0 - (1.0 - middle) ** TAIL_POWER, -np.diff((1.0 - edge) ** TAIL_POWER)
    even = np.stack(np.meshgrid(middle, quantile, indexing="ij"), axis=-1).reshape(-1, 2)
    weight = np.tile(weight, STRATA) / STRATA
    albedo = [_one_albedo(float(mu), roughness, reflectance, even) @ weight for mu in cosine]
    cosine[0] = 0.0
    return AlbedoTable(read_only(cosine), read_only(np.array(albedo, float)))


def _one_albedo(
    cosine: float,
    roughness: float,
    reflectance: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    even: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the light that each draw of a facet sends on."""
    outgoing = np.broadcast_to(directions_at_cosine(np.array([cosine])), (len(even), 3))
    normal = microfacet.sample_visible_normals(outgoing, roughness, even)
    incoming = microfacet.mirror_direction(outgoing, normal)
    above = incoming[:, 2] > 0.0
    behind_eye = microfacet.smith_lambda(np.array([cosine]), roughness)
    behind_light = microfacet.smith_lambda(np.where(above, incoming[:, 2], 1.0), roughness)
    free = np.where(above, (1.0 + behind_eye) / (1.0 + behind_eye + behind_light), 0.0)
    return free * reflectance(np.sum(outgoing * normal, axis=1))
