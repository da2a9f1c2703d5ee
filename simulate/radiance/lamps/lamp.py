"""A lamp: a spectrum of so many watts, shone where its distribution says."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulate.radiance.lamps.distribution import Distribution, Isotropic
from simulate.radiance.spectrum import SourceSpectrum


@dataclass(frozen=True, kw_only=True, eq=False)
class Lamp:
    """A lamp without a place: scenes put it somewhere.

    Parameters
    ----------
    flux
        Radiant flux, W over wavelength (`spectrum`).
    distribution
        Where it goes, in the lamp's frame: z is its axis.
    """

    flux: SourceSpectrum
    distribution: Distribution = field(default_factory=Isotropic)

    def intensity(self, direction: NDArray[np.floating], wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Return the spectral radiant intensity, W sr-1 nm-1, shape (band, ray).

        Parameters
        ----------
        direction
            Unit vectors away from the lamp in its frame, shape (ray, 3).
        wavelength_nm
            The whole spectral grid, shape (band,), nm; a line's power lies in the bands around it (`SourceSpectrum.on`).
        """
        return self.flux.on(wavelength_nm)[:, None] * self.distribution.per_sr(direction)

    def exitance(self, area_m2: float, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Return what a surface of an area gives off when it is this lamp, W m-2 nm-1, shape (band,)."""
        return self.flux.on(wavelength_nm) / area_m2
