"""A glossy coat on a matt base: paint, plastic, wet ground, and water where the base is dark."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata.errors import BadInput
from simulate.radiance.brdf import fresnel, microfacet
from simulate.radiance.brdf.albedo_table import AlbedoTable, dielectric_albedo
from simulate.radiance.brdf.base_layer import base_value
from simulate.radiance.brdf.directions import both_above, cosine_density
from simulate.radiance.brdf.metal import require_roughness
from simulate.radiance.brdf.mixture import sample_mixture
from simulate.radiance.materials.reflectance import Reflectance

# The share of draws that either part gets at least.
LEAST_SHARE = 0.1


@dataclass(frozen=True, kw_only=True)
class Glossy:
    """GGX facets of a dielectric over a matt base that gets all the light they let pass.

    Parameters
    ----------
    reflectance
        Of the base, over wavelength.
    roughness
        GGX's a of the coat, dimensionless.
    refractive_index
        Of the coat, dimensionless; 1.5 of paint and plastic, 1.33 of water.

    Notes
    -----
    f = F D G/(4 cos cos) + rho (1 - E(i)) (1 - E(o))/(pi (1 - E_mean)), F by Fresnel, E the coat's albedo.
    """

    reflectance: Reflectance
    roughness: float
    refractive_index: float = 1.5

    def __post_init__(self) -> None:
        require_roughness(self.roughness)
        if not 1.0 < self.refractive_index <= 4.0:
            raise BadInput(f"refractive_index must lie in (1, 4], got {self.refractive_index:g}")

    @property
    def _coat(self) -> AlbedoTable:
        return dielectric_albedo(self.roughness, self.refractive_index)

    def value(
        self, incoming: NDArray[np.floating], outgoing: NDArray[np.floating], wavelength_nm: ArrayLike
    ) -> NDArray[np.float64]:
        """Return f, sr-1, shape (band, ray)."""
        facing = np.sum(outgoing * microfacet.halfway(incoming, outgoing), axis=1)
        mirrored = microfacet.lobe(incoming, outgoing, self.roughness)
        mirrored = mirrored * fresnel.dielectric(facing, self.refractive_index)
        coat, base = self._coat, self.reflectance.at(wavelength_nm)[:, None]
        below = base_value(coat.at(incoming), coat.at(outgoing), coat.mean, base)
        return mirrored + below * both_above(incoming, outgoing)

    def sample(
        self, outgoing: NDArray[np.floating], rng: np.random.Generator
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Draw mirrored directions or by the cosine law, as coat and base share the light; and their densities."""
        normals = microfacet.sample_visible_normals(outgoing, self.roughness, rng.random((len(outgoing), 2)))
        drawn = sample_mixture(microfacet.mirror_direction(outgoing, normals), self._coat_share(outgoing), rng)
        return drawn, self.pdf(drawn, outgoing)

    def pdf(self, incoming: NDArray[np.floating], outgoing: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the density of `sample`, sr-1, shape (ray,)."""
        share = self._coat_share(outgoing)
        mirrored = microfacet.mirror_density(incoming, outgoing, self.roughness)
        return share * mirrored + (1.0 - share) * cosine_density(incoming)

    def albedo(self, outgoing: NDArray[np.floating], wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Return the share of a uniform sky's light that goes to the eye, shape (band, ray)."""
        coat = self._coat.at(outgoing)
        return coat + (1.0 - coat) * self.reflectance.at(wavelength_nm)[:, None]

    def _coat_share(self, outgoing: NDArray[np.floating]) -> NDArray[np.float64]:
        coat, base = self._coat.at(outgoing), float(np.mean(self.reflectance.share))
        share = coat / np.maximum(coat + (1.0 - coat) * base, 1e-12)
        return np.clip(share, LEAST_SHARE, 1.0 - LEAST_SHARE)
