"""Twilight: zenith brightness by the depression of sun or moon, its spectrum and its shape."""

import numpy as np

from simulate.arrays import Array
from simulate.radiance.spectrum import SourceSpectrum

# Zenith brightness, mag arcsec-2, over the depression d in degrees: a0 + a1 (d - 5) + a2 (d - 5)^2
# for 5 <= d <= 15, in U, B, V, R, I (Patat, Ugolnikov and Postylyakov, Astron. Astrophys. 455, 385,
# 2006).
BANDS_NM = np.array([366.0, 438.0, 545.0, 641.0, 798.0])
A0 = np.array([11.78, 11.84, 11.84, 11.40, 10.93])
A1 = np.array([1.376, 1.411, 1.518, 1.567, 1.470])
A2 = np.array([-0.039, -0.041, -0.057, -0.064, -0.062])
# Flux of magnitude 0 in these bands, W m-2 nm-1 (Bessell, Castelli and Plez 1998).
ZERO_W_M2_NM = np.array([4.175e-11, 6.32e-11, 3.631e-11, 2.177e-11, 1.126e-11])
FIRST_DEG, TANGENT_DEG, LAST_DEG = 5.0, 12.0, 20.0
# Relative radiance 1 + RISE s^2 + 2.0 s^2 cos(azimuth from the sun), s the sine of the zenith
# angle: with a hemisphere of twice the zenith the illuminances of civil and nautical dusk come out,
# 3.4 and 0.008 lux.
RISE = 2.0


def twilight_magnitude(depression_deg: float) -> Array:
    """Return the zenith's brightness in U, B, V, R, I, mag arcsec-2, at a depression of the sun of
    0 to 20 degrees.
    """
    if depression_deg < FIRST_DEG:
        # From sunset on the zenith dims so much per degree that a level place has 600 lux at
        # sunset; above, the glow fades out until daylight of `scattering` has taken over.
        return A0 - 0.85 * (FIRST_DEG - depression_deg)
    # Beyond 12 degrees the measured sky approaches its night level; the twilight is extrapolated
    # with the slope there.
    x = min(depression_deg, TANGENT_DEG) - FIRST_DEG
    extrapolated_deg = max(depression_deg - TANGENT_DEG, 0.0)
    return A0 + A1 * x + A2 * x**2 + extrapolated_deg * (A1 + 2.0 * A2 * (TANGENT_DEG - FIRST_DEG))


def twilight_spectrum(elevation_deg: float, relative: float = 1.0) -> SourceSpectrum | None:
    """Return the zenith's radiance by twilight, W m-2 sr-1, or None, for an elevation and strength
    over the sun's.

    Notes
    -----
    Below -20 degrees there is none, above 0 it stays and fades out towards 10 degrees. The moon
    counts as a dim sun.
    """
    if elevation_deg <= -LAST_DEG or elevation_deg >= 10.0 or relative <= 0.0:
        return None
    magnitude = twilight_magnitude(max(-elevation_deg, 0.0))
    extinction = 1.0 - max(elevation_deg, 0.0) / 10.0
    radiance = (
        relative
        * extinction
        * ZERO_W_M2_NM
        * (180.0 * 3600.0 / np.pi) ** 2
        * 10.0 ** (-0.4 * magnitude)
    )
    fine = np.arange(350.0, 1151.0, 10.0)
    return SourceSpectrum(
        wavelength_nm=fine, density=np.exp(np.interp(fine, BANDS_NM, np.log(radiance)))
    )


def twilight_shape(direction: Array, sun_direction: tuple[float, float, float]) -> Array:
    """Return radiance relative to the zenith's for directions (path, 3) and a body's direction,
    shape (path,).
    """
    level = float(np.hypot(sun_direction[0], sun_direction[1]))
    sine = np.hypot(direction[:, 0], direction[:, 1])
    if level == 0.0:
        return 1.0 + RISE * sine**2
    # s cos(azimuth difference) is the projection on the body's azimuth.
    sun_cosine = (direction[:, 0] * sun_direction[0] + direction[:, 1] * sun_direction[1]) / level
    return 1.0 + RISE * sine**2 + 2.0 * sine * sun_cosine
