"""Moonlight by phase, colour and distance against the reference tables of the ROLO model and
Allen's phase curve.
"""

import numpy as np
import pytest

from simulate.radiance import Atmosphere
from simulate.radiance.sky import Disc, NightSky, moon_reflectance, moon_spectrum, sun_spectrum

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
