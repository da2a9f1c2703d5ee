"""How likely an edge's profile is under many transfers at once: step, levels and slopes marginalised beforehand."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


class EdgeLikelihood:
    """ln of the likelihood of transfers on one profile.

    Parameters
    ----------
    grid, fixed
        Nodes, cycles per pixel, and the known part of the transfer there, real and imaginary, shape (2, node).
    centre_px
        Shift around which the map is made, px.
    white, levels, data
        Map from nodes to whitened bins, shape (2 node, bin); whitened level and slopes, shape (3, bin); data, (bin,).
    level_precision
        Precision of the priors of level and slopes, DN^-2; 0 for a free one.
    step_dn
        Unit in which the step's own prior is flat, DN.

    Notes
    -----
    What is linear and has a Gaussian prior is marginalised by projection: priors are further bins whose data are none,
    and what level and slopes can make of the bins falls out of map and data alike. What is left of the map has few
    directions that a transfer moves, and only these are kept.
    """

    def __init__(
        self, grid: Array, fixed: Array, centre_px: float, white: Array, levels: Array, data: Array,
        level_precision: Array, step_dn: float,
    ) -> None:  # fmt: skip
        span = np.linalg.qr(np.concatenate([levels, np.diag(np.sqrt(level_precision))], axis=1).T)[0]
        none = np.zeros(len(levels))
        self._data = _without(np.concatenate([data, none]), span)
        self._map = _without(np.concatenate([white, np.zeros((len(white), none.size))], axis=1), span)
        self._grid, self._fixed, self._centre_px = grid, fixed, centre_px
        self._step_dn = step_dn

    def __call__(self, modulus: Array, shift_px: Array) -> Array:
        """Return ln of the likelihood of transfers, shape (n, node), at shifts of the edge, shape (n,), px."""
        spread = _turned(modulus, shift_px - self._centre_px, self._grid, self._fixed) @ self._map
        curvature = np.maximum(np.einsum("ij,ij->i", spread, spread), 1e-300)
        left = self._data @ self._data - (spread @ self._data) ** 2 / curvature
        return -0.5 * (left + np.log(curvature * self._step_dn**2))


def _without(rows: Array, span: Array) -> Array:
    """Return rows less what orthonormal columns span of them."""
    return rows - (rows @ span) @ span.T


@njit(cache=True)
def _turned(modulus: Array, shift_px: Array, grid: Array, fixed: Array) -> Array:
    """Return transfers whose edges are shifted, real and imaginary parts side by side, shape (n, 2 node).

    Sine and cosine are their series within an eighth of a turn, to the last digit but one: a processor takes several
    of these at a time, and none of a library's.
    """
    size = grid.size
    out = np.empty((shift_px.size, 2 * size))
    for i in range(shift_px.size):
        for j in range(size):
            quarters = 4.0 * shift_px[i] * grid[j]
            whole = math.floor(quarters + 0.5)
            angle = (quarters - whole) * (0.5 * math.pi)
            sine, cosine = _series(angle)
            half = math.floor(0.5 * whole)
            sign = 1.0 - 2.0 * (half - 2.0 * math.floor(0.5 * half))
            crossed = whole != 2.0 * half
            real = sign * (-sine if crossed else cosine)
            imaginary = sign * (cosine if crossed else sine)
            out[i, j] = modulus[i, j] * (fixed[0, j] * real + fixed[1, j] * imaginary)
            out[i, size + j] = modulus[i, j] * (fixed[1, j] * real - fixed[0, j] * imaginary)
    return out


@njit(cache=True, inline="always")
def _series(angle: float) -> tuple[float, float]:
    """Return sine and cosine of an angle of at most an eighth of a turn, rad, by Taylor's series."""
    square = angle * angle
    sine = 1.0 - square * (1.0 / 210.0)
    cosine = 1.0 - square * (1.0 / 240.0)
    sine, cosine = 1.0 - square * (1.0 / 156.0) * sine, 1.0 - square * (1.0 / 182.0) * cosine
    sine, cosine = 1.0 - square * (1.0 / 110.0) * sine, 1.0 - square * (1.0 / 132.0) * cosine
    sine, cosine = 1.0 - square * (1.0 / 72.0) * sine, 1.0 - square * (1.0 / 90.0) * cosine
    sine, cosine = 1.0 - square * (1.0 / 42.0) * sine, 1.0 - square * (1.0 / 56.0) * cosine
    sine, cosine = 1.0 - square * (1.0 / 20.0) * sine, 1.0 - square * (1.0 / 30.0) * cosine
    sine, cosine = 1.0 - square * (1.0 / 6.0) * sine, 1.0 - square * (1.0 / 12.0) * cosine
    return angle * sine, 1.0 - 0.5 * square * cosine
