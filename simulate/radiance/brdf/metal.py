"""A rough metal: facets that mirror by Fresnel, and the light that bounces between them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata.errors import BadInput
from simulate.radiance.brdf import fresnel, microfacet
from simulate.radiance.brdf.albedo_table import AlbedoTable, schlick_albedo, specular_albedo
from simulate.radiance.brdf.base_layer import base_value
from simulate.radiance.brdf.directions import both_above, cosine_density
from simulate.radiance.brdf.mixture import sample_mixture
from simulate.radiance.materials.reflectance import Reflectance

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
        one = normal * mirrored + (1.0 - normal) * (mirrored * fresnel.schlick_rise(facing))
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
        """Return the share of a uniform sky's light that goes to the eye, shape (band, ray)."""
        normal = self.reflectance.at(wavelength_nm)[:, None]
        perfect, rise = self._perfect.at(outgoing), schlick_albedo(self.roughness).at(outgoing)
        return normal * perfect + (1.0 - normal) * rise + (1.0 - perfect) * self._between(normal)

    def _between(self, normal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return F_m, the reflectance of light that bounces between facets."""
        facet, perfect = normal + (1.0 - normal) * MEAN_RISE, self._perfect.mean
        return facet**2 * perfect / (1.0 - facet * (1.0 - perfect))
