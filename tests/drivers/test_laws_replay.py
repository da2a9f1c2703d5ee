"""A recorded session keeps the laws of cameras, and plays what was recorded: numbers, stamps, gaps
and pixels.
"""

import time
from itertools import pairwise

import numpy as np
import pytest

from drivers.cameras.replay import LONGEST_PAUSE_S, ReplayCamera
from drivers.errors import CameraError
from labdata import (
    BadInput,
    CameraSettings,
    Conditions,
    Frame,
    SessionWriter,
    lost_frames_with_reason,
    open_session,
)
from tests.drivers.camera_laws import Bench, CameraLaws, taken
from tests.drivers.fake_video import PERIOD_S, luma

WHOLE = [number for number in range(1, 61) if number % 7 != 3]
CONDITIONS = Conditions(exposure_s=0.016, camera_gain_db=3.0)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Two stacks; of the first every seventh frame was lost."""
    folder = tmp_path_factory.mktemp("recorded") / "session"
    with SessionWriter.create(folder, name="night", bit_depth=8) as writer:
        for label, numbers in (("lossy", WHOLE), ("whole", range(1, 41))):
            with writer.begin_stack(label, "flat", (24, 32), np.uint8, CONDITIONS) as stack:
                for number in numbers:
                    stack.append(luma(number), 100.0 + number * PERIOD_S, number)
                missing = [
                    number for one, later in pairwise(numbers) for number in range(one + 1, later)
                ]
                stack.finish(losses=lost_frames_with_reason("missing packets", missing))
    return folder


def is_whole(frame: Frame) -> bool:
    return np.array_equal(frame.pixels, luma(frame.number))


@pytest.mark.parametrize("label", ["lossy", "whole"])
class TestReplay(CameraLaws):
    @pytest.fixture
    def laws(self, recorded, label):
        return Bench(
            open=lambda: ReplayCamera(recorded, label=label, speed=None),
            quiet=lambda: ReplayCamera(recorded, label=label, speed=0.01),
            is_whole=is_whole,
            loses=label == "lossy",
            counts_from=1,
            asked=(
                CameraSettings(
                    rows=24, columns=32, first_row=0, first_column=0, pixel_format="Mono8"
                ),
                CameraSettings(
                    exposure_s=0.016, gain_db=3.0, frame_rate_hz=1 / PERIOD_S, trigger="off"
                ),
            ),
            refused=(
                (CameraSettings(rows=25), "rows of the replay .* must be as recorded, 24, got 25"),
                (
                    CameraSettings(pixel_format="Mono16"),
                    "pixel_format .* as recorded, Mono8, got Mono16",
                ),
                (CameraSettings(exposure_s=0.03), "exposure_s .* as recorded, 0.016, got 0.03"),
                (
                    CameraSettings(field_order="top first"),
                    "field_order .* as recorded, None, got top first",
                ),
            ),
        )


def test_what_is_played_is_what_was_recorded_to_the_last_frame(recorded):
    entry = open_session(recorded).stack("lossy")
    stack = entry.read()
    with ReplayCamera(recorded, label="lossy", speed=None) as camera:
        frames, capture = taken(camera, len(stack))
    assert np.array_equal(np.stack([frame.pixels for frame in frames]), stack.data)
    assert [frame.number for frame in frames] == stack.frame_number.tolist() == WHOLE
    assert [frame.time_s for frame in frames] == stack.time_s.tolist()
    assert capture.lost_frames == entry.lost_frames == 9
    assert capture.losses == entry.losses
    assert {loss.reason for loss in capture.losses} == {"missing packets"}


def test_a_session_is_played_stack_after_stack_and_then_has_ended(recorded):
    with ReplayCamera(recorded, speed=None) as camera:
        assert taken(camera, 40)[1].lost_frames > 0
        assert taken(camera, 40)[1].lost_frames == 0
        with pytest.raises(CameraError, match="has ended: all 2 stacks were played"):
            camera.capture(frames=1)


def test_frames_that_are_played_back_are_never_taken_for_new_ones(recorded):
    with ReplayCamera(recorded, label="whole") as camera:
        assert camera.configure(CameraSettings()).notes == (
            f"frames are a replay of {recorded}#whole",
        )


def test_more_frames_than_were_recorded_are_refused(recorded):
    with (
        ReplayCamera(recorded, label="whole", speed=None) as camera,
        pytest.raises(CameraError, match="must hold the 41 requested frames, stack 'whole' has 40"),
    ):
        camera.capture(frames=38, discard=3)


def test_frames_come_at_the_pace_of_the_recording(recorded):
    began_s = time.monotonic()
    with ReplayCamera(recorded, label="whole", speed=2.0) as camera:
        taken(camera, 13)
    assert 12 * PERIOD_S / 2 <= time.monotonic() - began_s < 12 * PERIOD_S / 2 + 2 * LONGEST_PAUSE_S


def test_an_unknown_stack_or_folder_is_refused(recorded, tmp_path):
    with (
        pytest.raises(BadInput, match=r"must be one of \['lossy', 'whole'\], got 'other'"),
        ReplayCamera(recorded, label="other"),
    ):
        pass
    with (
        pytest.raises(BadInput, match="a session must be a folder"),
        ReplayCamera(tmp_path / "none"),
    ):
        pass


def test_a_recording_without_stamps_is_numbered_and_timed_anew_and_says_so(tmp_path):
    np.save(tmp_path / "flat.npy", np.stack([luma(number) for number in range(1, 6)]))
    (tmp_path / "session.toml").write_text(
        'name = "loose"\n[[stack]]\nlabel = "flat"\nkind = "flat"\nframes = "flat.npy"\n'
    )
    said = []
    with ReplayCamera(tmp_path, label="flat", speed=None, say=said.append) as camera:
        frames, _ = taken(camera, 5)
    assert [frame.number for frame in frames] == [1, 2, 3, 4, 5]
    assert all(is_whole(frame) for frame in frames)
    assert len(said) == 2
    assert "has no time stamps: 30 frames/s are assumed" in said[1]
