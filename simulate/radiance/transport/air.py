"""What the air takes from light on its way and adds to it, kept over lengths so that it is computed once."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
# Lengths at which air is computed, evenly in (length / longest)^(1/2).
LENGTHS = 192


@dataclass(frozen=True)
class Air:
    """Air of a scene.

    Parameters
    ----------
    longest_m
        Longest way, m; beyond it light is weakened as by that.
    transmittance
        What ways let through, shape (length, band), or None for no air.
    added
        Radiance that ways (lengths (ray,), m, unit directions (ray, 3)) add, shape (ray, band); or None.
    """

    longest_m: float = 1.0
    transmittance: NDArray[np.float32] | None = None
    added: Callable[[Array, Array], NDArray[np.float32]] | None = None

    @property
    def absorbs(self) -> bool:
        """Whether it takes any light."""
        return self.transmittance is not None

    def through(self, range_m: Array) -> NDArray[np.float32]:
        """Return what ways of some lengths let through, shape (ray, band)."""
        assert self.transmittance is not None
        place = np.sqrt(np.minimum(range_m / self.longest_m, 1.0)) * (len(self.transmittance) - 1)
        below = np.minimum(place.astype(np.int64), len(self.transmittance) - 2)
        share = (place - below).astype(np.float32)[:, None]
        found = self.transmittance[below]
        found += share * (self.transmittance[below + 1] - found)
        return found


def air(
    transmittance: Callable[[Array], Array],
    longest_m: float,
    added: Callable[[Array, Array], NDArray[np.float32]] | None = None,
) -> Air:
    """Return air kept over lengths up to the longest, of a transmittance by lengths (way,), m: (band, way)."""
    lengths = longest_m * np.linspace(0.0, 1.0, LENGTHS) ** 2
    return Air(longest_m, np.ascontiguousarray(transmittance(lengths).T, np.float32), added)
