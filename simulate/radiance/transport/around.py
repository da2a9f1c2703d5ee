"""Rays that gather light at places, and what they meet."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.transport.panes import Passed
from simulate.radiance.transport.points import Points

Array = NDArray[np.floating]


@dataclass(frozen=True)
class Around:
    """Rays that gather: their points, starts, directions, densities and factors, and what they meet."""

    many: Points
    start_m: Array
    direction: Array
    density: Array
    factor: Array
    face: NDArray[np.int64]
    range_m: Array
    met: NDArray[np.int64]
    open: NDArray[np.bool_]
    glass: Passed | None = None

    @property
    def glazed(self) -> NDArray[np.bool_]:
        """Whether rays met panes."""
        return self._of_glass(np.zeros(len(self.face), np.bool_), lambda glass: np.ones(len(glass.which), np.bool_))

    @property
    def last_start_m(self) -> Array:
        """Where the last legs of rays begin."""
        return self._of_glass(self.start_m, lambda glass: glass.start_m)

    @property
    def last_direction(self) -> Array:
        """Directions of the last legs of rays."""
        return self._of_glass(self.direction, lambda glass: glass.direction)

    @property
    def gone_m(self) -> Array:
        """Ways before the last legs, m."""
        return self._of_glass(np.zeros(len(self.face)), lambda glass: glass.gone_m)

    @property
    def turned(self) -> NDArray[np.bool_]:
        """Whether panes mirrored rays."""
        return self._of_glass(np.zeros(len(self.face), np.bool_), lambda glass: glass.turned)

    def weaken(self, which: NDArray[np.int64], light: NDArray[np.float32]) -> None:
        """Weaken the light of some rays (ray, band) by the panes that they met."""
        if self.glass is not None:
            _, among, here = np.intersect1d(self.glass.which, which, assume_unique=True, return_indices=True)
            light[here] *= self.glass.weight[among]

    def _of_glass(self, plain: NDArray, own: Callable[[Passed], NDArray]) -> NDArray:
        if self.glass is None:
            return plain
        found = plain.copy()
        found[self.glass.which] = own(self.glass)
        return found
