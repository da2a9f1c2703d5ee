"""Spectral radiance image with one plane per wavelength."""

from dataclasses import dataclass

import numpy as np

from labdata.errors import BadInput
from labdata.frames import read_only
from simulate.arrays import Array, Array32


@dataclass(frozen=True, kw_only=True)
class RadianceCube:
    """Spectral radiance, averaged over each cell of the image."""

    # Wavelengths, ascending, shape (band,), nm. Between them radiance is taken as linear.
    wavelength_nm: Array
    radiance: Array  # Spectral radiance, shape (band, row, col), W m-2 sr-1 nm-1. Made read-only
    # Whether values are averages over the bands (`SourceSpectrum.on`), so that the sum of value,
    # width (`band_widths`) and response at the band is the integral; else they are values at the
    # wavelengths.
    averaged: bool = False

    def __post_init__(self) -> None:
        wavelength = np.asarray(self.wavelength_nm, float)
        radiance = np.asarray(self.radiance)
        if radiance.ndim != 3 or len(radiance) != len(wavelength):
            raise BadInput(
                f"a radiance cube must have the axes (band, row, col) with {len(wavelength)} "
                f"bands, got shape {radiance.shape}"
            )
        if not (np.diff(wavelength) > 0).all():
            raise BadInput(f"wavelengths must ascend, got {wavelength.tolist()}")
        if not (wavelength > 0).all():
            raise BadInput(f"wavelengths must be positive, got {wavelength.tolist()}")
        object.__setattr__(self, "wavelength_nm", read_only(wavelength))
        object.__setattr__(self, "radiance", read_only(radiance))

    def sum_bands(self, weight: Array) -> Array32:
        """Return the sum over bands with weights (band,), shape (row, col)."""
        return np.tensordot(
            weight.astype(np.float32), self.radiance.astype(np.float32, copy=False), axes=1
        )


def band_widths(wavelength_nm: Array) -> Array:
    """Return the trapezoidal width of each band, shape (band,), nm: an integral is the sum of value
    times width.
    """
    steps = np.diff(np.asarray(wavelength_nm, float))
    return 0.5 * (np.append(steps, 0.0) + np.insert(steps, 0, 0.0))
