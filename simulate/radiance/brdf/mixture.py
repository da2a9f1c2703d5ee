"""Draws from two densities, one of them the cosine law."""

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.brdf.directions import cosine_directions


def sample_mixture(
    first: NDArray[np.float64], share: NDArray[np.floating], rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return directions of the first draw with a probability `share` (ray,), else by the cosine law, shape (ray, 3)."""
    takes_first = rng.random(len(first)) < share
    return np.where(takes_first[:, None], first, cosine_directions(len(first), rng))
