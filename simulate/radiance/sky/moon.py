"""Spectra of sun and moon, the latter by the ROLO model, and their discs as light sources."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulate.radiance.atmosphere import Atmosphere
from simulate.radiance.sky.ephemeris import AU_KM, Ephemeris
from simulate.radiance.spectrum import SourceSpectrum, require_grid, table


def sun_spectrum(distance_au: float = 1.0) -> SourceSpectrum:
    """Return the sun's irradiance normal to the beam, W m-2, at a distance in astronomical units.

    Notes
    -----
    ASTM G173-03's extraterrestrial spectrum in steps of 5 nm: Fraunhofer lines are averaged, 133,100 lux are kept.
    """
    sun = table("sun")
    return SourceSpectrum(
        wavelength_nm=sun["wavelength_nm"], density=sun["irradiance_w_m2_nm"] / np.square(distance_au)
    )


SOLID_ANGLE_SR = 6.4177e-5
STANDARD_KM = 384_400.0
# Terms common to all bands: libration (per degree), and the widths of the opposition surge, degrees.
LIBRATION = (0.00034115, -0.0013425, 0.00095906, 0.00066229)
SURGE_DEG = (4.06054, 12.8802, -30.5858, 16.7498)
# ln A is smoothed over wavelength by a polynomial: the bands' own calibration scatters by a few percent.
SMOOTHING_DEGREE = 3


def band_reflectance(
    phase_deg: float,
    sun_longitude_deg: float | None = None,
    observer_latitude_deg: float = 0.0,
    observer_longitude_deg: float = 0.0,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the disc-equivalent reflectance of the moon at the model's bands.

    Parameters
    ----------
    phase_deg
        Angle at the moon between sun and observer, degrees.
    sun_longitude_deg
        Selenographic longitude of the sun, degrees, positive before full moon; by default the phase.
    observer_latitude_deg, observer_longitude_deg
        Selenographic, degrees.

    Returns
    -------
    wavelength_nm, reflectance
        Both of shape (band,).

    Notes
    -----
    ln A = sum a_i g^i + sum b_j P^(2j-1) + c1 th + c2 ph + c3 P th + c4 P ph + d1 exp(-g/p1) + d2 exp(-g/p2)
    + d3 cos((g - p3)/p4) (Kieffer and Stone, Astron. J. 129, 2887, 2005, eq. 10, model 311g). Fitted for phases from
    1.55 to 97 degrees; it is used beyond, where it stays within 0.35 mag of Allen's phase curve up to 150 degrees.
    """
    rolo = table("rolo")
    phase = np.deg2rad(phase_deg)
    sun = np.deg2rad(phase_deg if sun_longitude_deg is None else sun_longitude_deg)
    logarithm = sum(rolo[f"a{i}"] * phase**i for i in range(4))
    logarithm = logarithm + sum(rolo[f"b{j}"] * sun ** (2 * j - 1) for j in (1, 2, 3))
    c1, c2, c3, c4 = LIBRATION
    logarithm = logarithm + (c1 + c3 * sun) * observer_latitude_deg + (c2 + c4 * sun) * observer_longitude_deg
    p1, p2, p3, p4 = SURGE_DEG
    surge = rolo["d1"] * np.exp(-phase_deg / p1) + rolo["d2"] * np.exp(-phase_deg / p2)
    ripple = rolo["d3"] * np.cos((phase_deg - p3) / p4)
    return rolo["wavelength_nm"], np.exp(logarithm + surge + ripple)


@cache
def _smoother() -> NDArray[np.float64]:
    """Return the matrix that takes values at the bands to polynomial coefficients, by least squares."""
    powers = np.vander(_scale_wavelength(table("rolo")["wavelength_nm"]), SMOOTHING_DEGREE + 1)
    return np.asarray(np.linalg.pinv(powers), float)


def _scale_wavelength(wavelength_nm: NDArray[np.floating]) -> NDArray[np.float64]:
    return (np.asarray(wavelength_nm, float) - 700.0) / 350.0


def moon_reflectance(wavelength_nm: ArrayLike, *geometry: float) -> NDArray[np.float64]:
    """Return the reflectance at any wavelengths, smoothed over the bands; geometry as for `band_reflectance`.

    Outside 405 to 1059.5 nm it is that of the nearer end.
    """
    bands, reflectance = band_reflectance(*geometry)
    inside = np.clip(np.asarray(wavelength_nm, float), bands[0], bands[-1])
    return np.exp(np.polyval(_smoother() @ np.log(reflectance), _scale_wavelength(inside)))


def moon_spectrum(
    *geometry: float, moon_distance_km: float = STANDARD_KM, sun_distance_au: float = 1.0
) -> SourceSpectrum:
    """Return the moon's irradiance before the atmosphere, W m-2.

    Parameters
    ----------
    geometry
        Phase and libration, as for `band_reflectance`.
    moon_distance_km
        From the observer, km.
    sun_distance_au
        From moon to sun, astronomical units.

    Notes
    -----
    E = A Omega / pi E_sun / (d_sun/AU)^2 (384,400 km / d_moon)^2, Omega 6.4177e-5 sr.
    """
    share = SOLID_ANGLE_SR / np.pi * (STANDARD_KM / moon_distance_km) ** 2
    return sun_spectrum(sun_distance_au).multiply(lambda nm: share * moon_reflectance(nm, *geometry))


def moonlight(at: Ephemeris) -> SourceSpectrum:
    """Return the moon's irradiance before the atmosphere, W m-2, at a place and time; dark in an eclipse's umbra."""
    from_sun = at.sun.position_km - at.moon.position_km
    light = moon_spectrum(
        at.phase_deg,
        at.sun_selenographic_longitude_deg,
        at.observer_selenographic_latitude_deg,
        at.observer_selenographic_longitude_deg,
        moon_distance_km=at.moon.distance_km,
        sun_distance_au=float(np.linalg.norm(from_sun)) / AU_KM,
    )
    return light.scale(at.sunlit_share)


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
        """Fraction of the disc above a level horizon, dimensionless."""
        height = np.clip(np.deg2rad(self.elevation_deg) / self.angular_radius_rad, -1.0, 1.0)
        return float(0.5 + (np.arcsin(height) + height * np.sqrt(1.0 - height**2)) / np.pi)

    def irradiance(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Return the irradiance at the ground, normal to the beam, W m-2 nm-1, shape (band,); zero when set.

        Parameters
        ----------
        wavelength_nm
            The complete spectral grid, shape (band,), nm.
        """
        grid = require_grid(wavelength_nm)
        # Absorption bands of gases are narrower than spectral bands: transmittance is applied before averaging.
        air, height = self.atmosphere, self.elevation_deg
        left = self.extraterrestrial.multiply(lambda nm: air.slant_transmittance(height, nm)[:, 0])
        return self.visible_share * left.on(grid)
