"""The forward model of a small target: a rotationally symmetric transfer behind a known aperture."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.mtf.edge_model import KNOTS, PARAMETERS, PHASE_KNOTS, EdgeModel

Array = NDArray[np.float64]

_CORE = slice(1, 3 + KNOTS.size)


@dataclass(frozen=True, kw_only=True)
class RadialModel:
    """The transfers of `EdgeModel` without shift and phase: place is fitted apart, and phase is the known filter's.

    Parameters
    ----------
    transfers
        Forms, priors and evidence; its fixed part is not used, the pictures of the nodes hold it.
    """

    transfers: EdgeModel

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.transfers.names[_CORE] + self.transfers.names[PARAMETERS:]

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the parameters."""
        return self.transfers.units[_CORE] + self.transfers.units[PARAMETERS:]

    @property
    def bounds(self) -> Array:
        """Bounds of the parameters, shape (parameter, 2)."""
        return self._reduced(self.transfers.bounds)

    def start(self, half_frequency: float, exponent: float) -> Array:
        """Return a point from which to climb."""
        return self._reduced(self.transfers.start(half_frequency, exponent))

    def modulus(self, theta: Array, grid: Array | None = None) -> Array:
        """Return the radial transfer, shape (n, frequency)."""
        return self.transfers.modulus(self._full(theta), grid)

    def log_probability(self, theta: Array) -> Array:
        """Return ln of the posterior up to a constant, shape (n, parameter) -> (n,)."""
        full = self._full(theta)
        value = self.transfers.log_prior(full)
        inside = np.isfinite(value)
        if inside.any():
            modulus = self.transfers.modulus(full[inside])
            value[inside] += self.transfers.evidence.log_likelihood(modulus.astype(complex))
        return value

    @staticmethod
    def _reduced(full: Array) -> Array:
        return np.concatenate([full[_CORE], full[PARAMETERS:]])

    @staticmethod
    def _full(theta: Array) -> Array:
        count = _CORE.stop - _CORE.start
        zeros = np.zeros((len(theta), 1)), np.zeros((len(theta), PHASE_KNOTS.size))
        return np.concatenate([zeros[0], theta[:, :count], zeros[1], theta[:, count:]], axis=1)
