"""Atmosphere: transmittance of paths near the ground and to space, and path radiance."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from labdata.errors import BadInput, check, check_range
from simulate.arrays import Array
from simulate.radiance.spectrum import table

# ln 50: the visibility is defined by a contrast of 2 %.
KOSCHMIEDER = 3.912
REFERENCE_NM = 550.0
# Visibility below which haze is fog or mist, of larger drops, km.
FOG_KM = 2.0


def visibility_extinction_per_km(visibility_km: float) -> float:
    """Return the extinction at 550 nm, per km, 3.912/V (Koschmieder)."""
    return KOSCHMIEDER / visibility_km


def kruse_exponent(visibility_km: float) -> float:
    """Return q of extinction proportional to wavelength^-q: 1.6 beyond 50 km, 1.3 down to fog,
    there 0.585 V^(1/3).

    Notes
    -----
    Kruse, but for haze from 2 to 6 km: his 0.585 V^(1/3) makes the near infrared 0.06 too dark at 2
    km in visibility of 5 km against the rural haze of MODTRAN 5, whose spectrum does not depend on
    its amount.
    """
    if visibility_km > 50.0:
        return 1.6
    return 1.3 if visibility_km > FOG_KM else 0.585 * visibility_km ** (1.0 / 3.0)


def kruse_per_km(wavelength_nm: ArrayLike, visibility_km: float) -> Array:
    """Return 3.912/V (wavelength/550 nm)^-q, per km."""
    relative = np.asarray(wavelength_nm, float) / REFERENCE_NM
    return visibility_extinction_per_km(visibility_km) * relative ** -kruse_exponent(visibility_km)


def scattering_albedo(wavelength_nm: ArrayLike) -> Array:
    """Return the single-scattering albedo of haze, dimensionless.

    Notes
    -----
    0.945 exp(-0.095 ln(l/400 nm)^2), rural haze (Bird and Riordan 1984, eq. 3-16).
    """
    return 0.945 * np.exp(-0.095 * np.square(np.log(np.asarray(wavelength_nm, float) / 400.0)))


EARTH_RADIUS_KM = 6370.0


def airmass(elevation_deg: ArrayLike) -> Array:
    """Return the relative air mass, dimensionless: 1 at the zenith, 37.9 at the horizon and for all
    below it.

    Notes
    -----
    1 / (sin h + 0.50572 (h + 6.07995)^-1.6364), h in degrees (Kasten and Young, Appl. Opt. 28,
    4735, 1989).
    """
    elevation = np.maximum(np.asarray(elevation_deg, float), 0.0)
    return 1.0 / (np.sin(np.deg2rad(elevation)) + 0.50572 * (elevation + 6.07995) ** -1.6364)


def ozone_mass(elevation_deg: ArrayLike) -> Array:
    """Return the relative mass of a layer of ozone 22 km up, dimensionless (Bird and Riordan 1984,
    eq. 2-10).
    """
    sine = np.sin(np.deg2rad(np.maximum(np.asarray(elevation_deg, float), 0.0)))
    relative = 22.0 / EARTH_RADIUS_KM
    return (1.0 + relative) / np.sqrt(np.square(sine) + 2.0 * relative)


def _coefficient(wavelength_nm: ArrayLike, name: str) -> Array:
    gases = table("gases")
    return np.interp(
        np.atleast_1d(np.asarray(wavelength_nm, float)), gases["wavelength_nm"], gases[name]
    )


def water_transmittance(wavelength_nm: ArrayLike, precipitable_cm: ArrayLike) -> Array:
    """Return the transmittance of water vapour, shape (band, path), for water on each path as a
    layer of liquid, cm.

    Notes
    -----
    exp(-0.2385 x / (1 + 20.07 x)^0.45), x = a w (Bird and Riordan 1984, eq. 2-8).
    """
    amount = _coefficient(wavelength_nm, "water_vapour_per_cm")[:, None] * np.atleast_1d(
        precipitable_cm
    )
    return np.exp(-0.2385 * amount / (1.0 + 20.07 * amount) ** 0.45)


def uniform_gas_transmittance(wavelength_nm: ArrayLike, airmass: ArrayLike) -> Array:
    """Return the transmittance of oxygen and carbon dioxide, shape (band, path), for
    pressure-corrected air masses.

    Notes
    -----
    exp(-1.41 x / (1 + 118.3 x)^0.45), x = a m (Bird and Riordan 1984, eq. 2-11, the constant of its
    program).
    """
    amount = _coefficient(wavelength_nm, "mixed_gases")[:, None] * np.atleast_1d(airmass)
    return np.exp(-1.41 * amount / (1.0 + 118.3 * amount) ** 0.45)


def ozone_transmittance(wavelength_nm: ArrayLike, ozone_atm_cm: ArrayLike) -> Array:
    """Return the transmittance of ozone, shape (band, path), for ozone on each path, atm cm."""
    return np.exp(
        -_coefficient(wavelength_nm, "ozone_per_atm_cm")[:, None] * np.atleast_1d(ozone_atm_cm)
    )


def vapour_density_g_m3(temperature_c: float, relative_humidity: float) -> float:
    """Return the mass of water vapour in air, g m-3.

    Notes
    -----
    Saturation pressure 6.112 exp(17.62 t / (243.12 + t)) hPa (Magnus, WMO Guide 8), ideal gas.
    """
    pressure_pa = (
        611.2 * np.exp(17.62 * temperature_c / (243.12 + temperature_c)) * relative_humidity
    )
    return float(1e3 * pressure_pa / (461.5 * (temperature_c + 273.15)))


# Height of a column of sea-level density that holds all air, km.
SCALE_HEIGHT_KM = 8.43
SEA_LEVEL_HPA = 1013.25


def rayleigh_depth(wavelength_nm: ArrayLike) -> Array:
    """Return the optical depth of the whole atmosphere straight up at sea level, dimensionless.

    Notes
    -----
    0.00864 L^-(3.916 + 0.074 L + 0.05/L), L in um (Leckner, Solar Energy 20, 143, 1978, after
    Froehlich and Shaw).
    """
    micrometre = np.asarray(wavelength_nm, float) * 1e-3
    return 0.00864 * micrometre ** -(3.916 + 0.074 * micrometre + 0.05 / micrometre)


def rayleigh_per_km(wavelength_nm: ArrayLike) -> Array:
    """Return the extinction coefficient of sea-level air, per km."""
    return rayleigh_depth(wavelength_nm) / SCALE_HEIGHT_KM


class SkyLight(Protocol):
    """Light source of the path radiance of air."""

    def air_radiance(self, direction: Array, wavelength_nm: ArrayLike) -> Array:
        """Return the radiance of an infinite path along directions (path, 3), W m-2 sr-1 nm-1,
        shape (band, path).
        """
        ...


@dataclass(frozen=True, kw_only=True)
class Atmosphere:
    """Homogeneous air of one visibility and humidity.

    Notes
    -----
    Extinction at 550 nm is 3.912/V, molecules included; the rest of it is haze, falling by Kruse's
    power of wavelength. Single scattering: light scattered out of a path is lost, so that an image
    loses contrast and not resolution. There is no refraction.
    """

    # meteorological range: distance at which a black object has a contrast of 2 %, km
    visibility_km: float = 23.0
    relative_humidity: float = 0.5  # at the ground, 0 to 1, dimensionless
    # Of the air at the ground.
    temperature_c: float = 15.0
    pressure_hpa: float = SEA_LEVEL_HPA
    ozone_atm_cm: float = 0.3  # ozone overhead, atm cm
    # height of a column of the haze at the ground that holds all of it, km
    aerosol_scale_height_km: float = 1.2
    # light source of the path radiance, set by `NightSky.air`; None: no path radiance
    light: SkyLight | None = None

    def __post_init__(self) -> None:
        clearest = KOSCHMIEDER / float(rayleigh_per_km(REFERENCE_NM))
        if not 0.01 <= self.visibility_km <= clearest:
            raise BadInput(
                f"visibility_km must lie between 0.01 and that of clean air, {clearest:.0f}, got "
                f"{self.visibility_km:g}"
            )
        check_range(self, -60.0, 60.0, "temperature_c")
        check(
            self,
            positive="pressure_hpa aerosol_scale_height_km",
            not_negative="ozone_atm_cm",
            fraction="relative_humidity",
        )

    @property
    def vapour_g_m3(self) -> float:
        """Water vapour at the ground, g m-3."""
        return vapour_density_g_m3(self.temperature_c, self.relative_humidity)

    @property
    def precipitable_cm(self) -> float:
        """Water vapour overhead as a layer of liquid, cm."""
        # The US standard atmosphere's 5.9 g m-3 at the ground hold 1.42 cm of water above.
        return 0.1 * self.vapour_g_m3 * 2.4

    def haze_per_km(self, wavelength_nm: ArrayLike) -> Array:
        """Return the extinction by haze at the ground, per km, shape (band,)."""
        wavelength = np.atleast_1d(np.asarray(wavelength_nm, float))
        molecules = float(rayleigh_per_km(REFERENCE_NM))
        haze_fraction = 1.0 - molecules / visibility_extinction_per_km(self.visibility_km)
        return haze_fraction * kruse_per_km(wavelength, self.visibility_km)

    def molecules_depth(self, wavelength_nm: ArrayLike) -> Array:
        """Return the optical depth of molecules straight up, dimensionless, shape (band,)."""
        depth = rayleigh_depth(np.atleast_1d(np.asarray(wavelength_nm, float)))
        return depth * self.pressure_hpa / SEA_LEVEL_HPA

    def haze_depth(self, wavelength_nm: ArrayLike) -> Array:
        """Return the optical depth of haze straight up, dimensionless, shape (band,)."""
        return self.haze_per_km(wavelength_nm) * self.aerosol_scale_height_km

    def transmittance(self, range_m: ArrayLike, wavelength_nm: ArrayLike) -> Array:
        """Return the transmittance of paths near the ground of lengths (path,), m, shape (band,
        path).
        """
        return self._particle_transmittance(range_m, wavelength_nm) * self.gas_transmittance(
            range_m, wavelength_nm
        )

    def slant_transmittance(self, elevation_deg: ArrayLike, wavelength_nm: ArrayLike) -> Array:
        """Return the transmittance of the atmosphere, shape (band, path), along elevations (path,)
        in degrees.

        Paths below the horizon count as along it.
        """
        depth = self.molecules_depth(wavelength_nm) + self.haze_depth(wavelength_nm)
        mass = np.atleast_1d(airmass(elevation_deg))
        return np.exp(-depth[:, None] * mass) * self.gas_slant_transmittance(
            elevation_deg, wavelength_nm
        )

    def gas_slant_transmittance(self, elevation_deg: ArrayLike, wavelength_nm: ArrayLike) -> Array:
        """Return the gas transmittance of the atmosphere, shape (band, path), along elevations in
        degrees.
        """
        mass = np.atleast_1d(airmass(elevation_deg))
        pressure = self.pressure_hpa / SEA_LEVEL_HPA
        ozone = np.atleast_1d(ozone_mass(elevation_deg)) * self.ozone_atm_cm
        return (
            water_transmittance(wavelength_nm, mass * self.precipitable_cm)
            * uniform_gas_transmittance(wavelength_nm, mass * pressure)
            * ozone_transmittance(wavelength_nm, ozone)
        )

    def _particle_transmittance(self, range_m: ArrayLike, wavelength_nm: ArrayLike) -> Array:
        """Return the transmittance of haze and molecules on paths near the ground, shape (band,
        path).
        """
        metres = np.atleast_1d(np.asarray(range_m, float))
        if metres.size and not metres.min() >= 0.0:
            raise BadInput(f"a range must not be negative, got {metres.min():g} m")
        return np.exp(-self.extinction_per_m(wavelength_nm)[:, None] * metres)

    def extinction_per_m(self, wavelength_nm: ArrayLike) -> Array:
        """Return the extinction by haze and molecules at the ground, shape (band,), m-1."""
        wavelength = np.atleast_1d(np.asarray(wavelength_nm, float))
        molecules = rayleigh_per_km(wavelength) * self.pressure_hpa / SEA_LEVEL_HPA
        return 1e-3 * (molecules + self.haze_per_km(wavelength))

    def gas_transmittance(self, range_m: ArrayLike, wavelength_nm: ArrayLike) -> Array:
        """Return the gas transmittance near the ground, without ozone, which absorbs less than 0.1
        % per km.
        """
        metres = np.atleast_1d(np.asarray(range_m, float))
        mixed = 1e-3 * metres / SCALE_HEIGHT_KM * self.pressure_hpa / SEA_LEVEL_HPA
        water = water_transmittance(wavelength_nm, 1e-4 * metres * self.vapour_g_m3)
        return water * uniform_gas_transmittance(wavelength_nm, mixed)
