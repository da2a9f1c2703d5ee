"""The V4L2 driver against a kernel: the vivid virtual camera, whose errors and pictures are set by
its controls.

Runs where the kernel has that camera, such as in the guest of `python tests/vivid/guest.py`.
"""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from drivers.cameras.v4l2 import V4l2Camera, list_devices
from drivers.errors import CameraError
from labdata import CameraSettings, Frame
from tests.drivers.camera_laws import Bench, CameraLaws, taken

PATH, WEBCAM, COMPOSITE = "/dev/video0", 0, 1
NAMES = Path("/sys/class/video4linux/video0/name")
CHECKERS, BLACK, WHITE = 10, 5, 6
DROPPED, SPOIL = "Percentage of Dropped Buffers", "Inject V4L2_BUF_FLAG_ERROR"

pytestmark = pytest.mark.skipif(
    not (NAMES.exists() and NAMES.read_text().startswith("vivid")),
    reason="the kernel has no virtual camera (vivid)",
)


@contextmanager
def vivid(
    input_number: int = WEBCAM,
    *,
    pattern: int = CHECKERS,
    video_lines: int | None = None,
    **controls: int,
) -> Iterator[V4l2Camera]:
    """The virtual camera with a still picture, nothing automatic, and no fault but those asked
    for.
    """
    with V4l2Camera(PATH, input_number=input_number, video_lines=video_lines) as camera:
        calm = {"OSD Text Mode": 2, "Test Pattern": pattern, DROPPED: 0, "Wrap Sequence Number": 0}
        for name, value in (
            calm | {name.replace("_", " "): value for name, value in controls.items()}
        ).items():
            camera.set_control(name, value)
        if input_number == WEBCAM:
            camera.configure(
                CameraSettings(rows=180, columns=320, pixel_format="Mono8", frame_rate_hz=30.0)
            )
        camera.configure(CameraSettings(pixel_format="Mono8", gain_db=100.0))
        yield camera


@contextmanager
def slow() -> Iterator[V4l2Camera]:
    """The virtual camera at one frame a second."""
    with vivid() as camera:
        camera.configure(CameraSettings(frame_rate_hz=1.0))
        yield camera


def is_checkered(frame: Frame) -> bool:
    """Squares of 16 px, black and white by turns, and nothing else."""
    squares = np.indices(frame.pixels.shape) // 16
    white = squares.sum(axis=0) % 2 == frame.pixels[0, 0] // 128 % 2
    lit, dark = frame.pixels[~white], frame.pixels[white]
    levels = sorted((float(lit.mean()), float(dark.mean())))
    return len(set(lit.tolist())) == len(set(dark.tolist())) == 1 and levels[1] > 10 * max(
        levels[0], 1.0
    )


@pytest.mark.parametrize("lost_percent", [0, 1, 5])
class TestWebcam(CameraLaws):
    @pytest.fixture
    def laws(self, lost_percent: int) -> Bench:
        return Bench(
            open=lambda: vivid(**{DROPPED.replace(" ", "_"): lost_percent}),
            quiet=slow,
            is_whole=is_checkered,
            frames=60 if lost_percent else 20,
            loses=True,  # an emulated machine that is held up drops frames of its own
            asked=(
                CameraSettings(rows=360, columns=640),
                CameraSettings(pixel_format="Mono16"),
                CameraSettings(pixel_format="Mono12"),
                CameraSettings(pixel_format="Mono10"),
                CameraSettings(pixel_format="YUYV"),
                CameraSettings(pixel_format="UYVY"),
                CameraSettings(pixel_format="NV12"),
                CameraSettings(gain_db=20.0),
                CameraSettings(frame_rate_hz=15.0),
                CameraSettings(field_order="progressive", trigger="off"),
            ),
            refused=(
                (CameraSettings(rows=7, columns=9), "rows and columns that it offers .*180x320"),
                (CameraSettings(pixel_format="RGB8"), "must be one of"),
                (CameraSettings(gain_db=999.0), "must lie in 0"),
                (CameraSettings(frame_rate_hz=7777.0), "must accept the requested frame rate"),
                (CameraSettings(exposure_s=0.01), "must have a control for the exposure"),
            ),
        )


class TestComposite(CameraLaws):
    @pytest.fixture
    def laws(self) -> Bench:
        return Bench(
            open=lambda: vivid(COMPOSITE, video_lines=525),
            quiet=slow,
            is_whole=is_checkered,
            frames=10,
            loses=True,
        )


def test_the_device_is_listed_with_what_it_offers() -> None:
    with vivid() as camera:
        (device,) = list_devices()
        controls = camera.controls()
    assert (device.path, device.driver, device.card) == (PATH, "vivid", "vivid")
    assert len(device.inputs) == 2
    assert {"Mono8", "Mono16", "YUYV", "UYVY", "NV12"} <= {one.name for one in device.formats}
    assert next(one.sizes for one in device.formats if one.name == "Mono8")[0] == (180, 320)
    assert {"Gain", "Brightness", DROPPED} <= {one.name for one in controls}


def test_every_control_set_is_read_back() -> None:
    with vivid() as camera:
        assert camera.set_control("Brightness", 77) == camera.control("Brightness") == 77
        camera.set_control("Brightness", 128)


@pytest.mark.parametrize(
    ("lines", "order", "rows"), [(525, "bottom first", 480), (625, "top first", 576)]
)
def test_the_older_field_follows_the_video_standard(lines: int, order: str, rows: int) -> None:
    with vivid(COMPOSITE, video_lines=lines) as camera:
        settings = camera.configure(CameraSettings())
        frames, _ = taken(camera, 3)
    assert settings.field_order == order
    assert {frame.field_order for frame in frames} == {order}
    assert frames[0].pixels.shape == (rows, 720)


@pytest.mark.parametrize("name", ["Mono8", "YUYV", "UYVY", "NV12", "Mono10", "Mono12", "Mono16"])
def test_white_is_brighter_than_black_in_every_pixel_of_every_format(name: str) -> None:
    level = {}
    for pattern in (BLACK, WHITE):
        with vivid(pattern=pattern) as camera:
            camera.configure(CameraSettings(pixel_format=name))
            (frame,), _ = taken(camera, 1)
            level[pattern] = frame.pixels
            camera.configure(CameraSettings(pixel_format="Mono8"))
    full = {"Mono10": 1023, "Mono12": 4095, "Mono16": 65535}.get(name, 255)
    assert level[BLACK].max() <= 0.07 * full
    assert 0.9 * full <= level[WHITE].min() <= level[WHITE].max() <= full


def test_frames_that_the_driver_drops_are_counted() -> None:
    with vivid(**{DROPPED.replace(" ", "_"): 20}) as camera:
        frames, capture = taken(camera, 60)
    numbered = frames[-1].number - frames[0].number + 1
    # 20 % of the frames between the first and the last: 15 of 75, give or take four standard errors
    # of 3.9.
    assert 2 <= capture.lost_frames <= 34
    assert capture.lost_frames == numbered - 60
    assert {loss.reason for loss in capture.losses} == {"never arrived"}


def test_a_frame_that_the_driver_marks_as_spoiled_is_counted_and_not_handed_out() -> None:
    with vivid() as camera, camera.capture(frames=20) as capture:
        numbers = []
        for frame in capture:
            numbers.append(frame.number)
            if len(numbers) == 5:
                camera.set_control(SPOIL, 1)
    # An emulated machine that is held up may drop others of its own.
    (spoiled,) = [
        loss for loss in capture.losses if loss.reason == "marked as spoiled by its driver"
    ]
    assert len(spoiled) == 1
    assert spoiled.first not in numbers


def test_numbers_run_on_where_32_bits_start_again() -> None:
    with vivid(Wrap_Sequence_Number=1) as camera:
        camera.configure(CameraSettings(frame_rate_hz=60.0))
        frames, capture = taken(camera, 140)
        camera.configure(CameraSettings(frame_rate_hz=30.0))
    assert frames[0].number < 1 << 32 < frames[-1].number
    assert frames[-1].number - frames[0].number == 139 + capture.lost_frames


def test_time_stamps_are_those_of_the_kernels_clock() -> None:
    before_s = time.monotonic()
    with vivid() as camera:
        frames, _ = taken(camera, 10)
    # This driver stamps the end of the frame that it has drawn, which may be still to come.
    assert before_s < frames[0].time_s < frames[-1].time_s < time.monotonic() + 1 / 30
    seconds, numbered = (
        np.ptp([getattr(frame, name) for frame in frames]) for name in ("time_s", "number")
    )
    assert seconds / numbered == pytest.approx(1 / 30, rel=0.2)


@pytest.mark.parametrize(
    "control",
    ["Inject VIDIOC_REQBUFS Error", "Inject VIDIOC_QBUF Error", "Inject VIDIOC_STREAMON Error"],
)
def test_a_refusal_to_start_is_a_sentence_and_the_next_start_works(control: str) -> None:
    with vivid() as camera:
        camera.set_control(control, 1)
        with pytest.raises(CameraError, match="must"):
            taken(camera, 1)
        assert len(taken(camera, 2)[0]) == 2


@pytest.mark.parametrize("control", ["Inject Fatal Streaming Error", "Disconnect"])
def test_a_camera_that_fails_or_is_unplugged_in_mid_run_is_noticed_at_once(control: str) -> None:
    """The last test: a disconnected camera comes back only when its driver is loaded again."""
    ended_s = []
    with pytest.raises(CameraError, match="has gone or failed"), vivid() as camera:
        threading.Timer(
            0.5, lambda: (ended_s.append(time.monotonic()), camera.set_control(control, 1))
        ).start()
        taken(camera, 10_000)
    assert time.monotonic() - ended_s[0] < 2.0
