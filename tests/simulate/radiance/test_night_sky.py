"""The sky by day, dusk and night: right amounts, right sides, and no jumps as sun and moon set;
without a moon the bands, the luminance and the slope that were measured.
"""

from datetime import UTC, datetime

import numpy as np
import pytest

from labdata import BadInput
from simulate.radiance import Atmosphere, airmass, band_widths, luminous_efficiency
from simulate.radiance.lamps import spectrum
from simulate.radiance.sky import (
    Disc,
    NightSky,
    ObserverLocation,
    TownGlow,
    dark_sky,
    krisciunas_schaefer_mie,
    krisciunas_schaefer_rayleigh,
    moon_spectrum,
    night_sky,
    sun_spectrum,
    van_rhijn,
)

# The sky by day, dusk and night: right amounts, right sides, and no jumps as sun and moon set.


ROCHESTER = ObserverLocation(latitude_deg=43.16, longitude_deg=-77.61, altitude_m=150.0)
SVALBARD = ObserverLocation(latitude_deg=78.2, longitude_deg=15.6)
EYE = np.arange(380.0, 771.0, 5.0)
GRID = np.linspace(420.0, 940.0, 27)


def towards(elevation_deg, azimuth_deg=90.0):
    up, around = np.deg2rad(elevation_deg), np.deg2rad(azimuth_deg)
    return (
        float(np.cos(up) * np.sin(around)),
        float(np.cos(up) * np.cos(around)),
        float(np.sin(up)),
    )


def body(elevation_deg, light, air, radius=0.0046):
    return Disc(
        name="body",
        direction=towards(elevation_deg),
        angular_radius_rad=radius,
        extraterrestrial=light,
        atmosphere=air,
    )


def lit_by(elevation_deg, light, air=None, **parts):
    air = air or Atmosphere()
    return NightSky(atmosphere=air, bodies=(body(elevation_deg, light, air),), **parts)


def luminance(sky, direction):
    return 683.0 * 5.0 * luminous_efficiency(EYE) @ sky.radiance(np.atleast_2d(direction), EYE)


# nL per foot-candle to sr-1: 1 nL is 1e-5/pi cd m-2, 1 foot-candle 10.764 lux.
NANOLAMBERT_CD_M2 = 1e-5 / np.pi


def krisciunas_schaefer_nl(
    phase_deg, separation_deg, moon_zenith_deg, view_zenith_deg, extinction_mag
):
    """Visual brightness of the moonlit sky, nL (Publ. Astron. Soc. Pac. 103, 1033, 1991; 8 to 23
    %).
    """
    moon = 10.0 ** (-0.4 * (3.84 + 0.026 * abs(phase_deg) + 4e-9 * phase_deg**4))
    to_moon, to_view = (
        1.0 / np.sqrt(1.0 - 0.96 * np.sin(np.deg2rad(z)) ** 2)
        for z in (moon_zenith_deg, view_zenith_deg)
    )
    spread = krisciunas_schaefer_rayleigh(separation_deg) + krisciunas_schaefer_mie(separation_deg)
    lost = 10.0 ** (-0.4 * extinction_mag * to_moon)
    return float(spread * moon * lost * (1.0 - 10.0 ** (-0.4 * extinction_mag * to_view)))


@pytest.mark.parametrize("phase", [10.0, 45.0, 90.0])
@pytest.mark.parametrize(
    ("zenith", "azimuth"), [(20.0, 270.0), (45.0, 0.0), (60.0, 270.0), (70.0, 90.0)]
)
def test_the_moonlit_sky_in_clear_air_is_theirs_within_their_scatter(phase, zenith, azimuth):
    """Amount by Bird and Riordan, shape by Krisciunas and Schaefer: together as their measured sky,
    23 % at most.
    """
    air = Atmosphere(visibility_km=200.0)
    sky = lit_by(60.0, moon_spectrum(phase), air, airglow=0.0, zodiacal=0.0, starlight=0.0)
    view = np.array(towards(90.0 - zenith, azimuth))
    separation = np.rad2deg(np.arccos(view @ np.array(towards(60.0))))
    extinction = 1.0857 * float(
        air.molecules_depth(550.0)[0] + air.haze_depth(550.0)[0] + 0.3 * 0.085
    )
    theirs = (
        krisciunas_schaefer_nl(phase, float(separation), 30.0, zenith, extinction)
        * NANOLAMBERT_CD_M2
    )
    assert luminance(sky, view)[0] == pytest.approx(theirs, rel=0.23)


# Diffuse and direct irradiance by SPECTRL2 (pvlib 0.16.1): aerosol depth 0.1 at 500 nm falling as
# l^-1.3, water 1.5 cm, ozone 0.3 atm cm, ground albedo 0.2; both over the extraterrestrial
# irradiance.
SUN = {450: 2.0043, 550: 1.8913, 710: 1.3985, 860: 0.9983}
DIFFUSE = {
    30: {450: 0.3656, 550: 0.2185, 710: 0.0976, 860: 0.0490},
    60: {450: 0.2776, 550: 0.1714, 710: 0.0808, 860: 0.0415},
    75: {450: 0.1847, 550: 0.1182, 710: 0.0615, 860: 0.0330},
}
DIRECT = {
    30: {450: 1.3549, 550: 1.4807, 710: 1.2354, 860: 0.9257},
    60: {450: 1.0188, 550: 1.2394, 710: 1.1296, 860: 0.8761},
    75: {450: 0.5506, 550: 0.8457, 710: 0.9323, 860: 0.7780},
}


@pytest.mark.parametrize("zenith", [30, 60, 75])
def test_direct_and_diffuse_light_agree_with_spectrl2(zenith):
    depth = 0.1 * 1.1**-1.3
    air = Atmosphere(visibility_km=3.912 / (depth / 1.2 + 0.0971 / 8.43), relative_humidity=0.485)
    sky = lit_by(90.0 - zenith, sun_spectrum(), air, airglow=0.0, zodiacal=0.0, starlight=0.0)
    grid = np.array(sorted(SUN), float)
    fine = np.unique(np.concatenate([grid - 1.0, grid, grid + 1.0]))
    at = np.searchsorted(fine, grid)
    outside = sun_spectrum().on(fine)[at]
    direct = sky.discs()[0].irradiance(fine)[at]
    diffuse = sky.irradiance(fine)[at] - direct * np.cos(np.deg2rad(zenith))
    for index, nm in enumerate(sorted(SUN)):
        assert direct[index] / outside[index] == pytest.approx(
            DIRECT[zenith][nm] / SUN[nm], rel=0.02
        )
        assert diffuse[index] / outside[index] == pytest.approx(
            DIFFUSE[zenith][nm] / SUN[nm], rel=0.05
        )


@pytest.mark.parametrize("step_nm", [10.0, 25.0, 50.0])
def test_wide_bands_lose_nothing_of_the_narrow_bands_of_gases(step_nm):
    sky = lit_by(20.0, moon_spectrum(30.0), airglow=0.0, zodiacal=0.0, starlight=0.0)
    wide, narrow = (np.arange(450.0, 950.1, step) for step in (step_nm, 1.0))
    for light in (sky.discs()[0].irradiance, sky.irradiance):
        power = [float(light(grid) @ band_widths(grid)) for grid in (wide, narrow)]
        assert power[0] == pytest.approx(power[1], rel=3e-3)


# Illuminance of open ground in clear weather: handbooks' values for the ends of civil and nautical
# dusk; noon, low sun.
@pytest.mark.parametrize(
    ("elevation", "lux", "within"),
    [
        (60.0, 1.0e5, 0.15),
        (10.0, 1.1e4, 0.25),
        (0.0, 600.0, 0.4),
        (-6.0, 3.4, 0.2),
        (-12.0, 0.008, 0.5),
    ],
)
def test_daylight_and_dusk(elevation, lux, within):
    assert lit_by(elevation, sun_spectrum()).illuminance_lux() == pytest.approx(lux, rel=within)


@pytest.mark.parametrize("light", [sun_spectrum(), moon_spectrum(5.0)], ids=["sun", "moon"])
def test_light_only_fades_as_a_body_sinks_and_never_jumps(light):
    parts = {"airglow": 0.0, "zodiacal": 0.0, "starlight": 0.0}
    heights = np.concatenate(
        [np.linspace(30.0, 2.0, 15), np.linspace(1.5, -1.5, 31), np.linspace(-2.0, -21.0, 20)]
    )
    lux = np.array([lit_by(float(h), light, **parts).illuminance_lux() for h in heights])
    assert (np.diff(lux) <= 1e-9 * lux[:-1]).all()
    # Around the horizon, no more than a third in a tenth of a degree.
    assert (lux[16:46] / lux[15:45] > 0.66).all()
    assert lux[-1] == 0.0


def test_dusk_is_brightest_where_the_sun_went_down():
    sky = lit_by(-8.0, sun_spectrum())
    west, north, east, zenith = luminance(
        sky, [towards(5.0), towards(5.0, 0.0), towards(5.0, 270.0), towards(90.0)]
    )
    assert west > north > east
    assert west > 3.0 * zenith


def test_a_moon_below_the_horizon_shines_no_beam():
    sky = lit_by(-5.0, moon_spectrum(10.0))
    assert sky.discs() == ()
    assert sky.illuminance_lux() == pytest.approx(NightSky().illuminance_lux(), rel=0.05)


def test_a_half_set_disc_gives_half_its_light():
    half = body(0.0, moon_spectrum(5.0), Atmosphere())
    assert half.visible_share == pytest.approx(0.5)
    shares = [
        body(h, moon_spectrum(5.0), Atmosphere()).visible_share for h in (-0.3, -0.2, 0.1, 0.3)
    ]
    assert shares[0] == 0.0 and shares[-1] == 1.0
    assert 0.0 < shares[1] < 0.5 < shares[2] < 1.0


def test_polar_night_has_no_sun_and_polar_day_has_one():
    night = NightSky.at(SVALBARD, datetime(2024, 12, 21, 11, tzinfo=UTC))
    assert all(disc.name != "sun" for disc in night.discs())
    assert 5e-4 < night.illuminance_lux() < 1.0
    day = NightSky.at(SVALBARD, datetime(2024, 6, 21, 23, tzinfo=UTC))
    assert [disc.name for disc in day.discs()] == ["sun"]
    assert 5e3 < day.illuminance_lux() < 5e4


def test_the_nearly_full_moon_over_rochester_gives_a_fifth_of_a_lux():
    sky = NightSky.at(ROCHESTER, datetime(2024, 2, 24, 6, tzinfo=UTC))
    assert [disc.name for disc in sky.discs()] == ["moon"]
    assert 0.15 < sky.illuminance_lux() < 0.26


def test_there_is_no_sky_below_the_horizon():
    sky = NightSky.at(ROCHESTER, datetime(2024, 2, 24, 6, tzinfo=UTC))
    down, up = sky.radiance(np.array([towards(-1.0), towards(1.0)]), GRID).T
    assert not down.any()
    assert (up > 0.0).all()


def test_a_town_glows_in_its_own_colour_on_its_own_side():
    town = TownGlow(azimuth_deg=30.0, luminance_cd_m2=0.01)
    sky, dark = NightSky(towns=(town,)), NightSky()
    near, far = np.array(towards(0.5, 30.0)), np.array(towards(0.5, 210.0))
    assert luminance(sky, near)[0] - luminance(dark, near)[0] == pytest.approx(0.01, rel=0.06)
    assert luminance(sky, far)[0] == pytest.approx(luminance(dark, far)[0], rel=1e-6)
    # All of sodium's light is there, its line at 819 nm too.
    lamp = spectrum("high-pressure-sodium")
    assert town.spectrum.total(800, 830) / town.spectrum.lumens == pytest.approx(
        lamp.total(800, 830), rel=1e-6
    )


def test_sources_name_every_line_for_the_grid():
    sky = NightSky(towns=(TownGlow(azimuth_deg=0.0, luminance_cd_m2=0.01, lamp="mercury"),))
    lines = {line for source in sky.sources() for line in source.line_nm}
    assert {557.7, 630.0, 435.8, 546.1} <= lines


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: NightSky(airglow=-1.0), "airglow must not be negative, got -1"),
        (lambda: NightSky(ground_albedo=2.0), r"ground_albedo must lie between 0 and 1, got 2"),
        (
            lambda: TownGlow(azimuth_deg=0.0, luminance_cd_m2=-1.0),
            "luminance_cd_m2 must not be negative",
        ),
        (lambda: TownGlow(azimuth_deg=0.0, luminance_cd_m2=1.0, lamp="candle"), "one of the kinds"),
        (lambda: NightSky().radiance(np.array([[0.0, 0.0, 1.0]]), [550.0]), "at least two bands"),
    ],
)
def test_impossible_skies_are_refused_in_a_sentence(make, says):
    with pytest.raises(BadInput, match=says):
        make()


# The moonless sky has the bands, the luminance, the colour and the slope towards the horizon that
# were measured.


# Means over 50 nm, 1e-6 W m-2 sr-1 um-1 and 1e12 photons s-1 m-2 sr-1 um-1.
BANDS = [
    (400, 2.41, 5.2),
    (450, 2.54, 6.1),
    (500, 2.54, 6.7),
    (550, 3.71, 10.7),
    (600, 5.08, 16.1),
    (650, 3.20, 10.9),
    (700, 4.00, 14.6),
    (750, 6.28, 24.6),
    (800, 6.84, 28.4),
    (850, 9.10, 40.2),
    (900, 13.9, 64.8),
    (950, 17.2, 84.8),
]
JOULE_METRE = 6.62607015e-34 * 2.99792458e8
UP = np.array([[0.0, 0.0, 1.0]])


def photons(spectrum, low, high):
    """Photons per s between two wavelengths."""
    ends = np.array([low, high], float)
    return spectrum.through(ends, ends * 1e-9 / JOULE_METRE)


@pytest.mark.parametrize(("start", "power", "count"), BANDS)
def test_bands_of_the_zenith(start, power, count):
    whole = dark_sky().total
    assert 1e9 * whole.total(start, start + 50) / 50.0 == pytest.approx(power, rel=0.005)
    assert photons(whole, start, start + 50) / 0.05 / 1e12 == pytest.approx(count, rel=0.03)


def test_luminance_and_illuminance():
    assert dark_sky().total.lumens == pytest.approx(2.45e-4, rel=0.03)
    assert np.pi * dark_sky().total.lumens == pytest.approx(7.7e-4, rel=0.03)


@pytest.mark.parametrize(
    ("elevation", "factor"),
    [(90.0, 1.0), (60.0, 1.15), (30.0, 1.92), (15.0, 3.28), (10.0, 4.19), (0.0, 6.01)],
)
def test_airglow_grows_towards_the_horizon(elevation, factor):
    assert van_rhijn(elevation) == pytest.approx(factor, rel=2e-3)


def test_airglow_on_level_ground_is_more_than_its_zenith_says():
    """E/(pi L) is 1.71 without air, and 1.42 where all that 0.15 mag of air takes is lost; ours
    gives some back.
    """
    cosine = (np.arange(4000) + 0.5) / 4000
    elevation = np.rad2deg(np.arcsin(cosine))
    assert np.mean(2.0 * cosine * van_rhijn(elevation)) == pytest.approx(1.71, rel=5e-3)
    assert np.mean(2.0 * cosine * van_rhijn(elevation)) == pytest.approx(
        night_sky.AIRGLOW_HEMISPHERE, rel=2e-3
    )
    lost = 10.0 ** (-0.06 * (airmass(elevation) - 1.0))
    assert np.mean(2.0 * cosine * van_rhijn(elevation) * lost) == pytest.approx(1.42, rel=5e-3)
    grid = np.array([540.0, 550.0, 560.0])
    airglow = NightSky(zodiacal=0.0, starlight=0.0)
    ratio = airglow.irradiance(grid) / np.pi / airglow.radiance(UP, grid)[:, 0]
    assert 1.42 < ratio[1] < 1.6


def test_the_dark_horizon_is_that_of_an_endless_path():
    grid = np.linspace(420.0, 880.0, 10)
    sky = NightSky()
    horizon = np.array([[1.0, 0.0, 0.0]])
    assert np.allclose(
        sky.radiance(horizon, grid)[:5], sky.air_radiance(horizon, grid)[:5], rtol=0.02
    )
    # Brightest between: neither the zenith nor the horizon.
    low = sky.radiance(np.array([[0.95, 0.0, np.sqrt(1.0 - 0.95**2)]]), grid)
    assert (low > sky.radiance(UP, grid)).all() and (low > sky.radiance(horizon, grid)).all()


def test_the_three_parts_scale_by_themselves_and_add_up():
    grid = np.linspace(400.0, 950.0, 56)
    direction = np.array([[0.0, 0.6, 0.8], [0.0, 0.0, 1.0]])
    names = ("airglow", "zodiacal", "starlight")
    none = dict.fromkeys(names, 0.0)
    parts = [NightSky(**{**none, name: 1.0}).radiance(direction, grid) for name in names]
    assert np.allclose(sum(parts), NightSky().radiance(direction, grid), rtol=1e-12)
    assert np.allclose(
        NightSky(**{**none, "airglow": 2.0}).radiance(direction, grid), 2.0 * parts[0]
    )
    assert all((part > 0.0).all() for part in parts)
    luminous = dark_sky().total.lumens
    assert dark_sky().zodiacal.lumens / luminous == pytest.approx(0.30, rel=1e-3)
    assert dark_sky().starlight.lumens / luminous == pytest.approx(0.20, rel=1e-3)
