"""The disk: whether it takes frames, how fast with each one safe, and for how long."""

import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from charact.live.doctor.finding import Finding
from labdata.capture import Frame
from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.store import SessionWriter

SHAPE, DTYPE = (493, 768), np.uint16
VIDEO_HZ, SPARE = 30.0, 2.0
TRIED_FRAMES, TOGETHER = 32, 8
LEAST_MINUTES = 10.0


def disk_findings(folder: Path) -> Iterator[Finding]:
    """Yield the speed of the disk under a folder by writing frames to it as acquisition does, and its room."""
    try:
        rate_hz = write_rate_hz(folder)
    except (OSError, BadInput) as error:
        why = error.strerror if isinstance(error, OSError) else error
        yield Finding(area="disk", says=f"{folder} takes no frames: {why}", fix="name another folder", core=True)
        return
    yield speed_finding(folder, rate_hz)
    yield room_finding(folder, shutil.disk_usage(folder).free)


def write_rate_hz(folder: Path) -> float:
    """Return how many frames a second are written, forced to the disk together as those that wait are, Hz."""
    frame = np.random.default_rng(0).integers(0, 4096, SHAPE).astype(DTYPE)
    with TemporaryDirectory(dir=folder, prefix=".charact-doctor-") as made:
        session = Path(made) / "session"
        with (
            SessionWriter.create(session, name="doctor") as writer,
            writer.begin_stack("flat", "flat", SHAPE, DTYPE, Conditions()) as stack,
        ):
            stack.append(frame, 0.0, 0)
            began = time.perf_counter()
            for first in range(1, TRIED_FRAMES, TOGETHER):
                numbers = range(first, first + TOGETHER)
                stack.extend([Frame(pixels=frame, number=number, time_s=float(number)) for number in numbers])
            return TRIED_FRAMES / (time.perf_counter() - began)


def speed_finding(folder: Path, rate_hz: float) -> Finding:
    """Return whether a rate of writing keeps up with video, Hz."""
    told = f"{folder} takes {rate_hz:.1f} frames/s of {SHAPE[1]} x {SHAPE[0]} px, 16 bit, forced to the disk"
    if rate_hz >= SPARE * VIDEO_HZ:
        return Finding(area="disk", says=told)
    return Finding(
        area="disk", says=f"{told}; video needs {VIDEO_HZ:g}, and as many to spare", fix="name a faster disk"
    )


def room_finding(folder: Path, free_bytes: int) -> Finding:
    """Return for how long the room left lasts."""
    minutes = free_bytes / (np.prod(SHAPE) * np.dtype(DTYPE).itemsize * VIDEO_HZ) / 60.0
    told = f"{folder} has {free_bytes / 1e9:.3g} GB left, {minutes:.0f} minutes of video"
    fix = None if minutes >= LEAST_MINUTES else "make room, or name another disk"
    return Finding(area="disk", says=told, fix=fix)
