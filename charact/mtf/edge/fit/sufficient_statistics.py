"""Everything the pixels say of an edge's profile, kept as a few matrices on the nodes of the transfer.

The bin means are linear in the transfer and in the levels, so that chi squared of any transfer is a quadratic form:
once these matrices are made, a likelihood costs the same whatever the size of the picture.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.mtf.edge.fit.marginal import Marginal

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ProfileStatistics:
    """The data with levels and illumination slopes marginalised.

    Parameters
    ----------
    marginal
        Likelihood of transfers.
    free
        Data less levels marginalised.
    spread
        From transfers, real and imaginary parts side by side, to edge spreads less one half, shape (bin, 2 node).
    value, nuisance, nuisance_sd, precision_root
        What else it was made of: bin means, shapes with their priors, and the inverse root of the covariance.
    log_nuisance
        ln of what marginalising the shapes costs, up to a constant: it lets priors of different width be compared.
    """

    marginal: Marginal
    free: int
    spread: Array
    value: Array
    nuisance: Array
    nuisance_sd: Array
    precision_root: Array
    log_nuisance: float

    def profile(self, stacked: Array) -> tuple[Array, Array]:
        """Return the best profile at the bins for one transfer, DN, and the amplitudes of step and nuisance shapes."""
        design = np.concatenate([(self.spread @ stacked)[:, None], self.nuisance], axis=1)
        white = self.precision_root @ design
        prior = np.concatenate([[0.0], 1.0 / np.maximum(self.nuisance_sd, 1e-300) ** 2])
        amplitude = np.linalg.solve(white.T @ white + np.diag(prior), white.T @ (self.precision_root @ self.value))
        return design @ amplitude, np.asarray(amplitude, float)


def profile_statistics(
    value: Array, covariance: Array, spread: Array, nuisance: Array, nuisance_sd: Array, step: float
) -> ProfileStatistics:
    """Build the evidence of bin means.

    Parameters
    ----------
    value
        Bin means, shape (bin,), DN.
    covariance
        Their covariance, shape (bin, bin).
    spread
        Weights of `charact.mtf.edge.fit.esf_from_mtf.edge_weights` side by side, shape (bin, 2 node); the data's model is
        step (spread @ transfer) + nuisance.
    nuisance
        Shapes whose amplitudes are marginalised, shape (bin, shape).
    nuisance_sd
        Standard deviation of their Gaussian priors, DN; infinite for a free one.
    """
    precision_root = np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), float)
    white = precision_root @ np.concatenate([spread, nuisance, value[:, None]], axis=1)
    nodes = spread.shape[1]
    weights, shapes, data = white[:, :nodes], white[:, nodes:-1], white[:, -1]
    precision = 1.0 / np.maximum(nuisance_sd, 1e-300) ** 2
    known = np.isfinite(nuisance_sd)
    return ProfileStatistics(
        marginal=Marginal(weights.T, shapes.T, data, precision, step),
        free=len(value) - nuisance.shape[1],
        spread=spread,
        value=value,
        nuisance=nuisance,
        nuisance_sd=nuisance_sd,
        precision_root=precision_root,
        log_nuisance=-0.5 * float(np.linalg.slogdet(shapes.T @ shapes + np.diag(precision))[1])
        - float(np.sum(np.log(nuisance_sd[known]))),
    )
