"""Microfacet model: GGX normals, Smith masking, Fresnel reflectance, albedo tables and the base
under a layer.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from labdata.frames import read_only
from simulate.arrays import Array
from simulate.radiance.brdf.protocol import cosine_directions, directions_at_cosine

# Limits of the roughness.
SMOOTHEST, ROUGHEST = 0.002, 1.0


def normals_density(half: Array, roughness: float) -> Array:
    """Return the GGX density of facet normals D, sr-1: a^2 / (pi (z^2 (a^2 - 1) + 1)^2), shape
    (ray,).
    """
    square = roughness**2
    # sin^2 + a^2 cos^2, which keeps its digits for smooth surfaces.
    spread = half[:, 0] ** 2 + half[:, 1] ** 2 + square * half[:, 2] ** 2
    return np.where(half[:, 2] > 0.0, square / (np.pi * spread**2), 0.0)


def smith_lambda(cosine: Array, roughness: float) -> Array:
    """Return Smith's Lambda, (sqrt(1 + a^2 tan^2) - 1)/2: the fraction 1/(1 + Lambda) of the facets
    is visible.
    """
    tangent2 = (1.0 - cosine**2) / np.maximum(cosine**2, 1e-300)
    return 0.5 * (np.sqrt(1.0 + roughness**2 * np.maximum(tangent2, 0.0)) - 1.0)


def halfway(incoming: Array, outgoing: Array) -> Array:
    """Return the normals of the facets that reflect one direction into the other, shape (ray,
    3).
    """
    total = incoming + outgoing
    return total / np.maximum(np.linalg.norm(total, axis=1), 1e-300)[:, None]


def lobe(incoming: Array, outgoing: Array, roughness: float) -> Array:
    """Return D G / (4 cos cos) with the height-correlated Smith term, sr-1, shape (ray,): times
    Fresnel it is a BRDF.

    Notes
    -----
    Walter et al. 2007 (GGX); G = 1/(1 + Lambda(i) + Lambda(o)) (Heitz, J. Comput. Graph. Tech.
    3(2), 2014).
    """
    cos_in, cos_out = incoming[:, 2], outgoing[:, 2]
    is_above = (cos_in > 0.0) & (cos_out > 0.0)
    safe_in, safe_out = np.where(is_above, cos_in, 1.0), np.where(is_above, cos_out, 1.0)
    visible_fraction = 1.0 / (
        1.0 + smith_lambda(safe_in, roughness) + smith_lambda(safe_out, roughness)
    )
    density = normals_density(halfway(incoming, outgoing), roughness)
    return np.where(is_above, density * visible_fraction / (4.0 * safe_in * safe_out), 0.0)


def sample_visible_normals(outgoing: Array, roughness: float, uniform_pairs: Array) -> Array:
    """Return visible facet normals from pairs of uniform numbers in [0, 1), shape (ray, 2).

    Notes
    -----
    Stretch to a hemisphere, draw on the cap that faces the viewer, stretch back (Dupuy and Benyoub,
    Comput. Graph. Forum 42(8), 2023).
    """
    scaled_outgoing = outgoing * np.array([roughness, roughness, 1.0])
    scaled_outgoing = scaled_outgoing / np.linalg.norm(scaled_outgoing, axis=1)[:, None]
    azimuth = 2.0 * np.pi * uniform_pairs[:, 0]
    height = (1.0 - uniform_pairs[:, 1]) * (1.0 + scaled_outgoing[:, 2]) - scaled_outgoing[:, 2]
    level = np.sqrt(np.maximum(1.0 - height**2, 0.0))
    cap = (
        np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), height])
        + scaled_outgoing
    )
    normal = cap * np.array([roughness, roughness, 1.0])
    normal[:, 2] = np.maximum(normal[:, 2], 0.0)
    return normal / np.linalg.norm(normal, axis=1)[:, None]


def mirror_direction(outgoing: Array, normal: Array) -> Array:
    """Return the direction that a facet reflects to the viewer, shape (ray, 3)."""
    return 2.0 * np.sum(outgoing * normal, axis=1)[:, None] * normal - outgoing


def mirror_density(incoming: Array, outgoing: Array, roughness: float) -> Array:
    """Return the density of mirrored `sample_visible_normals`, D / (4 cos(o) (1 + Lambda(o))),
    sr-1, shape (ray,).

    Directions below the surface have a density too: they are drawn and give zero.
    """
    cos_out = np.maximum(outgoing[:, 2], 1e-12)
    density = normals_density(halfway(incoming, outgoing), roughness)
    return density / (4.0 * cos_out * (1.0 + smith_lambda(cos_out, roughness)))


def dielectric(cosine: ArrayLike, refractive_index: float) -> Array:
    """Return the reflectance of unpolarised light on glass, water, lacquer; cosine of the angle
    from the normal.
    """
    parallel, perpendicular = dielectric_polarised(cosine, refractive_index)
    return 0.5 * (parallel + perpendicular)


def dielectric_polarised(cosine: ArrayLike, refractive_index: float) -> tuple[Array, Array]:
    """Return the reflectances of light polarised parallel and perpendicular to the plane of
    incidence.
    """
    cos_in = np.clip(np.asarray(cosine, float), 0.0, 1.0)
    cos_on = np.sqrt(1.0 - (1.0 - cos_in**2) / refractive_index**2)
    parallel = (refractive_index * cos_in - cos_on) / (refractive_index * cos_in + cos_on)
    perpendicular = (cos_in - refractive_index * cos_on) / (cos_in + refractive_index * cos_on)
    return parallel**2, perpendicular**2


def schlick_rise(cosine: ArrayLike) -> Array:
    """Return (1 - cosine)^5: a metal of normal reflectance F0 has about F0 + (1 - F0) (1 -
    cosine)^5 (Schlick 1994).
    """
    return (1.0 - np.clip(np.asarray(cosine, float), 0.0, 1.0)) ** 5


NODES, STRATA = 96, 64
# Steep facets are rare and lose their light: quantiles are denser towards them by this power.
TAIL_POWER = 4


@dataclass(frozen=True, eq=False)
class AlbedoTable:
    """Directional albedo over the cosine of the viewing angle, linear between nodes."""

    # Nodes from 0 to 1, and values, both of shape (node,).
    cosine: Array
    albedo: Array

    def at(self, outgoing: Array) -> Array:
        """Return the albedo towards directions (ray, 3), shape (ray,)."""
        return np.interp(outgoing[:, 2], self.cosine, self.albedo)

    @property
    def mean(self) -> float:
        """2 int E mu dmu of the broken line, exactly."""
        low, high = self.cosine[:-1], self.cosine[1:]
        lower, upper = self.albedo[:-1], self.albedo[1:]
        piece = (high - low) / 6.0 * (lower * (2.0 * low + high) + upper * (low + 2.0 * high))
        return float(2.0 * piece.sum())


@lru_cache(maxsize=64)
def specular_albedo(roughness: float) -> AlbedoTable:
    """Return the single-scattering albedo of a rough face with perfectly reflecting facets."""
    return _rough_albedo(roughness, np.ones_like)


@lru_cache(maxsize=64)
def schlick_albedo(roughness: float) -> AlbedoTable:
    """Return the albedo of a rough face whose facets reflect (1 - cos)^5."""
    return _rough_albedo(roughness, schlick_rise)


@lru_cache(maxsize=64)
def dielectric_albedo(roughness: float, refractive_index: float) -> AlbedoTable:
    """Return the single-scattering albedo of a rough dielectric face."""
    return _rough_albedo(roughness, lambda cosine: dielectric(cosine, refractive_index))


def _rough_albedo(roughness: float, reflectance: Callable[[Array], Array]) -> AlbedoTable:
    """Integrate over the visible facets: reflectance times the probability that the reflected ray
    is unmasked.
    """
    # Nodes are denser at grazing angles, where the albedo changes most.
    cosine = np.linspace(0.0, 1.0, NODES) ** 2
    cosine[0] = 1e-5
    centre, edge = (np.arange(STRATA) + 0.5) / STRATA, np.arange(STRATA + 1) / STRATA
    quantile, weight = 1.0 - (1.0 - centre) ** TAIL_POWER, -np.diff((1.0 - edge) ** TAIL_POWER)
    uniform_pairs = np.stack(np.meshgrid(centre, quantile, indexing="ij"), axis=-1).reshape(-1, 2)
    weight = np.tile(weight, STRATA) / STRATA
    albedo = [
        _one_albedo(float(mu), roughness, reflectance, uniform_pairs) @ weight for mu in cosine
    ]
    cosine[0] = 0.0
    return AlbedoTable(read_only(cosine), read_only(np.array(albedo, float)))


def _one_albedo(
    cosine: float, roughness: float, reflectance: Callable[[Array], Array], uniform_pairs: Array
) -> Array:
    """Return the fraction of light that each sampled facet reflects."""
    outgoing = np.broadcast_to(directions_at_cosine(np.array([cosine])), (len(uniform_pairs), 3))
    normal = sample_visible_normals(outgoing, roughness, uniform_pairs)
    incoming = mirror_direction(outgoing, normal)
    is_above = incoming[:, 2] > 0.0
    behind_eye = smith_lambda(np.array([cosine]), roughness)
    behind_light = smith_lambda(np.where(is_above, incoming[:, 2], 1.0), roughness)
    free = np.where(is_above, (1.0 + behind_eye) / (1.0 + behind_eye + behind_light), 0.0)
    return free * reflectance(np.sum(outgoing * normal, axis=1))


def base_value(first_in: Array, first_out: Array, first_mean: Array | float, base: Array) -> Array:
    """Return the BRDF of a base under a first layer of given albedo towards light and viewer and
    its mean, sr-1.

    Notes
    -----
    rho (1 - E(i)) (1 - E(o)) / (pi (1 - E_mean)) (Kelemen and Szirmay-Kalos, Eurographics 2001):
    its albedo is rho (1 - E(o)), so with rho = 1 all light comes back.
    """
    return base * (1.0 - first_in) * (1.0 - first_out) / (np.pi * (1.0 - first_mean))


def sample_mixture(first: Array, first_probability: Array, rng: np.random.Generator) -> Array:
    """Return the first directions with a probability, else cosine-law draws, shape (ray, 3).

    `first_probability`: probability of the first direction, shape (ray,).
    """
    takes_first = rng.random(len(first)) < first_probability
    return np.where(takes_first[:, None], first, cosine_directions(len(first), rng))
