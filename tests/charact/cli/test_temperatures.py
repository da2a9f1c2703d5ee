"""`charact temperatures`: tables and pictures of a scene, what was left out, and what is refused in
one sentence.
"""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

import simulate
from labdata import BadInput, load_camera, save_sensor
from tests.charact.cli.runner import LAWN, assert_one_sentence, charact, done_well, json_of

SCENE = (
    LAWN.replace("CAMERA", "position_m = [0, -9, 3], look_at_m = [0, 0, 1]").replace(
        "green-canopy", "concrete"
    )
    + "size_m = [2, 2, 2]\n"
)


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "box.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture
def small(tmp_path):
    """Write the description of a camera of few pixels and the same field, and return its path."""
    sensor = load_camera("pulnix-ag5745ef3")
    shrunk = replace(sensor, ccd=replace(sensor.ccd, rows=32, columns=48))
    focal = "optics.focal_length_mm"
    save_sensor(
        shrunk.with_values({focal: float(sensor.parameters()[focal]) / 16.0}),
        tmp_path / "small.toml",
    )
    return tmp_path / "small.toml"


def test_tables_map_and_pictures_agree(scene, small, tmp_path):
    out = tmp_path / "warm"
    done = done_well("temperatures", scene, out, "--sensor", small, "--explain")
    with open(out / "temperatures.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["hour", "air_c", "ground:lawn_c", "box:paint_c"]
    assert len(rows) == 25 and float(rows[-1]["hour"]) == 2.0 and float(rows[-1]["air_c"]) == 16.0
    kelvin = np.load(out / "map.npz")["temperature_k"]
    assert kelvin.shape == (32, 48)
    warmest, coldest = np.nanmax(kelvin) - 273.15, np.nanmin(kelvin) - 273.15
    assert coldest < 16.0 < float(rows[-1]["ground:lawn_c"]) < warmest + 0.5
    assert all((out / name).stat().st_size > 10_000 for name in ("temperatures.png", "map.png"))
    document = json.loads((out / "temperatures.json").read_text())
    conductivity = document["slabs"]["ground:lawn"]["layer 1 conductivity_w_m_k"]
    assert (
        conductivity["value"] == 1.4
        and conductivity["standing"] == "default"
        and conductivity["source"]
    )
    left = [term for term in document["terms"] if not term["kept"]]
    assert left and sum(term["changes_mk"] for term in left) < 40.0
    for term in document["terms"]:
        assert f"{term['name']} " in done.stdout
    assert "modelled" in done.stderr
    again = charact("temperatures", scene, out, "--sensor", small)
    assert_one_sentence(again, f"{out}-2 is free")


def test_the_document_holds_the_last_row_with_intervals(scene, small, tmp_path):
    document = json_of("temperatures", scene, tmp_path / "warm", "--sensor", small)
    with open(tmp_path / "warm" / "temperatures.csv", newline="") as file:
        last = list(csv.DictReader(file))[-1]
    found = {one["stack"]: one for one in document["measurements"]}
    assert {f"{name}_c" for name in found} == set(last) - {"hour", "air_c"}
    for name, one in found.items():
        assert (one["quantity"], one["unit"], one["status"]) == ("surface_temperature", "C", "ok")
        assert one["value"] == pytest.approx(float(last[f"{name}_c"]), abs=6e-4)
        half = 0.5 * (one["interval95"][1] - one["interval95"][0])
        # Handbook slabs under a modelled sky: some tenths of a kelvin to some kelvin.
        assert 0.2 < half < 6.0 and any("modelled" in note for note in one["notes"])
    warm = simulate.temperatures(scene, sensor=small, out=tmp_path / "python")
    assert {m.stack: m.value for m in warm.measurements} == {
        name: one["value"] for name, one in found.items()
    }
    for name in ("temperatures.csv", "temperatures.json"):
        files = [tmp_path / made / name for made in ("python", "warm")]
        assert files[0].read_bytes() == files[1].read_bytes()
    with np.load(tmp_path / "warm" / "map.npz") as file:
        assert np.array_equal(file["temperature_k"], warm.map_k, equal_nan=True)
    with pytest.raises(BadInput, match="needs a camera of visible light, got 'VOx LWIR 640'"):
        simulate.temperatures(scene, sensor="vox-lwir-640")
    assert "outdoor scene" in json_of("temperatures", "bench", tmp_path / "cold")["error"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("wind_m_s = 1", "cloud = 0"), "wind_m_s"),
        (("weather = {", "# weather = {"), "[weather]"),
        (("wind_m_s = 1", 'file = "absent.epw"'), "must exist"),
        (('library = "concrete"', "reflectance = [0.3]"), "'lawn' without one"),
        (("wind_m_s = 1", "wind = 1"), "unknown key 'wind'"),
        (
            ('material = "paint"', 'material = "paint"\nheat_hours = [20, 30]'),
            "heat_hours must lie",
        ),
        (
            ('material = "paint"', 'material = "paint"\ntemperature_c = 5\nabove_air_k = 5'),
            "either a temperature_c",
        ),
    ],
)
def test_a_scene_that_lacks_something_is_refused_in_one_sentence(
    scene, small, tmp_path, change, words
):
    scene.write_text(SCENE.replace(*change))
    done = charact("temperatures", scene, tmp_path / "warm", "--sensor", small)
    assert_one_sentence(done, words)
    assert not (tmp_path / "warm").exists()
