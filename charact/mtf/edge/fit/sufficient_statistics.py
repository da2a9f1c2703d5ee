"""Everything the pixels say of an edge's profile, kept as a few matrices on the nodes of the transfer.

The bin means are linear in the transfer and in the levels, so that chi squared of any transfer is a quadratic form:
once these matrices are made, a likelihood costs the same whatever the size of the picture.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Marginal:
    """ln of the likelihood of transfers on one profile, step, level and slopes marginalised.

    Parameters
    ----------
    white, levels, data
        Map from nodes, real and imaginary parts side by side, to whitened bins, shape (2 node, bin); whitened level and
        slopes, shape (level, bin); whitened data, shape (bin,).
    level_precision
        Precision of the priors of level and slopes, DN^-2; 0 for a free one.
    step_dn
        Unit in which the step's own prior is flat, DN.

    Attributes
    ----------
    power
        Chi squared without a step.

    Notes
    -----
    What is linear and has a Gaussian prior is marginalised by projection: priors are further bins whose data are none,
    and what level and slopes can make of the bins falls out of map and data alike.
    """

    def __init__(self, white: Array, levels: Array, data: Array, level_precision: Array, step_dn: float) -> None:
        span = np.linalg.qr(np.concatenate([levels, np.diag(np.sqrt(level_precision))], axis=1).T)[0]
        none = np.zeros(len(levels))
        self._data = _project_out(np.concatenate([data, none]), span)
        self._map = _project_out(np.concatenate([white, np.zeros((len(white), none.size))], axis=1), span)
        self._step_dn = step_dn
        self.power = float(self._data @ self._data)

    def log_likelihood(self, stacked: Array) -> Array:
        """Return ln of the likelihood of transfers, shape (n, 2 node) -> (n,)."""
        overlap, curvature = self._seen(stacked)
        return -0.5 * (self.power - overlap**2 / curvature + np.log(curvature * self._step_dn**2))

    def amplitude(self, stacked: Array) -> tuple[Array, Array]:
        """Return the best step of transfers, DN, and chi squared there, shape (n, 2 node) -> (n,)."""
        overlap, curvature = self._seen(stacked)
        return overlap / curvature, self.power - overlap**2 / curvature

    def _seen(self, stacked: Array) -> tuple[Array, Array]:
        """Return what spreads have in common with the data, and their own power."""
        spread = stacked @ self._map
        return spread @ self._data, np.maximum(np.einsum("ij,ij->i", spread, spread), 1e-300)


def _project_out(rows: Array, span: Array) -> Array:
    """Return rows less what orthonormal columns span of them."""
    return rows - (rows @ span) @ span.T


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
        Weights of `charact.mtf.edge.fit.esf_from_mtf.edge_weights` side by side, shape (bin, 2 node); the model is
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


@njit(cache=True)
def apply_phases(modulus: Array, turns: Array, fixed: Array) -> Array:
    """Return transfers delayed by phases, real and imaginary parts side by side, shape (n, 2 node).

    Parameters
    ----------
    modulus
        Shape (n, node).
    turns
        Phase by which each node is late, shape (n, node), in turns: shift times frequency.
    fixed
        Known part of the transfer, real and imaginary, shape (2, node).

    Notes
    -----
    Sine and cosine are their series within an eighth of a turn, to the last digit but one: a processor takes several
    of these at a time, and none of a library's.
    """
    count, size = modulus.shape
    out = np.empty((count, 2 * size))
    for i in range(count):
        for j in range(size):
            quarters = 4.0 * turns[i, j]
            whole = math.floor(quarters + 0.5)
            sine, cosine = _series((quarters - whole) * (0.5 * math.pi))
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
