"""Air takes from light what was tabulated, adds what makes far things fade, and hides a wall by
law.
"""

from dataclasses import replace

import numpy as np
import pytest

from labdata import BadInput
from simulate.radiance import (
    Atmosphere,
    airmass,
    kruse_per_km,
    load_scene,
    rayleigh_depth,
    visibility_extinction_per_km,
)
from simulate.radiance.integrator import IntegratorSettings, radiance_along
from simulate.radiance.outdoor import BuiltScene
from simulate.radiance.sky import Disc, NightSky, moon_spectrum

# Air takes from light what was tabulated, and adds to it what makes far things fade into the
# horizon.


CLEAREST_KM = 339.0


@pytest.mark.parametrize(
    ("nm", "depth", "by_6s"),
    [
        (400, 0.3601, None),
        (450, 0.2211, 0.2218),
        (550, 0.0971, 0.0975),
        (700, 0.0365, 0.0366),
        (850, 0.0167, 0.0167),
    ],
)
def test_molecules_scatter_as_tabulated_and_as_6s_says(nm, depth, by_6s):
    assert rayleigh_depth(nm) == pytest.approx(depth, abs=6e-5)
    if by_6s is not None:
        assert rayleigh_depth(nm) == pytest.approx(by_6s, rel=5e-3)


@pytest.mark.parametrize(
    ("visibility", "per_km", "kept"), [(23.0, 0.1701, 0.8436), (5.0, 0.7824, 0.4573)]
)
def test_koschmieders_law_over_a_kilometre(visibility, per_km, kept):
    assert visibility_extinction_per_km(visibility) == pytest.approx(per_km, rel=1e-3)
    air = Atmosphere(visibility_km=visibility, relative_humidity=0.0)
    assert air.transmittance(1000.0, [550.0])[0, 0] == pytest.approx(kept, rel=1e-3)
    assert air.transmittance(1e3 * visibility, [550.0])[0, 0] == pytest.approx(0.02, rel=1e-2)


def test_kruses_law_over_wavelength():
    assert np.allclose(
        kruse_per_km([450, 550, 700, 850], 23.0), [0.2208, 0.1701, 0.1243, 0.0966], atol=6e-5
    )


@pytest.mark.parametrize(("elevation", "mass"), [(30.0, 1.994), (10.0, 5.586), (0.0, 37.92)])
def test_airmass(elevation, mass):
    assert airmass(elevation) == pytest.approx(mass, rel=1e-3)


# LOWTRAN7, US standard atmosphere without aerosol, straight up: single wavelengths and band means.
@pytest.mark.parametrize(
    ("low", "high", "kept"), [(445, 455, 0.801), (545, 555, 0.882), (845, 855, 0.970)]
)
def test_clear_air_straight_up_agrees_with_lowtran(low, high, kept):
    assert vertical(low, high) == pytest.approx(kept, abs=0.005)


@pytest.mark.parametrize(
    ("low", "high", "kept"), [(700, 800, 0.90), (800, 900, 0.95), (900, 950, 0.69)]
)
def test_water_and_oxygen_straight_up_agree_with_lowtran(low, high, kept):
    assert vertical(low, high) == pytest.approx(kept, abs=0.03)


def vertical(low, high):
    """Band mean of clear air, water and ozone of the US standard atmosphere (1.42 cm, 0.34 atm
    cm).
    """
    air = Atmosphere(
        visibility_km=CLEAREST_KM, relative_humidity=0.46, temperature_c=15.0, ozone_atm_cm=0.34
    )
    assert air.precipitable_cm == pytest.approx(1.42, rel=0.02)
    return air.slant_transmittance(90.0, np.arange(low, high + 1.0))[:, 0].mean()


@pytest.mark.parametrize(("kilometre", "kept"), [(0.1, 0.93), (1.0, 0.78), (5.0, 0.55)])
def test_the_water_band_at_900_to_950_nm_along_the_ground_agrees_with_lowtran(kilometre, kept):
    air = Atmosphere(visibility_km=CLEAREST_KM, relative_humidity=0.46)
    mean = air.transmittance(1e3 * kilometre, np.arange(900.0, 951.0)).mean()
    assert mean == pytest.approx(kept, abs=0.05)


def test_two_paths_in_a_row_scatter_as_one():
    air = Atmosphere(visibility_km=8.0, relative_humidity=0.0)
    grid = [450.0, 550.0, 870.0]
    apart = air.transmittance(700.0, grid) * air.transmittance(1800.0, grid)
    assert np.allclose(apart, air.transmittance(2500.0, grid), rtol=1e-9)


def test_moist_air_takes_more_at_940_nm_and_nothing_at_870():
    dry, moist = (
        Atmosphere(relative_humidity=x).transmittance(2000.0, [870.0, 940.0])[:, 0]
        for x in (0.1, 0.9)
    )
    assert moist[1] < 0.8 * dry[1]
    assert moist[0] == pytest.approx(dry[0], rel=1e-3)


def moonlit(air):
    direction = (float(np.cos(0.6)), 0.0, float(np.sin(0.6)))
    moon = Disc(
        name="moon",
        direction=direction,
        angular_radius_rad=0.0045,
        extraterrestrial=moon_spectrum(20.0),
        atmosphere=air,
    )
    return NightSky(atmosphere=air, bodies=(moon,))


LEVEL = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
GRID = np.linspace(420.0, 880.0, 24)


def test_the_moonlit_air_is_as_bright_as_the_horizon_and_brightest_towards_the_moon():
    sky = moonlit(Atmosphere(relative_humidity=0.2))
    endless = sky.air_radiance(LEVEL, GRID)
    assert np.allclose(endless[:16], sky.radiance(LEVEL, GRID)[:16], rtol=0.25)
    towards, across, away = endless.T
    assert (towards > across).all() and (towards > away).all()


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (
            lambda: Atmosphere(visibility_km=0.0),
            "between 0.01 and that of clean air, 339, got 0",
        ),
        (lambda: Atmosphere(visibility_km=1000.0), "that of clean air, 339, got 1000"),
        (
            lambda: Atmosphere(relative_humidity=1.2),
            r"relative_humidity must lie between 0 and 1, got 1.2",
        ),
        (lambda: Atmosphere(temperature_c=float("nan")), "temperature_c must lie between"),
        (lambda: replace(Atmosphere(), pressure_hpa=0.0), "pressure_hpa must be positive, got 0"),
        (
            lambda: Atmosphere().transmittance(-1.0, [550.0]),
            "a range must not be negative, got -1 m",
        ),
    ],
)
def test_impossible_air_is_refused_in_a_sentence(make, says):
    with pytest.raises(BadInput, match=says):
        make()


# Haze weakens light by Koschmieder's law at any range, with a sky and without.


NM = np.array([500.0, 550.0, 600.0])
AHEAD = np.array([[0.0, 1.0, 0.0]])
PLACE = (
    "place = { latitude_deg = 43.16, longitude_deg = -77.61, time = 1998-06-24T02:00:00-04:00 }\n"
)
# A lone wall of 20 m: the only surface, so that nothing else says how large the scene is.
SCENE = """
name = "a lone wall"
{place}
{weather}
camera = {{ position_m = [0, 0, 2], look_at_m = [0, 1, 2] }}
[[material]]
label = "wall"
reflectance = [0.0]
glow_lm_per_m2 = {glow}
[[object]]
label = "wall"
shape = "box"
size_m = [20, 1, 20]
position_m = [0, {middle_m}, -8]
material = "wall"
"""


def radiance(folder, range_m, glow=1.0, place="", weather="weather = { visibility_km = 5 }"):
    """Return what the camera sees of the wall at a range, shape (band,)."""
    path = folder / "wall.toml"
    path.write_text(SCENE.format(place=place, weather=weather, glow=glow, middle_m=range_m + 0.5))
    stage = BuiltScene(load_scene(path)).on(NM)
    origin = np.array([[0.0, 0.0, 2.0]])
    effort = IntegratorSettings(max_bounces=0, sky_shadowing=False)
    return radiance_along(
        stage, origin, AHEAD, effort, np.random.default_rng(0), gather_rays=1
    ).total()[0]


@pytest.mark.parametrize("visibility_km", [0.2, 5.0, 23.0])
def test_a_lone_wall_is_weakened_by_koschmieders_law_at_any_range(tmp_path, visibility_km):
    """Out to where the twelve-thousandth part is left; at 550 nm no gas takes any."""
    weather = f"weather = {{ visibility_km = {visibility_km} }}"
    bright = radiance(tmp_path, 1e-3, weather="")[1]
    for share in (0.001, 0.1, 0.6, 2.4):
        range_m = 1e3 * share * visibility_km
        left = radiance(tmp_path, range_m, weather=weather)[1] / bright
        assert left == pytest.approx(np.exp(-3.912 / visibility_km * 1e-3 * range_m), rel=0.005)


def test_a_lone_wall_under_a_sky_at_3_km_in_5_km_of_visibility_keeps_a_tenth(tmp_path):
    lit, unlit = (radiance(tmp_path, 3000.0, glow, PLACE)[1] for glow in (1e6, 0.0))
    assert 1e-6 * (lit - unlit) / radiance(tmp_path, 1e-3, weather="")[1] == pytest.approx(
        0.0957, rel=0.005
    )


def test_weather_counts_without_a_place_and_there_is_no_air_without_weather(tmp_path):
    near = radiance(tmp_path, 1.0, weather="")
    assert radiance(tmp_path, 3000.0, weather="") == pytest.approx(near, rel=1e-6)
    assert radiance(tmp_path, 3000.0)[1] / near[1] == pytest.approx(
        np.exp(-3.912 / 5.0 * 3.0), rel=0.005
    )


def test_a_far_wall_fades_into_the_radiance_of_an_endless_way(tmp_path):
    """A black wall at 12 km in 5 km visibility shows all but the ten-thousandth part of the light
    of the air.
    """
    near, far = (radiance(tmp_path, range_m, 0.0, PLACE)[1] for range_m in (3000.0, 12000.0))
    assert near / far == pytest.approx(1.0 - np.exp(-3.912 / 5.0 * 3.0), rel=0.005)
