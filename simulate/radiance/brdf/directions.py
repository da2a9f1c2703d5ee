"""Directions of a hemisphere in the surface's own frame: cosines, draws by the cosine law, angles between."""

import numpy as np
from numpy.typing import NDArray


def both_above(incoming: NDArray[np.floating], outgoing: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return 1 where both directions lie above the surface and 0 elsewhere, shape (ray,)."""
    return ((incoming[:, 2] > 0.0) & (outgoing[:, 2] > 0.0)).astype(float)


def cosine_directions(count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw directions with density cos/pi, shape (count, 3)."""
    square, turn = rng.random(count), 2.0 * np.pi * rng.random(count)
    radius = np.sqrt(square)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1.0 - square)])


def cosine_density(incoming: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return cos/pi, sr-1, zero below the surface, shape (ray,)."""
    return np.maximum(incoming[:, 2], 0.0) / np.pi


def directions_at_cosine(cosine: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return unit vectors (x, 0, z) with z given, shape (ray, 3)."""
    sine = np.sqrt(np.maximum(1.0 - np.square(cosine), 0.0))
    return np.asarray(np.column_stack([sine, np.zeros_like(sine), cosine]), float)
