"""What goes wrong between a program and a video device: unplugging, silence, spoiled frames,
numbers that leap.
"""

import errno
import time
from itertools import chain, count, islice

import numpy as np
import pytest

from drivers.cameras.v4l2 import V4l2Camera
from drivers.cameras.v4l2.fields import (
    ALTERNATE,
    BOTTOM,
    BOTTOM_THEN_TOP,
    INTERLACED,
    TOP,
    TOP_THEN_BOTTOM,
)
from drivers.errors import CameraError
from labdata.capture import CameraSettings
from tests.drivers.camera_laws import taken
from tests.drivers.fake_video import COLUMNS, ROWS, FakeDevice, Sent, luma, steadily

NTSC, PAL = 0x1000, 0xFF


def camera_on(device: FakeDevice, **options) -> V4l2Camera:
    return V4l2Camera("fake", open_device=lambda _: device, **options)


def test_a_device_that_has_nothing_yet_is_asked_again():
    def late():
        for sent in steadily():
            yield Sent(error=errno.EAGAIN)
            yield sent

    with camera_on(FakeDevice(late)) as camera:
        frames, capture = taken(camera, 5)
    assert [frame.number for frame in frames] == [0, 1, 2, 3, 4]
    assert capture.lost_frames == 0


def test_silence_ends_in_the_time_allowed():
    device = FakeDevice(lambda: [Sent(sequence=0)])
    device.wait = lambda timeout_s: time.sleep(timeout_s)
    began_s = time.monotonic()
    with (
        camera_on(device, silence_s=0.1) as camera,
        pytest.raises(CameraError, match="has sent no frame for"),
    ):
        taken(camera, 2)
    assert time.monotonic() - began_s < 1.0
    assert device.is_closed


def test_a_camera_may_take_long_to_begin_and_not_to_go_on():
    begins_s = time.monotonic() + 0.6

    def one():
        while time.monotonic() < begins_s:
            yield Sent(error=errno.EAGAIN)
        yield Sent(sequence=0)
        while True:
            yield Sent(error=errno.EAGAIN)

    device = FakeDevice(one)
    device.wait = lambda timeout_s: not time.sleep(min(timeout_s, 0.01))
    with (
        camera_on(device, silence_s=0.2) as camera,
        camera.capture(frames=2) as capture,
        pytest.raises(CameraError, match=r"has sent no frame for 0\.[34] s"),
    ):
        frames = iter(capture)
        assert next(frames).number == 0
        next(frames)


def test_a_driver_that_tells_a_frame_period_of_a_century_is_not_waited_for_as_long(monkeypatch):
    monkeypatch.setattr("drivers.cameras.v4l2.camera.LONGEST_WAIT_S", 0.1)
    device = FakeDevice(list)
    device.period = (4_000_000_000, 1)
    began_s = time.monotonic()
    with (
        camera_on(device, silence_s=0.05) as camera,
        pytest.raises(CameraError, match="has sent no frame for"),
    ):
        taken(camera, 1)
    assert time.monotonic() - began_s < 2.0


def test_a_device_that_is_always_ready_and_never_has_a_frame_is_left_in_time():
    began_s = time.monotonic()
    device = FakeDevice(list)
    with (
        camera_on(device, silence_s=0.05) as camera,
        pytest.raises(CameraError, match="has sent no frame for"),
    ):
        taken(camera, 1)
    assert time.monotonic() - began_s < 1.0


@pytest.mark.parametrize("error", [errno.ENODEV, errno.EIO])
def test_a_camera_unplugged_in_mid_stream_is_noticed_at_once_and_everything_is_given_back(error):
    device = FakeDevice(lambda: chain(islice(steadily(), 3), [Sent(error=error)]))
    got: list[int] = []
    with (
        pytest.raises(CameraError, match="has gone or failed"),
        camera_on(device) as camera,
        camera.capture(frames=10) as capture,
    ):
        frames = iter(capture)
        got = [next(frames).number for _ in range(3)]
        next(frames)
    assert got == [0, 1, 2]
    assert device.is_closed
    assert [memory.is_closed for memory in device.memory] == [True] * 8


def test_a_spoiled_frame_is_counted_with_its_reason_and_never_handed_out():
    script = [Sent(sequence=n, faulty=n == 2, share=0.4 if n == 4 else 1.0) for n in range(8)]
    with camera_on(FakeDevice(lambda: script)) as camera:
        frames, capture = taken(camera, 6)
    assert [frame.number for frame in frames] == [0, 1, 3, 5, 6, 7]
    assert [(loss.first, loss.last) for loss in capture.losses] == [(2, 2), (4, 4)]
    assert "spoiled" in capture.losses[0].reason
    assert f"instead of {ROWS * COLUMNS}" in capture.losses[1].reason


def test_a_leap_of_a_thousand_million_frames_is_counted_without_waiting():
    began_s = time.monotonic()
    with camera_on(FakeDevice(lambda: (Sent(sequence=n) for n in (0, 1 << 30)))) as camera:
        _, capture = taken(camera, 2)
    assert capture.lost_frames == (1 << 30) - 1
    assert time.monotonic() - began_s < 1.0


def test_a_number_that_comes_again_is_too_late():
    with camera_on(FakeDevice(lambda: (Sent(sequence=n) for n in (0, 1, 1, 0, 2)))) as camera:
        frames, capture = taken(camera, 3)
    assert [frame.number for frame in frames] == [0, 1, 2]
    assert capture.lost_frames == 0


def test_a_camera_that_sends_only_broken_frames_is_given_up_in_time_however_many_are_asked_for():
    broken = FakeDevice(lambda: (Sent(sequence=n, faulty=n > 2) for n in count()))
    with (
        camera_on(broken, silence_s=0.1) as camera,
        pytest.raises(CameraError, match=r"must send a whole frame within .* after 3 whole"),
    ):
        taken(camera, 10_000)


def test_a_buffer_that_was_never_lent_is_refused():
    device = FakeDevice(lambda: [Sent(sequence=0, index=99)])
    with (
        camera_on(device) as camera,
        pytest.raises(CameraError, match="one of 8 buffers, got number 99"),
    ):
        taken(camera, 1)


@pytest.mark.parametrize(
    ("name", "spoil", "rule"),
    [
        ("REQBUFS", {"count": 0}, "must lend 2 to 32 buffers, got 0"),
        ("REQBUFS", {"count": 4_000_000_000}, "must lend 2 to 32 buffers"),
        ("QUERYBUF", {"length": 10}, "must hold a picture of 768 bytes, got 10"),
        ("QUERYBUF", {"length": 0xFFFFFFFF}, "must hold a picture"),
        ("QUERYBUF", {"length": 1 << 25}, "must be mapped"),
        ("QUERYCAP", {"capabilities": 0}, "must capture video into mapped memory"),
    ],
)
def test_an_answer_of_the_wrong_size_is_refused_in_a_sentence(name, spoil, rule):
    def change(answered, structure):
        if answered == name:
            for key, value in spoil.items():
                setattr(structure, key, value)

    with pytest.raises(CameraError, match=rule), camera_on(FakeDevice(spoil=change)) as camera:
        taken(camera, 1)


@pytest.mark.parametrize("standard", [NTSC, PAL])
def test_the_older_field_follows_the_video_standard(standard):
    with camera_on(FakeDevice(field=INTERLACED, standard=standard)) as camera:
        order = camera.configure(CameraSettings()).field_order
        (frame,), _ = taken(camera, 1)
    assert order == frame.field_order == ("bottom first" if standard == NTSC else "top first")


@pytest.mark.parametrize(
    ("field", "order"), [(TOP_THEN_BOTTOM, "top first"), (BOTTOM_THEN_TOP, "bottom first")]
)
def test_fields_that_come_one_after_the_other_are_woven_into_rows(field, order):
    with camera_on(FakeDevice(field=field, standard=NTSC)) as camera:
        (frame,), _ = taken(camera, 1)
    sent = luma(0)
    first, second = (0, 1) if order == "top first" else (1, 0)
    assert frame.field_order == order
    assert np.array_equal(frame.pixels[first::2], sent[: ROWS // 2])
    assert np.array_equal(frame.pixels[second::2], sent[ROWS // 2 :])


def fields_apart(standard: int, *, without: tuple[int, ...] = ()):
    """Fields in the order of a standard, two for each sequence number, some of them never sent."""
    older, younger = (BOTTOM, TOP) if standard == NTSC else (TOP, BOTTOM)
    sent = (
        Sent(sequence=at // 2, field=younger if at % 2 else older)
        for at in count()
        if at not in without
    )
    return lambda: sent


@pytest.mark.parametrize("standard", [NTSC, PAL])
def test_fields_that_come_each_for_itself_are_put_together_two_by_two(standard):
    with camera_on(
        FakeDevice(fields_apart(standard), field=ALTERNATE, standard=standard)
    ) as camera:
        settings = camera.configure(CameraSettings())
        frames, capture = taken(camera, 4)
    assert (settings.rows, settings.field_order) == (
        2 * ROWS,
        "bottom first" if standard == NTSC else "top first",
    )
    assert [frame.number for frame in frames] == [0, 1, 2, 3]
    assert capture.lost_frames == 0
    for frame in frames:
        assert frame.field_order == settings.field_order
        assert np.array_equal(frame.pixels[0::2], luma(frame.number))
        assert np.array_equal(frame.pixels[1::2], luma(frame.number))


@pytest.mark.parametrize("field", [4, 5])
def test_a_frame_of_one_field_only_is_lost_and_no_other(field):
    with camera_on(
        FakeDevice(fields_apart(NTSC, without=(field,)), field=ALTERNATE, standard=NTSC)
    ) as camera:
        frames, capture = taken(camera, 5)
    assert [frame.number for frame in frames] == [0, 1, 3, 4, 5]
    (lost,) = capture.losses
    assert (lost.first, lost.last) == (2, 2)
    assert lost.reason == f"its {'older' if field == 4 else 'younger'} field did not come"


def test_a_capture_that_begins_in_the_middle_of_a_frame_begins_with_the_next():
    with camera_on(
        FakeDevice(fields_apart(PAL, without=(0,)), field=ALTERNATE, standard=PAL)
    ) as camera:
        frames, capture = taken(camera, 2)
    assert [frame.number for frame in frames] == [1, 2]
    assert capture.lost_frames == 0


def test_grey_of_8_bits_is_the_luma_of_video_where_the_camera_has_no_grey_and_says_so():
    with camera_on(FakeDevice(letters=("UYVY",))) as camera:
        settings = camera.configure(CameraSettings(pixel_format="Mono8"))
        (frame,), _ = taken(camera, 1)
    assert settings.pixel_format == "UYVY"
    assert settings.notes[0] == "grey is the luma of UYVY video: black is 16 and white is 235 DN"
    assert np.array_equal(frame.pixels, luma(0))


def test_automatic_gain_and_exposure_are_told_and_end_when_a_value_is_asked():
    device = FakeDevice()
    with camera_on(device) as camera:
        assert set(camera.configure(CameraSettings()).notes) == {
            "the camera's automatic gain is on",
            "the camera's automatic exposure is on",
        }
        settings = camera.configure(CameraSettings(exposure_s=0.01, gain_db=7.0))
    assert settings.notes == ()
    assert (settings.exposure_s, settings.gain_db) == (pytest.approx(0.01), 7.0)


def test_a_control_that_takes_another_value_is_told():
    device = FakeDevice()
    device._s_ctrl = lambda it: None
    with (
        camera_on(device) as camera,
        pytest.raises(CameraError, match="'Brightness' must accept the requested value, 9"),
    ):
        camera.set_control("Brightness", 9)


def test_buffers_are_given_back_in_the_order_of_use_and_the_camera_is_stopped():
    device = FakeDevice()
    with camera_on(device) as camera:
        taken(camera, 20)
    stream = [
        name for name in device.asked if name in ("STREAMON", "DQBUF", "STREAMOFF", "REQBUFS")
    ]
    assert stream == ["REQBUFS", "STREAMON", *["DQBUF"] * 20, "STREAMOFF", "REQBUFS"]
    assert [memory.is_closed for memory in device.memory] == [True] * 8
    assert device.is_closed
