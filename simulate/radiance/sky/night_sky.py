"""Sky radiance: sun and moon, scattered light, twilight, airglow, zodiacal light, stars and towns."""

from dataclasses import dataclass, field, replace
from datetime import datetime

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata.errors import BadInput
from simulate.radiance.atmosphere import Atmosphere, airmass
from simulate.radiance.cube import band_widths
from simulate.radiance.sky import scattering, sky_glow
from simulate.radiance.sky.moon import AU_KM, Disc, Ephemeris, ObserverLocation, ephemeris, moonlight, sun_spectrum
from simulate.radiance.sky.sky_glow import TownGlow, dark_sky, van_rhijn
from simulate.radiance.spectrum import LUMENS_PER_WATT, SourceSpectrum, luminous_efficiency, require_grid, sum_spectra

Array = NDArray[np.floating]

# Irradiance over pi times the zenith's radiance of a layer of airglow, above the air (`van_rhijn`).
AIRGLOW_HEMISPHERE = 1.715


@dataclass(frozen=True, kw_only=True, eq=False)
class NightSky:
    """Everything above the horizon.

    Notes
    -----
    Directions have x east, y north, z up. There are no clouds.
    """

    atmosphere: Atmosphere = field(default_factory=Atmosphere)  # the air
    bodies: tuple[Disc, ...] = ()  # sun and moon, also when below the horizon, where they still make twilight
    # Strength of each over a dark site's, dimensionless.
    airglow: float = 1.0
    zodiacal: float = 1.0
    starlight: float = 1.0
    towns: tuple[TownGlow, ...] = ()  # glow of towns
    ground_albedo: float = 0.2  # albedo of the surrounding land, which lights the sky from below

    def __post_init__(self) -> None:
        for name in ("airglow", "zodiacal", "starlight"):
            if not getattr(self, name) >= 0.0:
                raise BadInput(f"{name} must not be negative, got {getattr(self, name):g}")
        if not 0.0 <= self.ground_albedo <= 1.0:
            raise BadInput(f"ground_albedo must lie in [0, 1], got {self.ground_albedo:g}")

    @classmethod
    def at(
        cls, place: ObserverLocation, time: datetime, *, atmosphere: Atmosphere | None = None, **parts: object
    ) -> "NightSky":
        """Return the sky over a place at a time with its zone; by default in air of 23 km of visibility.

        Other fields of the sky (`airglow`, `towns` and so on) are passed on.

        Raises BadInput if the time has no zone or lies outside 1900 to 2100.
        """
        air = atmosphere or Atmosphere()
        return cls(atmosphere=air, bodies=_bodies(ephemeris(place, time), air), **parts)  # pyright: ignore[reportArgumentType]

    def discs(self) -> tuple[Disc, ...]:
        """Return sun and moon, those that stand above the horizon."""
        return tuple(body for body in self.bodies if body.visible_share > 0.0)

    def sources(self) -> tuple[SourceSpectrum, ...]:
        """Return the spectra that light the scene, for `spectral_grid`."""
        bodies = [body.extraterrestrial for body in self.bodies if body.elevation_deg > -sky_glow.LAST_DEG]
        return (*bodies, self._night(), *(town.spectrum for town in self.towns))

    def radiance(self, direction: Array, wavelength_nm: ArrayLike) -> Array:
        """Return the sky's radiance without the discs in directions (path, 3), W m-2 sr-1 nm-1, shape (band, path).

        On the complete spectral grid (band,), nm; zero below the horizon.
        """
        grid = require_grid(wavelength_nm)
        total = self._night_radiance(direction, grid)
        depth, _ = scattering.scattering_parts(self.atmosphere, grid)
        for body in self.bodies:
            if body.elevation_deg > 0.0:
                total += self._endless(body, direction, grid) * scattering.sky_depth(depth, direction)
            glow = self._twilight(body)
            if glow is not None:
                total += glow.on(grid)[:, None] * sky_glow.twilight_shape(direction, body.direction)
        return total * (direction[:, 2] >= 0.0)

    def air_radiance(self, direction: Array, wavelength_nm: ArrayLike) -> Array:
        """Return the radiance of an endless level path of the air near the ground, shape (band, path).

        Notes
        -----
        The same scattering of sun and moon as in the sky, so that far hills fade into the horizon; of dusk and towns,
        half of the sphere is sky and half is ground of the albedo given.
        """
        grid = require_grid(wavelength_nm)
        total = np.zeros((grid.size, len(direction)))
        for body in self.bodies:
            if body.elevation_deg > 0.0:
                total += self._endless(body, direction, grid)
        directions, weight = scattering.sky_quadrature()
        cosine = weight * directions[:, 2]
        around = np.zeros(grid.size)
        for town in self.towns:
            around += town.spectrum.on(grid) * (town.shape(directions) @ cosine)
        for body in self.bodies:
            glow = self._twilight(body)
            if glow is not None:
                around += glow.on(grid) * (sky_glow.twilight_shape(directions, body.direction) @ cosine)
        even = 0.5 * (1.0 + self.ground_albedo) / np.pi * around + self._night_air(grid)
        return total + even[:, None]

    def air(self) -> Atmosphere:
        """Return the atmosphere, lit by this sky."""
        return replace(self.atmosphere, light=self)

    def irradiance(self, wavelength_nm: ArrayLike) -> Array:
        """Return the irradiance of open level ground, W m-2 nm-1, shape (band,): sky and discs."""
        grid = require_grid(wavelength_nm)
        directions, weight = scattering.sky_quadrature()
        total = self.radiance(directions, grid) @ (weight * directions[:, 2])
        for disc in self.discs():
            total += disc.irradiance(grid) * max(disc.direction[2], 0.0)
        return total

    def illuminance_lux(self) -> float:
        """Return the illuminance of open level ground, lux."""
        grid = np.arange(380.0, 771.0, 5.0)
        weight = LUMENS_PER_WATT * luminous_efficiency(grid) * band_widths(grid)
        return float(np.sum(self.irradiance(grid) * weight))

    def _endless(self, body: Disc, direction: Array, grid: Array) -> Array:
        """Return the radiance of an endless path lit by one body; the sky it makes has the diffuse irradiance known."""
        depth, molecules = scattering.scattering_parts(self.atmosphere, grid)
        # Followed through the narrow bands of gases before it is put on the grid.
        diffuse = body.extraterrestrial.multiply(
            lambda nm: scattering.diffuse_share(self.atmosphere, body.elevation_deg, nm, self.ground_albedo)
        )
        per_shape = diffuse.on(grid) / scattering.level_irradiance(body.direction, depth, molecules)
        return per_shape[:, None] * scattering.endless_path(direction, body.direction, molecules)

    def _twilight(self, body: Disc) -> SourceSpectrum | None:
        return sky_glow.twilight_spectrum(body.elevation_deg, body.extraterrestrial.lumens / sun_spectrum().lumens)

    def _night(self) -> SourceSpectrum:
        dark = dark_sky()
        return sum_spectra(
            [dark.airglow.scale(self.airglow), dark.zodiacal.scale(self.zodiacal), dark.starlight.scale(self.starlight)]
        )

    def _night_radiance(self, direction: Array, grid: Array) -> Array:
        """Return airglow, zodiacal light, stars and towns, shape (band, path).

        Each part comes through the air, and what the air takes from it it gives back evenly from above and below.
        """
        elevation = np.rad2deg(np.arcsin(np.clip(direction[:, 2], 0.0, 1.0)))
        straight, slant = self._direct_fraction(np.array([90.0]), grid), self._direct_fraction(elevation, grid)
        total = np.zeros((grid.size, len(direction)))
        for zenith, shape, back in self._night_parts(elevation, grid):
            seen = shape * slant + back * (1.0 - slant)
            total += zenith[:, None] * seen / (straight + back * (1.0 - straight))
        for town in self.towns:
            total += town.spectrum.on(grid)[:, None] * town.shape(direction)
        return total

    def _night_air(self, grid: Array) -> Array:
        """Return the radiance of an endless path lit by airglow, zodiacal light and stars, shape (band,)."""
        straight = self._direct_fraction(np.array([90.0]), grid)[:, 0]
        parts = self._night_parts(np.array([90.0]), grid)
        return np.sum([zenith * back / (straight + back * (1.0 - straight)) for zenith, _, back in parts], axis=0)

    def _night_parts(self, elevation_deg: Array, grid: Array) -> tuple[tuple[Array, Array, float], ...]:
        """Return of even light and of airglow: the zenith, its shape above the air, and what an endless path has of it.

        Half of what lights the air comes from above and half from ground of the albedo given.
        """
        dark = dark_sky()
        even = self.zodiacal * dark.zodiacal.on(grid) + self.starlight * dark.starlight.on(grid)
        glow = self.airglow * dark.airglow.on(grid)
        half = 0.5 * (1.0 + self.ground_albedo)
        return ((even, np.ones(elevation_deg.shape), half), (glow, van_rhijn(elevation_deg), half * AIRGLOW_HEMISPHERE))

    def _direct_fraction(self, elevation_deg: Array, grid: Array) -> Array:
        """Return the transmittance for isotropic light, shape (band, path).

        Haze scatters forward: only 1 - g of its depth counts.
        """
        air = self.atmosphere
        depth = air.molecules_depth(grid) + (1.0 - scattering.ASYMMETRY) * air.haze_depth(grid)
        return np.exp(-depth[:, None] * airmass(elevation_deg))


def _bodies(at: Ephemeris, air: Atmosphere) -> tuple[Disc, ...]:
    sunlight = sun_spectrum(at.sun.distance_km / AU_KM).scale(at.sun_share)
    return tuple(
        Disc(
            name=name,
            direction=body.direction,
            angular_radius_rad=body.angular_radius_rad,
            extraterrestrial=light,
            atmosphere=air,
        )
        for name, body, light in (("sun", at.sun, sunlight), ("moon", at.moon, moonlight(at)))
    )
