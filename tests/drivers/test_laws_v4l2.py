"""The V4L2 driver keeps the laws of cameras against a device that answers at the ioctl boundary."""

import time
from itertools import count

import numpy as np
import pytest

from drivers.cameras.v4l2 import V4l2Camera
from labdata.capture import CameraSettings, Frame
from tests.drivers.camera_laws import Bench, CameraLaws
from tests.drivers.fake_video import FakeDevice, Sent, luma, steadily


def is_whole(frame: Frame) -> bool:
    deep = frame.pixels.dtype == np.uint16
    return np.array_equal(frame.pixels, luma(frame.number, *frame.pixels.shape, deep=deep))


def dropping():
    """Every fifth frame is missing, every seventh is spoiled, every eleventh is cut short."""
    for sequence in count():
        if sequence % 5 != 4:
            yield Sent(
                sequence=sequence,
                faulty=sequence % 7 == 3,
                share=0.5 if sequence % 11 == 6 else 1.0,
            )


class SlowDevice(FakeDevice):
    """A device that waits as long as it is asked to."""

    def wait(self, timeout_s: float) -> bool:
        time.sleep(timeout_s)
        return False


@pytest.mark.parametrize(
    "loses", [False, True], ids=["all arrive", "a third does not arrive whole"]
)
class TestV4l2(CameraLaws):
    @pytest.fixture
    def laws(self, loses: bool) -> Bench:
        return Bench(
            quiet=lambda: V4l2Camera("fake", silence_s=5.0, open_device=lambda _: SlowDevice(list)),
            open=lambda: V4l2Camera(
                "fake", open_device=lambda _: FakeDevice(dropping if loses else steadily)
            ),
            is_whole=is_whole,
            loses=loses,
            asked=(
                CameraSettings(rows=12, columns=16),
                CameraSettings(pixel_format="Mono16"),
                CameraSettings(pixel_format="YUYV"),
                CameraSettings(exposure_s=0.02),
                CameraSettings(gain_db=20.0),
                CameraSettings(frame_rate_hz=30 / 1.001),
                CameraSettings(
                    first_row=0, first_column=0, trigger="off", field_order="progressive"
                ),
            ),
            refused=(
                (CameraSettings(rows=5000), "rows and columns that it offers .*24x32, 12x16"),
                (CameraSettings(rows=13, columns=17), "got 13x17, which it makes 12x16"),
                (
                    CameraSettings(frame_rate_hz=500.0),
                    "must accept the requested frame rate, 500 Hz, but reads back 60",
                ),
                (
                    CameraSettings(pixel_format="RGB8"),
                    "must be one of Mono8, Mono16, YUYV, got 'RGB8'",
                ),
                (
                    CameraSettings(pixel_format="Mono12"),
                    "must be one of Mono8, Mono16, YUYV, got 'Mono12'",
                ),
                (CameraSettings(exposure_s=100.0), r"must lie in 0\.0001\.\.1 s, got 100"),
                (CameraSettings(gain_db=999.0), r"must lie in 0\.\.255 of its own steps, got 999"),
                (CameraSettings(first_row=3), "must begin at row 0 and column 0"),
                (CameraSettings(trigger="Line1"), "V4L2 has no trigger"),
                (CameraSettings(field_order="top first"), "must accept the requested field order"),
            ),
        )
