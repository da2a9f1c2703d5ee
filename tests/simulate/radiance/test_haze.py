"""Haze weakens light by Koschmieder's law at any range, with a sky and without."""

import numpy as np
import pytest

from simulate.radiance import load_scene
from simulate.radiance.integrator import IntegratorSettings, radiance_along
from simulate.radiance.outdoor import BuiltScene

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
