"""`charact simulate` of a moving scene: a camera of visible light and a thermal imager in step."""

import numpy as np
import pytest

from labdata import load_camera, open_session
from tests.charact.cli.runner import LAWN, done_well, small_camera, small_imager

# The front of the box is 10 m before the cameras. ACROSS is its velocity (east), m/s.
SCENE = (
    LAWN.replace("CAMERA", "position_m = [0, -10, 1], look_at_m = [0, 0, 1]")
    + """
size_m = [0.15, 0.15, 1.2]
position_m = [0, 0.075, 0]
temperature_c = 60
KEYFRAMES
[[lamp]]
label = "lamp"
kind = "incandescent"
lumens = 3e2
position_m = [0, -8, 4]
"""
)
FRAMES = 2


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A bolometer array and a camera of visible light of few pixels."""
    folder = tmp_path_factory.mktemp("sequence")
    small_imager(folder, "vox-lwir-640", "bolometer", rows=24, columns=64)
    small_camera(folder, 24, 64).rename(folder / "visible.toml")
    return folder


def simulated(files, out, keyframes, *options):
    scene = files / f"{out.name}.toml"
    scene.write_text(SCENE.replace("KEYFRAMES", keyframes))
    done_well(
        "simulate",
        scene,
        out,
        "--sensor",
        files / "visible.toml",
        "--sensor",
        files / "thermal.toml",
        "--frames",
        FRAMES,
        "--gain",
        3e4,
        *options,
    )
    return open_session(out)


def truth_of(out, name, number=0):
    with np.load(
        out / "truth" / (f"{name}-{number:04d}.npz" if number else f"{name}.npz")
    ) as truth:
        return {key: truth[key] for key in truth.files}


def front_of_box(truth):
    """Columns of the front of the box, which faces the cameras, in one of its rows."""
    front = (truth["object"] == list(truth["objects"]).index("box")) & (
        truth["normal"][..., 1] < -0.5
    )
    row = np.flatnonzero(front.any(axis=1))[3]
    return np.flatnonzero(front[row])


def test_an_object_is_found_where_its_keyframes_bring_it_in_both_bands(files, tmp_path):
    """5 px of the thermal imager a frame: truth within half a pixel, frames within a tenth of the
    way.
    """
    thermal = load_camera(files / "thermal.toml")
    pitch = 1e-3 * thermal.pitch_mrad[1]
    shift_px = 5.0
    velocity = shift_px * pitch * 10.0 * thermal.frame_rate_hz
    keyframes = f"[[object.keyframe]]\ntime_s = 1\nposition_m = [{velocity}, 0.075, 0]"
    session = simulated(files, tmp_path / "moving", keyframes)
    for name in ("visible", "thermal"):
        first, last = (truth_of(tmp_path / "moving", name, number) for number in (0, FRAMES - 1))
        stack = session.stack(name).read()
        assert (
            len(stack) == FRAMES and first["time_s"] == 0.0 and last["time_s"] == stack.time_s[-1]
        )
        moved_px = velocity * last["time_s"] / 10.0 * first["focal_px"][0]
        found_px = front_of_box(last).mean() - front_of_box(first).mean()
        assert moved_px > 2.0 and abs(found_px - moved_px) <= 0.5
        assert "views, each with its truth" in " ".join(session.stack(name).notes)
    frames = session.stack("thermal").read().data.astype(float)
    rows = np.flatnonzero((truth_of(tmp_path / "moving", "thermal")["object"] == 1).any(axis=1))[
        2:-2
    ]
    hot = frames[:, rows].mean(axis=1)
    hot = np.maximum(hot - 0.5 * (hot.min() + hot.max()), 0.0)
    place = hot @ np.arange(hot.shape[1]) / hot.sum(axis=1)
    # Of a bolometer's frame the part exp(-T / tau) is that of the frame before.
    lag = float(np.exp(-1e3 / thermal.frame_rate_hz / float(thermal.bolometer.time_constant_ms)))
    assert place[1] - place[0] == pytest.approx((1.0 - lag) * shift_px, abs=0.2)


def test_a_still_scene_is_that_without_keyframes_bit_for_bit(files, tmp_path):
    still = simulated(files, tmp_path / "still", "")
    standing = simulated(
        files,
        tmp_path / "standing",
        "[[object.keyframe]]\ntime_s = 0.01\nposition_m = [0, 0.075, 0]\nheading_deg = 0",
    )
    for name in ("visible", "thermal"):
        np.testing.assert_array_equal(
            standing.stack(name).read().data, still.stack(name).read().data
        )
        np.testing.assert_array_equal(
            standing.stack(name).read().time_s, still.stack(name).read().time_s
        )
        for key, values in truth_of(tmp_path / "still", name).items():
            np.testing.assert_array_equal(truth_of(tmp_path / "standing", name)[key], values)
    assert sorted(path.name for path in (tmp_path / "standing" / "truth").iterdir()) == [
        "thermal.npz",
        "visible.npz",
    ]
