"""The glow of a distant town over the horizon."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.radiance.lamps.spectra import spectrum
from simulate.radiance.spectrum import SourceSpectrum


@dataclass(frozen=True, kw_only=True)
class TownGlow:
    """Lamp light that the air over a town sends back.

    Parameters
    ----------
    azimuth_deg
        Where the town lies, from north by east, degrees.
    luminance_cd_m2
        At the horizon above it, cd m-2; a dark zenith has 2.4e-4.
    height_deg, half_width_deg
        Where it has fallen to 1/e: upwards and sideways, degrees.
    lamp
        Kind of its lamps, one of `lamps.KINDS`.

    Notes
    -----
    exp(-h/height) exp(-(azimuth difference/half width)^2): a likeness, not a computation of the light.
    """

    azimuth_deg: float
    luminance_cd_m2: float
    height_deg: float = 10.0
    half_width_deg: float = 35.0
    lamp: str = "high-pressure-sodium"

    def __post_init__(self) -> None:
        if not self.luminance_cd_m2 >= 0.0:
            raise BadInput(f"luminance_cd_m2 must not be negative, got {self.luminance_cd_m2:g}")
        for name in ("height_deg", "half_width_deg"):
            if not getattr(self, name) > 0.0:
                raise BadInput(f"{name} must be positive, got {getattr(self, name):g}")
        _ = self.spectrum

    @property
    def spectrum(self) -> SourceSpectrum:
        """Radiance at the horizon above the town, W m-2 sr-1."""
        return spectrum(self.lamp, lumens=self.luminance_cd_m2)

    def shape(self, direction: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return radiance relative to the brightest place for directions (path, 3), shape (path,)."""
        elevation = np.rad2deg(np.arcsin(np.clip(direction[:, 2], 0.0, 1.0)))
        azimuth = np.rad2deg(np.arctan2(direction[:, 0], direction[:, 1])) - self.azimuth_deg
        aside = (azimuth + 180.0) % 360.0 - 180.0
        return np.exp(-elevation / self.height_deg - np.square(aside / self.half_width_deg))
