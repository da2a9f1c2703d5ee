"""Sun and moon by an independent ephemeris and by tables of moonlight; no light is lost
between wavelengths.
"""

from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest

from labdata import BadInput
from simulate.camera import JOULE_METRE, detection_weights, quantum_efficiency
from simulate.radiance import Atmosphere, SourceSpectrum, band_widths, spectral_grid, sum_spectra
from simulate.radiance.lamps import spectra, spectrum
from simulate.radiance.outdoor import render_settings
from simulate.radiance.sky import (
    Disc,
    NightSky,
    ObserverLocation,
    ephemeris,
    moon_reflectance,
    moon_spectrum,
    sun_spectrum,
    visible_disc_fraction,
)

# Sun and moon stand where an independent ephemeris has them, and the moon shines as tables have
# it.


# Sun and moon stand where an independent ephemeris has them, and eclipses happen on their days.


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


# Moonlight by phase, colour and distance against the reference tables of the ROLO model and
# Allen's phase curve.


# Phase, lux, mW m-2 um-1 at 550, 700 and 850 nm (means over 21 nm) and over 500 to 900 nm, above
# the atmosphere.
TABLE = [
    (0.0, 0.431, 5.88, 5.42, 4.31, 5.30),
    (2.0, 0.358, 4.89, 4.52, 3.60, None),
    (5.0, 0.299, 4.07, 3.80, 3.04, 3.71),
    (7.0, 0.274, 3.73, 3.50, 2.81, 3.42),
    (10.0, 0.248, 3.37, 3.19, 2.56, 3.10),
    (30.0, 0.152, 2.06, 2.01, 1.64, 1.94),
    (60.0, 0.0742, 1.00, 1.00, 0.834, 0.969),
    (90.0, 0.0306, 0.414, 0.418, 0.351, 0.403),
    (120.0, 0.0086, 0.116, 0.119, 0.098, 0.114),
]
# Magnitude of 1 lux, from the table's first row.
LUX_MAGNITUDE = -13.02 + 2.5 * np.log10(0.431)


@pytest.mark.parametrize(("phase", "lux", "at_550", "at_700", "at_850", "mean"), TABLE)
def test_moonlight_over_phase(phase, lux, at_550, at_700, at_850, mean):
    moon = moon_spectrum(phase)
    assert moon.lumens == pytest.approx(lux, rel=0.03)
    for centre, expected in ((550.0, at_550), (700.0, at_700), (850.0, at_850)):
        assert 1e6 * moon.total(centre - 10.5, centre + 10.5) / 21.0 == pytest.approx(
            expected, rel=0.035
        )
    if mean is not None:
        assert 1e6 * moon.total(500.0, 900.0) / 400.0 == pytest.approx(mean, rel=0.03)


@pytest.mark.parametrize("phase", [2.0, 5.0, 7.0, 10.0, 30.0, 60.0, 90.0, 120.0, 150.0])
def test_moonlight_follows_allens_phase_curve(phase):
    """V = -12.73 + 0.026 g + 4e-9 g^4 (Allen, Astrophysical Quantities); at 0 the surge is 0.3 mag
    above it.
    """
    allen = -12.73 + 0.026 * phase + 4e-9 * phase**4
    assert LUX_MAGNITUDE - 2.5 * np.log10(moon_spectrum(phase).lumens) == pytest.approx(
        allen, abs=0.2
    )


@pytest.mark.parametrize(
    ("nm", "ratio"),
    [
        (400.0, 0.78),
        (450.0, 0.81),
        (500.0, 0.90),
        (600.0, 1.08),
        (700.0, 1.19),
        (800.0, 1.34),
        (900.0, 1.37),
    ],
)
def test_moonlight_is_redder_than_sunlight(nm, ratio):
    reflectance = moon_reflectance(np.array([nm, 550.0]), 5.0)
    # Single bands of the reference scatter by a few percent, which smoothing takes out.
    assert reflectance[0] / reflectance[1] == pytest.approx(ratio, rel=0.05)


def test_the_sun_is_445_000_nearly_full_moons():
    assert sun_spectrum().lumens / moon_spectrum(5.0).lumens == pytest.approx(445_000, rel=0.01)
    assert moon_spectrum(5.0).total(400.0, 950.0) == pytest.approx(1.96e-3, rel=0.01)


@pytest.mark.parametrize(("moon_km", "factor"), [(356_500.0, 1.163), (406_700.0, 0.893)])
def test_perigee_is_brighter_than_apogee(moon_km, factor):
    assert moon_spectrum(30.0, moon_distance_km=moon_km).lumens / moon_spectrum(
        30.0
    ).lumens == pytest.approx(factor, rel=1e-3)


def test_libration_changes_the_moon_by_a_percent_or_so():
    middle = moon_spectrum(30.0).lumens
    for libration in ((7.0, 0.0), (0.0, 7.0), (-7.0, -7.0)):
        assert 1e-3 < abs(moon_spectrum(30.0, 30.0, *libration).lumens / middle - 1.0) < 0.03


# Moon of phase 5 degrees on level ground, SPECTRL2 with an aerosol depth of 0.1 at 500 nm and 1.5
# cm of water.
@pytest.mark.parametrize(
    ("zenith", "lux"), [(0.0, 0.277), (30.0, 0.236), (60.0, 0.124), (75.0, 0.053)]
)
def test_moonlight_on_the_ground(zenith, lux):
    depth = 0.1 * (550.0 / 500.0) ** -1.3
    air = Atmosphere(visibility_km=3.912 / (depth / 1.2 + 0.0971 / 8.43), relative_humidity=0.485)
    assert air.precipitable_cm == pytest.approx(1.5, rel=0.02)
    height = np.deg2rad(90.0 - zenith)
    moon = Disc(
        name="moon",
        direction=(float(np.cos(height)), 0.0, float(np.sin(height))),
        angular_radius_rad=0.0045,
        extraterrestrial=moon_spectrum(5.0),
        atmosphere=air,
    )
    sky = NightSky(atmosphere=air, bodies=(moon,), airglow=0.0, zodiacal=0.0, starlight=0.0)
    assert sky.illuminance_lux() == pytest.approx(lux, rel=0.03)


# No light is lost between the wavelengths of a grid, and no more of them are taken than the sensor
# needs.


@pytest.mark.parametrize("kind", [*spectra.KINDS, "moon", "dark sky"])
def test_any_grid_keeps_all_power_and_its_mean_wavelength(kind, seed):
    """A weight that is linear in wavelength is integrated exactly, however coarse and uneven the
    grid.
    """
    light = {"moon": moon_spectrum(5.0), "dark sky": NightSky().sources()[-1]}.get(
        kind
    ) or spectrum(kind, lumens=100.0)
    rng = np.random.default_rng([seed, len(kind)])
    for bands in (2, 5, 40):
        grid = np.sort(np.concatenate([[300.0, 1200.0], rng.uniform(300.0, 1200.0, bands - 2)]))
        weight = (grid - 300.0) * band_widths(grid)
        expected = light.through([300.0, 1200.0], [0.0, 900.0])
        assert np.sum(light.on(grid) * weight) == pytest.approx(expected, rel=1e-9)
        assert np.sum(light.on(grid) * band_widths(grid)) == pytest.approx(
            light.total(300.0, 1200.0), rel=1e-9
        )


def test_light_outside_the_grid_is_not_folded_in():
    line = SourceSpectrum(
        wavelength_nm=np.array([300.0, 1200.0]),
        density=np.zeros(2),
        line_nm=(589.0,),
        line_power=(1.0,),
    )
    assert np.sum(line.on(np.array([600.0, 700.0, 800.0]))) == 0.0
    assert np.sum(spectrum("led-cool").on(np.array([900.0, 1000.0]))) == 0.0


def response(sheet):
    """The tube's photoelectrons per W, over its own wavelengths."""
    nm = np.asarray(sheet.photocathode.wavelength_nm)
    return nm, quantum_efficiency(sheet, nm) * nm * 1e-9 / JOULE_METRE


@pytest.mark.parametrize("kind", spectra.KINDS)
def test_every_line_is_on_the_grid(sheet, kind):
    light = spectrum(kind)
    grid = spectral_grid([light], *response(sheet))
    inside = [nm for nm in light.line_nm if grid[0] < nm < grid[-1]]
    assert set(inside) <= set(grid.tolist())


@pytest.mark.parametrize("tolerance", [0.02, 0.003])
def test_photoelectrons_on_the_grid_are_those_of_the_whole_spectrum(sheet, tolerance):
    """Also through a leaf, whose reflectance jumps at 700 nm, which the grid was told of."""
    nm, per_watt = response(sheet)
    leaf = np.array([400.0, 650.0, 690.0, 740.0, 950.0]), np.array([0.05, 0.04, 0.06, 0.42, 0.45])
    lights = [spectrum(kind) for kind in spectra.KINDS] + [
        moon_spectrum(5.0),
        *NightSky().sources(),
    ]
    grid = spectral_grid(lights, nm, per_watt, tolerance=tolerance, spectra=[leaf])
    width = band_widths(grid)
    for light in lights:
        for table in (None, leaf):

            def seen(at, table=table):
                reflected = 1.0 if table is None else np.interp(at, *table)
                return np.interp(at, nm, per_watt, left=0.0, right=0.0) * reflected

            fine = np.union1d(
                np.linspace(grid[0], grid[-1], 2001), np.concatenate([nm, leaf[0][1:-1]])
            )
            expected = light.through(fine, seen(fine))
            assert np.sum(light.on(grid) * width * seen(grid)) == pytest.approx(
                expected, rel=1.2 * tolerance
            )


def filtered(middle_nm, width_nm, edge_nm=0.2):
    """A detector behind a filter with steep edges: wavelengths and efficiency."""
    half = 0.5 * width_nm
    edges = [
        middle_nm - half - edge_nm,
        middle_nm - half,
        middle_nm + half,
        middle_nm + half + edge_nm,
    ]
    return np.array([400.0, *edges, 950.0]), np.array([0.0, 0.0, 0.5, 0.5, 0.0, 0.0])


def detected(light, nm, efficiency):
    """Photons of a rendered light that a detector detects, as lens and detector take them from a
    picture's bands.
    """
    fine = np.union1d(nm, np.arange(nm[0], nm[-1], 5.0))
    per_watt = np.interp(fine, nm, efficiency) * fine * 1e-9 / JOULE_METRE
    grid = spectral_grid(
        [light], fine, per_watt, tolerance=render_settings.RENDER_LIMITS.max_spectral_error
    )
    return light.on(grid) @ detection_weights(grid, nm, efficiency, averaged=True)


BROAD = (
    np.array([400.0, 500.0, 600.0, 700.0, 900.0, 950.0]),
    np.array([0.1, 0.4, 0.42, 0.38, 0.1, 0.0]),
)


@pytest.mark.parametrize("detector", [BROAD, filtered(589.3, 5.0), filtered(590.1, 10.0)])
def test_a_watt_of_low_pressure_sodium_is_detected_line_by_line(detector):
    """The closed form: power, efficiency and energy of a photon at 589.0 and 589.6 nm, in the
    shares 2 to 1.
    """
    light = spectrum("low-pressure-sodium", watts=1.0)
    exact = sum(
        share / 3.0 * np.interp(line, *detector) * line * 1e-9 / JOULE_METRE
        for line, share in ((589.0, 2.0), (589.6, 1.0))
    )
    assert detected(light, *detector) == pytest.approx(exact, rel=0.001)


@pytest.mark.parametrize(("width_nm", "middle_nm"), [(5.0, 612.37), (10.0, 800.7)])
def test_even_light_through_a_steep_filter_keeps_the_filters_area(width_nm, middle_nm):
    """A watt per nm: 0.5 (width + one edge) lambda / (h c), of bands of a rendering and of bands
    that a file states.
    """
    nm, efficiency = filtered(middle_nm, width_nm)
    exact = 0.5 * (width_nm + 0.2) * middle_nm * 1e-9 / JOULE_METRE
    even = SourceSpectrum(wavelength_nm=np.array([300.0, 1200.0]), density=np.ones(2))
    assert detected(even, nm, efficiency) == pytest.approx(exact, rel=0.001)
    assert detection_weights([400.0, 700.0, 950.0], nm, efficiency).sum() == pytest.approx(
        exact, rel=1e-6
    )


def test_a_smooth_light_needs_few_bands_and_a_tighter_tolerance_more(sheet):
    sensor = response(sheet)
    loose, tight = (
        spectral_grid([moon_spectrum(5.0)], *sensor, tolerance=x) for x in (0.02, 0.001)
    )
    assert loose.size < 16 < tight.size < 60
    lines = spectral_grid([spectrum("mercury")], *sensor, tolerance=0.02)
    assert lines.size > loose.size


def test_spectra_add():
    parts = [spectrum("mercury"), spectrum("low-pressure-sodium", lumens=3.0)]
    assert sum_spectra(parts).lumens == pytest.approx(4.0, rel=1e-3)
    half = parts[0].multiply(lambda nm: np.full(np.shape(nm), 0.5))
    assert half.lumens == pytest.approx(0.5)


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
        (lambda: spectral_grid([], [400.0, 500.0], [0.0, 0.0]), "must respond at some wavelength"),
        (
            lambda: spectral_grid([], [400.0, 500.0], [1.0, 1.0], tolerance=0.0),
            "must be positive, got 0",
        ),
        (lambda: spectrum("mercury").on([500.0]), "at least two bands"),
        (lambda: spectrum("mercury").on([500.0, 400.0]), "must be positive and ascend"),
    ],
)
def test_impossible_places_times_and_grids_are_refused_in_a_sentence(make, says):
    with pytest.raises(BadInput, match=says):
        make()
