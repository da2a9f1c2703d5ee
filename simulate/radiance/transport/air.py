"""What the air takes from light on its way and adds to it, at any range."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.transport import dome

if TYPE_CHECKING:
    from simulate.radiance.atmosphere.air import Atmosphere

Array = NDArray[np.floating]
# Gases take less per metre the longer a way is: their extinction is kept at ranges of 2^(n / NODES) m, from 1 m on.
NODES, OCTAVES = 8, 20


@dataclass(frozen=True)
class Air:
    """Air of a scene.

    Parameters
    ----------
    scattered_per_m
        Extinction by haze and molecules, shape (band,), m-1; None: no air.
    absorbed_per_m
        Mean extinction by gases over ways of 2^(n / `NODES`) m, shape (length, band), m-1.
    endless
        Radiance of endless ways by direction; None where nothing lights the air.
    """

    scattered_per_m: NDArray[np.float32] | None = None
    absorbed_per_m: NDArray[np.float32] | None = None
    endless: dome.Dome | None = None

    @property
    def absorbs(self) -> bool:
        """Whether it takes any light."""
        return self.scattered_per_m is not None

    def through(self, range_m: Array) -> NDArray[np.float32]:
        """Return what ways of some lengths (ray,), m, let through, shape (ray, band): exp(-extinction length)."""
        assert self.scattered_per_m is not None
        depth = self._absorbed(range_m)
        depth += self.scattered_per_m
        depth *= -np.asarray(range_m, np.float32)[:, None]
        return np.exp(depth, out=depth)

    def added(self, range_m: Array, direction: Array) -> NDArray[np.float32] | None:
        """Return the radiance that ways along unit directions (ray, 3) add, shape (ray, band); None: nothing.

        Notes
        -----
        J (1 - T of haze and molecules) T of gases over half the way, see `Atmosphere.path_radiance`.
        """
        if self.endless is None or self.scattered_per_m is None:
            return None
        length = np.asarray(range_m, np.float32)[:, None]
        found = self.endless.irradiance(direction)
        found *= -np.expm1(-self.scattered_per_m * length)
        half = self._absorbed(0.5 * np.asarray(range_m))
        half *= -0.5 * length
        found *= np.exp(half, out=half)
        return found

    def _absorbed(self, range_m: Array) -> NDArray[np.float32]:
        """Extinction per m by gases over lengths, interpolated in their logarithm, shape (ray, band)."""
        table = self.absorbed_per_m
        assert table is not None
        place = np.clip(NODES * np.log2(np.maximum(range_m, 1.0)), 0.0, len(table) - 1.0)
        below = np.minimum(place.astype(np.int64), len(table) - 2)
        share = (place - below).astype(np.float32)[:, None]
        found = table[below]
        found += share * (table[below + 1] - found)
        return found


def air(lit: "Atmosphere", wavelength_nm: NDArray[np.float64]) -> Air:
    """Return an atmosphere on bands (band,), nm."""
    lengths = 2.0 ** (np.arange(NODES * OCTAVES + 1) / NODES)
    endless = None
    if lit.light is not None:
        light = lit.light
        endless = dome.sphere(lambda way: light.air_radiance(way, wavelength_nm))
    return Air(
        lit.scattered_per_m(wavelength_nm).astype(np.float32),
        np.ascontiguousarray((-np.log(lit.unabsorbed(lengths, wavelength_nm)) / lengths).T, np.float32),
        endless,
    )
