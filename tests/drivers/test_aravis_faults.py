"""What goes wrong on a GigE Vision wire: lost packets, a camera that dies, and buffers that must be
large enough.
"""

import os
import signal
import time

import numpy as np
import pytest

from drivers.errors import CameraError
from labdata import CameraSettings, Target
from simulate.lab import LabBench
from simulate.virtual_bench.camera import CameraProcess
from simulate.virtual_bench.outputs import read_outputs
from simulate.virtual_bench.tube import VirtualTube, frame_seed
from tests.drivers.wired_bench import MARKS, opened, taken, wired_bench

pytestmark = MARKS


def test_40_of_40_full_frames_arrive_whole_with_consecutive_numbers(tmp_path):
    folder, wires = wired_bench(tmp_path / "bench", rows=493, columns=768)
    with CameraProcess(folder, wires) as process, opened(process) as camera:
        frames, lost = taken(camera, 40)
    assert lost == 0
    assert [frame.number - frames[0].number for frame in frames] == list(range(40))
    assert all(frame.pixels.shape == (493, 768) for frame in frames)
    assert np.all(np.diff([frame.time_s for frame in frames]) > 0)
    # A frame whose tail never came would be black there, below the darkest pixel of the black
    # level.
    assert min(int(frame.pixels[-40:].min()) for frame in frames) > 0
    assert len({frame.pixels.tobytes() for frame in frames}) == 40


def test_frames_with_lost_packets_are_counted_and_never_handed_out(tmp_path):
    folder, wires = wired_bench(tmp_path / "bench", rows=61, columns=84)
    with CameraProcess(folder, wires, lost_packet_share=0.1) as process, opened(process) as camera:
        frames, lost = taken(camera, 12)
    assert lost > 0
    numbers = [frame.number for frame in frames]
    assert numbers == sorted(numbers)
    tube = VirtualTube(folder, lambda: read_outputs(wires))
    drawn = LabBench(tube.sensor).expose(
        "dark",
        Target(),
        tube.scene(exposure_s=0.016683, gain_db=0.0).conditions,
        frames=80,
        seed=frame_seed(3, 0),
    )
    there = {frame.tobytes() for frame in drawn.data}
    assert all(frame.pixels.tobytes() in there for frame in frames)


@pytest.mark.parametrize(
    ("how", "sentence"), [(signal.SIGKILL, "has gone"), (signal.SIGSTOP, "no longer answers")]
)
def test_a_camera_that_dies_in_mid_run_is_noticed_within_a_second_or_two(tmp_path, how, sentence):
    folder, wires = wired_bench(tmp_path / "bench", rows=61, columns=84)
    with CameraProcess(folder, wires) as process:
        camera = opened(process)
        with (
            pytest.raises(CameraError, match=sentence) as caught,
            camera,
            camera.capture(frames=10_000) as capture,
        ):
            for number, _ in enumerate(capture):
                if number == 3:
                    os.kill(process.pid, how)
                    died_s = time.monotonic()
        assert time.monotonic() - died_s < 2.0
        assert str(caught.value).count(".") <= 1
        os.kill(process.pid, signal.SIGCONT)


def test_a_camera_that_is_gone_before_a_run_is_noticed_at_once(tmp_path):
    folder, wires = wired_bench(tmp_path / "bench", rows=61, columns=84)
    with CameraProcess(folder, wires) as process, opened(process) as camera:
        process.kill()
        began_s = time.monotonic()
        with pytest.raises(CameraError, match="nothing listens on its control port"):
            camera.configure(CameraSettings(gain_db=1.0))
        assert time.monotonic() - began_s < 0.5


def test_a_camera_that_goes_while_it_is_spoken_to_is_not_spoken_to_for_seconds(tmp_path):
    folder, wires = wired_bench(tmp_path / "bench", rows=61, columns=84)
    with CameraProcess(folder, wires) as process, opened(process) as camera:

        def killed() -> None:
            process.kill()
            time.sleep(3.0)  # as long as the library repeats a command that nobody answers

        began_s = time.monotonic()
        with pytest.raises(CameraError, match="nothing listens on its control port"):
            camera.connection.while_alive(killed)
        assert time.monotonic() - began_s < 1.0
        assert camera.connection.is_dead
