"""Where the bench's frames come from: a camera that is only read, or a session that grows while a plan runs."""

import re
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from charact.method import Context
from drivers.interface import Camera
from labdata.capture import CameraSettings, Frame
from labdata.conditions import Conditions

ENDLESS = 2**40  # frames; at a thousand a second, 35 years


@dataclass(frozen=True, kw_only=True)
class SourceFrame:
    """A frame with what is known of it.

    Parameters
    ----------
    frame
        The frame.
    of
        What it is of: the camera, or the stack of a session.
    full_scale_dn
        Highest code of the digitiser, DN.
    lost_frames
        Frames numbered by the camera and not whole since the capture or the stack began.
    conditions
        Conditions as read back.
    """

    frame: Frame
    of: str
    full_scale_dn: float
    lost_frames: int = 0
    conditions: Conditions = field(default_factory=Conditions)


def highest_code(dtype: np.dtype, pixel_format: str | None = None) -> float:
    """Return the highest code of a pixel: of the depth that the format names ("Mono12"), else of the type."""
    named = re.search(r"\d+", pixel_format or "")
    own_bits = 8 * dtype.itemsize
    return float(2 ** min(int(named.group()) if named else own_bits, own_bits) - 1)


class FrameSource(Protocol):
    """Frames as they come."""

    @property
    def name(self) -> str:
        """What a person calls it."""
        ...

    @property
    def context(self) -> Context:
        """What is known of the camera: its fields and pitches."""
        ...

    def __iter__(self) -> Iterator[SourceFrame | None]:
        """Frames as they come; None now and then while none comes."""
        ...


class CameraSource:
    """A camera as it is set, exposing without end.

    Nothing is set: exposure and gain stay as they are, and no instrument of the tube is within reach.

    Parameters
    ----------
    camera
        The camera, not yet open.
    name
        What a person calls it.
    context
        What is known of it; a full scale in it goes before that of the camera's pixel format.
    most_hz
        Pace of a camera without a clock of its own, frames/s; None: the camera paces itself.
    frames_each
        Frames of one capture, after which the next begins; fewer where a recording has no more.
    """

    def __init__(
        self,
        camera: AbstractContextManager[Camera],
        *,
        name: str,
        context: Context,
        most_hz: float | None = None,
        frames_each: int = ENDLESS,
    ) -> None:
        self._camera, self.name, self.context = camera, name, context
        self._frames_each = frames_each
        self._period_s = 0.0 if most_hz is None else 1.0 / most_hz

    def __iter__(self) -> Iterator[SourceFrame | None]:
        with self._camera as camera:
            settings = camera.configure(CameraSettings())
            while True:
                yield from self._capture(camera, settings)

    def _capture(self, camera: Camera, settings: CameraSettings) -> Iterator[SourceFrame]:
        conditions = Conditions(exposure_s=settings.exposure_s, camera_gain_db=settings.gain_db)
        with camera.capture(frames=self._frames_each) as capture:
            due_s = time.monotonic()
            for frame in capture:
                own_scale_dn = highest_code(frame.pixels.dtype, settings.pixel_format)
                yield SourceFrame(
                    frame=frame,
                    of=camera.identifier,
                    full_scale_dn=self.context.full_scale_dn or own_scale_dn,
                    lost_frames=capture.lost_frames,
                    conditions=conditions,
                )
                due_s = max(due_s + self._period_s, time.monotonic())
                time.sleep(max(due_s - time.monotonic(), 0.0) if self._period_s else 0.0)
