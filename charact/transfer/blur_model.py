"""Blur models along one direction: a core, and an extended component.

Every core is scaled by the frequency at which it falls to one half, so that forms can be compared
parameter by parameter.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from charact.transfer.cores import CORES
from charact.transfer.extended import ExtendedComponent
from charact.transfer.form import Core, table_of
from labdata import Array


@dataclass(frozen=True, kw_only=True)
class BlurModel:
    """A form of the transfer along one direction, aperture and video filter excluded.

    T = C (1 - q + q W), with C the core, W the extended component and q its fraction of all light.

    Parameters
    ----------
    core
        Name of the core in `CORES`.
    wide
        Extended component, or None.
    """

    core: str
    wide: ExtendedComponent | None = None

    @property
    def name(self) -> str:
        """Name for people."""
        return self.core if self.wide is None else f"{self.core} + {self.wide.name}"

    @property
    def _core(self) -> Core:
        return CORES[self.core]

    @property
    def parameters(self) -> dict[str, tuple[str, tuple[float, float]]]:
        """Unit and bounds of each parameter by name."""
        return {
            **table_of(self._core.parameters),
            **(self.wide.parameters if self.wide else {}),
        }

    @cached_property
    def bounds(self) -> Array:
        """Bounds of the parameters, shape (parameter, 2)."""
        return np.array([bound for _, bound in self.parameters.values()])

    @property
    def core_parameters(self) -> int:
        """Number of parameters before those of the extended component."""
        return len(self._core.parameters)

    def start(self, half_frequency_cy_per_px: float) -> Array:
        """Return a starting point of the optimisation."""
        shape = [parameter.start for parameter in self._core.shape]
        extended = self.bounds[self.core_parameters :] @ [0.7, 0.3]
        return np.array([np.log(half_frequency_cy_per_px), *shape, *extended])

    def modulus(self, theta: Array, frequency: Array) -> Array:
        """Return the transfer, shape (n, parameter) and (f,) -> (n, f); negative where defocus
        turns it round.
        """
        core = self._core.transfer(theta[:, : self.core_parameters], frequency)
        if self.wide is None:
            return core
        tail = theta[:, self.core_parameters :]
        fraction = tail[:, :1] * self.wide.share_unit(tail[:, 1:])
        return core * (1.0 - fraction + fraction * self.wide.transfer(frequency, tail[:, 1:]))

    def derivatives(self, theta: Array, frequency: Array) -> Array:
        """Return the transfer and its slopes with the parameters, shape (parameter,) and (f,) ->
        (parameter + 1, f).
        """
        size = self.core_parameters
        core = self._core.derivatives(theta[:size], frequency)
        if self.wide is None:
            return core
        amplitude, shape = theta[size], theta[size + 1 :]
        unit, further = self.wide.share_unit(np.stack([shape, 2.0 * shape]))[:, 0]
        fraction = amplitude * unit
        part, by_size, *by_others = self.wide.terms(frequency, shape)
        by_size = fraction * by_size + amplitude * (further - unit) / shape[0] * (part - 1.0)
        tail = [unit * (part - 1.0), by_size, *(fraction * slope for slope in by_others)]
        return np.concatenate([core * (1.0 - fraction + fraction * part), core[0] * tail])

    def log_prior(self, theta: Array) -> Array:
        """Return ln of the prior density, -inf outside the bounds: flat but for half frequency and
        exponent.
        """
        bounds, (mean, precision) = self.bounds, self.prior_precision
        in_bounds = np.all((theta >= bounds[:, 0]) & (theta <= bounds[:, 1]), axis=1)
        normal = precision > 0
        flat = 0.5 * np.sum(np.log(precision[normal] / (2.0 * np.pi))) - np.sum(
            np.log(np.ptp(bounds[~normal], axis=1))
        )
        return np.where(
            in_bounds, flat - 0.5 * np.sum(precision * (theta - mean) ** 2, axis=1), -np.inf
        )

    @cached_property
    def prior_precision(self) -> tuple[Array, Array]:
        """Mean and precision of the Gaussian part of the prior of each parameter; 0: flat."""
        mean, precision = np.zeros((2, len(self.bounds)))
        for index, parameter in enumerate(self._core.parameters):
            mean[index], precision[index] = parameter.mean, parameter.sd**-2
        return mean, precision
