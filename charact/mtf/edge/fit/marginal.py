"""How likely the bins of an edge are under a spread, where level, slopes and step are whatever they are."""

import numpy as np
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
