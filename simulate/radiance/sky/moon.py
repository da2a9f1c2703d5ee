"""Sun and moon for an observer: ephemeris, spectra (of the moon by the ROLO model), and discs as
light sources.
"""

from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from labdata.errors import BadInput, check_range
from simulate.arrays import Array
from simulate.radiance.atmosphere import Atmosphere
from simulate.radiance.spectrum import SourceSpectrum, require_grid, table

AU_KM = 149_597_870.7
SUN_RADIUS_KM, EARTH_RADIUS_KM = 695_700.0, 6371.0


@dataclass(frozen=True, kw_only=True)
class ObserverLocation:
    """Location of an observer."""

    # Geodetic, north and east positive, degrees.
    latitude_deg: float
    longitude_deg: float
    altitude_m: float = 0.0  # over the sea, m

    def __post_init__(self) -> None:
        check_range(self, -90.0, 90.0, "latitude_deg")
        check_range(self, -180.0, 360.0, "longitude_deg", of=", east positive")
        check_range(self, -500.0, 9000.0, "altitude_m")


@dataclass(frozen=True, kw_only=True)
class Body:
    """Sun or moon for an observer, without refraction."""

    direction: tuple[float, float, float]  # unit vector: x east, y north, z up
    distance_km: float  # from the observer, km
    radius_km: float  # of the body, km

    @property
    def elevation_deg(self) -> float:
        """Height of the centre over the horizon, degrees."""
        return float(np.rad2deg(np.arcsin(np.clip(self.direction[2], -1.0, 1.0))))

    @property
    def azimuth_deg(self) -> float:
        """From north by east, degrees in [0, 360)."""
        return float(np.rad2deg(np.arctan2(self.direction[0], self.direction[1])) % 360.0)

    @property
    def angular_radius_rad(self) -> float:
        """Radius of the disc, rad."""
        return float(np.arcsin(self.radius_km / self.distance_km))

    @property
    def position_km(self) -> Array:
        """Vector from the observer, km."""
        return self.distance_km * np.asarray(self.direction)


@dataclass(frozen=True, kw_only=True)
class Ephemeris:
    """Sun and moon for an observer at one time."""

    # Where they stand.
    sun: Body
    moon: Body
    # of the point on the moon under the sun: positive before full moon, degrees
    sun_selenographic_longitude_deg: float
    # Libration: the point on the moon under the observer, degrees.
    observer_selenographic_latitude_deg: float
    observer_selenographic_longitude_deg: float

    @property
    def phase_deg(self) -> float:
        """Angle at the moon between sun and observer: 0 at full moon, degrees."""
        return angle_deg(self.sun.position_km - self.moon.position_km, -self.moon.position_km)

    @property
    def sunlit_share(self) -> float:
        """Fraction of the sun visible from the moon's centre, 0 in the umbra of the earth,
        dimensionless.
        """
        to_earth = np.array([0.0, 0.0, -EARTH_RADIUS_KM]) - self.moon.position_km
        to_sun = self.sun.position_km - self.moon.position_km
        sun, earth = (
            float(np.arcsin(radius / np.linalg.norm(direction)))
            for radius, direction in ((SUN_RADIUS_KM, to_sun), (EARTH_RADIUS_KM, to_earth))
        )
        return visible_disc_fraction(sun, earth, float(np.deg2rad(angle_deg(to_sun, to_earth))))

    @property
    def sun_share(self) -> float:
        """Fraction of the sun's disc that the moon does not cover for the observer,
        dimensionless.
        """
        separation_rad = np.deg2rad(angle_deg(self.sun.position_km, self.moon.position_km))
        return visible_disc_fraction(
            self.sun.angular_radius_rad, self.moon.angular_radius_rad, float(separation_rad)
        )


def ephemeris(location: ObserverLocation, time: datetime) -> Ephemeris:
    """Return sun and moon for an observer at a time with its zone, topocentric and without
    refraction.

    Raises BadInput if the time has no zone, or lies outside 1900 to 2100.

    Notes
    -----
    PyEphem (VSOP87, a moon of a few arc seconds) with no air; within 10" of DE421.
    """
    import ephem

    if time.tzinfo is None:
        raise BadInput(
            f"a time must know its zone, as in 2024-02-24T06:00:00Z, got {time.isoformat()}"
        )
    universal = time.astimezone(UTC)
    if not 1900 <= universal.year <= 2100:
        raise BadInput(f"a time must lie between 1900 and 2100, got {universal.isoformat()}")
    observer = ephem.Observer()
    observer.lat, observer.lon = str(location.latitude_deg), str(location.longitude_deg)
    observer.elevation, observer.pressure = location.altitude_m, 0.0
    observer.date = ephem.Date(universal.replace(tzinfo=None))
    sun, moon = ephem.Sun(observer), ephem.Moon(observer)
    return Ephemeris(
        sun=_body(sun, SUN_RADIUS_KM),
        moon=_body(moon, 1737.4),
        sun_selenographic_longitude_deg=float(
            (90.0 - np.rad2deg(float(moon.colong)) + 180.0) % 360.0 - 180.0
        ),
        observer_selenographic_latitude_deg=float(np.rad2deg(float(moon.libration_lat))),
        observer_selenographic_longitude_deg=float(np.rad2deg(float(moon.libration_long))),
    )


def _body(ephemeris_body: object, radius_km: float) -> Body:
    elevation, azimuth = float(ephemeris_body.alt), float(ephemeris_body.az)  # pyright: ignore[reportAttributeAccessIssue]
    distance_km = float(ephemeris_body.earth_distance) * AU_KM  # pyright: ignore[reportAttributeAccessIssue]
    level = np.cos(elevation)
    direction = (
        float(level * np.sin(azimuth)),
        float(level * np.cos(azimuth)),
        float(np.sin(elevation)),
    )
    return Body(direction=direction, distance_km=distance_km, radius_km=radius_km)


def angle_deg(vector: Array, other_vector: Array) -> float:
    """Return the angle between two vectors, degrees, exact for small ones."""
    return float(
        np.rad2deg(
            np.arctan2(np.linalg.norm(np.cross(vector, other_vector)), np.dot(vector, other_vector))
        )
    )


def visible_disc_fraction(radius: float, cover_radius: float, separation: float) -> float:
    """Return the fraction of a disc that another one in front of it does not cover; radii and
    distance in rad.
    """
    if separation >= radius + cover_radius:
        return 1.0
    if separation <= abs(radius - cover_radius):
        return max(0.0, 1.0 - (cover_radius / radius) ** 2)
    cosine_at_disc = (separation**2 + radius**2 - cover_radius**2) / (2.0 * separation * radius)
    cosine_at_cover = (separation**2 + cover_radius**2 - radius**2) / (
        2.0 * separation * cover_radius
    )
    kite = 0.5 * np.sqrt(
        (radius + cover_radius - separation)
        * (separation + radius - cover_radius)
        * (separation - radius + cover_radius)
        * (separation + radius + cover_radius)
    )
    covered_area = (
        radius**2 * np.arccos(cosine_at_disc) + cover_radius**2 * np.arccos(cosine_at_cover) - kite
    )
    return float(1.0 - covered_area / (np.pi * radius**2))


def sun_spectrum(distance_au: float = 1.0) -> SourceSpectrum:
    """Return the sun's irradiance normal to the beam, W m-2, at a distance in astronomical units.

    Notes
    -----
    ASTM G173-03's extraterrestrial spectrum in steps of 5 nm: Fraunhofer lines are averaged,
    133,100 lux are kept.
    """
    sun = table("sun")
    return SourceSpectrum(
        wavelength_nm=sun["wavelength_nm"],
        density=sun["irradiance_w_m2_nm"] / np.square(distance_au),
    )


STANDARD_KM = 384_400.0


def band_reflectance(
    phase_deg: float,
    sun_longitude_deg: float | None = None,
    observer_latitude_deg: float = 0.0,
    observer_longitude_deg: float = 0.0,
) -> tuple[Array, Array]:
    """Return the model's bands, nm, and the disc-equivalent reflectance of the moon at them, both
    of shape (band,).

    By the angle at the moon between sun and observer, the selenographic longitude of the sun
    (positive before full moon; by default the phase), and the selenographic position of the
    observer, degrees.

    Notes
    ----- ln A = sum a_i g^i + sum b_j P^(2j-1) + c1 th + c2 ph + c3 P th + c4 P ph + d1 exp(-g/p1)
    + d2 exp(-g/p2) + d3 cos((g - p3)/p4) (Kieffer and Stone, Astron. J. 129, 2887, 2005, eq. 10,
    model 311g). Fitted for phases from 1.55 to 97 degrees; it is used beyond, where it stays within
    0.35 mag of Allen's phase curve up to 150 degrees.
    """
    rolo = table("rolo")
    phase = np.deg2rad(phase_deg)
    sun = np.deg2rad(phase_deg if sun_longitude_deg is None else sun_longitude_deg)
    logarithm = sum(rolo[f"a{i}"] * phase**i for i in range(4))
    logarithm = logarithm + sum(rolo[f"b{j}"] * sun ** (2 * j - 1) for j in (1, 2, 3))
    # Terms common to all bands: libration (per degree), and the widths of the opposition surge,
    # degrees.
    c1, c2, c3, c4 = (0.00034115, -0.0013425, 0.00095906, 0.00066229)
    logarithm = (
        logarithm
        + (c1 + c3 * sun) * observer_latitude_deg
        + (c2 + c4 * sun) * observer_longitude_deg
    )
    p1, p2, p3, p4 = (4.06054, 12.8802, -30.5858, 16.7498)
    surge = rolo["d1"] * np.exp(-phase_deg / p1) + rolo["d2"] * np.exp(-phase_deg / p2)
    ripple = rolo["d3"] * np.cos((phase_deg - p3) / p4)
    return rolo["wavelength_nm"], np.exp(logarithm + surge + ripple)


@cache
def _smoother() -> Array:
    """Return the matrix that takes values at the bands to polynomial coefficients, by least
    squares.
    """
    # ln A is smoothed over wavelength by a polynomial: the bands' own calibration scatters by a few
    # percent.
    powers = np.vander(_scale_wavelength(table("rolo")["wavelength_nm"]), 3 + 1)
    return np.asarray(np.linalg.pinv(powers), float)


def _scale_wavelength(wavelength_nm: Array) -> Array:
    return (np.asarray(wavelength_nm, float) - 700.0) / 350.0


def moon_reflectance(wavelength_nm: ArrayLike, *geometry: float) -> Array:
    """Return the reflectance at any wavelengths, smoothed over the bands; geometry as for
    `band_reflectance`.

    Outside 405 to 1059.5 nm it is that of the nearer end.
    """
    bands, reflectance = band_reflectance(*geometry)
    limited_nm = np.clip(np.asarray(wavelength_nm, float), bands[0], bands[-1])
    return np.exp(np.polyval(_smoother() @ np.log(reflectance), _scale_wavelength(limited_nm)))


def moon_spectrum(
    *geometry: float, moon_distance_km: float = STANDARD_KM, sun_distance_au: float = 1.0
) -> SourceSpectrum:
    """Return the moon's irradiance before the atmosphere, W m-2, by phase and libration as for
    `band_reflectance`.

    Notes
    -----
    E = A Omega / pi E_sun / (d_sun/AU)^2 (384,400 km / d_moon)^2, Omega 6.4177e-5 sr.
    """
    albedo_factor = 6.4177e-5 / np.pi * (STANDARD_KM / moon_distance_km) ** 2
    return sun_spectrum(sun_distance_au).multiply(
        lambda nm: albedo_factor * moon_reflectance(nm, *geometry)
    )


def moonlight(positions: Ephemeris) -> SourceSpectrum:
    """Return the moon's irradiance before the atmosphere, W m-2, at a place and time; dark in an
    eclipse's umbra.
    """
    from_sun = positions.sun.position_km - positions.moon.position_km
    light = moon_spectrum(
        positions.phase_deg,
        positions.sun_selenographic_longitude_deg,
        positions.observer_selenographic_latitude_deg,
        positions.observer_selenographic_longitude_deg,
        moon_distance_km=positions.moon.distance_km,
        sun_distance_au=float(np.linalg.norm(from_sun)) / AU_KM,
    )
    return light.scale(positions.sunlit_share)


@dataclass(frozen=True, kw_only=True, eq=False)
class Disc:
    """Sun or moon."""

    name: str  # "sun" or "moon"
    direction: tuple[float, float, float]  # unit vector (x east, y north, z up) to its centre
    angular_radius_rad: float  # radius, rad
    extraterrestrial: SourceSpectrum  # irradiance before the atmosphere, normal to the beam, W m-2
    atmosphere: Atmosphere  # air that its light crosses

    @property
    def elevation_deg(self) -> float:
        """Height of the centre over the horizon, degrees."""
        return float(np.rad2deg(np.arcsin(np.clip(self.direction[2], -1.0, 1.0))))

    @property
    def visible_share(self) -> float:
        """Fraction of the disc above a level horizon, dimensionless."""
        height = np.clip(np.deg2rad(self.elevation_deg) / self.angular_radius_rad, -1.0, 1.0)
        return float(0.5 + (np.arcsin(height) + height * np.sqrt(1.0 - height**2)) / np.pi)

    def irradiance(self, wavelength_nm: ArrayLike) -> Array:
        """Return the irradiance at the ground, normal to the beam, on the complete grid, W m-2
        nm-1; zero when set.
        """
        grid = require_grid(wavelength_nm)
        # Absorption bands of gases are narrower than spectral bands: transmittance is applied
        # before averaging.
        air, height = self.atmosphere, self.elevation_deg
        transmitted = self.extraterrestrial.multiply(
            lambda nm: air.slant_transmittance(height, nm)[:, 0]
        )
        return self.visible_share * transmitted.on(grid)
