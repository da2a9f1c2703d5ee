"""Frames over a real GigE Vision wire: whole, numbered, of the settings read back, and never of a
time before.
"""

import subprocess
import sys
import time

import numpy as np
import pytest

from drivers.cameras.aravis.camera import AravisCamera
from drivers.cameras.aravis.connection import list_cameras
from drivers.errors import CameraError
from labdata import BadInput, CameraSettings, Target, load_sensor
from simulate.lab import LabBench
from simulate.virtual_bench.camera import CameraProcess
from simulate.virtual_bench.in_process import InProcessCamera
from simulate.virtual_bench.outputs import (
    GATE_FILE,
    GateOutput,
    VirtualOperator,
    publish,
    read_outputs,
    read_placement,
)
from simulate.virtual_bench.tube import VirtualTube, frame_seed
from tests.drivers.wired_bench import MARKS, OPEN, PATIENCE_S, opened, taken, wired_bench

pytestmark = MARKS


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    folder, wires = wired_bench(tmp_path_factory.mktemp("bench"), rows=61, columns=84)
    with CameraProcess(folder, wires) as process:
        yield folder, wires, process


def test_frames_are_those_that_the_bench_would_draw(small):
    folder, wires, process = small
    VirtualOperator(folder).place(kind="edge", target=Target(angle_deg=5.0), illuminance_lux=2e-5)
    with opened(process) as camera:
        frames, _ = taken(camera, 4, discard=2)
    tube = VirtualTube(folder, lambda: read_outputs(wires))
    scene = tube.scene(exposure_s=0.016683, gain_db=0.0)
    # It stands where the bench put it, off its stated angle by a degree at most.
    assert 0.0 < abs(scene.placement.target.angle_deg - 5.0) <= 1.0
    drawn = LabBench(tube.sensor).expose(
        "edge",
        scene.placement.target,
        scene.conditions,
        frames=4,
        seed=frame_seed(3, read_placement(folder).number),
        first_frame=2,
    )
    assert np.array_equal(np.stack([frame.pixels for frame in frames]), drawn.data)


def test_the_camera_inside_this_process_sends_the_same_frames(small):
    folder, wires, process = small
    VirtualOperator(folder).place(kind="flat", target=Target(), illuminance_lux=2e-5)
    with opened(process) as camera:
        wired, _ = taken(camera, 3, discard=1)
    with InProcessCamera(folder, lambda: read_outputs(wires)) as camera:
        inside, _ = taken(camera, 3, discard=1)
    assert all(
        np.array_equal(one.pixels, other.pixels) for one, other in zip(wired, inside, strict=True)
    )


def test_no_frame_shows_light_that_is_gone(small):
    folder, _, process = small
    operator = VirtualOperator(folder)
    with opened(process) as camera:
        for _ in range(3):
            operator.place(kind="flat", target=Target(), illuminance_lux=1e-4)
            bright, _ = taken(camera, 3)
            operator.place(kind="flat", target=Target(), illuminance_lux=0.0)
            dark, _ = taken(camera, 3)
            assert max(frame.pixels.mean() for frame in dark) < 0.7 * min(
                frame.pixels.mean() for frame in bright
            )


def test_a_closed_gate_leaves_the_black_level(small):
    folder, wires, process = small
    VirtualOperator(folder).place(kind="flat", target=Target(), illuminance_lux=1e-4)
    publish(wires, GATE_FILE, vars(GateOutput()))
    try:
        with opened(process) as camera:
            frames, _ = taken(camera, 3)
    finally:
        publish(wires, GATE_FILE, vars(OPEN))
    black_dn = float(load_sensor("pulnix-ag5745ef3").video.black_level_dn)
    assert all(abs(float(frame.pixels.mean()) - black_dn) < 1.5 for frame in frames)


def test_every_setting_asked_is_read_back(small):
    _, _, process = small
    asked = CameraSettings(
        rows=40,
        columns=64,
        pixel_format="Mono16",
        exposure_s=0.012,
        gain_db=6.0,
        frame_rate_hz=20.0,
    )
    with opened(process) as camera:
        before = camera.configure(CameraSettings())
        read_back = camera.configure(asked)
        frames, _ = taken(camera, 2)
        camera.configure(before)
    assert (before.rows, before.columns, before.pixel_format) == (61, 84, "Mono8")
    assert before.exposure_s == pytest.approx(1.001 / 60, abs=1e-6)
    assert before.frame_rate_hz == pytest.approx(30 / 1.001, rel=1e-4)
    assert (read_back.rows, read_back.columns, read_back.pixel_format) == (40, 64, "Mono16")
    for name in ("exposure_s", "gain_db", "frame_rate_hz"):
        assert getattr(read_back, name) == pytest.approx(getattr(asked, name), rel=1e-4)
    assert frames[0].pixels.shape == (40, 64)
    assert frames[0].pixels.dtype == np.uint16


def test_video_gain_multiplies_the_signal_above_black(small):
    folder, _, process = small
    VirtualOperator(folder).place(kind="flat", target=Target(), illuminance_lux=2e-5)
    black_dn = float(load_sensor("pulnix-ag5745ef3").video.black_level_dn)
    level = {}
    with opened(process) as camera:
        for gain_db in (0.0, 6.0):
            camera.configure(CameraSettings(gain_db=gain_db))
            frames, _ = taken(camera, 12, discard=1)
            level[gain_db] = np.mean([frame.pixels.mean() for frame in frames]) - black_dn
        camera.configure(CameraSettings(gain_db=0.0))
    assert level[6.0] / level[0.0] == pytest.approx(10 ** (6 / 20), rel=0.15)


@pytest.mark.parametrize(
    ("settings", "rule"),
    [
        (CameraSettings(gain_db=99.0), r"gain of camera .* must lie in 0\.\.10"),
        (CameraSettings(exposure_s=1e-6), "exposure of camera .* must lie in"),
        (CameraSettings(exposure_s=1.0), "exposure of camera .* must lie in"),
        (CameraSettings(rows=5000), "must fit into the sensor's 61 rows and 84 columns"),
        (CameraSettings(pixel_format="RGB8"), "pixel format must be one of"),
    ],
)
def test_what_the_camera_cannot_do_is_refused_in_a_sentence(small, settings, rule):
    _, _, process = small
    with opened(process) as camera, pytest.raises(BadInput, match=rule):
        camera.configure(settings)


def test_a_camera_is_found_by_name_by_address_and_in_the_list(small):
    _, _, process = small
    assert [camera.identifier for camera in list_cameras()] == [process.identifier]
    with AravisCamera("127.0.0.1", silence_s=PATIENCE_S) as camera:
        assert len(taken(camera, 1)[0]) == 1
    with AravisCamera(silence_s=PATIENCE_S) as camera:
        assert camera.identifier == process.identifier


def test_an_unknown_camera_is_refused_with_those_that_are_there(small):
    _, _, process = small
    with (
        pytest.raises(
            CameraError, match=f"no-such-camera cannot be opened .*found: {process.identifier}"
        ),
        AravisCamera("no-such-camera"),
    ):
        pass


def test_a_camera_that_another_program_holds_is_said_to_be_held(small):
    _, _, process = small
    said = []
    with (
        opened(process),
        pytest.raises(CameraError, match="is held by another program"),
        opened(process, control_s=0.0, say=said.append),
    ):
        pass
    assert said == []
    with opened(process) as camera:
        assert len(taken(camera, 1)[0]) == 1


HOLDER = """
import sys
from drivers.cameras.aravis.camera import AravisCamera
with AravisCamera(sys.argv[1], silence_s=30.0) as camera, camera.capture(frames=10_000) as capture:
    for frame in capture:
        print("frame", flush=True)
"""


def test_a_camera_locked_by_a_dead_client_frees_itself_and_the_wait_is_told(small):
    _, _, process = small
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, process.identifier], stdout=subprocess.PIPE
    ) as holder:
        assert holder.stdout and holder.stdout.readline()
        holder.kill()
    said, began_s = [], time.monotonic()
    with opened(process, say=said.append) as camera:
        assert len(taken(camera, 2)[0]) == 2
    assert time.monotonic() - began_s < 12.0
    assert all("heartbeat" in sentence for sentence in said)
