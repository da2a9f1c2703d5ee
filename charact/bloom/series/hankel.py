"""Light along the radius from transforms: L(r) = 2 pi int T(f) J0(2 pi f r) f df.

Gauss-Legendre quadrature is exact for what is smooth, and dense at low frequencies, where tails have their cusp.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# High enough for the sharpest core allowed, and nodes enough for the farthest ring.
HIGHEST_CY_PER_PX = 1.25
NODES = 300


@lru_cache(maxsize=1)
def _quadrature() -> tuple[Array, Array]:
    at, weight = np.polynomial.legendre.leggauss(NODES)
    return 0.5 * HIGHEST_CY_PER_PX * (at + 1.0), 0.5 * HIGHEST_CY_PER_PX * weight


def frequencies() -> Array:
    """Frequencies of the transforms, cycles per column pitch."""
    return _quadrature()[0]


def onto_nodes(node_px: Array) -> Array:
    """Return the matrix that takes transforms to light at radii, shape (frequency, node); not to be written to."""
    return _onto_nodes(np.asarray(node_px, np.float64).tobytes())


@lru_cache(maxsize=4)
def _onto_nodes(nodes: bytes) -> Array:
    from scipy.special import j0

    node_px = np.frombuffer(nodes)
    frequency, weight = (one[:, None] for one in _quadrature())
    return 2.0 * np.pi * frequency * weight * j0(2.0 * np.pi * frequency * node_px)
