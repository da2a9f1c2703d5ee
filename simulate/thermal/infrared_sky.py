"""Infrared radiance of clear and cloudy sky by direction, and sunlight, in the bins of the air."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from simulate.arrays import Array
from simulate.radiance.atmosphere import airmass
from simulate.radiance.outdoor.scene import Weather as State
from simulate.radiance.spectrum import STEFAN_BOLTZMANN, band_radiance
from simulate.thermal.air import InfraredAir, bins_of
from simulate.thermal.clear_day import CLOUD_EMISSIVITY, sky_emissivity, solar_hour
from simulate.thermal.exposure import RINGS
from simulate.thermal.slab import ZERO_C, vapour_pressure_pa
from simulate.thermal.thresholds import INFRARED
from simulate.thermal.weather import Weather

# Lengths of paths in air as at the ground that emit as the clear sky does in the zenith, km, and
# the powers of the air mass by which they grow: of dry gases, lines of water, its continuum. Fitted
# with the depth of ozone (`air.csv`) to the brightness temperatures of six model atmospheres of
# LOWTRAN7 in three bands, 0 to 85 degrees from the zenith: within 2.5 K. They are shorter than the
# scale heights, for air above is colder and thinner.
DRY_KM, WATER_KM, CONTINUUM_KM = 2.74, 0.638, 1.605
DRY_POWER, WATER_POWER, CONTINUUM_POWER, OZONE_POWER = 0.1, 1.386, 0.856, 0.9
# Column of haze as at the ground, km.
HAZE_KM = 1.2
# Base of low cloud, which is black, and the fall of temperature up to it.
CLOUD_BASE_KM, LAPSE_K_PER_KM = 1.0, 6.5
# The sun as a black body in the infrared, K, and its solid angle at the mean distance, sr: 21.8 W
# m-2 from 3 to 5 um.
SUN_K, SUN_SR = 5770.0, 6.794e-5
# Points in each ring by which its mean radiance is found.
RING_POINTS = 8


class Surroundings(Protocol):
    """Radiance of what is not a surface."""

    def radiance(self, direction: Array) -> Array:
        """Return the radiance from unit directions (ray, 3), W m-2 sr-1, shape (ray, bin)."""
        ...

    @property
    def sun(self) -> Array | None:
        """Direction of the sun, shape (3,); None below the horizon."""
        ...

    @property
    def sunlight(self) -> Array:
        """Irradiance of a surface that faces the sun, W m-2, shape (bin,)."""
        ...


@dataclass(frozen=True, kw_only=True)
class InfraredSky:
    """Sky above homogeneous air, and below the horizon ground of the air's temperature.

    Parameters
    ----------
    air
        The air near the ground.
    cloud
        Fraction of the sky that low cloud covers, evenly in all directions, dimensionless.
    sun
        Direction of the sun, shape (3,); None below the horizon.
    """

    air: InfraredAir
    cloud: float = 0.0
    sun: Array | None = None

    def clear_transmittance(self, sine: Array) -> Array:
        """Return 1 minus the emissivity of the clear sky at sines of the elevation (ray,), shape
        (ray, bin).

        Notes
        -----
        Radiance over that of a black body of the air's temperature is the emissivity.
        """
        mass = airmass(np.rad2deg(np.arcsin(np.clip(sine, 0.0, 1.0))))
        lengths = (
            DRY_KM * mass**DRY_POWER,
            WATER_KM * mass**WATER_POWER,
            CONTINUUM_KM * mass**CONTINUUM_POWER,
        )
        ozone_depth = self.air.rows["ozone_depth"] * mass[:, None] ** OZONE_POWER
        return np.exp(
            -self.air.depth(*lengths) - ozone_depth - self.air.haze_per_km * HAZE_KM * mass[:, None]
        )

    def radiance(self, direction: Array) -> Array:
        """Return the radiance from unit directions (ray, 3), W m-2 sr-1, shape (ray, bin), without
        the sun's disc.
        """
        sine = direction[:, 2]
        clear = self.clear_transmittance(sine)
        base = self.air.black_body(self.air.temperature_k - LAPSE_K_PER_KM * CLOUD_BASE_KM)
        sky_radiance = (1.0 - clear) * self.air.black_body(
            self.air.temperature_k
        ) + self.cloud * clear * base
        sky_radiance[sine < 0.0] = self.air.black_body(self.air.temperature_k)
        return sky_radiance

    @property
    def sunlight(self) -> Array:
        """Irradiance of a surface that faces the sun, W m-2, shape (bin,)."""
        if self.sun is None:
            return np.zeros(len(self.air.low_um))
        extraterrestrial = SUN_SR * band_radiance(self.air.low_um, self.air.high_um, SUN_K)
        return (1.0 - self.cloud) * extraterrestrial * self.clear_transmittance(self.sun[2:])[0]


def notes_on_sky(air: InfraredAir) -> tuple[str, ...]:
    """Return a sentence if the clear sky of some air is beyond the atmospheres to which it was
    fitted, else none.
    """
    kelvin, vapour = air.temperature_k, air.vapour_g_m3
    (coldest, warmest), (driest, wettest) = INFRARED.models_k, INFRARED.models_g_m3
    if coldest <= kelvin <= warmest and driest <= vapour <= wettest:
        return ()
    return (
        f"the infrared sky was fitted to atmospheres of {coldest - ZERO_C:.0f} to "
        f"{warmest - ZERO_C:.0f} C with {driest:.2g} to {wettest:.2g} g/m3 of water vapour at the "
        f"ground, and is extrapolated to {kelvin - ZERO_C:.0f} C and {vapour:.2g} g/m3",
    )


def ring_radiance(sky: Surroundings) -> Array:
    """Return the mean radiance of the sky in each ring of `exposure.RING_SINE`, W m-2 sr-1, shape
    (ring, bin).
    """
    sine = np.sqrt((np.arange(RINGS * RING_POINTS) + 0.5) / (RINGS * RING_POINTS))
    direction = np.stack([np.sqrt(1.0 - sine**2), 0.0 * sine, sine], axis=1)
    return sky.radiance(direction).reshape(RINGS, RING_POINTS, -1).mean(axis=1)


def sky_of(band_um: tuple[float, float], weather: Weather, state: State) -> InfraredSky:
    """Return the sky of a scene's weather at its time, in the bins of a band.

    Parameters
    ----------
    band_um
        Ends of the band, um.
    weather, state
        Weather up to the scene's time, and the scene's table of it, for the visibility.

    Notes
    -----
    The cloud is what the weather's longwave has above that of a clear sky, by the law that the
    weather itself uses; none where a clear sky of wet air is black itself.
    """
    air_k, dew_k = weather.air_k[-1:], weather.dew_point_k[-1:]
    hour = solar_hour(weather.location, weather.times[-1:])
    clear = sky_emissivity(dew_k, hour, weather.pressure_hpa[-1:], 0.0)
    emissivity = weather.longwave_w_m2[-1:] / (STEFAN_BOLTZMANN * air_k**4)
    seen_through = 1.0 - float(clear[0])
    cloud = (
        float(emissivity[0] - clear[0]) / seen_through / CLOUD_EMISSIVITY
        if seen_through > 0.0
        else 0.0
    )
    sun = weather.sun[-1]
    return InfraredSky(
        air=InfraredAir(
            edges_um=bins_of(band_um),
            temperature_k=float(air_k[0]),
            vapour_g_m3=1e3 * float(vapour_pressure_pa(dew_k)[0]) / (461.5 * float(air_k[0])),
            visibility_km=state.visibility_km,
        ),
        cloud=min(max(cloud, 0.0), 1.0),
        sun=sun if sun[2] > 0.0 else None,
    )
