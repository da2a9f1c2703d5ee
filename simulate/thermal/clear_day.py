"""Model of a clear day: sunlight, air temperature, wind and sky emissivity by hour."""

from datetime import datetime

import numpy as np
from numpy.typing import ArrayLike

from simulate.arrays import Array, Mask
from simulate.radiance.sky.moon import AU_KM, ObserverLocation, ephemeris
from simulate.radiance.spectrum import STEFAN_BOLTZMANN
from simulate.thermal.slab import ZERO_C, vapour_pressure_pa
from simulate.thermal.thresholds import LIMITS

# That of the model's authors: with 1361 W/m2 all of it would be 0.4 % lower.
SOLAR_CONSTANT_W_M2 = 1366.1
# Solar hours of the highest air temperature and of the strongest wind; decay of the air's
# temperature over a night.
WARMEST_H, WINDIEST_H, NIGHT_DECAY = 15.0, 14.0, 2.2
# Wind over its daily maximum: at night, and where the day's part starts.
NIGHT_WIND, DAY_WIND = 0.3, 0.4
# Emissivity that opaque low cloud adds, as a fraction of what the clear sky lacks.
CLOUD_EMISSIVITY = 0.9


def sun_directions(location: ObserverLocation, times: list[datetime]) -> tuple[Array, Array]:
    """Return the sun's direction (time, 3), x east, y north, z up, and its distance (time,), au."""
    bodies = [ephemeris(location, time).sun for time in times]
    return np.array([body.direction for body in bodies]), np.array(
        [body.distance_km / AU_KM for body in bodies]
    )


def solar_hour(location: ObserverLocation, times: list[datetime]) -> Array:
    """Return the local mean solar time, hours in [0, 24)."""
    return (
        np.array([time.timestamp() for time in times]) / 3600.0 + location.longitude_deg / 15.0
    ) % 24.0


def clear_sun(
    sine: ArrayLike, distance_au: ArrayLike, altitude_m: float, turbidity: float
) -> tuple[Array, Array]:
    """Return direct normal and diffuse horizontal irradiance of a clear sky, W m-2.

    Parameters
    ----------
    sine
        Sine of the sun's elevation.
    distance_au
        Distance of the sun, au.
    altitude_m
        Altitude, m.
    turbidity
        Linke turbidity, dimensionless.

    Notes
    -----
    Ineichen and Perez, Solar Energy 73, 151 (2002), with the air mass of Kasten and Young (1989).
    """
    sines = np.asarray(sine, float)
    is_day = sines > 0.0
    cosine = np.where(is_day, np.maximum(sines, 0.01), 1.0)
    elevation = np.rad2deg(np.arcsin(cosine))
    mass = np.exp(-altitude_m / 8434.5) / (cosine + 0.50572 * (elevation + 6.07995) ** -1.6364)
    extraterrestrial = SOLAR_CONSTANT_W_M2 / np.square(distance_au)
    low, high = np.exp(-altitude_m / 8000.0), np.exp(-altitude_m / 1250.0)
    total = (5.09e-5 * altitude_m + 0.868) * extraterrestrial * cosine
    total = total * np.exp(
        -(3.92e-5 * altitude_m + 0.0387) * mass * (low + high * (turbidity - 1.0))
    )
    direct = (0.664 + 0.163 / low) * extraterrestrial * np.exp(-0.09 * mass * (turbidity - 1.0))
    limit = 1.0 - (0.1 - 0.2 * np.exp(-turbidity)) / (0.1 + 0.882 / low)
    direct = np.minimum(direct, total * limit / cosine)
    return np.where(is_day, direct, 0.0), np.where(is_day, total - direct * cosine, 0.0)


def sun_under_cloud(
    direct: Array, diffuse: Array, sine: Array, cloud: float
) -> tuple[Array, Array]:
    """Return direct and diffuse irradiance where clouds cover a fraction of the sky (Kasten and
    Czeplak, 1980).
    """
    total = (direct * np.maximum(sine, 0.0) + diffuse) * (1.0 - 0.75 * cloud**3.4)
    direct = (1.0 - cloud) * direct
    return direct, total - direct * np.maximum(sine, 0.0)


def sky_emissivity(
    dew_point_k: Array, hour: Array, pressure_hpa: ArrayLike, cloud: ArrayLike
) -> Array:
    """Return the hemispherical emissivity of the sky for longwave, dimensionless.

    Notes
    -----
    Berdahl and Martin, Solar Energy 32, 663 (1984), with their terms of hour and pressure; low
    opaque cloud adds `CLOUD_EMISSIVITY` of what lacks. The formulas in use differ by 0.04, which is
    0.5 to 0.8 K of a surface at night.
    """
    dew = (dew_point_k - ZERO_C) / 100.0
    clear = 0.711 + 0.56 * dew + 0.73 * dew**2 + 0.013 * np.cos(2.0 * np.pi * hour / 24.0)
    clear = np.clip(clear + 1.2e-4 * (np.asarray(pressure_hpa) - 1000.0), 0.0, 1.0)
    return clear + (1.0 - clear) * CLOUD_EMISSIVITY * np.asarray(cloud)


def sky_radiance(emissivity: Array, air_k: Array, dew_point_k: Array, sine: Array) -> Array:
    """Return pi times the sky's longwave radiance at elevations of a sine, W m-2, shape (time,
    elevation).

    Notes
    -----
    1 - e(z) = exp(-t sec^n z) with n = 0.20 + 0.035 w, w the precipitable water in cm; fitted to
    LOWTRAN within 0.011 down to 5 degrees. The optical depth t is that which has the hemispherical
    emissivity as its mean: the zenith has 0.945 of it. A sky that radiates as much as a black body
    of the air's temperature is even.
    """
    emissivity, air_k, dew_point_k = (
        np.asarray(value, float)[:, None] for value in (emissivity, air_k, dew_point_k)
    )
    black = STEFAN_BOLTZMANN * air_k**4
    overcast = emissivity > 1.0 - LIMITS.even_sky
    clear = np.where(overcast, 0.5, emissivity)
    water_cm = 46.5 * vapour_pressure_pa(dew_point_k) / 100.0 / air_k
    steepness = 0.20 + 0.035 * water_cm
    path = np.sqrt((np.arange(200) + 0.5) / 200.0) ** -steepness
    depth = -np.log(1.0 - 0.945 * clear)
    for _ in range(LIMITS.newton_steps):
        transmittance = np.exp(-depth * path)
        depth += (transmittance.mean(axis=1, keepdims=True) - 1.0 + clear) / (
            path * transmittance
        ).mean(axis=1, keepdims=True)
    directional = -np.expm1(-depth * np.maximum(np.asarray(sine), 1e-3) ** -steepness)
    return np.where(overcast, emissivity, directional) * black


def course(hour: Array, is_day: Mask) -> tuple[Array, Array]:
    """Return the course of a clear day by solar hours: the air's temperature from 0 to 1, and wind
    over its maximum.

    Parameters
    ----------
    hour
        Solar hour of each time, shape (time,).
    is_day
        Whether the sun is up, shape (time,).

    Notes
    -----
    The air is coldest at sunrise, follows a sine to its maximum and on to sunset, and then decays
    (Parton and Logan, Agric. Meteorol. 23, 205, 1981), shifted so that it meets the next sunrise.
    """
    half = 12.0 * is_day.mean() if 0.02 < is_day.mean() < 0.98 else 6.0
    rise, fall = 12.0 - half, 12.0 + half
    wave = 0.5 * np.pi / (WARMEST_H - rise)
    night = (hour - fall) % 24.0 / (24.0 - 2.0 * half)
    decay = (np.exp(-NIGHT_DECAY * night) - np.exp(-NIGHT_DECAY)) / (1.0 - np.exp(-NIGHT_DECAY))
    by_day = (hour >= rise) & (hour <= fall)
    air = np.where(by_day, np.sin(wave * (hour - rise)), np.sin(wave * (fall - rise)) * decay)
    breeze = (1.0 - DAY_WIND) * np.maximum(np.cos(2.0 * np.pi * (hour - WINDIEST_H) / 24.0), 0.0)
    return air, np.where(by_day, DAY_WIND + breeze, NIGHT_WIND)
