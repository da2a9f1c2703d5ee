"""Air takes from light what was tabulated, and adds to it what makes far things fade into the
horizon.
"""

from dataclasses import replace

import numpy as np
import pytest

from labdata import BadInput
from simulate.radiance import (
    Atmosphere,
    airmass,
    kruse_per_km,
    rayleigh_depth,
    visibility_extinction_per_km,
)
from simulate.radiance.sky import Disc, NightSky, moon_spectrum

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
