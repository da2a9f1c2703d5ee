"""Ephemeris of sun and moon for an observer: directions, distances, phase, libration and eclipses."""

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput

AU_KM = 149_597_870.7
SUN_RADIUS_KM, MOON_RADIUS_KM, EARTH_RADIUS_KM = 695_700.0, 1737.4, 6371.0
FIRST_YEAR, LAST_YEAR = 1900, 2100


@dataclass(frozen=True, kw_only=True)
class ObserverLocation:
    """Location of an observer.

    Parameters
    ----------
    latitude_deg, longitude_deg
        Geodetic, north and east positive, degrees.
    altitude_m
        Over the sea, m.
    """

    latitude_deg: float
    longitude_deg: float
    altitude_m: float = 0.0

    def __post_init__(self) -> None:
        if not -90.0 <= self.latitude_deg <= 90.0:
            raise BadInput(f"latitude_deg must lie in [-90, 90], got {self.latitude_deg:g}")
        if not -180.0 <= self.longitude_deg <= 360.0:
            raise BadInput(f"longitude_deg must lie in [-180, 360], east positive, got {self.longitude_deg:g}")
        if not -500.0 <= self.altitude_m <= 9000.0:
            raise BadInput(f"altitude_m must lie in [-500, 9000], got {self.altitude_m:g}")


@dataclass(frozen=True, kw_only=True)
class Body:
    """Sun or moon for an observer, without refraction.

    Parameters
    ----------
    direction
        Unit vector: x east, y north, z up.
    distance_km
        From the observer, km.
    radius_km
        Of the body, km.
    """

    direction: tuple[float, float, float]
    distance_km: float
    radius_km: float

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
    def position_km(self) -> NDArray[np.float64]:
        """Vector from the observer, km."""
        return self.distance_km * np.asarray(self.direction)


@dataclass(frozen=True, kw_only=True)
class Ephemeris:
    """Sun and moon for an observer at one time.

    Parameters
    ----------
    sun, moon
        Where they stand.
    sun_selenographic_longitude_deg
        Of the point on the moon under the sun: positive before full moon, degrees.
    observer_selenographic_latitude_deg, observer_selenographic_longitude_deg
        Libration: the point on the moon under the observer, degrees.
    """

    sun: Body
    moon: Body
    sun_selenographic_longitude_deg: float
    observer_selenographic_latitude_deg: float
    observer_selenographic_longitude_deg: float

    @property
    def phase_deg(self) -> float:
        """Angle at the moon between sun and observer: 0 at full moon, degrees."""
        return angle_deg(self.sun.position_km - self.moon.position_km, -self.moon.position_km)

    @property
    def sunlit_share(self) -> float:
        """Fraction of the sun visible from the moon's centre, 0 in the umbra of the earth, dimensionless."""
        to_earth = np.array([0.0, 0.0, -EARTH_RADIUS_KM]) - self.moon.position_km
        to_sun = self.sun.position_km - self.moon.position_km
        sun, earth = (
            float(np.arcsin(radius / np.linalg.norm(way)))
            for radius, way in ((SUN_RADIUS_KM, to_sun), (EARTH_RADIUS_KM, to_earth))
        )
        return visible_disc_fraction(sun, earth, float(np.deg2rad(angle_deg(to_sun, to_earth))))

    @property
    def sun_share(self) -> float:
        """Fraction of the sun's disc that the moon does not cover for the observer, dimensionless."""
        apart = np.deg2rad(angle_deg(self.sun.position_km, self.moon.position_km))
        return visible_disc_fraction(self.sun.angular_radius_rad, self.moon.angular_radius_rad, float(apart))


def ephemeris(place: ObserverLocation, time: datetime) -> Ephemeris:
    """Return sun and moon for an observer at a time, topocentric and without refraction.

    Parameters
    ----------
    place
        Where.
    time
        When; must know its time zone.

    Raises
    ------
    BadInput
        If the time has no zone, or lies outside 1900 to 2100.

    Notes
    -----
    PyEphem (VSOP87, a moon of a few arc seconds) with no air; within 10" of DE421.
    """
    import ephem

    observer = ephem.Observer()
    observer.lat, observer.lon = str(place.latitude_deg), str(place.longitude_deg)
    observer.elevation, observer.pressure = place.altitude_m, 0.0
    observer.date = ephem.Date(_universal(time).replace(tzinfo=None))
    sun, moon = ephem.Sun(observer), ephem.Moon(observer)
    return Ephemeris(
        sun=_body(sun, SUN_RADIUS_KM),
        moon=_body(moon, MOON_RADIUS_KM),
        sun_selenographic_longitude_deg=_wrap_angle(90.0 - np.rad2deg(float(moon.colong))),
        observer_selenographic_latitude_deg=float(np.rad2deg(float(moon.libration_lat))),
        observer_selenographic_longitude_deg=float(np.rad2deg(float(moon.libration_long))),
    )


def _universal(time: datetime) -> datetime:
    if time.tzinfo is None:
        raise BadInput(f"a time must know its zone, as in 2024-02-24T06:00:00Z, got {time.isoformat()}")
    universal = time.astimezone(UTC)
    if not FIRST_YEAR <= universal.year <= LAST_YEAR:
        raise BadInput(f"a time must lie between {FIRST_YEAR} and {LAST_YEAR}, got {universal.isoformat()}")
    return universal


def _body(found: object, radius_km: float) -> Body:
    elevation, azimuth = float(found.alt), float(found.az)  # pyright: ignore[reportAttributeAccessIssue]
    distance_km = float(found.earth_distance) * AU_KM  # pyright: ignore[reportAttributeAccessIssue]
    level = np.cos(elevation)
    direction = (float(level * np.sin(azimuth)), float(level * np.cos(azimuth)), float(np.sin(elevation)))
    return Body(direction=direction, distance_km=distance_km, radius_km=radius_km)


def _wrap_angle(angle: float) -> float:
    return float((angle + 180.0) % 360.0 - 180.0)


def angle_deg(one: NDArray[np.floating], other: NDArray[np.floating]) -> float:
    """Return the angle between two vectors, degrees, exact for small ones."""
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(one, other)), np.dot(one, other))))


def visible_disc_fraction(radius: float, cover_radius: float, apart: float) -> float:
    """Return the fraction of a disc that another one in front of it does not cover; radii and distance in rad."""
    if apart >= radius + cover_radius:
        return 1.0
    if apart <= abs(radius - cover_radius):
        return max(0.0, 1.0 - (cover_radius / radius) ** 2)
    own = (apart**2 + radius**2 - cover_radius**2) / (2.0 * apart * radius)
    others = (apart**2 + cover_radius**2 - radius**2) / (2.0 * apart * cover_radius)
    kite = 0.5 * np.sqrt(
        (radius + cover_radius - apart)
        * (apart + radius - cover_radius)
        * (apart - radius + cover_radius)
        * (apart + radius + cover_radius)
    )
    covered = radius**2 * np.arccos(own) + cover_radius**2 * np.arccos(others) - kite
    return float(1.0 - covered / (np.pi * radius**2))
