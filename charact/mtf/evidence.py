"""Everything the pixels say of an edge's profile, kept as a few matrices on the nodes of the transfer.

The bin means are linear in the transfer and in the levels, so that chi squared of any transfer is a quadratic form:
once these matrices are made, a likelihood costs the same whatever the size of the picture.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """Quadratic forms of the data with levels and illumination slopes marginalised.

    Parameters
    ----------
    root
        F with F F^T = W^T P W of the stacked weights (even, odd), shape (2 node, rank); P is the precision with the
        levels projected out. Combinations of nodes that the data do not feel are left out.
    match
        W^T P y, shape (2 node,).
    power
        y^T P y.
    free
        Data less levels marginalised.
    step
        Scale of the step, DN: the prior of the amplitude is flat and wide on it.
    value, even, odd, nuisance, nuisance_sd, precision_root
        What it was made of: bin means, weights, shapes with their priors, and the inverse root of the covariance.
    log_nuisance
        ln of what marginalising the shapes costs, up to a constant: it lets priors of different width be compared.
    """

    root: Array
    match: Array
    power: float
    free: int
    step: float
    value: Array
    even: Array
    odd: Array
    nuisance: Array
    nuisance_sd: Array
    precision_root: Array
    log_nuisance: float

    def log_likelihood(self, transfer: NDArray[np.complex128]) -> Array:
        """Return ln of the likelihood of transfers at the nodes, shape (n, node) -> (n,), the step marginalised."""
        stacked = np.concatenate([transfer.real, transfer.imag], axis=1)
        curvature = np.sum((stacked @ self.root) ** 2, axis=1)
        overlap = stacked @ self.match
        curvature = np.maximum(curvature, 1e-300)
        chi2 = self.power - overlap**2 / curvature
        return -0.5 * (chi2 + np.log(curvature * self.step**2))

    def amplitude(self, transfer: NDArray[np.complex128]) -> tuple[float, float]:
        """Return the best step of one transfer, DN, and chi squared there."""
        stacked = np.concatenate([transfer.real, transfer.imag])
        curvature, overlap = np.sum((stacked @ self.root) ** 2), stacked @ self.match
        return float(overlap / curvature), float(self.power - overlap**2 / curvature)

    def profile(self, transfer: NDArray[np.complex128]) -> tuple[Array, Array]:
        """Return the best profile at the bins for one transfer, DN, and the amplitudes of step and nuisance shapes."""
        shape = self.even @ transfer.real + self.odd @ transfer.imag
        design = np.concatenate([shape[:, None], self.nuisance], axis=1)
        white = self.precision_root @ design
        prior = np.concatenate([[0.0], 1.0 / np.maximum(self.nuisance_sd, 1e-300) ** 2])
        amplitude = np.linalg.solve(white.T @ white + np.diag(prior), white.T @ (self.precision_root @ self.value))
        return design @ amplitude, np.asarray(amplitude, float)


def evidence_of(
    value: Array, covariance: Array, even: Array, odd: Array, nuisance: Array, nuisance_sd: Array, step: float
) -> Evidence:
    """Build the evidence of bin means.

    Parameters
    ----------
    value
        Bin means, shape (bin,), DN.
    covariance
        Their covariance, shape (bin, bin).
    even, odd
        Weights of `charact.mtf.spread.edge_weights`, shape (bin, node); the data's model is
        step (even Re H + odd Im H) + nuisance.
    nuisance
        Shapes whose amplitudes are marginalised, shape (bin, shape).
    nuisance_sd
        Standard deviation of their Gaussian priors, DN; infinite for a free one.
    """
    precision_root = np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), float)
    white = precision_root @ np.concatenate([even, odd, nuisance, value[:, None]], axis=1)
    nodes = 2 * even.shape[1]
    weights, shapes, data = white[:, :nodes], white[:, nodes:-1], white[:, -1]
    prior = np.diag(1.0 / np.maximum(nuisance_sd, 1e-300) ** 2)
    outer = shapes.T @ shapes + prior
    inner = np.linalg.inv(outer)
    known = np.isfinite(nuisance_sd)
    onto_weights, onto_data = shapes.T @ weights, shapes.T @ data
    values, vectors = np.linalg.eigh(weights.T @ weights - onto_weights.T @ inner @ onto_weights)
    felt = values > 1e-11 * values[-1]
    return Evidence(
        root=vectors[:, felt] * np.sqrt(values[felt]),
        match=weights.T @ data - onto_weights.T @ inner @ onto_data,
        power=float(data @ data - onto_data @ inner @ onto_data),
        free=len(value) - nuisance.shape[1],
        step=step,
        value=value,
        even=even,
        odd=odd,
        nuisance=nuisance,
        nuisance_sd=nuisance_sd,
        precision_root=precision_root,
        log_nuisance=-0.5 * float(np.linalg.slogdet(outer)[1]) - float(np.sum(np.log(nuisance_sd[known]))),
    )
