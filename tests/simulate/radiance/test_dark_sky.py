"""The moonless sky has the bands, the luminance, the colour and the slope towards the horizon that
were measured.
"""

import numpy as np
import pytest

from simulate.radiance import airmass
from simulate.radiance.sky import NightSky, dark_sky, night_sky, van_rhijn

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
