"""A rough face as many small mirrors: how they lean, which hide others, and a draw of those that the eye sees."""

import numpy as np
from numpy.typing import NDArray

# The narrowest and widest spread of slopes.
SMOOTHEST, ROUGHEST = 0.002, 1.0


def normals_density(half: NDArray[np.floating], roughness: float) -> NDArray[np.float64]:
    """Return the GGX density of facet normals D, sr-1: a^2 / (pi (z^2 (a^2 - 1) + 1)^2), shape (ray,)."""
    square = roughness**2
    # sin^2 + a^2 cos^2, which keeps its digits for smooth surfaces.
    spread = half[:, 0] ** 2 + half[:, 1] ** 2 + square * half[:, 2] ** 2
    return np.where(half[:, 2] > 0.0, square / (np.pi * spread**2), 0.0)


def smith_lambda(cosine: NDArray[np.floating], roughness: float) -> NDArray[np.float64]:
    """Return Smith's Lambda, (sqrt(1 + a^2 tan^2) - 1)/2: 1/(1 + Lambda) of the facets is seen from a direction."""
    tangent2 = (1.0 - cosine**2) / np.maximum(cosine**2, 1e-300)
    return 0.5 * (np.sqrt(1.0 + roughness**2 * np.maximum(tangent2, 0.0)) - 1.0)


def halfway(incoming: NDArray[np.floating], outgoing: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the normals of the facets that mirror one direction into the other, shape (ray, 3)."""
    total = incoming + outgoing
    return total / np.maximum(np.linalg.norm(total, axis=1), 1e-300)[:, None]


def lobe(incoming: NDArray[np.floating], outgoing: NDArray[np.floating], roughness: float) -> NDArray[np.float64]:
    """Return D G / (4 cos cos) with the height-correlated Smith term, sr-1, shape (ray,): times Fresnel it is a BRDF.

    Notes
    -----
    Walter et al. 2007 (GGX); G = 1/(1 + Lambda(i) + Lambda(o)) (Heitz, J. Comput. Graph. Tech. 3(2), 2014).
    """
    cos_in, cos_out = incoming[:, 2], outgoing[:, 2]
    above = (cos_in > 0.0) & (cos_out > 0.0)
    safe_in, safe_out = np.where(above, cos_in, 1.0), np.where(above, cos_out, 1.0)
    seen = 1.0 / (1.0 + smith_lambda(safe_in, roughness) + smith_lambda(safe_out, roughness))
    density = normals_density(halfway(incoming, outgoing), roughness)
    return np.where(above, density * seen / (4.0 * safe_in * safe_out), 0.0)


def sample_visible_normals(
    outgoing: NDArray[np.floating], roughness: float, even: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Return facet normals as the eye sees them, from pairs of numbers even in [0, 1), shape (ray, 2).

    Notes
    -----
    Stretch to a hemisphere, draw on the cap that faces the eye, stretch back (Dupuy and Benyoub, Comput. Graph. Forum
    42(8), 2023).
    """
    stretched = outgoing * np.array([roughness, roughness, 1.0])
    stretched = stretched / np.linalg.norm(stretched, axis=1)[:, None]
    turn = 2.0 * np.pi * even[:, 0]
    height = (1.0 - even[:, 1]) * (1.0 + stretched[:, 2]) - stretched[:, 2]
    level = np.sqrt(np.maximum(1.0 - height**2, 0.0))
    cap = np.column_stack([level * np.cos(turn), level * np.sin(turn), height]) + stretched
    back = cap * np.array([roughness, roughness, 1.0])
    back[:, 2] = np.maximum(back[:, 2], 0.0)
    return back / np.linalg.norm(back, axis=1)[:, None]


def mirror_direction(outgoing: NDArray[np.floating], normal: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the direction that a facet mirrors to the eye, shape (ray, 3)."""
    return 2.0 * np.sum(outgoing * normal, axis=1)[:, None] * normal - outgoing


def mirror_density(
    incoming: NDArray[np.floating], outgoing: NDArray[np.floating], roughness: float
) -> NDArray[np.float64]:
    """Return the density of `mirror_direction` draws of `sample_visible_normals`, D / (4 cos(o) (1 + Lambda(o))), sr-1, shape (ray,).

    Directions below the surface have one too: they are drawn, and lost.
    """
    cos_out = np.maximum(outgoing[:, 2], 1e-12)
    density = normals_density(halfway(incoming, outgoing), roughness)
    return density / (4.0 * cos_out * (1.0 + smith_lambda(cos_out, roughness)))
