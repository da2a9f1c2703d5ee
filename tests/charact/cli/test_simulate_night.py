"""`charact simulate` of a scene out of doors: frames, and beside them its radiance, its truth and its plan."""

import json
from dataclasses import replace

import numpy as np
import pytest

from labdata.sensors import load_camera, save_sensor
from labdata.session import open_session
from tests.charact.cli.runner import charact, done_well

SCENE = """
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


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A camera with a small chip and a scene, as files."""
    folder = tmp_path_factory.mktemp("night")
    camera = load_camera("pulnix-ag5745ef3")
    save_sensor(replace(camera, ccd=replace(camera.ccd, rows=48, columns=64)), folder / "camera.toml")
    (folder / "scene.toml").write_text(SCENE)
    return folder


def test_a_scene_becomes_frames_with_radiance_truth_and_plan_beside_them(tmp_path, files):
    out = tmp_path / "out"
    asked = ("simulate", files / "scene.toml", out, "--sensor", files / "camera.toml", "--frames", 40, "--explain")
    done = done_well(*asked)
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


def test_what_does_not_belong_to_a_scene_is_refused_in_one_sentence(tmp_path, files):
    asked = ("simulate", files / "scene.toml", tmp_path / "out", "--sensor", files / "camera.toml")
    for more, words in (
        (("--illuminance-lux", 1e-4), "--illuminance-lux is only for bench scenes"),
        (("--black-dn", 3), "--black-dn is only for an image"),
    ):
        done = charact(*asked, *more)
        assert done.exit_code == 1 and words in done.stderr
    done = charact("simulate", "bench", tmp_path / "out", "--sensor", files / "camera.toml", "--preview")
    assert done.exit_code == 1 and "--preview needs an outdoor scene" in done.stderr
    done = charact("simulate", "nowhere", tmp_path / "out", "--sensor", files / "camera.toml")
    assert (
        done.exit_code == 1 and "must be a .toml file or one of airfield, bench, bench-lit, hangar, road" in done.stderr
    )
    assert not (tmp_path / "out").exists()
