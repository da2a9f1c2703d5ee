"""Glossy dielectrics over a diffuse base (paint, plastic, wet ground, water) and rough metals."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata.errors import BadInput
from simulate.radiance.brdf import microfacet
from simulate.radiance.brdf.microfacet import (
    AlbedoTable,
    base_value,
    dielectric_albedo,
    sample_mixture,
    schlick_albedo,
    specular_albedo,
)
from simulate.radiance.brdf.protocol import Reflectance, both_above, cosine_density

# Mean of (1 - cos)^5 over the hemisphere, cosine-weighted.
MEAN_RISE = 1.0 / 21.0


def require_roughness(roughness: float) -> None:
    """Refuse a roughness that the facet model does not reach."""
    if not microfacet.SMOOTHEST <= roughness <= microfacet.ROUGHEST:
        raise BadInput(f"roughness must lie in [{microfacet.SMOOTHEST:g}, {microfacet.ROUGHEST:g}], got {roughness:g}")


@dataclass(frozen=True, kw_only=True)
class Metal:
    """GGX facets of a metal, the light that hits several facets given back.

    Parameters
    ----------
    reflectance
        At normal incidence, over wavelength.
    roughness
        GGX's a, the spread of the facets' slopes, dimensionless.

    Notes
    -----
    f = F D G/(4 cos cos) + F_m (1 - E(i)) (1 - E(o))/(pi (1 - E_mean)), E the albedo of perfect facets, F by Schlick,
    F_m = F_mean^2 E_mean/(1 - F_mean (1 - E_mean)) (Kulla and Conty, SIGGRAPH 2017 course): a perfect mirror metal of
    any roughness sends all light back. Without the second term roughness 1 loses up to 69 %.
    """

    reflectance: Reflectance
    roughness: float

    def __post_init__(self) -> None:
        require_roughness(self.roughness)

    @property
    def _perfect(self) -> AlbedoTable:
        return specular_albedo(self.roughness)

    def value(
        self, incoming: NDArray[np.floating], outgoing: NDArray[np.floating], wavelength_nm: ArrayLike
    ) -> NDArray[np.float64]:
        """Return f, sr-1, shape (band, ray)."""
        normal = self.reflectance.at(wavelength_nm)[:, None]
        facing = np.sum(outgoing * microfacet.halfway(incoming, outgoing), axis=1)
        mirrored = microfacet.lobe(incoming, outgoing, self.roughness)
        one = normal * mirrored + (1.0 - normal) * (mirrored * microfacet.schlick_rise(facing))
        perfect = self._perfect
        many = base_value(perfect.at(incoming), perfect.at(outgoing), perfect.mean, self._between(normal))
        return one + many * both_above(incoming, outgoing)

    def sample(
        self, outgoing: NDArray[np.floating], rng: np.random.Generator
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Draw mirrored directions, or by the cosine law as often as light hits several facets; and their densities."""
        normals = microfacet.sample_visible_normals(outgoing, self.roughness, rng.random((len(outgoing), 2)))
        drawn = sample_mixture(microfacet.mirror_direction(outgoing, normals), self._perfect.at(outgoing), rng)
        return drawn, self.pdf(drawn, outgoing)

    def pdf(self, incoming: NDArray[np.floating], outgoing: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the density of `sample`, sr-1, shape (ray,)."""
        share = self._perfect.at(outgoing)
        mirrored = microfacet.mirror_density(incoming, outgoing, self.roughness)
        return share * mirrored + (1.0 - share) * cosine_density(incoming)

    def albedo(self, outgoing: NDArray[np.floating], wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Return the fraction of a uniform sky's light that goes to the viewer, shape (band, ray)."""
        normal = self.reflectance.at(wavelength_nm)[:, None]
        perfect, rise = self._perfect.at(outgoing), schlick_albedo(self.roughness).at(outgoing)
        return normal * perfect + (1.0 - normal) * rise + (1.0 - perfect) * self._between(normal)

    def _between(self, normal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return F_m, the reflectance of light that bounces between facets."""
        facet, perfect = normal + (1.0 - normal) * MEAN_RISE, self._perfect.mean
        return facet**2 * perfect / (1.0 - facet * (1.0 - perfect))


# Least fraction of the samples for either part.
LEAST_SHARE = 0.1


@dataclass(frozen=True, kw_only=True)
class Glossy:
    """GGX microfacets of a dielectric over a diffuse base that receives all transmitted light.

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
        mirrored = mirrored * microfacet.dielectric(facing, self.refractive_index)
        coat, base = self._coat, self.reflectance.at(wavelength_nm)[:, None]
        below = base_value(coat.at(incoming), coat.at(outgoing), coat.mean, base)
        return mirrored + below * both_above(incoming, outgoing)

    def sample(
        self, outgoing: NDArray[np.floating], rng: np.random.Generator
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Draw specular directions or by the cosine law, in the ratio of coat and base; and their densities."""
        normals = microfacet.sample_visible_normals(outgoing, self.roughness, rng.random((len(outgoing), 2)))
        drawn = sample_mixture(microfacet.mirror_direction(outgoing, normals), self._coat_share(outgoing), rng)
        return drawn, self.pdf(drawn, outgoing)

    def pdf(self, incoming: NDArray[np.floating], outgoing: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the density of `sample`, sr-1, shape (ray,)."""
        share = self._coat_share(outgoing)
        mirrored = microfacet.mirror_density(incoming, outgoing, self.roughness)
        return share * mirrored + (1.0 - share) * cosine_density(incoming)

    def albedo(self, outgoing: NDArray[np.floating], wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Return the fraction of a uniform sky's light that goes to the viewer, shape (band, ray)."""
        coat = self._coat.at(outgoing)
        return coat + (1.0 - coat) * self.reflectance.at(wavelength_nm)[:, None]

    def _coat_share(self, outgoing: NDArray[np.floating]) -> NDArray[np.float64]:
        coat, base = self._coat.at(outgoing), float(np.mean(self.reflectance.share))
        share = coat / np.maximum(coat + (1.0 - coat) * base, 1e-12)
        return np.clip(share, LEAST_SHARE, 1.0 - LEAST_SHARE)
