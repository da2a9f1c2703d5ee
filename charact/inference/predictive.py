"""Posterior predictive checks: comparison of data with replicates from the posterior."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata.errors import BadInput

Array = NDArray[np.float64]

# Probability of rejecting a correct model, divided between the three discrepancies.
MISFIT_LEVEL = 0.01


@dataclass(frozen=True, kw_only=True)
class PredictiveCheck:
    """Posterior predictive p-values of three discrepancies, uniform between 0 and 1 under the
    model.

    Parameters
    ----------
    chi_squared
        p-value of the sum of squares: excess noise, or any misfit.
    runs
        p-value of the number of runs of one sign: a wrong mean.
    neighbours
        p-value of the correlation of neighbouring residuals, over lags up to the root of their
        number: a wrong mean.
    level
        Probability of rejecting a correct model.
    """

    chi_squared: float
    runs: float
    neighbours: float
    level: float = MISFIT_LEVEL

    @property
    def probability(self) -> float:
        """Smallest p-value, corrected for three tests (Bonferroni)."""
        return min(1.0, 3.0 * min(self.chi_squared, self.runs, self.neighbours))

    @property
    def flags(self) -> tuple[str, ...]:
        """`model-misfit` where the model is rejected."""
        return ("model-misfit",) if self.probability < self.level else ()


def predictive_check(
    data: ArrayLike,
    predictions: ArrayLike,
    noise: ArrayLike,
    *,
    rng: np.random.Generator,
    replicates: int = 2000,
    level: float = MISFIT_LEVEL,
) -> PredictiveCheck:
    """Compare the residuals of data with those of data replicated from the posterior.

    Parameters
    ----------
    data
        Measured data in their natural order, shape (datum,).
    predictions
        Predicted mean of the data at each posterior draw, shape (draw, datum).
    noise
        Standard deviation of the noise, shape (datum,), or its covariance, shape (datum, datum).
    rng
        Generator of the replicates.
    replicates
        Number of replicated data sets, which limits the resolution of the p-values.
    level
        Probability of rejecting a correct model.

    Raises
    ------
    BadInput
        If the shapes do not fit, a number is not finite, or the noise is no covariance.

    Notes
    -----
    Whitened residuals at the posterior's mean prediction, z = L^-1 (y - m), have covariance 1 - H
    under the model, with H the posterior covariance of L^-1 times the prediction: exact for
    Gaussian noise and a mean linear in the parameters with a Gaussian prior, where H is the hat
    matrix. Replicates are drawn from that distribution, so that the data are not used twice, which
    would bias the p-values towards 1/2 (Meng 1994, doi 10.1214/aos/1176325622).
    """
    measured, mean = np.asarray(data, float), np.asarray(predictions, float)
    if (
        measured.ndim != 1
        or mean.ndim != 2
        or mean.shape[1] != measured.size
        or len(mean) < 2
        or measured.size < 4
    ):
        raise BadInput(
            f"predictions must be (draw, datum) for 4 data or more, got {mean.shape} and "
            f"{measured.shape}"
        )
    if not (np.isfinite(measured).all() and np.isfinite(mean).all()):
        raise BadInput("data and predictions must be finite")
    whiten = _whitener(np.asarray(noise, float), measured.size)
    spread = whiten((mean - mean.mean(axis=0)).T).T / np.sqrt(len(mean) - 1)
    residual = whiten((measured - mean.mean(axis=0))[:, None])[:, 0]
    ours = _discrepancies(residual[None])
    blocks = np.array_split(np.arange(replicates), -(-replicates * measured.size // (1 << 20)))
    theirs = [
        _discrepancies(_shrink_by_fit(rng.standard_normal((len(block), measured.size)), spread))
        for block in blocks
    ]
    odd = [
        _tail(observed[0], replicated, rng)
        for observed, replicated in zip(ours, np.concatenate(theirs, axis=1), strict=True)
    ]
    return PredictiveCheck(chi_squared=odd[0], runs=odd[1], neighbours=odd[2], level=level)


def _whitener(noise: Array, size: int) -> Callable[[Array], Array]:
    """Return the map that makes noise white and of unit variance, along the first axis."""
    if noise.shape == (size,):
        if not (np.isfinite(noise).all() and (noise > 0).all()):
            raise BadInput("the noise's standard deviations must be positive")
        return lambda columns: columns / noise[:, None]
    if noise.shape != (size, size):
        raise BadInput(f"the noise must be ({size},) or ({size}, {size}), got {noise.shape}")
    try:
        root = np.linalg.cholesky(noise)
    except np.linalg.LinAlgError as error:
        raise BadInput("the noise's covariance must be positive definite") from error
    return lambda columns: np.asarray(np.linalg.solve(root, columns), np.float64)


def _shrink_by_fit(white: Array, spread: Array) -> Array:
    """Return white noise (replicate, datum) after a fit: each direction has variance 1 - H.

    A direction that the noise alone determines has H = 1 at most; excess scatter of the draws is
    clipped.
    """
    _, values, directions = np.linalg.svd(spread, full_matrices=False)
    remaining = np.sqrt(np.clip(1.0 - values**2, 0.0, 1.0))
    return white - ((white @ directions.T) * (1.0 - remaining)) @ directions


def _discrepancies(residual: Array) -> Array:
    """Return the three discrepancies of white residuals (data set, datum), shape (discrepancy, data
    set).
    """
    squares = np.sum(residual**2, axis=1)
    runs = np.sum(np.diff(residual > 0, axis=1), axis=1).astype(float)
    # Autocorrelations up to the root of the number of data, weighted by 1 - lag/(last + 1).
    last = max(1, round(np.sqrt(residual.shape[1])))
    products = [
        np.einsum("rn,rn->r", residual[:, lag:], residual[:, :-lag]) for lag in range(1, last + 1)
    ]
    weights = 1.0 - np.arange(1, last + 1) / (last + 1)
    return np.array([squares, -runs, weights @ np.array(products) / squares])


def _tail(ours: float, theirs: Array, rng: np.random.Generator) -> float:
    """Return the probability of a sign as large, ties broken at random, so that it is uniform under
    the model.
    """
    larger, level = np.sum(theirs > ours), np.sum(theirs == ours)
    return float((larger + rng.uniform() * (level + 1)) / (len(theirs) + 1))
