"""From transfers to the bins of an edge's profile, plain and whitened: two matrices made once for all fits of it."""

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dtrmm  # pyright: ignore[reportAttributeAccessIssue]
from scipy.linalg.lapack import dpotrf, dtrtri  # pyright: ignore[reportAttributeAccessIssue]

from charact.mtf.edge.fit.esf_from_mtf import edge_weights, nodes
from charact.mtf.edge.fit.gauss_newton import LARGEST_TURN_PX
from charact.mtf.edge.fit.marginal import Marginal
from charact.mtf.edge.fit.phases import apply_phases
from charact.mtf.edge.pixels.profile import EdgeProfile
from charact.mtf.known_transfer import KnownTransfer

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


class EdgeMaps:
    """Linear maps from a transfer at the nodes to the bins of a profile.

    Parameters
    ----------
    profile
        The measured profile with the covariance of its bins.
    known
        Known part of the transfer: aperture and video filter.
    """

    def __init__(self, profile: EdgeProfile, known: KnownTransfer) -> None:
        self.grid = nodes(fine=profile.gathered.half_width_px > 24.0)
        self.fixed = known(self.grid)
        self.root = _inverse_root(profile.covariance)
        self.data = self.root @ profile.value
        self.white_levels = self.root @ profile.levels
        self._profile = profile
        self._build_around(0.0)

    def _build_around(self, shift_px: float) -> None:
        self._centre = shift_px
        even, odd = edge_weights(self.grid, self._profile.distance - shift_px, self._profile.spread_px)
        plain = np.concatenate([even, odd], axis=1)
        self.plain_map = np.ascontiguousarray(plain.T)
        # Half the work of a product: the root is a triangle.
        self._white = np.ascontiguousarray(dtrmm(1.0, self.root, plain.T, side=1, lower=1, trans_a=1))
        fixed = np.stack([self.fixed.real, self.fixed.imag])
        levels = np.ascontiguousarray(self.white_levels.T)
        self.compiled = (self.grid, fixed, shift_px, self._white, levels, self.data)

    def rebuild_for(self, shift_px: float) -> None:
        """Make the maps anew where they do not serve a shift."""
        if abs(shift_px - self._centre) > LARGEST_TURN_PX:
            self._build_around(shift_px)

    @cached_property
    def power(self) -> float:
        """Chi squared of a level alone."""
        level = self.white_levels[:, :1]
        return float(self.data @ self.data - (level[:, 0] @ self.data) ** 2 / (level[:, 0] @ level[:, 0]))

    def shift_transfers(self, modulus: Array, shift_px: float) -> Complex:
        """Return transfers of spreads at a shift, shape (n, node), their known part included."""
        self.rebuild_for(shift_px)
        return modulus * (self.fixed * np.exp(-2j * np.pi * (shift_px - self._centre) * self.grid))

    def likelihood(self, level_precision: Array) -> Callable[[Array, Array], Array]:
        """Return ln of the likelihood of transfers, shape (n, node), and shifts, shape (n,), px.

        Parameters
        ----------
        level_precision
            Precision of the priors of level and slopes, which are marginalised, DN^-2; 0 for a free one.
        """
        grid, fixed, centre_px, white, levels, data = self.compiled
        marginal = Marginal(white, levels, data, level_precision, self._profile.step)

        def likelihood(modulus: Array, shift_px: Array) -> Array:
            return marginal.log_likelihood(apply_phases(modulus, np.multiply.outer(shift_px - centre_px, grid), fixed))

        return likelihood

    def white(self, transfer: Complex) -> Array:
        """Return whitened edge spreads less one half, shape (n, node) -> (n, bin)."""
        return _real_and_imaginary(transfer) @ self._white


def _inverse_root(covariance: Array) -> Array:
    """Return the inverse of the Cholesky root, a lower triangle."""
    root, failed = dpotrf(covariance.T, lower=1, clean=1)
    if failed:
        raise np.linalg.LinAlgError("the covariance of the bins is not positive definite")
    return dtrtri(root, lower=1)[0]


def _real_and_imaginary(transfer: Complex) -> Array:
    return np.concatenate([transfer.real, transfer.imag], axis=1)
