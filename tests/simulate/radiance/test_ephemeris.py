"""Sun and moon stand where an independent ephemeris has them, and eclipses happen on their days."""

from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest

from labdata import BadInput
from simulate.radiance.sky import ObserverLocation, ephemeris, visible_disc_fraction

ROCHESTER = ObserverLocation(latitude_deg=43.16, longitude_deg=-77.61, altitude_m=150.0)


def cases(count=50):
    """Random places and times of 1998 to 2024, for which the earth's rotation is known without a
    download.
    """
    rng = np.random.default_rng(17)
    start = datetime(1998, 1, 1, tzinfo=UTC)
    for _ in range(count):
        place = ObserverLocation(
            latitude_deg=float(np.rad2deg(np.arcsin(rng.uniform(-1.0, 1.0)))),
            longitude_deg=float(rng.uniform(-180.0, 180.0)),
            altitude_m=float(rng.uniform(0.0, 4000.0)),
        )
        yield place, start + timedelta(days=float(rng.uniform(0.0, 9800.0)))


def by_astropy(body, places, times):
    """Topocentric unit vectors (east, north, up) without air, and distances in km, by astropy's
    built-in ephemeris.
    """
    from astropy import units
    from astropy.coordinates import AltAz, EarthLocation, get_body
    from astropy.time import Time
    from astropy.utils import iers

    iers.conf.auto_download = False
    location = EarthLocation.from_geodetic(
        [place.longitude_deg for place in places] * units.deg,
        [place.latitude_deg for place in places] * units.deg,
        [place.altitude_m for place in places] * units.m,
    )
    when = Time(times, scale="utc")
    found = get_body(body, when, location, ephemeris="builtin").transform_to(
        AltAz(obstime=when, location=location, pressure=0.0 * units.hPa)
    )
    up, around = found.alt.rad, found.az.rad
    way = np.column_stack([np.cos(up) * np.sin(around), np.cos(up) * np.cos(around), np.sin(up)])
    return way, found.distance.to_value(units.km)


@pytest.mark.parametrize(("body", "distance"), [("moon", 3e-4), ("sun", 1e-4)])
def test_sun_and_moon_stand_within_a_fiftieth_of_a_degree_of_astropy(body, distance):
    chosen = list(cases())
    places, times = (
        [place for place, _ in chosen],
        [time.replace(tzinfo=None) for _, time in chosen],
    )
    direction, range_km = by_astropy(body, places, times)
    ours = [getattr(ephemeris(place, time), body) for place, time in chosen]
    apart = np.linalg.norm(direction - np.array([one.direction for one in ours]), axis=1)
    assert np.rad2deg(apart.max()) < 0.02
    assert np.abs(np.array([one.distance_km for one in ours]) / range_km - 1.0).max() < distance


def test_the_phase_is_that_of_the_place_and_not_of_the_earths_centre():
    """Two places that see the moon at the same time from 12,000 km apart see phases up to 2 degrees
    apart.
    """
    time = datetime(2024, 2, 24, 12, 30, tzinfo=UTC)
    phases = [
        ephemeris(ObserverLocation(latitude_deg=lat, longitude_deg=lon), time).phase_deg
        for lat, lon in ((60.0, 170.0), (-60.0, 170.0))
    ]
    assert 0.2 < abs(phases[0] - phases[1]) < 2.0


def test_a_time_zone_changes_nothing_but_the_writing():
    east = timezone(timedelta(hours=-4))
    one = ephemeris(ROCHESTER, datetime(1998, 6, 24, 2, tzinfo=east))
    other = ephemeris(ROCHESTER, datetime(1998, 6, 24, 6, tzinfo=UTC))
    assert one == other
    # Two hours after new moon.
    assert one.phase_deg > 170.0


def test_the_moon_of_14_march_2025_is_eclipsed_and_the_next_nights_is_not():
    assert ephemeris(ROCHESTER, datetime(2025, 3, 14, 6, 59, tzinfo=UTC)).sunlit_share == 0.0
    assert ephemeris(ROCHESTER, datetime(2025, 3, 15, 6, 59, tzinfo=UTC)).sunlit_share == 1.0


def test_the_sun_of_8_april_2024_is_covered_over_rochester_at_19_22():
    assert ephemeris(ROCHESTER, datetime(2024, 4, 8, 19, 21, 30, tzinfo=UTC)).sun_share == 0.0
    assert 0.0 < ephemeris(ROCHESTER, datetime(2024, 4, 8, 18, 40, tzinfo=UTC)).sun_share < 1.0
    assert ephemeris(ROCHESTER, datetime(2024, 4, 8, 16, 0, tzinfo=UTC)).sun_share == 1.0


def test_a_half_covered_disc_agrees_with_counting():
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, 1001), np.linspace(-1.0, 1.0, 1001))
    disc = np.hypot(x, y) < 1.0
    for cover, apart in ((1.5, 1.2), (0.5, 0.9), (3.0, 2.6), (0.4, 0.2)):
        free = disc & (np.hypot(x - apart, y) >= cover)
        assert visible_disc_fraction(1.0, cover, apart) == pytest.approx(
            free.sum() / disc.sum(), abs=3e-3
        )


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: ephemeris(ROCHESTER, datetime(2024, 2, 24, 6)), "must know its zone"),
        (lambda: ephemeris(ROCHESTER, datetime(2350, 1, 1, tzinfo=UTC)), "between 1900 and 2100"),
        (
            lambda: ObserverLocation(latitude_deg=91.0, longitude_deg=0.0),
            r"latitude_deg must lie between -90 and 90, got 91",
        ),
        (
            lambda: ObserverLocation(latitude_deg=0.0, longitude_deg=400.0),
            "longitude_deg must lie between",
        ),
    ],
)
def test_impossible_places_and_times_are_refused_in_a_sentence(make, says):
    with pytest.raises(BadInput, match=says):
        make()
