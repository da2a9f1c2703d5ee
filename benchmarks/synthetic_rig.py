"""A rig that costs nothing: a camera that keeps its pace whoever reads it, instruments that take
their time.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Self

import numpy as np

from drivers.interface import FrameLevels, Operator
from labdata import Conditions, Target
from labdata.capture import CameraSettings, Frame, LostFrames, lost_frames_with_reason
from labdata.session import Kind

ROWS, COLUMNS = 493, 768
BUFFERS = 64
"""Frames that the camera's driver holds for a late reader; older ones are lost, as with Aravis."""


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
            rows=ROWS,
            columns=COLUMNS,
            pixel_format="Mono16",
            exposure_s=0.0166,
            gain_db=0.0,
            frame_rate_hz=rate_hz,
        )
        rng = np.random.default_rng(1)
        self.pictures = tuple(
            rng.integers(0, 4096, (ROWS, COLUMNS), dtype=np.uint16) for _ in range(8)
        )

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Keep all settings but the exposure."""
        if settings.exposure_s is not None:
            self.settings = replace(self.settings, exposure_s=settings.exposure_s)
        return self.settings

    def capture(
        self, *, frames: int, discard: int = 0, while_waiting: Callable[[], None] = lambda: None
    ) -> "PacedCapture":
        """Return a capture; its frames come at the camera's rate, 10 Hz or more, from its beginning
        on.
        """
        return PacedCapture(self, frames=frames, discard=discard, while_waiting=while_waiting)


class PacedCapture(_Opened):
    """A capture whose frames are due at fixed times."""

    def __init__(
        self, camera: PacedCamera, *, frames: int, discard: int, while_waiting: Callable[[], None]
    ) -> None:
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
                self.losses += lost_frames_with_reason(
                    "overrun: all buffers were full", range(number, number + late)
                )
                number += late
            time.sleep(max(0.0, began_s + number * period_s - time.monotonic()))
            if number > self._discard:
                handed_out += 1
                # A frame of its own, as a driver copies it out of its buffer, and a new picture.
                pixels = self._camera.pictures[number % 8].copy()
                pixels.flat[number % pixels.size] ^= 1
                yield Frame(pixels=pixels, number=number, time_s=time.time())


class SlowBench(_Opened):
    """Gate and gain that take their time.

    Parameters
    ----------
    answer_s
        Time that each setting takes, s.
    """

    dark_seen, last_words = True, ""

    def __init__(self, *, answer_s: float = 0.0) -> None:
        self._answer_s = answer_s

    def set_conditions(self, conditions: Conditions) -> Conditions:
        """Wait and read back what was asked."""
        time.sleep(self._answer_s)
        return conditions

    def guard(self, operator: Operator) -> Operator:
        """Nothing to guard."""
        return operator

    def dark_frame_seen(self, levels: FrameLevels) -> bool:
        """Nothing to see."""
        return True

    def frame_seen(self, levels: FrameLevels) -> None:
        """Nothing to see."""

    def read_meters(self) -> tuple[Conditions, tuple[str, ...]]:
        """There is no meter."""
        return Conditions(), ()

    def verify(self) -> None:
        """Nothing changes by itself."""

    def patience(self, seconds: float) -> AbstractContextManager[None]:
        """Nobody waits."""
        return nullcontext()

    def slack_s(self) -> float:
        """The machine is idle."""
        return 0.0

    def safe_at_once(self) -> None:
        """Nothing is on."""

    def check(self) -> None:
        """Nothing went wrong."""

    def safe(self) -> None:
        """Nothing is on."""


class NoOperator:
    """Nobody moves anything."""

    is_by_hand = False

    def __init__(self) -> None:
        self.while_waiting: Callable[[], None] = lambda: None

    def darken(self) -> None:
        """Nothing shines."""

    def place(
        self,
        *,
        kind: Kind,
        target: Target,
        illuminance_lux: float,
        filter_density: float | None = None,
    ) -> Conditions:
        """Read back what was asked."""
        return Conditions(illuminance_lux=illuminance_lux)
