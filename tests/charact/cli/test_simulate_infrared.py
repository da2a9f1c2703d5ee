"""Thermal imagers and temperatures from the command line."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

import simulate
from labdata import BadInput, load_camera, open_session, save_sensor
from simulate import save_view_radiance
from simulate.radiance.geometry.viewpoint import Viewpoint
from simulate.radiance.outdoor.scene import RigSensor, SceneCamera
from tests.charact.cli.runner import (
    LAWN,
    assert_one_sentence,
    charact,
    done_well,
    json_of,
    small_camera,
    small_imager,
)

# `charact simulate` of a scene out of doors, for thermal imagers, alone and with a camera of
# visible light on one rig, and for a camera at night: frames, radiance, truth and plan.


SCENE = (
    LAWN.replace("CAMERA", "position_m = [0, -9, 1.5], look_at_m = [0, 0, 1]")
    + """
size_m = [1.2, 1.2, 1.6]
[rig.visible]
offset_m = [0.2, 0, 0]
[rig.thermal]
pointing_deg = [4, 0]
delay_s = 0.5
"""
)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A scene with and one without wind, a small scanner and a small camera of visible light."""
    folder = tmp_path_factory.mktemp("rig")
    (folder / "scene.toml").write_text(SCENE)
    (folder / "still.toml").write_text(SCENE.replace(", wind_m_s = 1", ""))
    small_imager(folder, "scanning-lwir", "scanner", lines_per_field=20, samples=48)
    small_camera(folder, 24, 32).rename(folder / "visible.toml")
    return folder


def test_a_thermal_imager_alone_gives_frames_truth_in_kelvin_terms_and_radiance(files, tmp_path):
    out = tmp_path / "out"
    done = done_well(
        "simulate",
        files / "scene.toml",
        out,
        "--sensor",
        files / "thermal.toml",
        "--frames",
        3,
        "--explain",
        "--radiance",
        "npz",
    )
    assert "term of infrared radiance" in done.output and "NETD of a pixel" in done.output
    session = open_session(out)
    frames = session.stack("scene").read()
    assert frames.data.shape == (3, 40, 48) and session.bit_depth == 8 and session.is_interlaced
    assert frames.time_s[0] == 0.5
    notes = " ".join(session.stack("scene").notes)
    assert "set for the surfaces of the scene" in notes
    with np.load(out / "truth.npz") as truth, np.load(out / "radiance" / "thermal.npz") as light:
        kelvin, sky = truth["temperature_k"], truth["object"] < 0
        assert np.isnan(kelvin[sky]).all() and 275.0 < np.nanmin(kelvin) < np.nanmax(kelvin) < 300.0
        box = truth["object"] == list(truth["objects"]).index("box")
        assert light["radiance"].shape == (8, 40, 48) and list(light["edges_um"][[0, -1]]) == [
            8.0,
            12.0,
        ]
        assert str(light["unit"]) == "W m-2 sr-1" and light["range_m"][box].min() == pytest.approx(
            8.4, abs=0.1
        )
        signal = light["radiance"].sum(axis=0)
    # Warm where the light is strong: frame and radiance go together, and the sky is darker high up.
    mean = frames.data.mean(axis=0)
    assert np.corrcoef(mean.ravel(), signal.ravel())[0, 1] > 0.9
    last = int(np.flatnonzero(sky.all(axis=1))[-1])
    assert mean[0].mean() < mean[last].mean() - 20.0
    terms = json.loads((out / "light.json").read_text())
    assert {"netd_mk", "by_chance_mk", "temperatures", "radiance"} <= terms.keys()
    assert (out / "radiance.png").read_bytes()[:4] == b"\x89PNG"
    changed = load_camera(out / "sensor.toml").parameters()["video.level_c"]
    assert changed.value != 22.0


def test_sensors_of_a_rig_share_a_session_and_see_the_same_things(files, tmp_path):
    out = tmp_path / "rig"
    done = done_well(
        "simulate",
        files / "scene.toml",
        out,
        "--sensor",
        files / "visible.toml",
        "--sensor",
        files / "thermal.toml",
        "--frames",
        2,
        "--gain",
        3e4,
        "--radiance",
        "npz",
    )
    assert "2 frames each of visible, thermal" in done.output
    session = open_session(out)
    assert [stack.label for stack in session.stacks] == ["visible", "thermal"]
    assert [stack.sensor for stack in session.stacks] == [
        "sensor/visible.toml",
        "sensor/thermal.toml",
    ]
    assert [stack.read().full_scale_dn for stack in session.stacks] == [255.0, 255.0]
    assert load_camera(out / "sensor" / "thermal.toml").is_thermal
    truths = {}
    for name in ("visible", "thermal"):
        with np.load(out / "truth" / f"{name}.npz") as truth:
            truths[name] = {key: truth[key] for key in truth.files}
        assert (out / "radiance" / f"{name}.npz").exists() and (
            out / "light" / f"{name}.json"
        ).exists()
    of = [
        truth["temperature_k"][truth["object"] == list(truth["objects"]).index("box")]
        for truth in truths.values()
    ]
    assert np.median(of[0]) == pytest.approx(np.median(of[1]), abs=0.5)
    # The thermal imager points 4 degrees to the right of the visible camera: the box lies left of
    # its middle.
    column = {
        name: np.nonzero(truth["object"] == 1)[1].mean() / truth["object"].shape[1]
        for name, truth in truths.items()
    }
    assert column["thermal"] < 0.4 < column["visible"] < 0.5
    assert [float(truth["time_s"]) for truth in truths.values()] == [0.0, 0.5]
    # The lens of the visible camera is a barrel of 1 %, its taper a pincushion of 2 % unless it was
    # left out.
    assert (
        truths["visible"]["frame_distortion"][0] == -0.01
        and truths["thermal"]["frame_distortion"].size == 0
    )
    assert_places_agree(truths["visible"], truths["thermal"])


def places_m(truth):
    """Places of the middles of pixels by range and geometry, (row, col, 3), m; distortion inverted
    by fixed point.
    """
    rows, columns = truth["range_m"].shape
    x = (np.arange(columns) + 0.5 - 0.5 * columns) / truth["focal_px"][0] + np.zeros((rows, 1))
    y = ((np.arange(rows) + 0.5 - 0.5 * rows) / truth["focal_px"][1])[:, None] + np.zeros(
        (rows, columns)
    )
    corner, shrink = np.hypot(*(0.5 * np.array([columns, rows]) / truth["focal_px"])), 1.0
    for _ in range(50):
        shrink = 1.0 / (
            1.0 + float(truth["distortion_fraction"]) * (np.hypot(x, y) * shrink / corner) ** 2
        )
    ray = np.stack([x * shrink, y * shrink, np.ones_like(x)], axis=-1) @ truth["rotation"]
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    return truth["position_m"] + truth["range_m"][..., None] * ray


def assert_places_agree(*truths):
    """Assert that range and geometry of sensors lead to the same faces: of the lawn, z = 0, and of
    the box.
    """
    for truth in truths:
        place = places_m(truth)
        lawn, box = (
            truth["object"] == list(truth["objects"]).index(name) for name in ("ground", "box")
        )
        assert (
            box.sum() > 20 and np.abs(np.abs(place[box]) - [0.6, 0.6, 1.6]).min(axis=1).max() < 1e-3
        )
        assert np.abs(place[lawn][:, 2]).max(initial=0.0) < 1e-3 * truth["range_m"][lawn].max(
            initial=1.0
        )
    assert lawn.sum() > 200


def test_a_sensor_of_a_rig_stands_where_the_scene_says():
    camera = SceneCamera(position_m=(0.0, 0.0, 2.0), look_at_m=(0.0, 10.0, 2.0))
    moved = RigSensor(offset_m=(0.5, 0.25, 1.0), pointing_deg=(45.0, 0.0), roll_deg=3.0).camera(
        camera
    )
    assert moved.position_m == pytest.approx((0.5, 1.0, 2.25)) and moved.roll_deg == 3.0
    assert np.subtract(moved.look_at_m, moved.position_m) == pytest.approx(
        10.0 * np.sqrt(0.5) * np.array([1, 1, 0])
    )
    up = RigSensor(pointing_deg=(0.0, 30.0)).camera(camera)
    assert np.subtract(up.look_at_m, up.position_m) == pytest.approx(
        [0.0, 10.0 * np.cos(np.pi / 6), 5.0]
    )
    with pytest.raises(BadInput, match="delay_s of a rig's sensor must not be negative, got -1"):
        RigSensor(delay_s=-1.0)


def test_a_preview_takes_few_pixels(files, tmp_path):
    done = done_well(
        "simulate",
        files / "scene.toml",
        tmp_path / "p",
        "--sensor",
        files / "thermal.toml",
        "--preview",
    )
    assert "radiance.png: a preview" in done.output and (tmp_path / "p" / "truth.npz").exists()


@pytest.mark.parametrize(
    ("source", "options", "words"),
    [
        ("still.toml", (), "[weather] with wind_m_s or with a file"),
        ("bench", (), "a thermal imager needs an outdoor scene"),
        ("scene.toml", ("--gain", 100), "gain needs a camera of visible"),
        ("scene.toml", ("--sensor", "thermal.toml"), "different names, got 'thermal' twice"),
        ("scene.toml", ("--radiance", "tif"), "fits, envi, exr, got 'tif'"),
        ("scene.toml", ("--kind", "flat"), "must be scene, got flat"),
    ],
)
def test_what_a_thermal_imager_cannot_do_is_refused_in_one_sentence(
    files, tmp_path, monkeypatch, source, options, words
):
    monkeypatch.chdir(files)
    asked = ("simulate", source, tmp_path / "out", "--sensor", "thermal.toml", *options)
    assert_one_sentence(charact(*asked), words)


def test_radiance_as_fits_has_bands_range_and_pose(files, tmp_path):
    fits = pytest.importorskip("astropy.io.fits")
    from simulate import api, conditions_of

    imager = load_camera(files / "thermal.toml")
    request = api.SimulationRequest(source=files / "scene.toml", tolerance=0.1)
    view = api.preview(request, imager, conditions_of(imager))
    save_view_radiance(view, tmp_path / "light.fits")
    with fits.open(tmp_path / "light.fits") as file:
        assert file[0].data.shape == (8, 40, 48) and file[0].header["BUNIT"] == "W m-2 sr-1"
        assert file["EDGES_UM"].data[-1] == 12.0 and file["RANGE_M"].data.shape == (40, 48)
        lens = Viewpoint(
            position_m=tuple(file[0].header[f"POS{axis}"] for axis in "XYZ"),
            forward=tuple(file[0].header[f"AXIS{axis}"] for axis in "XYZ"),
            shape=(40, 48),
            focal_px=(file[0].header["FOCALX"], file[0].header["FOCALY"]),
        )
    assert lens.position_m == (0.0, -9.0, 1.5) and lens.forward[1] > 0.99


BALL = """
name = "a ball on a lawn"
place = { latitude_deg = 43.16, longitude_deg = -77.61, time = 1998-07-01T23:00:00-04:00 }
camera = { position_m = [0, -9, 1.5], look_at_m = [0, 0, 1] }
[[material]]
label = "lawn"
library = "green-canopy"
[[material]]
label = "paint"
reflectance = [0.6]
[[object]]
label = "ground"
shape = "ground"
size_m = [400]
material = "lawn"
[[object]]
label = "ball"
shape = "sphere"
size_m = [0.15]
material = "paint"
position_m = [0, 0, 1]
"""


def test_a_scene_becomes_frames_with_radiance_truth_and_plan_beside_them(tmp_path):
    out, camera = tmp_path / "out", small_camera(tmp_path, 48, 64)
    (tmp_path / "scene.toml").write_text(BALL)
    done = done_well(
        "simulate", tmp_path / "scene.toml", out, "--sensor", camera, "--frames", 40, "--explain"
    )
    assert "moon" in done.output and "bounces followed" in done.output
    frames = open_session(out).stack("scene").read().data.astype(float)
    with np.load(out / "truth.npz") as truth:
        ball = truth["object"] == list(truth["objects"]).index("ball")
        lawn = truth["object"] == list(truth["objects"]).index("ground")
        assert truth["range_m"][ball].min() == pytest.approx(np.hypot(9.0, 0.5) - 0.15, abs=0.05)
        assert list(truth["sources"]) == ["moon"]
    assert frames.shape[1:] == ball.shape
    mean = frames.mean(axis=0)
    # Pale paint in moonlight beside a lawn: the camera sees it where the truth says it is.
    assert mean[ball].mean() > mean[lawn].mean() + 5.0 * mean[lawn].std() / np.sqrt(lawn.sum())
    plan = json.loads((out / "light.json").read_text())
    assert {effect["name"] for effect in plan["effects"]} >= {"moon", "bounce 1", "hidden sky"}
    assert (out / "radiance.png").read_bytes()[:4] == b"\x89PNG"


# `charact temperatures`: tables and pictures of a scene, what was left out, and what is refused in
# one sentence.


MEADOW = (
    LAWN.replace("CAMERA", "position_m = [0, -9, 3], look_at_m = [0, 0, 1]").replace(
        "green-canopy", "concrete"
    )
    + "size_m = [2, 2, 2]\n"
)


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "box.toml"
    path.write_text(MEADOW)
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
    scene.write_text(MEADOW.replace(*change))
    done = charact("temperatures", scene, tmp_path / "warm", "--sensor", small)
    assert_one_sentence(done, words)
    assert not (tmp_path / "warm").exists()
