"""Scattering of sunlight and moonlight by the atmosphere: diffuse irradiance and angular distribution."""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulate.radiance.atmosphere import Atmosphere, airmass, scattering_albedo

# nL per foot-candle to sr-1: 1 nL is 1e-5/pi cd m-2, 1 foot-candle 10.764 lux.
NANOLAMBERT_CD_M2 = 1e-5 / np.pi
FOOT_CANDLE_LUX = 10.764
# Haze scatters forward: its mean cosine, and the angle within which the aureole is taken as flat.
ASYMMETRY = 0.65
AUREOLE_DEG = 1.0
# Rings and steps of the quadrature over the sky.
RINGS, TURNS = 48, 48


def krisciunas_schaefer_rayleigh(separation_deg: ArrayLike) -> NDArray[np.float64]:
    """Return f_R, nL per foot-candle: 10^5.36 (1.06 + cos^2) of the angle from the moon, degrees."""
    return 10.0**5.36 * (1.06 + np.square(np.cos(np.deg2rad(separation_deg))))


def krisciunas_schaefer_mie(separation_deg: ArrayLike) -> NDArray[np.float64]:
    """Return f_M, nL per foot-candle: 10^(6.15 - angle/40), inside 10 degrees 6.2e7/angle^2, flat inside 1 degree."""
    angle = np.maximum(np.asarray(separation_deg, float), AUREOLE_DEG)
    return np.where(angle < 10.0, 6.2e7 / np.square(angle), 10.0 ** (6.15 - angle / 40.0))


def krisciunas_schaefer_nl(
    phase_deg: float, separation_deg: float, moon_zenith_deg: float, view_zenith_deg: float, extinction_mag: float
) -> float:
    """Return the visual brightness of the moonlit sky, nL.

    Parameters
    ----------
    phase_deg
        Angle at the moon between sun and observer, degrees.
    separation_deg
        Angle between moon and view, degrees.
    moon_zenith_deg, view_zenith_deg
        Zenith angles, degrees.
    extinction_mag
        Extinction straight up, magnitudes.

    Notes
    -----
    f I 10^(-0.4 k X(moon)) (1 - 10^(-0.4 k X(view))), X = (1 - 0.96 sin^2 z)^-1/2, I = 10^(-0.4 (3.84 + 0.026 a
    + 4e-9 a^4)) (Krisciunas and Schaefer, Publ. Astron. Soc. Pac. 103, 1033, 1991; 8 to 23 %). `NightSky` takes from it
    how light is spread over angles; the amount comes from `diffuse_share`, and this formula is a check on both.
    """
    moon = 10.0 ** (-0.4 * (3.84 + 0.026 * abs(phase_deg) + 4e-9 * phase_deg**4))
    to_moon, to_view = (
        1.0 / np.sqrt(1.0 - 0.96 * np.sin(np.deg2rad(z)) ** 2) for z in (moon_zenith_deg, view_zenith_deg)
    )
    spread = krisciunas_schaefer_rayleigh(separation_deg) + krisciunas_schaefer_mie(separation_deg)
    lost = 10.0 ** (-0.4 * extinction_mag * to_moon)
    return float(spread * moon * lost * (1.0 - 10.0 ** (-0.4 * extinction_mag * to_view)))


def diffuse_share(
    atmosphere: Atmosphere, elevation_deg: float, wavelength_nm: NDArray[np.floating], ground_albedo: float
) -> NDArray[np.float64]:
    """Return the diffuse irradiance of level ground over the extraterrestrial one normal to the beam, shape (band,).

    Parameters
    ----------
    atmosphere
        The air.
    elevation_deg
        Of sun or moon, degrees; at and below 0 nothing comes (see `twilight`).
    wavelength_nm
        Wavelengths, shape (band,), nm.
    ground_albedo
        Reflectance of the land around, dimensionless.

    Notes
    -----
    Bird and Riordan 1984 (SERI/TR-215-2436), eq. 3-1 to 3-17: molecules send half of their light down, haze by its
    asymmetry 0.65, ground and sky reflect to each other.
    """
    if elevation_deg <= 0.0:
        return np.zeros(len(wavelength_nm))
    sine = np.sin(np.deg2rad(elevation_deg))
    mass = float(airmass(elevation_deg))
    molecules, scattered, absorbed = _layers(atmosphere, wavelength_nm, mass)
    gas = atmosphere.gas_slant_transmittance(elevation_deg, wavelength_nm)[:, 0]
    ozone_free = np.where(wavelength_nm <= 450.0, ((wavelength_nm + 550.0) / 1000.0) ** 1.8, 1.0)
    by_molecules = 0.5 * (1.0 - molecules**0.95)
    by_haze = molecules**1.5 * (1.0 - scattered) * _forward_share(sine)
    down = sine * gas * absorbed * (by_molecules + by_haze) * ozone_free
    direct = sine * gas * molecules * scattered * absorbed
    sky = _sky_albedo(atmosphere, wavelength_nm)
    return down + (down + direct) * sky * ground_albedo / (1.0 - sky * ground_albedo)


def _layers(
    atmosphere: Atmosphere, wavelength_nm: NDArray[np.floating], mass: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return what is left after scattering by molecules, by haze, and after absorption by haze."""
    share = scattering_albedo(wavelength_nm)
    haze = atmosphere.haze_depth(wavelength_nm) * mass
    return (
        np.exp(-atmosphere.molecules_depth(wavelength_nm) * mass),
        np.exp(-share * haze),
        np.exp(-(1.0 - share) * haze),
    )


def _forward_share(sine: float) -> float:
    """Return the downward fraction of light scattered by haze, for light from an elevation of this sine."""
    log = np.log(1.0 - ASYMMETRY)
    first = log * (1.459 + log * (0.1595 + log * 0.4129))
    second = log * (0.0783 + log * (-0.3824 - log * 0.5874))
    return float(1.0 - 0.5 * np.exp((first + second * sine) * sine))


def _sky_albedo(atmosphere: Atmosphere, wavelength_nm: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the reflectance of the sky for light from the ground, at an air mass of 1.8."""
    molecules, scattered, absorbed = _layers(atmosphere, wavelength_nm, 1.8)
    elevation = np.rad2deg(np.arcsin(1.0 / 1.8))
    gas = atmosphere.gas_slant_transmittance(elevation, wavelength_nm)[:, 0]
    by_haze = (1.0 - _forward_share(1.0 / 1.8)) * molecules * (1.0 - scattered)
    return gas * absorbed * (0.5 * (1.0 - molecules) + by_haze)


def endless_path(
    direction: NDArray[np.floating], towards: tuple[float, float, float], molecules_share: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Return the relative radiance of an endless path of air, sr-1, shape (band, path).

    Parameters
    ----------
    direction
        Directions that one looks in, shape (path, 3).
    towards
        Direction to sun or moon.
    molecules_share
        Share of scattering that molecules do, shape (band,).

    Notes
    -----
    Krisciunas and Schaefer's f_R and f_M, each scaled to an integral of 1 over all directions.
    """
    separation = np.rad2deg(np.arccos(np.clip(direction @ np.asarray(towards), -1.0, 1.0)))
    molecules = krisciunas_schaefer_rayleigh(separation) / RAYLEIGH_INTEGRAL
    haze = krisciunas_schaefer_mie(separation) / MIE_INTEGRAL
    return haze + molecules_share[:, None] * (molecules - haze)


def _integral_over_directions(spread: NDArray[np.floating], separation: NDArray[np.floating]) -> float:
    return float(2.0 * np.pi * np.trapezoid(spread * np.sin(np.deg2rad(separation)), np.deg2rad(separation)))


_FINE = np.linspace(0.0, 180.0, 18001)
RAYLEIGH_INTEGRAL = _integral_over_directions(krisciunas_schaefer_rayleigh(_FINE), _FINE)
MIE_INTEGRAL = _integral_over_directions(krisciunas_schaefer_mie(_FINE), _FINE)


def scattering_parts(
    atmosphere: Atmosphere, wavelength_nm: NDArray[np.floating]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the vertical scattering depth and the molecules' fraction of it, both of shape (band,)."""
    molecules, haze = atmosphere.molecules_depth(wavelength_nm), atmosphere.haze_depth(wavelength_nm)
    return molecules + haze, molecules / (molecules + haze)


def sky_depth(depth: NDArray[np.floating], direction: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return 1 - exp(-depth times air mass): how much of an endless path the sky holds, shape (band, path)."""
    elevation = np.rad2deg(np.arcsin(np.clip(direction[:, 2], -1.0, 1.0)))
    return -np.expm1(-depth[:, None] * airmass(elevation))


def level_irradiance(
    towards: tuple[float, float, float], depth: NDArray[np.floating], molecules_share: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Return the irradiance of level ground under the sky of relative radiance `endless_path` x `sky_depth`."""
    return _level_irradiance(towards[2], tuple(depth.tolist()), tuple(molecules_share.tolist()))


@lru_cache(maxsize=64)
def _level_irradiance(sine: float, depth: tuple[float, ...], molecules_share: tuple[float, ...]) -> NDArray[np.float64]:
    directions, weight = sky_quadrature()
    level = float(np.sqrt(max(1.0 - sine**2, 0.0)))
    shape = endless_path(directions, (level, 0.0, sine), np.array(molecules_share))
    return (shape * sky_depth(np.array(depth), directions)) @ (weight * directions[:, 2])


@lru_cache(maxsize=1)
def sky_quadrature() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return directions over the sky, shape (node, 3), and their solid angles, sr, shape (node,).

    Gauss-Legendre in the sine of elevation, even in azimuth.
    """
    node, width = np.polynomial.legendre.leggauss(RINGS)
    height, turn = 0.5 * (node + 1.0), 2.0 * np.pi * (np.arange(TURNS) + 0.5) / TURNS
    up, around = np.meshgrid(height, turn, indexing="ij")
    level = np.sqrt(1.0 - up**2)
    directions = np.stack([level * np.sin(around), level * np.cos(around), up], axis=-1).reshape(-1, 3)
    return directions, np.repeat(0.5 * width * 2.0 * np.pi / TURNS, TURNS)
