"""Matt and clear materials: what share of the light they reflect and let through, by wavelength."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata.errors import BadInput


@dataclass(frozen=True, kw_only=True)
class Material:
    """A surface that reflects diffusely and transmits straight through.

    Parameters
    ----------
    wavelength_nm
        Wavelengths of the two tables, ascending, nm; one wavelength makes a grey material.
    reflectance, transmittance
        Shares of the light, dimensionless, together at most 1; linear between wavelengths, constant outside.
    """

    wavelength_nm: tuple[float, ...] = (550.0,)
    reflectance: tuple[float, ...] = (0.0,)
    transmittance: tuple[float, ...] = (0.0,)

    def __post_init__(self) -> None:
        count = len(self.wavelength_nm)
        if count == 0 or len(self.reflectance) != count or len(self.transmittance) != count:
            raise BadInput(
                f"a material must have one reflectance and one transmittance per wavelength, got {count} wavelengths, "
                f"{len(self.reflectance)} and {len(self.transmittance)}"
            )
        if any(b <= a for a, b in zip(self.wavelength_nm, self.wavelength_nm[1:], strict=False)):
            raise BadInput(f"a material's wavelengths must ascend, got {list(self.wavelength_nm)}")
        for given, passed in zip(self.reflectance, self.transmittance, strict=True):
            if given < 0.0 or passed < 0.0 or given + passed > 1.0:
                raise BadInput(
                    f"reflectance and transmittance must not be negative nor exceed 1 together, got {given:g} "
                    f"and {passed:g}"
                )

    def reflected(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Reflectance at wavelengths, dimensionless."""
        return np.interp(np.asarray(wavelength_nm, float), self.wavelength_nm, self.reflectance)

    def transmitted(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Transmittance at wavelengths, dimensionless."""
        return np.interp(np.asarray(wavelength_nm, float), self.wavelength_nm, self.transmittance)
