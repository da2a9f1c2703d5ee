"""The moonless sky: airglow, zodiacal light, stars, each of its own spectrum and its own law over the sky."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulate.radiance.photometry import planck
from simulate.radiance.sky.sun import PACKAGE, sun_spectrum
from simulate.radiance.spectrum import SourceSpectrum, sum_spectra
from simulate.radiance.tables import table

BAND_NM = 50.0
# Airglow's lines that stand out of a 50 nm band, W m-2 sr-1: oxygen at 558 and 630 nm (160 and 115 rayleigh), sodium.
LINES_NM = (557.7, 589.3, 630.0)
LINES_W_M2_SR = (4.5e-8, 1.3e-8, 2.9e-8)
# Shares of the zenith's luminance, after Leinert et al., Astron. Astrophys. Suppl. 127, 1 (1998).
ZODIACAL_SHARE, STARLIGHT_SHARE = 0.30, 0.20
# Colour of the stars' integrated light: redder than the sun.
STARS_K = 4700.0
EARTH_RADIUS_KM, LAYER_HEIGHT_KM = 6370.0, 90.0
FIRST_NM, LAST_NM = 350.0, 1150.0


def van_rhijn(elevation_deg: ArrayLike) -> NDArray[np.float64]:
    """Return how much longer a slanting ray runs in a thin layer 90 km up, dimensionless: 1 at the zenith, 6 at 0.

    Notes
    -----
    (1 - (R cos h/(R + H))^2)^-1/2 (van Rhijn 1921).
    """
    grazing = np.cos(np.deg2rad(np.maximum(np.asarray(elevation_deg, float), 0.0)))
    return 1.0 / np.sqrt(1.0 - np.square(grazing * EARTH_RADIUS_KM / (EARTH_RADIUS_KM + LAYER_HEIGHT_KM)))


@dataclass(frozen=True, eq=False)
class DarkSky:
    """Zenith radiance of the moonless sky in three parts, W m-2 sr-1, as it arrives at the ground in clear air.

    Parameters
    ----------
    airglow, zodiacal, starlight
        Their spectra.
    """

    airglow: SourceSpectrum
    zodiacal: SourceSpectrum
    starlight: SourceSpectrum

    @property
    def total(self) -> SourceSpectrum:
        """Their sum."""
        return sum_spectra([self.airglow, self.zodiacal, self.starlight])


@cache
def dark_sky() -> DarkSky:
    """Return the three parts of a dark site's sky.

    Notes
    -----
    The sum is a measured spectrum; zodiacal light has the sun's spectrum and 30 % of the luminance, stars that of a
    black body of 4700 K and 20 %; airglow is the rest, so nearly all of the near infrared. The airglow varies twofold
    over the solar cycle; where on the sky the ecliptic and the Milky Way lie is left out.
    """
    smooth = _continuum()
    lines = SourceSpectrum(wavelength_nm=smooth.wavelength_nm, density=0.0 * smooth.density,
                     line_nm=LINES_NM, line_power=LINES_W_M2_SR)  # fmt: skip
    whole = sum_spectra([smooth, lines])
    sunlight = np.interp(smooth.wavelength_nm, sun_spectrum().wavelength_nm, sun_spectrum().density)
    zodiacal = _share(whole, sunlight, ZODIACAL_SHARE)
    starlight = _share(whole, planck(smooth.wavelength_nm, STARS_K), STARLIGHT_SHARE)
    rest = whole.density - zodiacal.density - starlight.density
    airglow = SourceSpectrum(
        wavelength_nm=whole.wavelength_nm, density=rest, line_nm=whole.line_nm, line_power=whole.line_power
    )
    return DarkSky(airglow, zodiacal, starlight)


def _share(whole: SourceSpectrum, shape: NDArray[np.floating], luminance_share: float) -> SourceSpectrum:
    one = SourceSpectrum(wavelength_nm=whole.wavelength_nm, density=shape)
    return one.scaled(luminance_share * whole.lumens / one.lumens)


def _continuum() -> SourceSpectrum:
    """Return what the table's bands hold besides the lines: the smoothest broken line with the bands' means."""
    bands = table(PACKAGE, "dark_sky")
    start, mean = bands["wavelength_nm"], 1e-9 * bands["radiance_1e-6_w_m2_sr_um"]
    for nm, power in zip(LINES_NM, LINES_W_M2_SR, strict=True):
        mean = mean - np.where((start <= nm) & (nm < start + BAND_NM), power / BAND_NM, 0.0)
    knots = np.arange(FIRST_NM, LAST_NM + 1.0, 10.0)
    rows = np.stack([_band_mean(knots, low) for low in start])
    # Least sum of squared second differences under the bands' means, which Lagrange's multipliers keep exactly.
    bend = np.diff(np.eye(knots.size), 2, axis=0)
    flat = np.zeros((2, knots.size))
    flat[0, :2], flat[1, -2:] = (1.0, -1.0), (1.0, -1.0)
    system = np.block([[bend.T @ bend + 10.0 * flat.T @ flat, rows.T], [rows, np.zeros((len(rows), len(rows)))]])
    solved = np.linalg.solve(system, np.concatenate([np.zeros(knots.size), mean]))
    return SourceSpectrum(wavelength_nm=knots, density=solved[: knots.size])


def _band_mean(knots: NDArray[np.floating], low_nm: float) -> NDArray[np.float64]:
    """Return the weights that average a broken line over a band; its ends are knots."""
    inside = (knots >= low_nm) & (knots <= low_nm + BAND_NM)
    weight = np.where(inside, 1.0, 0.0)
    weight[np.flatnonzero(inside)[[0, -1]]] = 0.5
    return weight / weight.sum()
