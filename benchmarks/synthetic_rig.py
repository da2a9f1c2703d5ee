"""A rig that costs nothing: a camera that keeps its pace whoever reads it, instruments that take their time."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from drivers.interface import Operator
from labdata.capture import CameraSettings, Frame, LostFrames, lost_for
from labdata.conditions import Conditions
from labdata.session import Kind
from labdata.target import Target

ROWS, COLUMNS = 493, 768
BUFFERS = 64
"""Frames that the camera's driver holds for a reader who is late; older ones are lost, as with Aravis."""


class _Opened:
    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return None


class PacedCamera(_Opened):
    """A camera of 768 x 493 pixels and 16 bits at a steady rate.

    Parameters
    ----------
    rate_hz
        Frames per second, Hz.
    """

    identifier = "synthetic"

    def __init__(self, *, rate_hz: float = 30.0) -> None:
        self.settings = CameraSettings(
            rows=ROWS, columns=COLUMNS, pixel_format="Mono16", exposure_s=0.0166, gain_db=0.0, frame_rate_hz=rate_hz
        )
        rng = np.random.default_rng(1)
        self.pictures = tuple(rng.integers(0, 4096, (ROWS, COLUMNS), dtype=np.uint16) for _ in range(8))

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Keep all settings but the exposure."""
        if settings.exposure_s is not None:
            self.settings = replace(self.settings, exposure_s=settings.exposure_s)
        return self.settings

    def capture(
        self, *, frames: int, discard: int = 0, while_waiting: Callable[[], None] = lambda: None
    ) -> "PacedCapture":
        """Return a capture; its frames come at the camera's rate, 10 Hz or more, from its beginning on."""
        return PacedCapture(self, frames=frames, discard=discard, while_waiting=while_waiting)


class PacedCapture(_Opened):
    """A capture whose frames are due at fixed times."""

    def __init__(self, camera: PacedCamera, *, frames: int, discard: int, while_waiting: Callable[[], None]) -> None:
        self._camera, self._frames, self._discard = camera, frames, discard
        self._while_waiting = while_waiting
        self.losses: tuple[LostFrames, ...] = ()

    @property
    def lost_frames(self) -> int:
        """Frames that nobody took in time."""
        return sum(map(len, self.losses))

    def __iter__(self) -> Iterator[Frame]:
        period_s, began_s = 1.0 / (self._camera.settings.frame_rate_hz or 30.0), time.monotonic()
        number = handed_out = 0
        while handed_out < self._frames:
            self._while_waiting()
            number += 1
            late = int((time.monotonic() - began_s) / period_s) - BUFFERS - number
            if late > 0:
                self.losses += lost_for("overrun: all buffers were full", range(number, number + late))
                number += late
            time.sleep(max(0.0, began_s + number * period_s - time.monotonic()))
            if number > self._discard:
                handed_out += 1
                # A frame of its own, as a driver copies it out of its buffer.
                yield Frame(pixels=self._camera.pictures[number % 8].copy(), number=number, time_s=time.time())


class SlowBench(_Opened):
    """Gate and gain that take their time.

    Parameters
    ----------
    answer_s
        Time that each setting takes, s.
    """

    dark_seen = True

    def __init__(self, *, answer_s: float = 0.0) -> None:
        self._answer_s = answer_s

    def set_conditions(self, conditions: Conditions) -> Conditions:
        """Wait and read back what was asked."""
        time.sleep(self._answer_s)
        return conditions

    def guard(self, operator: Operator) -> Operator:
        """Nothing to guard."""
        return operator

    def saw_without_light(self, pixels: NDArray, full_scale_dn: float) -> None:
        """Nothing to see."""

    def read_beside(self) -> tuple[Conditions, tuple[str, ...]]:
        """No meter stands beside it."""
        return Conditions(), ()

    def check(self) -> None:
        """Nothing went wrong."""

    def safe(self) -> None:
        """Nothing is on."""


class NoOperator:
    """Nobody moves anything."""

    def darken(self) -> None:
        """Nothing shines."""

    def place(
        self, *, kind: Kind, target: Target, illuminance_lux: float, filter_density: float | None = None
    ) -> Conditions:
        """Read back what was asked."""
        return Conditions(illuminance_lux=illuminance_lux)
