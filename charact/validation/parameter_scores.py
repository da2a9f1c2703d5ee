"""Estimates of the errors of camera parameters, each by the combination of all numbers that its
change moves most.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labdata import Array


@dataclass(frozen=True, kw_only=True)
class ParameterScores:
    """Linear estimates of relative errors of parameters from the numbers of a set of frames.

    `titles`: parameters; `weights`: shape (parameter, number); `centre`: mean numbers of the
    simulated sets, shape (number,); `sd`: standard deviation of an estimate of a right simulation,
    shape (parameter,); `degrees`: degrees of freedom of that.
    """

    titles: tuple[str, ...]
    weights: Array
    centre: Array
    sd: Array
    degrees: int

    def of(self, chosen: NDArray[np.bool_]) -> "ParameterScores":
        """Return the estimates of chosen parameters, shape (parameter,)."""
        titles = tuple(title for title, kept in zip(self.titles, chosen, strict=True) if kept)
        return replace(self, titles=titles, weights=self.weights[chosen], sd=self.sd[chosen])

    def estimates(self, measured: Array) -> Array:
        """Return the relative errors of the parameters, each as if it were the only wrong one,
        shape (parameter,).
        """
        return self.weights @ (measured - self.centre)

    def p_value(self, measured: Array) -> float:
        """Return the probability of an estimate as far from 0 in its standard deviation, over all
        parameters.
        """
        from scipy.stats import t

        largest = float(np.max(np.abs(self.estimates(measured)) / self.sd))
        return min(1.0, len(self.titles) * 2.0 * float(t.sf(largest, self.degrees)))

    def finds(self, noise: Array, shift: Array, level: float) -> NDArray[np.bool_]:
        """Return which sets have a p-value below a level, shape (set,).

        `noise`: their deviations from the centre, shape (set, number), to which a shift is added,
        shape (number,) or one for each set.
        By the covariance that gave the weights estimates scatter less than those of other sets do:
        they are given the scatter of those.
        """
        from scipy.stats import t

        limit = float(t.isf(level / (2.0 * len(self.titles)), self.degrees))
        estimates = noise @ self.weights.T
        pulls = (
            estimates / np.sqrt(np.mean(estimates**2, axis=0)) + shift @ self.weights.T / self.sd
        )
        return np.abs(pulls).max(axis=1) > limit


def parameter_scores(
    titles: Sequence[str], changes: Array, values: Array, least_sd: Array
) -> ParameterScores:
    """Return the estimates of parameters from simulated sets.

    Parameters
    ----------
    titles
        Names of the parameters.
    changes
        Change of each number by a relative change of 1 of each parameter, shape (parameter,
        number).
    values
        Numbers of the simulated sets, shape (set, number).
    least_sd
        Least standard deviation of each number, shape (number,).

    Notes
    -----
    With the covariance C of the numbers, the estimate of least variance is

    .. math:: a = d^T C^{-1} (y - \\bar y) / d^T C^{-1} d

    (score test of a Gaussian; Rao 1948). C has its correlations halved, as there are fewer sets
    than numbers; the weights are then not the best, but the estimate stays unbiased. Its variance
    is that of the estimates of each set by the other sets alone (cross-validation): neither the
    choice of the weights nor wrong correlations make it too small. Sampling noise and the width of
    the posterior are both in it.
    """
    count = len(values)
    weights, centre = _weights(changes, values, least_sd), values.mean(axis=0)
    left_out = np.empty((count, len(titles)))
    for index in range(count):
        other_sets = np.delete(values, index, axis=0)
        left_out[index] = _weights(changes, other_sets, least_sd) @ (
            values[index] - other_sets.mean(axis=0)
        )
    sd = np.sqrt(np.mean(left_out**2, axis=0))
    return ParameterScores(
        titles=tuple(titles), weights=weights, centre=centre, sd=sd, degrees=count - 1
    )


def _weights(changes: Array, values: Array, least_sd: Array) -> Array:
    """Return the weights of the numbers in the estimates, shape (parameter, number)."""
    # In standard deviations, as the numbers have many units; with halved correlations, solved in
    # the space of the sets.
    sd = np.sqrt(np.maximum(values.var(axis=0, ddof=1), least_sd**2))
    spread = (values - values.mean(axis=0)) / sd / np.sqrt(len(values) - 1.0)
    # Variances are kept: what correlations lose is added to the diagonal.
    diagonal = 1.0 - 0.5 * (spread**2).sum(axis=0)
    scaled_changes = changes / sd
    inner = np.eye(len(values)) + 0.5 * (spread / diagonal) @ spread.T
    plain = scaled_changes / diagonal
    solved = plain - 0.5 * (np.linalg.solve(inner, spread @ plain.T).T @ spread) / diagonal
    scale = np.einsum("pn,pn->p", solved, scaled_changes)
    return solved / scale[:, None] / sd
