"""Sun or moon as a scene sees it: a small bright disc."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulate.radiance.atmosphere.air import Atmosphere
from simulate.radiance.spectrum import SourceSpectrum, require_grid


@dataclass(frozen=True, kw_only=True, eq=False)
class Disc:
    """Sun or moon.

    Parameters
    ----------
    name
        "sun" or "moon".
    direction
        Unit vector (x east, y north, z up) to its centre.
    angular_radius_rad
        Radius, rad.
    extraterrestrial
        Irradiance before the atmosphere, normal to the beam, W m-2.
    atmosphere
        Air that its light crosses.
    """

    name: str
    direction: tuple[float, float, float]
    angular_radius_rad: float
    extraterrestrial: SourceSpectrum
    atmosphere: Atmosphere

    @property
    def elevation_deg(self) -> float:
        """Height of the centre over the horizon, degrees."""
        return float(np.rad2deg(np.arcsin(np.clip(self.direction[2], -1.0, 1.0))))

    @property
    def visible_share(self) -> float:
        """Share of the disc over a level horizon, dimensionless: a disc half set gives half its light."""
        height = np.clip(np.deg2rad(self.elevation_deg) / self.angular_radius_rad, -1.0, 1.0)
        return float(0.5 + (np.arcsin(height) + height * np.sqrt(1.0 - height**2)) / np.pi)

    def irradiance(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Return the irradiance at the ground, normal to the beam, W m-2 nm-1, shape (band,); zero when set.

        Parameters
        ----------
        wavelength_nm
            The whole spectral grid, shape (band,), nm.
        """
        grid = require_grid(wavelength_nm)
        # Bands of gases are narrower than those of pictures may be: they are followed before bands are made.
        air, height = self.atmosphere, self.elevation_deg
        left = self.extraterrestrial.filtered(lambda nm: air.slant_transmittance(height, nm)[:, 0])
        return self.visible_share * left.on(grid)
