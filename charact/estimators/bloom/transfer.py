"""Frequencies of the transfer functions of a point series, and radial profiles from them."""

from functools import lru_cache

import numpy as np

from charact.transfer.spreads import hankel_matrix, quadrature
from labdata import Array


def _quadrature() -> tuple[Array, Array]:
    """Quadrature for the sharpest core and the outermost ring of a series."""
    return quadrature(1.25, 300)


def frequencies() -> Array:
    """Frequencies of the transforms, cycles per column pitch."""
    return _quadrature()[0]


def onto_nodes(node_px: Array) -> Array:
    """Return the matrix that takes transforms to light at radii, shape (frequency, node); not to be
    written to.
    """
    return _onto_nodes(np.asarray(node_px, np.float64).tobytes())


@lru_cache(maxsize=4)
def _onto_nodes(nodes: bytes) -> Array:
    return hankel_matrix(_quadrature(), np.frombuffer(nodes))
