"""Scattering of sunlight and moonlight by the atmosphere: diffuse irradiance and angular
distribution.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from simulate.arrays import Array
from simulate.radiance.atmosphere import Atmosphere, airmass, scattering_albedo

# Haze scatters forward: its mean cosine, and the angle within which the aureole is taken as flat.
ASYMMETRY = 0.65
AUREOLE_DEG = 1.0
# Rings and steps of the quadrature over the sky.
RINGS, TURNS = 48, 48


def krisciunas_schaefer_rayleigh(separation_deg: ArrayLike) -> Array:
    """Return f_R, nL per foot-candle: 10^5.36 (1.06 + cos^2) of the angle from the moon,
    degrees.
    """
    return 10.0**5.36 * (1.06 + np.square(np.cos(np.deg2rad(separation_deg))))


def krisciunas_schaefer_mie(separation_deg: ArrayLike) -> Array:
    """Return f_M, nL per foot-candle: 10^(6.15 - angle/40), inside 10 degrees 6.2e7/angle^2, flat
    inside 1 degree.
    """
    angle = np.maximum(np.asarray(separation_deg, float), AUREOLE_DEG)
    return np.where(angle < 10.0, 6.2e7 / np.square(angle), 10.0 ** (6.15 - angle / 40.0))


def diffuse_share(
    atmosphere: Atmosphere, elevation_deg: float, wavelength_nm: Array, ground_albedo: float
) -> Array:
    """Return the diffuse irradiance of level ground over the extraterrestrial one normal to the
    beam, shape (band,).

    The elevation is that of sun or moon; at and below 0 there is none (see `twilight_spectrum`).

    Notes
    -----
    Bird and Riordan 1984 (SERI/TR-215-2436), eq. 3-1 to 3-17: molecules send half of their light
    down, haze by its asymmetry 0.65, ground and sky reflect to each other.
    """
    if elevation_deg <= 0.0:
        return np.zeros(len(wavelength_nm))
    sine = np.sin(np.deg2rad(elevation_deg))
    mass = float(airmass(elevation_deg))
    molecules, scattered, transmitted = _layers(atmosphere, wavelength_nm, mass)
    gas = atmosphere.gas_slant_transmittance(elevation_deg, wavelength_nm)[:, 0]
    ozone_free = np.where(wavelength_nm <= 450.0, ((wavelength_nm + 550.0) / 1000.0) ** 1.8, 1.0)
    by_molecules = 0.5 * (1.0 - molecules**0.95)
    by_haze = molecules**1.5 * (1.0 - scattered) * _forward_share(sine)
    diffuse = sine * gas * transmitted * (by_molecules + by_haze) * ozone_free
    direct = sine * gas * molecules * scattered * transmitted
    sky = _sky_albedo(atmosphere, wavelength_nm)
    return diffuse + (diffuse + direct) * sky * ground_albedo / (1.0 - sky * ground_albedo)


def _layers(
    atmosphere: Atmosphere, wavelength_nm: Array, mass: float
) -> tuple[Array, Array, Array]:
    """Return what is left after scattering by molecules, by haze, and after absorption by haze."""
    albedo = scattering_albedo(wavelength_nm)
    haze = atmosphere.haze_depth(wavelength_nm) * mass
    return (
        np.exp(-atmosphere.molecules_depth(wavelength_nm) * mass),
        np.exp(-albedo * haze),
        np.exp(-(1.0 - albedo) * haze),
    )


def _forward_share(sine: float) -> float:
    """Return the downward fraction of light scattered by haze, for light from an elevation of this
    sine.
    """
    log = np.log(1.0 - ASYMMETRY)
    polynomial = log * (1.459 + log * (0.1595 + log * 0.4129))
    second = log * (0.0783 + log * (-0.3824 - log * 0.5874))
    return float(1.0 - 0.5 * np.exp((polynomial + second * sine) * sine))


def _sky_albedo(atmosphere: Atmosphere, wavelength_nm: Array) -> Array:
    """Return the reflectance of the sky for light from the ground, at an air mass of 1.8."""
    molecules, scattered, transmitted = _layers(atmosphere, wavelength_nm, 1.8)
    elevation = np.rad2deg(np.arcsin(1.0 / 1.8))
    gas = atmosphere.gas_slant_transmittance(elevation, wavelength_nm)[:, 0]
    by_haze = (1.0 - _forward_share(1.0 / 1.8)) * molecules * (1.0 - scattered)
    return gas * transmitted * (0.5 * (1.0 - molecules) + by_haze)


def endless_path(
    direction: Array, sun_direction: tuple[float, float, float], molecules_share: Array
) -> Array:
    """Return the relative radiance of an endless path of air in directions (path, 3), sr-1, shape
    (band, path).

    It is lit from one direction, and molecules contribute a fraction (band,) of the scattering.

    Notes
    -----
    Krisciunas and Schaefer's f_R and f_M, each scaled to an integral of 1 over all directions.
    """
    separation = np.rad2deg(np.arccos(np.clip(direction @ np.asarray(sun_direction), -1.0, 1.0)))
    molecules = krisciunas_schaefer_rayleigh(separation) / RAYLEIGH_INTEGRAL
    haze = krisciunas_schaefer_mie(separation) / MIE_INTEGRAL
    return haze + molecules_share[:, None] * (molecules - haze)


def _integral_over_directions(spread: Array, separation: Array) -> float:
    return float(
        2.0 * np.pi * np.trapezoid(spread * np.sin(np.deg2rad(separation)), np.deg2rad(separation))
    )


_FINE = np.linspace(0.0, 180.0, 18001)
RAYLEIGH_INTEGRAL = _integral_over_directions(krisciunas_schaefer_rayleigh(_FINE), _FINE)
MIE_INTEGRAL = _integral_over_directions(krisciunas_schaefer_mie(_FINE), _FINE)


def scattering_parts(atmosphere: Atmosphere, wavelength_nm: Array) -> tuple[Array, Array]:
    """Return the vertical scattering depth and the molecules' fraction of it, both of shape
    (band,).
    """
    molecules, haze = (
        atmosphere.molecules_depth(wavelength_nm),
        atmosphere.haze_depth(wavelength_nm),
    )
    return molecules + haze, molecules / (molecules + haze)


def sky_depth(depth: Array, direction: Array) -> Array:
    """Return 1 - exp(-depth times air mass): the sky's fraction of an endless path, shape (band,
    path).
    """
    elevation = np.rad2deg(np.arcsin(np.clip(direction[:, 2], -1.0, 1.0)))
    return -np.expm1(-depth[:, None] * airmass(elevation))


def level_irradiance(
    sun_direction: tuple[float, float, float], depth: Array, molecules_share: Array
) -> Array:
    """Return the irradiance of level ground under the sky of relative radiance `endless_path` x
    `sky_depth`.
    """
    return _level_irradiance(
        sun_direction[2], tuple(depth.tolist()), tuple(molecules_share.tolist())
    )


@lru_cache(maxsize=64)
def _level_irradiance(
    sine: float, depth: tuple[float, ...], molecules_share: tuple[float, ...]
) -> Array:
    directions, weight = sky_quadrature()
    level = float(np.sqrt(max(1.0 - sine**2, 0.0)))
    shape = endless_path(directions, (level, 0.0, sine), np.array(molecules_share))
    return (shape * sky_depth(np.array(depth), directions)) @ (weight * directions[:, 2])


@lru_cache(maxsize=1)
def sky_quadrature() -> tuple[Array, Array]:
    """Return directions over the sky, shape (node, 3), and their solid angles, sr, shape (node,).

    Gauss-Legendre in the sine of elevation, even in azimuth.
    """
    node, width = np.polynomial.legendre.leggauss(RINGS)
    height, azimuth = 0.5 * (node + 1.0), 2.0 * np.pi * (np.arange(TURNS) + 0.5) / TURNS
    sine, azimuths = np.meshgrid(height, azimuth, indexing="ij")
    level = np.sqrt(1.0 - sine**2)
    directions = np.stack(
        [level * np.sin(azimuths), level * np.cos(azimuths), sine], axis=-1
    ).reshape(-1, 3)
    return directions, np.repeat(0.5 * width * 2.0 * np.pi / TURNS, TURNS)
