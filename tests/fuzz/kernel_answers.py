"""Answers that no kernel should give: the structures of V4L2 with noise in them, to the driver of a
video device.
"""

import ctypes
import random
import time
from collections.abc import Callable
from pathlib import Path

from drivers.cameras.v4l2 import V4l2Camera
from drivers.cameras.v4l2.listing import describe
from drivers.errors import CameraError
from labdata import BadInput, CameraSettings
from tests.drivers.camera_laws import taken
from tests.drivers.fake_video import FakeDevice

ANSWERS = (
    "QUERYCAP",
    "ENUM_FMT",
    "ENUM_FRAMESIZES",
    "G_FMT",
    "S_FMT",
    "REQBUFS",
    "QUERYBUF",
    "DQBUF",
    "G_PARM",
    "QUERYCTRL",
    "QUERYMENU",
    "G_CTRL",
    "G_STD",
)
LONGEST_S = 1.0  # of the processor: a busy machine may take longer
SILENCE_S = 0.02

Noise = Callable[[bytes], bytes]


def noise(rng: random.Random) -> Noise:
    """Draw what becomes of an answer: all of it noise, which rarely passes the first check, or a
    few bytes changed.
    """
    if rng.random() < 0.3:
        return lambda good: rng.randbytes(len(good))
    values = (0, 1, 2, 127, 128, 255, rng.randrange(256))
    changes = [(rng.randrange(208), rng.choice(values)) for _ in range(rng.randrange(1, 7))]
    return lambda good: bytes(dict(changes).get(place, byte) for place, byte in enumerate(good))


def spoiled(wrong: dict[str, Noise], first: int) -> Callable[[str, ctypes.Structure], None]:
    """Return what spoils answers by their names, from the n-th one of each kind on."""
    seen: dict[str, int] = {}

    def spoil(name: str, structure: ctypes.Structure) -> None:
        seen[name] = seen.get(name, 0) + 1
        if name in wrong and seen[name] > first:
            good = ctypes.string_at(ctypes.addressof(structure), ctypes.sizeof(structure))
            ctypes.memmove(ctypes.addressof(structure), wrong[name](good), ctypes.sizeof(structure))

    return spoil


def once(rng: random.Random, _folder: Path) -> bool:
    """Open a device that answers noise, look at it, set it, take frames; whether it came to
    frames.
    """
    wrong = {rng.choice(ANSWERS): noise(rng) for _ in range(rng.choice((1, 1, 2, 3)))}
    began_s, came = time.process_time(), False
    device = FakeDevice(spoil=spoiled(wrong, rng.randrange(4)))
    try:
        with V4l2Camera("fake", open_device=lambda _: device, silence_s=SILENCE_S) as camera:
            describe(device, "fake")
            camera.configure(
                CameraSettings(
                    rows=12, columns=16, pixel_format="Mono16", exposure_s=0.01, gain_db=3.0
                )
            )
            frames, capture = taken(camera, 4)
            assert len(frames) == 4, "a capture hands out the frames that were asked for"
            assert capture.lost_frames == frames[-1].number - frames[0].number - 3, (
                "what is missing is counted"
            )
            came = True
    except (CameraError, BadInput) as refusal:
        assert str(refusal), "a refusal says why"
    assert time.process_time() - began_s < LONGEST_S, "an answer is dealt with soon"
    assert device.is_closed or "QUERYCAP" not in device.asked, "a device that was opened is closed"
    return came
