"""A share of light over wavelength: reflectance, transmittance, emissivity."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata.errors import BadInput


@dataclass(frozen=True, kw_only=True)
class Reflectance:
    """Shares of light at wavelengths, linear between them and constant outside.

    Parameters
    ----------
    wavelength_nm
        Wavelengths, ascending, nm; one makes a grey.
    share
        Share at each, 0 to 1, dimensionless.
    """

    wavelength_nm: tuple[float, ...] = (550.0,)
    share: tuple[float, ...] = (0.0,)

    def __post_init__(self) -> None:
        if not self.wavelength_nm or len(self.wavelength_nm) != len(self.share):
            raise BadInput(
                f"a reflectance must have one share per wavelength, got {len(self.wavelength_nm)} wavelengths "
                f"and {len(self.share)} shares"
            )
        if any(b <= a for a, b in zip(self.wavelength_nm, self.wavelength_nm[1:], strict=False)):
            raise BadInput(f"a material's wavelengths must ascend, got {list(self.wavelength_nm)}")
        for share in self.share:
            if not 0.0 <= share <= 1.0:
                raise BadInput(f"a share of light must lie in [0, 1], got {share:g}")

    def at(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Return the share at wavelengths, dimensionless, shape (band,)."""
        return np.interp(np.atleast_1d(np.asarray(wavelength_nm, float)), self.wavelength_nm, self.share)


def grey(share: float) -> Reflectance:
    """Return the same share at all wavelengths."""
    return Reflectance(share=(share,))
