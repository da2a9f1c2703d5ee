"""A rig of plain objects that write down in which order they are used."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Any, Self

import numpy as np

from drivers.errors import BenchStopped
from drivers.interface import FrameLevels
from labdata import CameraSettings, Conditions, Frame, LostFrames

SIZE = (6, 8)


class FakeRig:
    """Camera, bench and operator in one diary."""

    def __init__(
        self, *, fail: Callable[[str], BaseException | None] = lambda event: None, lose: int = 0
    ) -> None:
        self.diary: list[str] = []
        self.fail, self.lose = fail, lose
        self.gate_open = False
        self.light_lux = 0.0
        self.mcp_v = 0.0
        self.frames_sent = 0
        self.picture = lambda number: np.full(SIZE, number % 251, np.uint8)
        self.camera, self.bench, self.operator = (
            FakeCamera(self),
            FakeBench(self),
            FakeOperator(self),
        )

    def happens(self, event: str) -> None:
        self.diary.append(event)
        if error := self.fail(event):
            raise error


class _Opened:
    name = ""

    def __init__(self, rig: FakeRig) -> None:
        self.rig = rig

    def __enter__(self) -> Self:
        self.rig.happens(f"{self.name} opens")
        return self

    def __exit__(self, *_: object) -> None:
        self.rig.happens(f"{self.name} closes")


class FakeCamera(_Opened):
    name = "camera"
    identifier = "fake"

    def __init__(self, rig: FakeRig) -> None:
        super().__init__(rig)
        self.settings = CameraSettings(
            rows=SIZE[0],
            columns=SIZE[1],
            pixel_format="Mono8",
            exposure_s=0.016683,
            gain_db=0.0,
            frame_rate_hz=30.0,
        )

    def configure(self, settings: CameraSettings) -> CameraSettings:
        given = {name: value for name, value in vars(settings).items() if value is not None}
        # Whole microseconds, as a real exposure register.
        if "exposure_s" in given:
            given["exposure_s"] = round(given["exposure_s"] * 1e6) * 1e-6
        self.settings = replace(self.settings, **given)
        return self.settings

    def capture(
        self, *, frames: int, discard: int = 0, while_waiting: Callable[[], None] = lambda: None
    ) -> "FakeCapture":
        return FakeCapture(self.rig, frames, while_waiting)


class FakeCapture:
    losses: tuple[LostFrames, ...] = ()

    def __init__(self, rig: FakeRig, frames: int, while_waiting: Callable[[], None]) -> None:
        self.rig, self.frames, self.while_waiting = rig, frames, while_waiting

    @property
    def lost_frames(self) -> int:
        return sum(map(len, self.losses))

    def __enter__(self) -> Self:
        self.rig.happens("capture starts")
        return self

    def __exit__(self, *_: object) -> None:
        self.rig.happens("capture stops")

    def __iter__(self) -> Iterator[Frame]:
        if self.rig.lose:
            self.losses = (LostFrames(first=1, last=self.rig.lose, reason="missing packets"),)
        for _ in range(self.frames):
            self.while_waiting()
            self.rig.frames_sent += 1
            self.rig.happens("frame")
            number = self.rig.frames_sent
            yield Frame(pixels=self.rig.picture(number), number=number, time_s=float(number))


class FakeBench(_Opened):
    name = "bench"
    dark_seen = True

    def guard(self, operator: "FakeOperator") -> "FakeOperator":
        return operator

    last_words = ""

    def dark_frame_seen(self, levels: FrameLevels) -> bool:
        raise AssertionError("a bench that has seen the dark looks no more")

    def frame_seen(self, levels: FrameLevels) -> None:
        self.levels = levels

    def verify(self) -> None:
        self.rig.happens("tube compared")

    def patience(self, seconds: float) -> AbstractContextManager[None]:
        return nullcontext()

    def slack_s(self) -> float:
        return 0.0

    fault: BenchStopped | None = None

    def safe_at_once(self) -> None:
        self.fault = BenchStopped("the tube was made safe at once")
        self.rig.gate_open, self.rig.mcp_v = False, 0.0

    def __exit__(self, *_: object) -> None:
        self.rig.gate_open, self.rig.mcp_v = False, 0.0
        super().__exit__()

    def set_conditions(self, conditions: Conditions) -> Conditions:
        self.rig.happens("conditions set")
        if conditions.gate_ns:
            self.rig.diary.append("light on" if self.rig.light_lux else "light out")
        self.rig.gate_open, self.rig.mcp_v = bool(conditions.gate_ns), conditions.mcp_v or 0.0
        # A supply reads back with its own resolution.
        return Conditions(
            mcp_v=None if conditions.mcp_v is None else conditions.mcp_v + 0.25,
            gate_ns=conditions.gate_ns,
        )

    def read_meters(self) -> tuple[Conditions, tuple[str, ...]]:
        return Conditions(), ()

    def check(self) -> None:
        self.rig.happens("bench checked")
        if self.fault is not None:
            raise self.fault

    def safe(self) -> None:
        self.rig.happens("made safe")
        self.rig.gate_open, self.rig.mcp_v = False, 0.0


class FakeOperator:
    is_by_hand = False

    def __init__(self, rig: FakeRig) -> None:
        self.rig, self.while_waiting = rig, lambda: None

    def place(
        self, *, kind: str, target: Any, illuminance_lux: float, filter_density: float | None = None
    ) -> Conditions:
        self.rig.happens(f"{kind} placed at {illuminance_lux:g} lux")
        if illuminance_lux == 0.0 and self.rig.gate_open:
            raise AssertionError("a target was placed before an open gate")
        self.rig.light_lux = illuminance_lux
        return Conditions(illuminance_lux=illuminance_lux, illuminance_relative_sd=0.03)

    def darken(self) -> None:
        self.rig.happens("darkened")
        self.rig.light_lux = 0.0
