"""The bench at work: a camera is only read, its rate is its own, and the terminal shows what the
page shows.
"""

import io
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import islice
from threading import Event

import numpy as np
import pytest

from charact.live import CameraSource, FrameRate, LiveLoop, lines, watch_on_terminal
from charact.method import Context
from labdata import BadInput, CameraSettings, Frame
from tests.charact.live.sources import Told, noisy, seen


class AskedCamera:
    """A camera that writes down what it is asked."""

    identifier = "asked"

    def __init__(self, frames: list[Frame]) -> None:
        self.asked: list[CameraSettings] = []
        self._frames, self.lost_frames = frames, 0

    def configure(self, settings: CameraSettings) -> CameraSettings:
        self.asked.append(settings)
        return CameraSettings(
            pixel_format="Mono12", exposure_s=0.01, gain_db=6.0, frame_rate_hz=30.0
        )

    @contextmanager
    def capture(
        self, *, frames: int, discard: int = 0, while_waiting: Callable[[], None] = lambda: None
    ) -> Iterator["AskedCamera"]:
        yield self

    def __iter__(self) -> Iterator[Frame]:
        for place, frame in enumerate(self._frames):
            self.lost_frames = frame.number - self._frames[0].number - place
            yield frame


def test_a_camera_is_read_and_nothing_of_it_is_set() -> None:
    frames = [
        Frame(pixels=np.full((8, 8), n, np.uint16), number=n, time_s=n / 30.0) for n in (5, 6, 9)
    ]
    camera = AskedCamera(frames)

    @contextmanager
    def opened():
        yield camera

    # One capture after the other, without end; the first is looked at.
    shown = list(islice(CameraSource(opened(), name="asked", context=Context()), 3))
    assert camera.asked == [CameraSettings()]
    assert [one.lost_frames for one in shown if one] == [0, 0, 2]
    assert all(
        one and one.full_scale_dn == 4095.0 and one.conditions.camera_gain_db == 6.0
        for one in shown
    )


def test_the_rate_is_the_cameras_own_and_counts_frames_that_nobody_looked_at() -> None:
    rate = FrameRate()
    told = [
        rate.after(Frame(pixels=np.zeros((2, 2)), number=n, time_s=n / 25.0))
        for n in range(0, 200, 3)
    ]
    assert told[0] is None
    assert told[-1] == pytest.approx(25.0)
    # A new stack counts from the beginning.
    assert rate.after(Frame(pixels=np.zeros((2, 2)), number=1, time_s=9.0)) is None


def test_frames_of_two_stacks_are_not_subtracted_from_one_another(seed) -> None:
    rng = np.random.default_rng(seed)
    frames = [seen(noisy(rng), 1, of="one"), seen(noisy(rng, mean_dn=200), 2, of="another")]
    with LiveLoop(Told(frames, pause_s=0.05)) as running:
        while running.newest.end_reason is None:
            running.newest.after(2**62, timeout_s=1.0)
        view = running.newest.view
    assert view is not None and view.number == 2 and view.statistics.noise_dn is None


def test_the_terminal_shows_every_meter_with_its_unit_and_ends_with_a_reason(seed) -> None:
    from rich.console import Console

    rng, written = np.random.default_rng(seed), io.StringIO()
    with LiveLoop(Told([seen(noisy(rng), 1)], let_go=Event())) as running:
        view = running.newest.after(0, timeout_s=5.0)
        assert view is not None
        told = lines(view)
        running.source.let_go.set()  # type: ignore[attr-defined]
        with pytest.raises(BadInput, match="no more frames"):
            watch_on_terminal(running, title="meters", console=Console(file=written, width=120))
    assert told["saturated"].startswith("0 of 20480 px") and told["mean"].endswith("DN")
    assert told["temporal noise"] == "needs two frames"
