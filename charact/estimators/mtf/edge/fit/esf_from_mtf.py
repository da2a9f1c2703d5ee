"""From transfer to spread: the linear map that turns an MTF on a few frequencies into an edge
spread at distances.

The edge spread is 1/2 + int M(f) sin(2 pi f d + phase) / (pi f) df. M is smooth, so it is carried
by a few nodes with local cubic interpolation, and the oscillating kernel is integrated against that
interpolation once, on a fine grid.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

NEAR_PX = 16.0
WIDEST_PX = 160.0


@lru_cache(maxsize=2)
def nodes(*, fine: bool) -> Array:
    """Return the frequencies that carry a transfer, cycles per pixel; fine ones follow the ripples
    of a wide halo.
    """
    low = np.array([1e-5, 2.5e-4, 5e-4, 1e-3, 2e-3, 3.5e-3, 5e-3, 7e-3])
    upper = np.concatenate(
        [np.arange(0.3, 0.7, 0.025), np.arange(0.7, 1.4, 0.07), np.arange(1.4, 4.4, 0.25)]
    )
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
    even_map, odd_map
        Shape (bin, node): edge spread - 1/2 = even_map @ Re H + odd_map @ Im H, for H of a line
        spread along +d.

    Notes
    -----
    With the line spread l(d) = int H(f) exp(2 pi i f d) df the edge spread is
    1/2 + int [Re H sin(2 pi f d) + Im H cos(2 pi f d)] / (pi f) df over f > 0.
    The mean over a bin is the value at its mean distance and half its variance times the second
    derivative.
    """
    table = spread_table(grid.tobytes())
    first, weight = table.taps(distance)
    side, bend = np.where(distance < 0, -1.0, 1.0), 0.5 * spread_px**2
    even_map = _look_up(table.even_map, table.even_bend, first, weight * side[:, None], bend)
    return even_map, _look_up(table.odd_map, table.odd_bend, first, weight, bend)


@njit(cache=True)
def _look_up(
    table: Array, bent: Array, first: NDArray[np.int64], weight: Array, bend: Array
) -> Array:
    """Return a table and so much of its second derivative, between its places, shape (bin,
    node).
    """
    out = np.zeros((first.size, table.shape[1]))
    for i in range(first.size):
        for j in range(4):
            plain, second = weight[i, j], weight[i, j] * bend[i]
            for k in range(table.shape[1]):
                out[i, k] += plain * table[first[i] + j, k] + second * bent[first[i] + j, k]
    return out


@dataclass(frozen=True, kw_only=True)
class SpreadTable:
    """Edge spreads of all transfers on some nodes, at distances fine enough to be interpolated.

    Parameters
    ----------
    distance
        Distances, ascending from a little below 0, shape (place,), px.
    even_map, odd_map
        Maps of `edge_weights` at these distances, shape (place, node).
    even_bend, odd_bend
        Their second derivatives, per px^2.
    """

    distance: Array
    even_map: Array
    odd_map: Array
    even_bend: Array
    odd_bend: Array

    def taps(self, distance: Array) -> tuple[NDArray[np.int64], Array]:
        """Return first of four places around each |distance|, and cubic weights of the four, shape
        (bin, 4).
        """
        return cubic_taps(self.distance, np.abs(distance))


def cubic_taps(nodes: Array, at: Array) -> tuple[NDArray[np.int64], Array]:
    """Return the first of the four places around each point, and the weights of cubic Lagrange
    interpolation.
    """
    first = np.clip(np.searchsorted(nodes, at) - 2, 0, nodes.size - 4)
    around = nodes[first[:, None] + np.arange(4)]
    offset = at[:, None] - around
    weight = np.ones((at.size, 4))
    for j in range(4):
        for k in range(4):
            if k != j:
                weight[:, j] *= offset[:, k] / (around[:, j] - around[:, k])
    return first, weight


@lru_cache(maxsize=4)
def spread_table(grid_bytes: bytes) -> SpreadTable:
    """Return the table of nodes, kept: it is the same for every edge."""
    grid = np.frombuffer(grid_bytes)
    near_px = np.arange(-2, 32 * NEAR_PX) / 32.0
    far_px = np.concatenate(
        [np.arange(NEAR_PX, 40.0, 0.125), np.arange(40.0, WIDEST_PX + 2.0, 0.25)]
    )
    parts = [_integrate(grid, near_px, 0.002, 4.0), _integrate(grid, far_px, 0.0005, 0.75)]
    even_map, odd_map, even_bend, odd_bend = (
        np.concatenate(pair) for pair in zip(*parts, strict=True)
    )
    return SpreadTable(
        distance=np.concatenate([near_px, far_px]),
        even_map=even_map,
        odd_map=odd_map,
        even_bend=even_bend,
        odd_bend=odd_bend,
    )


def _integrate(
    grid: Array, distance: Array, step: float, top: float
) -> tuple[Array, Array, Array, Array]:
    """Integrate the kernels against the interpolation with the midpoint rule up to a frequency."""
    f = np.arange(step / 2, top, step)
    # Far from the edge nothing fine is left: a smooth end of the integral keeps its ripple out.
    fade = np.ones_like(f) if top > 1 else np.clip((top - f) / (0.4 * top), 0.0, 1.0) ** 2
    phase = 2.0 * np.pi * np.outer(distance, f)
    carried = interpolation(grid, f) * (fade * step / (np.pi * f))[:, None]
    bent = carried * -((2.0 * np.pi * f) ** 2)[:, None]
    sine, cosine = np.sin(phase), np.cos(phase)
    return sine @ carried, cosine @ carried, sine @ bent, cosine @ bent
