"""Glossy dielectrics (paint, plastic, wet ground, water) and retroreflectors over a diffuse base,
and rough metals.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from labdata.errors import BadInput, check_range
from labdata.frames import read_only
from simulate.arrays import Array
from simulate.radiance.brdf import microfacet
from simulate.radiance.brdf.microfacet import (
    AlbedoTable,
    base_value,
    dielectric_albedo,
    sample_mixture,
    schlick_albedo,
    specular_albedo,
)
from simulate.radiance.brdf.protocol import (
    Reflectance,
    both_above,
    cosine_density,
    directions_at_cosine,
)

# Mean of (1 - cos)^5 over the hemisphere, cosine-weighted.
MEAN_RISE = 1.0 / 21.0


@dataclass(frozen=True, kw_only=True)
class Facets:
    """A first layer of GGX facets: it is sampled by mirrored directions, the rest by the cosine
    law.
    """

    reflectance: Reflectance  # of the metal at normal incidence, or of the base under a dielectric
    roughness: float  # GGX's a, the spread of the facets' slopes, dimensionless

    def __post_init__(self) -> None:
        check_range(self, microfacet.SMOOTHEST, microfacet.ROUGHEST, "roughness")

    def specular_share(self, outgoing: Array) -> Array:
        """Return the fraction of mirrored samples, shape (ray,)."""
        raise NotImplementedError

    def sample(self, outgoing: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw mirrored directions or by the cosine law; and their densities."""
        normals = microfacet.sample_visible_normals(
            outgoing, self.roughness, rng.random((len(outgoing), 2))
        )
        direction = sample_mixture(
            microfacet.mirror_direction(outgoing, normals), self.specular_share(outgoing), rng
        )
        return direction, self.pdf(direction, outgoing)

    def pdf(self, incoming: Array, outgoing: Array) -> Array:
        specular = self.specular_share(outgoing)
        mirror_density = microfacet.mirror_density(incoming, outgoing, self.roughness)
        return specular * mirror_density + (1.0 - specular) * cosine_density(incoming)


@dataclass(frozen=True, kw_only=True)
class Metal(Facets):
    """GGX facets of a metal, with the light of multiple scattering added.

    Notes
    -----
    f = F D G/(4 cos cos) + F_m (1 - E(i)) (1 - E(o))/(pi (1 - E_mean)), E the albedo of perfect
    facets, F by Schlick, F_m = F_mean^2 E_mean/(1 - F_mean (1 - E_mean)) (Kulla and Conty, SIGGRAPH
    2017 course): a perfect mirror metal of any roughness sends all light back. Without the second
    term roughness 1 loses up to 69 %.
    """

    @property
    def _perfect(self) -> AlbedoTable:
        return specular_albedo(self.roughness)

    def value(self, incoming: Array, outgoing: Array, wavelength_nm: ArrayLike) -> Array:
        normal = self.reflectance.at(wavelength_nm)[:, None]
        half_cosine = np.sum(outgoing * microfacet.halfway(incoming, outgoing), axis=1)
        lobe = microfacet.lobe(incoming, outgoing, self.roughness)
        single_bounce = normal * lobe + (1.0 - normal) * (
            lobe * microfacet.schlick_rise(half_cosine)
        )
        perfect = self._perfect
        multiple_bounce = base_value(
            perfect.at(incoming),
            perfect.at(outgoing),
            perfect.mean,
            self._multiple_reflectance(normal),
        )
        return single_bounce + multiple_bounce * both_above(incoming, outgoing)

    def specular_share(self, outgoing: Array) -> Array:
        """Return the albedo of perfect facets: the rest hits several facets."""
        return self._perfect.at(outgoing)

    def albedo(self, outgoing: Array, wavelength_nm: ArrayLike) -> Array:
        normal = self.reflectance.at(wavelength_nm)[:, None]
        perfect, rise = self._perfect.at(outgoing), schlick_albedo(self.roughness).at(outgoing)
        return (
            normal * perfect
            + (1.0 - normal) * rise
            + (1.0 - perfect) * self._multiple_reflectance(normal)
        )

    def _multiple_reflectance(self, normal: Array) -> Array:
        """Return F_m, the reflectance of light scattered more than once between facets."""
        facet, perfect = normal + (1.0 - normal) * MEAN_RISE, self._perfect.mean
        return facet**2 * perfect / (1.0 - facet * (1.0 - perfect))


# Least fraction of the samples for either part.
LEAST_SHARE = 0.1


@dataclass(frozen=True, kw_only=True)
class Glossy(Facets):
    """GGX microfacets of a dielectric over a diffuse base that receives all transmitted light.

    Notes
    -----
    f = F D G/(4 cos cos) + rho (1 - E(i)) (1 - E(o))/(pi (1 - E_mean)), F by Fresnel, E the coat's
    albedo.
    """

    # of the coat, dimensionless; 1.5 of paint and plastic, 1.33 of water
    refractive_index: float = 1.5

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1.0 < self.refractive_index <= 4.0:
            raise BadInput(f"refractive_index must lie in (1, 4], got {self.refractive_index:g}")

    @property
    def _coat(self) -> AlbedoTable:
        return dielectric_albedo(self.roughness, self.refractive_index)

    def value(self, incoming: Array, outgoing: Array, wavelength_nm: ArrayLike) -> Array:
        half_cosine = np.sum(outgoing * microfacet.halfway(incoming, outgoing), axis=1)
        lobe = microfacet.lobe(incoming, outgoing, self.roughness)
        lobe = lobe * microfacet.dielectric(half_cosine, self.refractive_index)
        coat, base = self._coat, self.reflectance.at(wavelength_nm)[:, None]
        from_base = base_value(coat.at(incoming), coat.at(outgoing), coat.mean, base)
        return lobe + from_base * both_above(incoming, outgoing)

    def albedo(self, outgoing: Array, wavelength_nm: ArrayLike) -> Array:
        coat = self._coat.at(outgoing)
        return coat + (1.0 - coat) * self.reflectance.at(wavelength_nm)[:, None]

    def specular_share(self, outgoing: Array) -> Array:
        """Return the fraction of mirrored samples, in the ratio of coat and base."""
        coat, base = self._coat.at(outgoing), float(np.mean(self.reflectance.fraction))
        fraction = coat / np.maximum(coat + (1.0 - coat) * base, 1e-12)
        return np.clip(fraction, LEAST_SHARE, 1.0 - LEAST_SHARE)


NARROWEST_DEG, WIDEST_DEG = 0.02, 20.0
# Directions of which the lobe's albedo is the mean.
LATTICE = 8192


@dataclass(frozen=True, kw_only=True)
class Retroreflector:
    """A lobe around the direction to the light, over a diffuse base.

    Notes
    -----
    f = R N(angle)/max(cos(i), cos(o)) + rho (1 - R e(i)) (1 - R e(o))/(pi (1 - R e_mean)), N = k
    exp(k (cos - 1))/(2 pi (1 - exp(-2 k))) with an integral of 1 over all directions, e the lobe's
    albedo: 1 but for grazing light. The coefficient of retroreflection, as sheets state it, is R
    N(0) cd lx-1 m-2 at normal incidence.
    """

    retroreflectance: Reflectance  # fraction of the light in the lobe, over wavelength
    reflectance: Reflectance  # of the base, over wavelength
    # angle between light and viewer at half of the lobe's maximum, degrees
    half_width_deg: float = 0.5

    def __post_init__(self) -> None:
        check_range(self, NARROWEST_DEG, WIDEST_DEG, "half_width_deg")

    @property
    def concentration(self) -> float:
        """k of the lobe, dimensionless."""
        return float(np.log(2.0) / (2.0 * np.sin(0.5 * np.deg2rad(self.half_width_deg)) ** 2))

    @property
    def _lobe_albedo(self) -> AlbedoTable:
        return _lobe_albedo(self.concentration)

    def value(self, incoming: Array, outgoing: Array, wavelength_nm: ArrayLike) -> Array:
        is_above = both_above(incoming, outgoing)
        lobe = _lobe(incoming, outgoing, self.concentration)
        lobe = lobe * is_above / np.maximum(np.maximum(incoming[:, 2], outgoing[:, 2]), 1e-12)
        retroreflectance, base = (
            self.retroreflectance.at(wavelength_nm)[:, None],
            self.reflectance.at(wavelength_nm)[:, None],
        )
        table = self._lobe_albedo
        from_base = base_value(
            retroreflectance * table.at(incoming),
            retroreflectance * table.at(outgoing),
            retroreflectance * table.mean,
            base,
        )
        return retroreflectance * lobe + from_base * is_above

    def sample(self, outgoing: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw directions from the lobe or by the cosine law, half of each; and their densities."""
        lobe_direction = _lobe_directions(
            outgoing, self.concentration, rng.random((len(outgoing), 2))
        )
        direction = sample_mixture(lobe_direction, np.full(len(outgoing), 0.5), rng)
        return direction, self.pdf(direction, outgoing)

    def pdf(self, incoming: Array, outgoing: Array) -> Array:
        return 0.5 * _lobe(incoming, outgoing, self.concentration) + 0.5 * cosine_density(incoming)

    def albedo(self, outgoing: Array, wavelength_nm: ArrayLike) -> Array:
        lobe_albedo = self.retroreflectance.at(wavelength_nm)[:, None] * self._lobe_albedo.at(
            outgoing
        )
        return lobe_albedo + (1.0 - lobe_albedo) * self.reflectance.at(wavelength_nm)[:, None]


def _lobe(incoming: Array, outgoing: Array, concentration: float) -> Array:
    # 1 - cos of the angle between, by the chord, which keeps its digits for narrow lobes.
    one_minus_cosine = 0.5 * np.sum(np.square(incoming - outgoing), axis=1)
    return (
        concentration
        / (-2.0 * np.pi * np.expm1(-2.0 * concentration))
        * np.exp(-concentration * one_minus_cosine)
    )


def _lobe_directions(outgoing: Array, concentration: float, uniform_pairs: Array) -> Array:
    """Return directions of the lobe from pairs of uniform numbers in [0, 1)."""
    one_minus_cosine = (
        -np.log1p(uniform_pairs[:, 0] * np.expm1(-2.0 * concentration)) / concentration
    )
    sine = np.sqrt(np.maximum(one_minus_cosine * (2.0 - one_minus_cosine), 0.0))
    azimuth = 2.0 * np.pi * uniform_pairs[:, 1]
    # Two directions normal to the viewing direction (Duff et al., J. Comput. Graph. Tech. 6(1),
    # 2017).
    sign = np.copysign(1.0, outgoing[:, 2])
    a = -1.0 / (sign + outgoing[:, 2])
    b = outgoing[:, 0] * outgoing[:, 1] * a
    x, y = outgoing[:, 0], outgoing[:, 1]
    first_tangent = np.column_stack([1.0 + sign * x**2 * a, sign * b, -sign * x])
    second_tangent = np.column_stack([b, sign + y**2 * a, -y])
    tangent_part = (sine * np.cos(azimuth))[:, None] * first_tangent + (sine * np.sin(azimuth))[
        :, None
    ] * second_tangent
    return (1.0 - one_minus_cosine)[:, None] * outgoing + tangent_part


@lru_cache(maxsize=64)
def _lobe_albedo(concentration: float) -> AlbedoTable:
    """Return int N cos(i)/max(cos(i), cos(o)) di; light below the surface is lost."""
    width = 1.0 / np.sqrt(concentration)
    near_grazing = min(8.0 * width, 1.0) * np.linspace(0.0, 1.0, 65) ** 2
    cosine = np.union1d(near_grazing, np.linspace(0.0, 1.0, 33))
    # A lattice (Korobov, golden ratio): rows of a square grid would all meet the horizon at once.
    steps = np.arange(LATTICE)
    lattice = np.column_stack([(steps + 0.5) / LATTICE, (steps * 0.6180339887498949) % 1.0])
    albedo = []
    for mu in cosine:
        incoming = _lobe_directions(
            np.broadcast_to(directions_at_cosine(np.array([mu])), (len(lattice), 3)),
            concentration,
            lattice,
        )
        height = np.maximum(incoming[:, 2], 0.0)
        albedo.append(float(np.mean(height / np.maximum(np.maximum(height, mu), 1e-12))))
    return AlbedoTable(read_only(cosine), read_only(np.array(albedo)))
