"""Sky radiance: sun and moon, scattered light, airglow, zodiacal light, stars and towns."""

from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from labdata.errors import check
from simulate.arrays import Array
from simulate.radiance.atmosphere import Atmosphere, airmass
from simulate.radiance.cube import band_widths
from simulate.radiance.lamps.spectra import spectrum
from simulate.radiance.sky import scattering
from simulate.radiance.sky.moon import (
    AU_KM,
    Disc,
    ObserverLocation,
    ephemeris,
    moonlight,
    sun_spectrum,
)
from simulate.radiance.sky.twilight import LAST_DEG, twilight_shape, twilight_spectrum
from simulate.radiance.spectrum import (
    LUMENS_PER_WATT,
    SourceSpectrum,
    luminous_efficiency,
    planck,
    require_grid,
    sum_spectra,
    table,
)

BAND_NM = 50.0
# Airglow's lines that stand out of a 50 nm band, W m-2 sr-1: oxygen at 558 and 630 nm (160 and 115
# rayleigh), sodium.
LINES_NM = (557.7, 589.3, 630.0)
LINES_W_M2_SR = (4.5e-8, 1.3e-8, 2.9e-8)


def van_rhijn(elevation_deg: ArrayLike) -> Array:
    """Return how much longer a slanting ray runs in a thin layer 90 km up, dimensionless: 1 at the
    zenith, 6 at 0.

    Notes
    -----
    (1 - (R cos h/(R + H))^2)^-1/2 (van Rhijn 1921).
    """
    grazing = np.cos(np.deg2rad(np.maximum(np.asarray(elevation_deg, float), 0.0)))
    return 1.0 / np.sqrt(1.0 - np.square(grazing * 6370.0 / (6370.0 + 90.0)))


@dataclass(frozen=True, eq=False)
class DarkSky:
    """Zenith radiance of the moonless sky in three parts, W m-2 sr-1, as it arrives at the ground
    in clear air.
    """

    # Their spectra.
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
    The sum is a measured spectrum; zodiacal light has the sun's spectrum and 30 % of the luminance,
    stars that of a black body of 4700 K and 20 %; airglow is the rest, so nearly all of the near
    infrared. The airglow varies twofold over the solar cycle; where on the sky the ecliptic and the
    Milky Way lie is left out.
    """
    smooth = _continuum()
    lines = SourceSpectrum(
        wavelength_nm=smooth.wavelength_nm,
        density=0.0 * smooth.density,
        line_nm=LINES_NM,
        line_power=LINES_W_M2_SR,
    )
    total_spectrum = sum_spectra([smooth, lines])
    sunlight = np.interp(smooth.wavelength_nm, sun_spectrum().wavelength_nm, sun_spectrum().density)
    zodiacal = _luminance_fraction(total_spectrum, sunlight, 0.30)
    # Colour of the stars' integrated light: redder than the sun.
    # Shares of the zenith's luminance, after Leinert et al., Astron. Astrophys. Suppl. 127, 1
    # (1998).
    starlight = _luminance_fraction(total_spectrum, planck(smooth.wavelength_nm, 4700.0), 0.20)
    residual_density = total_spectrum.density - zodiacal.density - starlight.density
    airglow = SourceSpectrum(
        wavelength_nm=total_spectrum.wavelength_nm,
        density=residual_density,
        line_nm=total_spectrum.line_nm,
        line_power=total_spectrum.line_power,
    )
    return DarkSky(airglow, zodiacal, starlight)


def _luminance_fraction(
    total_spectrum: SourceSpectrum, shape: Array, luminance_share: float
) -> SourceSpectrum:
    component = SourceSpectrum(wavelength_nm=total_spectrum.wavelength_nm, density=shape)
    return component.scale(luminance_share * total_spectrum.lumens / component.lumens)


def _continuum() -> SourceSpectrum:
    """Return the continuum of the table without the lines: the smoothest broken line with the
    bands' means.
    """
    bands = table("dark_sky")
    start, mean = bands["wavelength_nm"], 1e-9 * bands["radiance_1e-6_w_m2_sr_um"]
    for nm, power in zip(LINES_NM, LINES_W_M2_SR, strict=True):
        mean = mean - np.where((start <= nm) & (nm < start + BAND_NM), power / BAND_NM, 0.0)
    knots = np.arange(350.0, 1150.0 + 1.0, 10.0)
    rows = np.stack([_band_mean(knots, low) for low in start])
    # Least sum of squared second differences under the bands' means, which Lagrange's multipliers
    # keep exactly.
    bend = np.diff(np.eye(knots.size), 2, axis=0)
    flat = np.zeros((2, knots.size))
    flat[0, :2], flat[1, -2:] = (1.0, -1.0), (1.0, -1.0)
    system = np.block(
        [[bend.T @ bend + 10.0 * flat.T @ flat, rows.T], [rows, np.zeros((len(rows), len(rows)))]]
    )
    solved = np.linalg.solve(system, np.concatenate([np.zeros(knots.size), mean]))
    return SourceSpectrum(wavelength_nm=knots, density=solved[: knots.size])


def _band_mean(knots: Array, low_nm: float) -> Array:
    """Return the weights that average a broken line over a band; its ends are knots."""
    in_band = (knots >= low_nm) & (knots <= low_nm + BAND_NM)
    weight = np.where(in_band, 1.0, 0.0)
    weight[np.flatnonzero(in_band)[[0, -1]]] = 0.5
    return weight / weight.sum()


@dataclass(frozen=True, kw_only=True)
class TownGlow:
    """Lamp light scattered by the air above a town.

    Notes
    -----
    exp(-h/height) exp(-(azimuth difference/half width)^2), an empirical shape.
    """

    azimuth_deg: float  # where the town lies, from north by east, degrees
    luminance_cd_m2: float  # at the horizon above it, cd m-2; a dark zenith has 2.4e-4
    # Where it has fallen to 1/e: upwards and sideways, degrees.
    height_deg: float = 10.0
    half_width_deg: float = 35.0
    lamp: str = "high-pressure-sodium"  # kind of its lamps, one of `lamps.spectra.KINDS`

    def __post_init__(self) -> None:
        check(self, positive="height_deg half_width_deg", not_negative="luminance_cd_m2")
        _ = self.spectrum

    @property
    def spectrum(self) -> SourceSpectrum:
        """Radiance at the horizon above the town, W m-2 sr-1."""
        return spectrum(self.lamp, lumens=self.luminance_cd_m2)

    def shape(self, direction: Array) -> Array:
        """Return radiance relative to the maximum for directions (path, 3), shape (path,)."""
        elevation = np.rad2deg(np.arcsin(np.clip(direction[:, 2], 0.0, 1.0)))
        azimuth = np.rad2deg(np.arctan2(direction[:, 0], direction[:, 1])) - self.azimuth_deg
        relative_azimuth = (azimuth + 180.0) % 360.0 - 180.0
        return np.exp(
            -elevation / self.height_deg - np.square(relative_azimuth / self.half_width_deg)
        )


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
    bodies: tuple[
        Disc, ...
    ] = ()  # sun and moon, also when below the horizon, where they still make twilight
    # Strength of each over a dark site's, dimensionless.
    airglow: float = 1.0
    zodiacal: float = 1.0
    starlight: float = 1.0
    towns: tuple[TownGlow, ...] = ()  # glow of towns
    ground_albedo: float = 0.2  # albedo of the surrounding land, which lights the sky from below

    def __post_init__(self) -> None:
        check(self, not_negative="airglow zodiacal starlight", fraction="ground_albedo")

    @classmethod
    def at(
        cls,
        location: ObserverLocation,
        time: datetime,
        *,
        atmosphere: Atmosphere | None = None,
        **fields: object,
    ) -> "NightSky":
        """Return the sky over a place at a time with its zone; by default in air of 23 km of
        visibility.

        Other fields of the sky (`airglow`, `towns` and so on) are passed on.

        Raises BadInput if the time has no zone or lies outside 1900 to 2100.
        """
        air, positions = atmosphere or Atmosphere(), ephemeris(location, time)
        sunlight = sun_spectrum(positions.sun.distance_km / AU_KM).scale(positions.sun_share)
        bodies = tuple(
            Disc(
                name=name,
                direction=body.direction,
                angular_radius_rad=body.angular_radius_rad,
                extraterrestrial=light,
                atmosphere=air,
            )
            for name, body, light in (
                ("sun", positions.sun, sunlight),
                ("moon", positions.moon, moonlight(positions)),
            )
        )
        return cls(atmosphere=air, bodies=bodies, **fields)  # pyright: ignore[reportArgumentType]

    def discs(self) -> tuple[Disc, ...]:
        """Return sun and moon, those that stand above the horizon."""
        return tuple(body for body in self.bodies if body.visible_share > 0.0)

    def sources(self) -> tuple[SourceSpectrum, ...]:
        """Return the spectra that light the scene, for `spectral_grid`."""
        bodies = [body.extraterrestrial for body in self.bodies if body.elevation_deg > -LAST_DEG]
        return (*bodies, self._night(), *(town.spectrum for town in self.towns))

    def radiance(self, direction: Array, wavelength_nm: ArrayLike) -> Array:
        """Return the sky's radiance without the discs in directions (path, 3), W m-2 sr-1 nm-1,
        shape (band, path).

        On the complete spectral grid (band,), nm; zero below the horizon.
        """
        grid = require_grid(wavelength_nm)
        total = self._night_radiance(direction, grid)
        depth, _ = scattering.scattering_parts(self.atmosphere, grid)
        for body in self.bodies:
            if body.elevation_deg > 0.0:
                total += self._endless(body, direction, grid) * scattering.sky_depth(
                    depth, direction
                )
            glow = self._twilight(body)
            if glow is not None:
                total += glow.on(grid)[:, None] * twilight_shape(direction, body.direction)
        return total * (direction[:, 2] >= 0.0)

    def air_radiance(self, direction: Array, wavelength_nm: ArrayLike) -> Array:
        """Return the radiance of an endless level path of the air near the ground, shape (band,
        path).

        Notes
        -----
        The same scattering of sun and moon as in the sky, so that far hills fade into the horizon;
        of dusk and towns, half of the sphere is sky and half is ground of the albedo given.
        """
        grid = require_grid(wavelength_nm)
        total = np.zeros((grid.size, len(direction)))
        for body in self.bodies:
            if body.elevation_deg > 0.0:
                total += self._endless(body, direction, grid)
        directions, weight = scattering.sky_quadrature()
        cosine = weight * directions[:, 2]
        radiance = np.zeros(grid.size)
        for town in self.towns:
            radiance += town.spectrum.on(grid) * (town.shape(directions) @ cosine)
        for body in self.bodies:
            glow = self._twilight(body)
            if glow is not None:
                radiance += glow.on(grid) * (twilight_shape(directions, body.direction) @ cosine)
        isotropic = 0.5 * (1.0 + self.ground_albedo) / np.pi * radiance + self._night_air(grid)
        return total + isotropic[:, None]

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
        """Return the radiance of an endless path lit by one body; the sky it makes has the diffuse
        irradiance known.
        """
        depth, molecules = scattering.scattering_parts(self.atmosphere, grid)
        # Followed through the narrow bands of gases before it is put on the grid.
        diffuse = body.extraterrestrial.multiply(
            lambda nm: scattering.diffuse_share(
                self.atmosphere, body.elevation_deg, nm, self.ground_albedo
            )
        )
        per_shape = diffuse.on(grid) / scattering.level_irradiance(body.direction, depth, molecules)
        return per_shape[:, None] * scattering.endless_path(direction, body.direction, molecules)

    def _twilight(self, body: Disc) -> SourceSpectrum | None:
        return twilight_spectrum(
            body.elevation_deg, body.extraterrestrial.lumens / sun_spectrum().lumens
        )

    def _night(self) -> SourceSpectrum:
        dark = dark_sky()
        return sum_spectra(
            [
                dark.airglow.scale(self.airglow),
                dark.zodiacal.scale(self.zodiacal),
                dark.starlight.scale(self.starlight),
            ]
        )

    def _night_radiance(self, direction: Array, grid: Array) -> Array:
        """Return airglow, zodiacal light, stars and towns, shape (band, path).

        The air attenuates each part, and scatters the light lost isotropically up and down.
        """
        elevation = np.rad2deg(np.arcsin(np.clip(direction[:, 2], 0.0, 1.0)))
        zenith_direct, slant = (
            self._direct_fraction(np.array([90.0]), grid),
            self._direct_fraction(elevation, grid),
        )
        total = np.zeros((grid.size, len(direction)))
        for zenith, shape, air_glow in self._night_parts(elevation, grid):
            apparent_shape = shape * slant + air_glow * (1.0 - slant)
            total += (
                zenith[:, None]
                * apparent_shape
                / (zenith_direct + air_glow * (1.0 - zenith_direct))
            )
        for town in self.towns:
            total += town.spectrum.on(grid)[:, None] * town.shape(direction)
        return total

    def _night_air(self, grid: Array) -> Array:
        """Return the radiance of an endless path lit by airglow, zodiacal light and stars, shape
        (band,).
        """
        zenith_direct = self._direct_fraction(np.array([90.0]), grid)[:, 0]
        parts = self._night_parts(np.array([90.0]), grid)
        return np.sum(
            [
                zenith * air_glow / (zenith_direct + air_glow * (1.0 - zenith_direct))
                for zenith, _, air_glow in parts
            ],
            axis=0,
        )

    def _night_parts(
        self, elevation_deg: Array, grid: Array
    ) -> tuple[tuple[Array, Array, float], ...]:
        """Return zenith radiance, shape above the air and fraction along an endless path.

        The two parts are isotropic light and airglow. Half of the light that the air scatters comes
        from above, half from ground of the given albedo.
        """
        dark = dark_sky()
        isotropic = self.zodiacal * dark.zodiacal.on(grid) + self.starlight * dark.starlight.on(
            grid
        )
        glow = self.airglow * dark.airglow.on(grid)
        half = 0.5 * (1.0 + self.ground_albedo)
        return (
            (isotropic, np.ones(elevation_deg.shape), half),
            (glow, van_rhijn(elevation_deg), half * AIRGLOW_HEMISPHERE),
        )

    def _direct_fraction(self, elevation_deg: Array, grid: Array) -> Array:
        """Return the transmittance for isotropic light, shape (band, path).

        Haze scatters forward: only 1 - g of its depth counts.
        """
        air = self.atmosphere
        depth = air.molecules_depth(grid) + (1.0 - scattering.ASYMMETRY) * air.haze_depth(grid)
        return np.exp(-depth[:, None] * airmass(elevation_deg))
