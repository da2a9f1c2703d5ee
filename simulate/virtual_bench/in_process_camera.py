"""The virtual camera without its wire: the same frames from inside this process, where Aravis cannot be had."""

import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import fields, replace
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from labdata.capture import CameraSettings, Frame
from labdata.errors import BadInput
from simulate.virtual_bench.outputs import Outputs
from simulate.virtual_bench.tube import VirtualTube

POLL_S = 0.05
"""Longest wait for a frame between two calls of `while_waiting`, s."""


class InProcessCamera:
    """A camera with the interface of the driver's; it sends the frames that the virtual camera on its wire would.

    Parameters
    ----------
    folder
        Folder of the bench.
    outputs
        Returns what the instruments put on the tube's wires now.
    """

    identifier = "in-process"

    def __init__(self, folder: Path, outputs: Callable[[], Outputs]) -> None:
        self._tube = VirtualTube(folder, outputs)
        sensor = self._tube.sensor
        field_rate_hz = float(sensor.video.field_rate_hz)
        self._number = 0
        self._drawing = ThreadPoolExecutor(1)
        self._settings = CameraSettings(
            rows=sensor.ccd.rows,
            columns=sensor.ccd.columns,
            pixel_format="Mono8" if sensor.video.bit_depth <= 8 else "Mono16",
            exposure_s=round(1e6 / field_rate_hz) * 1e-6,
            gain_db=0.0,
            frame_rate_hz=field_rate_hz / (2 if sensor.video.interlaced else 1),
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        return None

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Set what is not None and return every setting; the picture's size and format are the sensor's own."""
        given = {item.name: value for item in fields(settings) if (value := getattr(settings, item.name)) is not None}
        for name in ("rows", "columns", "pixel_format"):
            own = getattr(self._settings, name)
            if given.get(name, own) != own:
                raise BadInput(f"{name} of the in-process camera must be {own}, got {given[name]}")
        self._settings = replace(self._settings, **given)
        return self._settings

    def capture(
        self, *, frames: int, discard: int = 0, while_waiting: Callable[[], None] = lambda: None
    ) -> "InProcessCapture":
        """Return a capture of `frames` frames after `discard` that are thrown away."""
        return InProcessCapture(self, frames=frames, discard=discard, while_waiting=while_waiting)

    def begin_exposure(self) -> Future[Frame]:
        """Start to expose a frame, as soon as the one before is drawn."""
        return self._drawing.submit(self._expose)

    def _expose(self) -> Frame:
        self._number += 1
        scene = self._tube.scene(exposure_s=self._settings.exposure_s or 0.0, gain_db=self._settings.gain_db or 0.0)
        deep = self._settings.pixel_format != "Mono8"
        pixels = self._tube.expose(scene).astype(np.uint16 if deep else np.uint8, copy=False)
        return Frame(pixels=pixels, number=self._number, time_s=time.time())


class InProcessCapture:
    """A capture that loses nothing."""

    lost_frames = 0
    losses = ()

    def __init__(
        self, camera: InProcessCamera, *, frames: int, discard: int, while_waiting: Callable[[], None]
    ) -> None:
        self._camera, self._frames, self._discard = camera, frames, discard
        self._while_waiting = while_waiting

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        return None

    def __iter__(self) -> Iterator[Frame]:
        for taken in range(self._discard + self._frames):
            self._while_waiting()
            drawing = self._camera.begin_exposure()
            while not wait([drawing], POLL_S).done:
                self._while_waiting()
            frame = drawing.result()
            if taken >= self._discard:
                yield frame
