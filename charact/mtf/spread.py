"""From transfer to spread: the linear map that turns an MTF on a few frequencies into an edge spread at distances.

The edge spread is 1/2 + int M(f) sin(2 pi f d + phase) / (pi f) df. M is smooth, so it is carried by a few nodes with
local cubic interpolation, and the oscillating kernel is integrated against that interpolation once, on a fine grid.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NEAR_PX = 16.0


@lru_cache(maxsize=2)
def nodes(*, fine: bool) -> Array:
    """Return the frequencies that carry a transfer, cycles per pixel; fine ones follow the ripples of a wide halo."""
    low = np.array([1e-5, 2.5e-4, 5e-4, 1e-3, 2e-3, 3.5e-3, 5e-3, 7e-3])
    upper = np.concatenate([np.arange(0.3, 0.7, 0.025), np.arange(0.7, 1.4, 0.07), np.arange(1.4, 4.4, 0.25)])
    middle = np.arange(0.01, 0.3, 0.01)
    if fine:
        low = np.concatenate([low[:4], np.arange(1.5e-3, 0.06, 1.5e-3)])
        middle = np.concatenate([np.arange(0.06, 0.12, 3e-3), np.arange(0.12, 0.3, 0.012)])
    grid = np.unique(np.concatenate([low, middle, upper]).round(7))
    grid.flags.writeable = False
    return grid


def interpolation(grid: Array, points: Array) -> Array:
    """Return the matrix (point, node) of local cubic (four-point Lagrange) interpolation."""
    first = np.clip(np.searchsorted(grid, points) - 2, 0, grid.size - 4)
    matrix = np.zeros((points.size, grid.size))
    rows = np.arange(points.size)
    for j in range(4):
        weight = np.ones(points.size)
        for k in range(4):
            if k != j:
                weight *= (points - grid[first + k]) / (grid[first + j] - grid[first + k])
        matrix[rows, first + j] = weight
    return matrix


def edge_weights(grid: Array, distance: Array, spread_px: Array) -> tuple[Array, Array]:
    """Return the maps from the transfer's real and imaginary part to the edge spread less one half.

    Parameters
    ----------
    grid
        Nodes, shape (node,).
    distance
        Mean distance of the pixels of each bin from the edge, shape (bin,), px.
    spread_px
        Standard deviation of those distances within the bin, shape (bin,), px.

    Returns
    -------
    even, odd
        Shape (bin, node): edge spread - 1/2 = even @ Re H + odd @ Im H, for H of a line spread along +d.

    Notes
    -----
    With the line spread l(d) = int H(f) exp(2 pi i f d) df the edge spread is
    1/2 + int [Re H sin(2 pi f d) + Im H cos(2 pi f d)] / (pi f) df over f > 0.
    """
    return _kept_weights(grid.tobytes(), distance.tobytes(), spread_px.tobytes())


@lru_cache(maxsize=4)
def _kept_weights(grid_bytes: bytes, distance_bytes: bytes, spread_bytes: bytes) -> tuple[Array, Array]:
    """Return the weights of `edge_weights`, kept because one edge asks for them several times."""
    grid, distance, spread_px = (np.frombuffer(part) for part in (grid_bytes, distance_bytes, spread_bytes))
    even, odd = np.empty((2, distance.size, grid.size))
    near = np.abs(distance) <= NEAR_PX
    for part, step, top in ((near, 0.002, 4.0), (~near, 0.0005, 0.75)):
        if part.any():
            even[part], odd[part] = _integrated(grid, distance[part], spread_px[part], step, top)
    even.flags.writeable = odd.flags.writeable = False
    return even, odd


def _integrated(grid: Array, distance: Array, spread_px: Array, step: float, top: float) -> tuple[Array, Array]:
    """Integrate the kernel against the interpolation with the midpoint rule up to a frequency."""
    f = np.arange(step / 2, top, step)
    # Far from the edge nothing fine is left: a smooth end of the integral keeps its ripple out.
    fade = np.ones_like(f) if top > 1 else np.clip((top - f) / (0.4 * top), 0.0, 1.0) ** 2
    kernel = fade * step / (np.pi * f) * np.exp(-2.0 * (np.pi * np.outer(spread_px, f)) ** 2)
    phase = 2.0 * np.pi * np.outer(distance, f)
    carried = interpolation(grid, f)
    return (kernel * np.sin(phase)) @ carried, (kernel * np.cos(phase)) @ carried
