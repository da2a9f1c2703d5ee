"""`charact simulate` of a scene out of doors: frames, and beside them its radiance, its truth and
its plan.
"""

import json

import numpy as np
import pytest

from labdata import open_session
from tests.charact.cli.runner import done_well, small_camera

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


def test_a_scene_becomes_frames_with_radiance_truth_and_plan_beside_them(tmp_path):
    out, camera = tmp_path / "out", small_camera(tmp_path, 48, 64)
    (tmp_path / "scene.toml").write_text(SCENE)
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
