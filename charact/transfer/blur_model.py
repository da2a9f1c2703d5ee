"""Blur models along one direction: a core, and an extended component.

Every core is scaled by the frequency at which it falls to one half, so that forms can be compared
parameter by parameter.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from charact.transfer.cores import CORES
from charact.transfer.extended import ExtendedComponent
from charact.transfer.form import Core, Parameter, ProperPrior, flat_parameters
from labdata import Array


@dataclass(frozen=True, kw_only=True)
class BlurModel(ProperPrior):
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

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the core, then those of the extended component."""
        return (
            *self._core.parameters,
            *(flat_parameters(self.wide.parameters) if self.wide else ()),
        )

    @property
    def core_parameters(self) -> int:
        """Number of parameters before those of the extended component."""
        return len(self._core.parameters)

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
