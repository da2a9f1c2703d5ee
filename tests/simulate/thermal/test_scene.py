"""Temperatures of scenes: what facets see, neighbours, sources, and single points against solutions
by themselves.
"""

import time
from dataclasses import replace

import numpy as np
import pytest

from labdata import BadInput, from_mapping
from simulate.radiance import STEFAN_BOLTZMANN, load_scene
from simulate.radiance.geometry import Viewpoint
from simulate.radiance.outdoor import BuiltScene, OutdoorScene
from simulate.thermal import (
    ZERO_C,
    Balance,
    Temperatures,
    exposure_of,
    facets_of,
    slab_of,
    temperatures,
    temperatures_of,
    weather_of,
)

NIGHT = {
    "name": "night",
    "place": {"latitude_deg": 43.16, "longitude_deg": -77.61, "time": "1998-06-24T02:00:00-04:00"},
    "weather": {"temperature_c": 16.0, "relative_humidity": 0.7, "wind_m_s": 1.0},
    "camera": {"position_m": [0, -20, 5], "look_at_m": [0, 0, 0]},
    "material": [
        {"label": "paving", "library": "concrete"},
        {"label": "paint", "library": "olive-drab-paint"},
        {"label": "metal", "library": "aluminium"},
        {"label": "face", "library": "light-skin"},
    ],
}


def scene_of(*objects, **changes) -> OutdoorScene:
    return from_mapping(NIGHT | {"object": list(objects)} | changes, OutdoorScene, where="test")


def plane(label, side, material="paving", height=0.0, **more):
    at = more.pop("position_m", [0, 0])
    return {"label": label, "shape": "plane", "size_m": [side, side], "material": material} | {
        "position_m": [*at, height],
        **more,
    }


def box(label, size, material="paint", **more):
    return {"label": label, "shape": "box", "size_m": size, "material": material, **more}


def facing(found: Temperatures, name: str, normal) -> int:
    """Return the facet of an object that faces a direction."""
    facets = found.balance.facets
    cosine = facets.normal @ np.asarray(normal, float)
    return max(
        (i for i, other in enumerate(facets.names) if other.startswith(name)),
        key=lambda i: cosine[i],
    )


def last_c(found: Temperatures, name: str, normal=(0, 0, 1)) -> float:
    return float(found.solution.faces_k[-1, facing(found, name, normal)] - ZERO_C)


def test_sun_goes_through_panes_and_infrared_does_not():
    glass = {"label": "glass", "pane_transmittance": [0.88], "slab": "window-glass"}
    pane = plane("pane", 8.0, "glass", height=1.0)
    found = temperatures_of(
        scene_of(plane("ground", 3.0), pane, material=[*NIGHT["material"], glass])
    )
    names, seen = found.balance.facets.names, found.balance.exposure
    ground, roof = names.index("ground:paving"), names.index("pane:glass")
    open_ = temperatures_of(scene_of(plane("ground", 3.0)))
    assert seen.lit[:, ground] == pytest.approx(open_.balance.exposure.lit[:, 0])
    assert seen.sees[ground, roof] > 0.8 and seen.sky[roof] == 1.0
    # Glass reflects 8 % of the sun, which neither heats it nor goes through.
    assert found.balance.reflectivity[roof] == pytest.approx(0.08)
    assert last_c(found, "ground") > last_c(open_, "ground") + 1.0


def exposure(scene):
    facets = facets_of(BuiltScene(scene).surfaces)
    sun = np.array([[0.0, -0.6, 0.8], [0.0, 0.6, 0.8]])
    return facets, exposure_of(facets, sun, np.random.default_rng(1))


def test_facets_see_sky_ground_and_each_other():
    facets, seen = exposure(scene_of(plane("ground", 4000.0), box("cube", [2, 2, 2])))
    assert len(facets) == 7 and facets.area_m2.sum() == pytest.approx(4000.0**2 + 24.0)
    walls = np.flatnonzero(np.abs(facets.normal[:, 2]) < 0.5)
    top = int(np.argmax(facets.normal[:, 2] * (facets.area_m2 < 10.0)))
    assert seen.sky[walls] == pytest.approx(0.5, abs=0.01) and seen.sky[top] == 1.0
    ground = int(np.argmax(facets.area_m2))
    assert seen.sees[walls, ground] == pytest.approx(0.5, abs=0.01)
    total = seen.sky + seen.sees.sum(axis=1) + seen.off_scene
    assert total == pytest.approx(1.0) and seen.rings.shape == (7, 12)
    # Level ground sees all rings alike; a wall sees more of the sky near the horizon.
    assert seen.rings[top] == pytest.approx(1.0 / 12.0, abs=0.01)
    assert (seen.rings[walls, 0] > 3.0 * seen.rings[walls, -1]).all()
    south = walls[np.argmin(facets.normal[walls, 1])]
    assert seen.lit[:, south] == pytest.approx([0.6, 0.0]) and seen.lit[:, top] == pytest.approx(
        0.8
    )


def test_the_view_factor_of_two_facing_squares_is_the_textbooks():
    _, seen = exposure(
        scene_of(plane("floor", 1.0), plane("roof", 1.0, "paint", height=1.0, roll_deg=180.0))
    )
    assert seen.sees[0, 1] == pytest.approx(0.1998, abs=0.015) == seen.sees[1, 0]
    assert seen.off_scene[1] == pytest.approx(0.8002, abs=0.015)
    assert seen.sky[0] == pytest.approx(0.8002, abs=0.015)


def test_copies_and_far_directions_belong_to_facets():
    poses = [{"position_m": [3.0 * n, 0, 0], "heading_deg": 20.0 * n} for n in range(4)]
    facets, seen = exposure(
        scene_of(plane("ground", 100.0), box("crates", [1, 1, 1], instances=poses))
    )
    face = np.concatenate(facets.faces)
    assert np.array_equal(
        facets.of_faces(face), np.repeat(np.arange(len(facets)), [len(f) for f in facets.faces])
    )
    assert seen.sees.sum() > 0.0


def dark_room(scene, temperature_k=285.0):
    """Return the balance of a scene whose air and sky have one temperature, without sun."""
    weather = weather_of(scene)
    steady = np.full(len(weather), temperature_k)
    even = replace(
        weather,
        air_k=steady,
        dew_point_k=steady - 10.0,
        direct_w_m2=0.0 * steady,
        diffuse_w_m2=0.0 * steady,
        longwave_w_m2=STEFAN_BOLTZMANN * steady**4,
    )
    site = BuiltScene(scene)
    facets = facets_of(site.surfaces)
    things = {thing.label: thing for thing in scene.object}
    materials = {surface.label: slab_of(scene, surface) for surface in scene.material}
    assert scene.weather is not None
    return Balance(
        facets=facets,
        exposure=exposure_of(facets, even.sun[::3], np.random.default_rng(1)),
        slabs=tuple(materials[site.surfaces.materials[number]] for number in facets.material),
        things=tuple(things[site.surfaces.objects[number]] for number in facets.object),
        weather=even,
        state=scene.weather,
    )


def test_an_isothermal_world_stays_at_its_temperature():
    scene = scene_of(
        plane("ground", 100.0),
        box("cube", [2, 2, 2]),
        box("tin", [1, 1, 1], "metal", position_m=[4, 0, 0]),
    )
    found = dark_room(scene).solve(0.0)
    assert found.faces_k == pytest.approx(285.0, abs=1e-6)


def test_walls_receive_what_the_ground_before_them_sends():
    scene = scene_of(plane("ground", 4000.0), box("cube", [2, 2, 2]))
    balance = temperatures_of(scene).balance
    ground = int(np.argmax(balance.facets.area_m2))
    walls = np.flatnonzero(np.abs(balance.facets.normal[:, 2]) < 0.5)
    sent = (1.0 - balance.absorptivity[ground]) * balance.sunlight[:, [ground]]
    assert sent.max() > 200.0
    assert balance.sunlight_by_reflection[:, walls] == pytest.approx(
        np.repeat(0.5 * sent, 4, axis=1), rel=0.03
    )
    warm = np.full((len(balance.weather), len(balance.facets)), 300.0)
    _, neighbours = balance.longwave(warm)
    assert neighbours[:, walls] == pytest.approx(0.5 * STEFAN_BOLTZMANN * 300.0**4, rel=0.04)
    assert neighbours[:, ground].max() < 2.0


@pytest.fixture(scope="module")
def hangar() -> tuple[Temperatures, float]:
    """Temperatures of the hangar, and the processor's seconds that they took."""
    began = time.process_time()
    found = temperatures_of(load_scene("hangar"))
    return found, time.process_time() - began


def test_the_hangar_at_night_is_as_the_paper_has_it(hangar):
    found, _ = hangar
    air = float(found.balance.weather.air_k[-1] - ZERO_C)
    tops = {
        name: air - last_c(found, name)
        for name in ("truck:olive", "fighter:grey", "hangar:", "truck:canvas")
    }
    paving = last_c(found, "apron") - air
    print(
        "K below air:",
        {name: round(below, 1) for name, below in tops.items()},
        f"apron {paving:.1f} above",
    )
    assert all(2.0 < below < 9.0 for below in tops.values()) and paving > 1.0
    for way in ((1, 0, 0), (-1, 0, 0), (0, 1, 0)):
        wall = last_c(found, "truck:olive", way)
        assert last_c(found, "truck:olive") < wall < last_c(found, "apron")
    # Undersides face the warm apron.
    assert last_c(found, "fighter:grey", (0, 0, -1)) > last_c(found, "fighter:grey", (1, 0, 0))
    # Bare aluminium emits little; glass is opaque in the infrared and has a temperature of its own.
    assert abs(last_c(found, "fighter:aluminium", (1, 0, 0)) - air) < 1.5
    assert 2.0 < air - last_c(found, "fighter:canopy glass") < 9.0
    assert last_c(found, "people:skin") == pytest.approx(32.5)
    assert sum(effect.influence for effect in found.solution.left_out) < 40.0


def test_a_map_of_640_by_480_pixels_of_the_hangar_takes_less_than_a_minute_of_two_cores(hangar):
    scene, (found, solved) = load_scene("hangar"), hangar
    ahead = np.subtract(scene.camera.look_at_m, scene.camera.position_m)
    towards = tuple(ahead / np.linalg.norm(ahead))
    few = Viewpoint(
        position_m=scene.camera.position_m, forward=towards, shape=(60, 80), focal_px=(125.0, 125.0)
    )
    began = time.process_time()
    found.map_k(few)
    whole = solved + 64.0 * (time.process_time() - began)
    print(f"solution {solved:.1f} s, with a map of 640 x 480 {whole:.1f} s of processor time")
    assert whole < 2.0 * 60.0


def test_further_passes_of_neighbours_change_less_than_what_is_reported():
    scene = load_scene("hangar")
    coarse, fine = (temperatures_of(scene, tolerance_mk=limit) for limit in (200.0, 0.01))
    left = {effect.name: effect.influence for effect in coarse.solution.left_out}
    difference = 1e3 * np.abs(coarse.solution.faces_k[-1] - fine.solution.faces_k[-1]).max()
    assert 1.0 < difference < 1.1 * sum(left.values())


def test_the_stated_effects_of_uncertain_inputs_are_those_of_changed_inputs():
    found = temperatures_of(scene_of(plane("ground", 30.0), box("crate", [2, 2, 2])))
    balance, weather = found.balance, found.balance.weather
    brighter = replace(
        balance, weather=replace(weather, longwave_w_m2=weather.longwave_w_m2 + 15.0)
    )
    change = brighter.solve(0.01).faces_k[-1] - balance.solve(0.01).faces_k[-1]
    # Walls see the ground get warmer, too.
    assert change == pytest.approx(found.solution.errors_k["longwave of the sky"], rel=0.1)
    assert set(found.last_sd_k()) == {"ground:paving", "crate:paint"}
    assert all(0.2 < sd < 3.0 for sd in found.last_sd_k().values())
    person = temperatures_of(scene_of(box("person", [0.5, 0.5, 1.8], "face")))
    assert person.last_sd_k()["person:face"] == pytest.approx((34.0 - 31.0) / 3.92, rel=1e-3)


def test_shade_all_day_leaves_concrete_colder():
    roof = {
        "label": "roof",
        "shape": "plane",
        "size_m": [8, 8],
        "material": "paint",
        "position_m": [0, 4.0, 9],
    }
    lit = temperatures_of(scene_of(plane("ground", 30.0)))
    balance = lit.balance
    dark = replace(balance, exposure=replace(balance.exposure, lit=0.0 * balance.exposure.lit))
    dark = replace(
        dark, weather=replace(balance.weather, diffuse_w_m2=0.0 * balance.weather.diffuse_w_m2)
    )
    change = dark.solve(20.0).faces_k[-1, 0] - lit.solution.faces_k[-1, 0]
    assert -6.0 < change < -3.0
    assert last_c(temperatures_of(scene_of(plane("ground", 30.0), roof)), "ground") != last_c(
        lit, "ground"
    )


# By day deep shade is 20 K away from its facet, which is in the sun.
@pytest.mark.parametrize(
    ("hours", "error_k"), [("1998-06-24T02:00:00-04:00", 0.35), ("1998-06-23T13:00:00-04:00", 0.7)]
)
def test_a_point_of_the_map_is_what_its_place_has_by_itself(hours, error_k):
    wall = box("wall", [6, 0.4, 3], position_m=[0, 4, 0])
    place = NIGHT["place"] | {"time": hours}
    whole = temperatures_of(scene_of(plane("ground", 60.0), wall, place=place))
    view = Viewpoint(
        position_m=(0.0, 0.0, 30.0),
        forward=(0.0, 0.0, -1.0),
        shape=(60, 60),
        focal_px=(100.0, 100.0),
    )
    pixels = whole.map_k(view)
    height = 29.99
    for x, y in ((0.0, 4.95), (-2.9, 6.5)):
        patch = plane("patch", 0.2, position_m=[x, y], height=0.01)
        alone = temperatures_of(scene_of(plane("ground", 60.0), wall, patch, place=place))
        row, col, _ = view.project(np.array([[x, y, -height]]))
        found = pixels[int(row[0]), int(col[0])] - ZERO_C
        print(f"{x:5.1f} {y:4.1f}: {found:.2f} C, by itself {last_c(alone, 'patch'):.2f} C")
        assert found == pytest.approx(last_c(alone, "patch"), abs=error_k)
    assert np.ptp(pixels[np.isfinite(pixels)]) > 2.0


def test_sources_and_prescribed_temperatures_act():
    scene = scene_of(
        plane("ground", 60.0),
        box("cold", [1, 1, 1], position_m=[-4, 0, 0.2]),
        box("engine", [1, 1, 1], position_m=[4, 0, 0.2], heat_w_m2=200.0),
        box("was running", [1, 1, 1], position_m=[8, 0, 0.2], heat_w_m2=200.0, heat_hours=[20, 0]),
        box("person", [0.5, 0.5, 1.8], "face", position_m=[0, 0, 0]),
        box("exhaust", [0.2, 0.2, 0.2], position_m=[0, 6, 0.3], temperature_c=200.0),
        box("tyre", [0.2, 0.8, 0.8], position_m=[2, 6, 0.3], above_air_k=10.0),
    )
    found = temperatures_of(scene)
    assert last_c(found, "engine") > last_c(found, "cold") + 10.0
    assert abs(last_c(found, "was running") - last_c(found, "cold")) < 1.0
    steps = [time.hour for time in found.balance.weather.times]
    tops = [facing(found, name, (0, 0, 1)) for name in ("was running", "cold")]
    hotter = np.subtract(*found.solution.faces_k[:, tops].T)
    assert (
        hotter[np.array(steps) == 22].min() > 8.0 and abs(hotter[np.array(steps) == 19]).max() < 0.5
    )
    assert last_c(found, "person") == pytest.approx(32.5, abs=1e-4)
    assert last_c(found, "exhaust") == pytest.approx(200.0, abs=1e-4)
    assert last_c(found, "tyre") == pytest.approx(26.0, abs=1e-4)


def test_dew_keeps_calm_tops_warmer():
    calm = NIGHT["weather"] | {"wind_m_s": 0.2, "relative_humidity": 0.95}
    found = temperatures_of(scene_of(box("top", [2, 2, 1]), weather=calm))
    terms = {effect.name: effect.influence for effect in found.solution.effects}
    dew = float(found.balance.weather.dew_point_k[-1] - ZERO_C)
    assert last_c(found, "top") < dew and terms["condensation"] > 500.0


def test_the_law_of_convection_is_chosen():
    tops = {}
    for law in (
        {},
        {"convection": "mcadams"},
        {"convection": "constant", "convection_w_m2_k": 4.0},
    ):
        tops[law.get("convection")] = last_c(
            temperatures_of(scene_of(box("b", [2, 2, 1]), weather=NIGHT["weather"] | law)), "b"
        )
    # The stronger the exchange, the nearer to the air.
    assert tops["constant"] < tops[None] < tops["mcadams"] < 16.0


def test_the_library_names_a_source_for_every_number():
    shelf = temperatures.library()
    assert len(shelf) >= 20
    for slab in shelf.values():
        for name, number in slab.parameters().items():
            assert number.source and number.standing, (slab.label, name)
    scene = load_scene("hangar")
    stated = {s.label: slab_of(scene, s).absorptivity for s in scene.material}
    assert float(stated["concrete"]) == float(shelf["concrete"].absorptivity)
    # Stated by the scene: pale paint that reflects .35 at 400 and .60 from 900 nm on.
    assert (
        0.40 < float(stated["sheet metal, painted pale"]) < 0.65
        and "900 nm" in stated["sheet metal, painted pale"].source
    )


def test_own_slabs_of_a_scene_are_used():
    layer = {
        "thickness_mm": 30,
        "conductivity_w_m_k": 0.04,
        "density_kg_m3": 30,
        "specific_heat_j_kg_k": 1400,
    }
    own = {"label": "foam", "layer": [layer], "emissivity": 0.9, "absorptivity": 0.5}
    material = [
        {"label": "paving", "reflectance": [0.3], "slab": "foam"},
        {"label": "paint", "library": "concrete"},
    ]
    found = temperatures_of(
        scene_of(
            plane("roof", 5.0),
            plane("slab", 5.0, "paint", position_m=[9, 0]),
            material=material,
            slab=[own],
        )
    )
    assert last_c(found, "roof") < last_c(found, "slab") - 4.0
    assert float(found.balance.slabs[0].absorptivity or 0.0) == 0.5


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"material": [{"label": "paving", "reflectance": [0.3]}]}, "must have a slab"),
        (
            {"material": [{"label": "paving", "reflectance": [0.3], "slab": "cheese"}]},
            "slab must be one of",
        ),
        ({"slab": [{"label": "x"}]}, "must have layers or else"),
        ({"slab": [{"label": "x", "above_air_k": 1, "emissivity": 1.5}]}, "emissivity must lie"),
        ({"weather": {"wind_m_s": -1.0}}, "wind_m_s must not be negative"),
        ({"weather": {"wind_m_s": 1.0, "dew_point_c": 20.0}}, "dew_point_c must not exceed"),
        (
            {"weather": {"wind_m_s": 1.0, "convection": "constant"}},
            "convection_w_m2_k must be given",
        ),
        ({"weather": {"wind_m_s": 1.0, "relative_humidity": 0.0}}, "relative_humidity must lie"),
    ],
)
def test_scenes_that_lack_what_temperatures_need_are_refused(changes, words):
    with pytest.raises(BadInput, match=words) as refused:
        temperatures_of(scene_of(plane("ground", 30.0), **changes))
    assert "\n" not in str(refused.value)
