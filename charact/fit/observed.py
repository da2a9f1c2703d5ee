"""What the fit compares its camera model with: measured numbers, their covariance, and what the model says of them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.fit.predicted_quantities import Values

Array = NDArray[np.float64]
Predict = Callable[[Values], Array]


@dataclass(frozen=True, kw_only=True)
class Observation:
    """Measured numbers with Gaussian errors and the model's prediction of them.

    Parameters
    ----------
    name
        What was measured, for messages.
    value
        Measured numbers, shape (k,).
    covariance
        Of their errors, what the model leaves out included, shape (k, k).
    predict
        Predictions for parameter draws: values of shape (n,) each -> (n, k).
    speaks_of
        Paths of the sensor parameters it depends on.
    """

    name: str
    value: Array
    covariance: Array
    predict: Predict
    speaks_of: tuple[str, ...]

    def chi_squared(self, values: Values) -> Array:
        """Return the squared distance of each draw's prediction in units of the errors, shape (n,)."""
        away = (self.predict(values) - self.value) @ self._whitening
        return np.sum(away**2, axis=1)

    def doubted(self, factor: float) -> "Observation":
        """Return the same numbers with all errors larger by a factor."""
        return replace(self, covariance=self.covariance * factor**2)

    @cached_property
    def _whitening(self) -> Array:
        """Root of the inverse covariance: residuals times it are independent and of unit variance."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariance)).T, np.float64)


def one(
    name: str, value: float, sd: float, predict: Callable[[Values], Array], speaks_of: tuple[str, ...]
) -> Observation:
    """Return one measured number; its prediction has shape (n,)."""
    return Observation(
        name=name,
        value=np.array([value]),
        covariance=np.array([[sd**2]]),
        predict=lambda values: predict(values)[:, None],
        speaks_of=speaks_of,
    )


def curve_observation(
    name: str,
    value: Array,
    sd: Array,
    frequency: Array,
    predict: Callable[[Values], Array],
    speaks_of: tuple[str, ...],
    *,
    correlation_length: float,
    model_sd: float,
) -> Observation:
    """Return points of a measured curve, whose errors go together over a correlation length in frequency.

    Notes
    -----
    Covariance sd_i sd_j exp(-|f_i - f_j|/L) + model_sd^2 on the diagonal: closely spaced points add little.
    """
    apart = np.abs(frequency[:, None] - frequency[None, :])
    covariance = np.outer(sd, sd) * np.exp(-apart / correlation_length) + model_sd**2 * np.eye(value.size)
    return Observation(name=name, value=value, covariance=covariance, predict=predict, speaks_of=speaks_of)
