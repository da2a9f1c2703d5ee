"""Whatever bytes a kernel answers with, the V4L2 driver ends in frames or in a sentence, soon and in little memory."""

import ctypes
import os
import time

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as some

from drivers.interface import CameraError
from drivers.v4l2 import V4l2Camera
from drivers.v4l2.listing import describe
from labdata.capture import CameraSettings
from labdata.errors import BadInput
from tests.drivers.camera_laws import taken
from tests.drivers.fake_video import FakeDevice

EXAMPLES = int(os.environ.get("CHARACT_FUZZ_EXAMPLES", "150"))
ANSWERS = ("QUERYCAP", "ENUM_FMT", "ENUM_FRAMESIZES", "G_FMT", "S_FMT", "REQBUFS", "QUERYBUF", "DQBUF", "G_PARM",
           "QUERYCTRL", "QUERYMENU", "G_CTRL", "G_STD")  # fmt: skip
LONGEST_S = 1.0  # of the processor: a busy machine may take longer
# Whole structures of noise, and single bytes of a good answer changed: the first rarely passes the first check.
NOISE = some.one_of(
    some.binary(min_size=208, max_size=208).map(lambda data: lambda good: data[: len(good)]),
    some.lists(some.tuples(some.integers(0, 207), some.integers(0, 255)), min_size=1, max_size=6).map(
        lambda changes: lambda good: bytes(dict(changes).get(place % 208, byte) for place, byte in enumerate(good))
    ),
)


def spoiled(noise: dict, first: int):
    """Answers with noise in them, from the n-th one of each kind on."""
    seen: dict[str, int] = {}

    def spoil(name: str, structure) -> None:
        seen[name] = seen.get(name, 0) + 1
        if name in noise and seen[name] > first:
            good = ctypes.string_at(ctypes.addressof(structure), ctypes.sizeof(structure))
            ctypes.memmove(ctypes.addressof(structure), noise[name](good), ctypes.sizeof(structure))

    return spoil


@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(some.dictionaries(some.sampled_from(ANSWERS), NOISE, min_size=1, max_size=3), some.integers(0, 3))
def test_any_answer_of_the_kernel_ends_in_frames_or_in_a_sentence(noise, first):
    began_s = time.process_time()
    device = FakeDevice(spoil=spoiled(noise, first))
    try:
        with V4l2Camera("fake", open_device=lambda _: device, silence_s=0.05) as camera:
            describe(device, "fake")
            camera.configure(CameraSettings(rows=12, columns=16, pixel_format="Mono16", exposure_s=0.01, gain_db=3.0))
            frames, capture = taken(camera, 4)
            assert len(frames) == 4
            assert capture.lost_frames == frames[-1].number - frames[0].number - 3
    except (CameraError, BadInput) as refusal:
        assert str(refusal)
    assert time.process_time() - began_s < LONGEST_S
    assert device.is_closed or "QUERYCAP" not in device.asked
