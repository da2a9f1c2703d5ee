"""What every camera keeps to, whatever its wire: one suite for all of them.

A test module makes a `Bench` for its camera in a fixture called `laws` and inherits from
`CameraLaws`.
"""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from itertools import count
from typing import Any

import numpy as np
import pytest

from drivers.errors import CameraError
from labdata import BadInput, CameraSettings, Frame


@dataclass(frozen=True, kw_only=True)
class Bench:
    """A camera under test."""

    open: Callable[[], AbstractContextManager[Any]]  # Returns the camera, not yet open
    # Returns the camera, not yet open, as it is while no frame comes for at least 0.7 s after at
    # most one
    quiet: Callable[[], AbstractContextManager[Any]]
    is_whole: Callable[
        [Frame], bool
    ]  # Whether a frame holds exactly the picture that the camera sent under its number
    asked: tuple[CameraSettings, ...] = ()  # Settings that the camera can take, each tried alone
    # Settings that it must refuse, each with the rule that the sentence states
    refused: tuple[tuple[CameraSettings, str], ...] = field(default_factory=tuple)
    frames: int = 12  # Whole frames to take at a time
    loses: bool = False  # Whether its wire loses frames
    # The number that the camera gives to the first frame it sends in a capture, be it lost or not
    counts_from: int = 0


def taken(camera: Any, frames: int, discard: int = 0) -> tuple[list[Frame], Any]:
    with camera.capture(frames=frames, discard=discard) as capture:
        return list(capture), capture


class WaitingLaws:
    """A run shows that it is alive and looks after its bench however long a camera exposes."""

    def test_a_run_is_called_ten_times_a_second_while_no_frame_comes_and_may_end_the_capture(
        self, laws: Bench
    ) -> None:
        calls_s: list[float] = []

        def waiting() -> None:
            calls_s.append(time.monotonic())
            if calls_s[-1] > calls_s[0] + 0.5:
                raise ZeroDivisionError

        frames: list[Frame] = []
        with laws.quiet() as camera:
            with (
                pytest.raises(ZeroDivisionError),
                camera.capture(frames=30, while_waiting=waiting) as capture,
            ):
                frames.extend(capture)
            ended_s = time.monotonic()
        assert len(frames) <= 1
        assert len(calls_s) > 5
        # A bench makes safe after 0.6 s without a sign of life.
        assert np.max(np.diff([*calls_s, ended_s])) < 0.5
        with laws.open() as camera:
            assert len(taken(camera, 3)[0]) == 3

    def test_a_run_is_called_between_frames_that_are_discarded(self, laws: Bench) -> None:
        calls = count()
        with (
            laws.open() as camera,
            camera.capture(frames=1, discard=4, while_waiting=lambda: next(calls)) as capture,
        ):
            next(iter(capture))
        assert next(calls) >= 5


class CameraLaws(WaitingLaws):
    """The laws."""

    def test_as_many_whole_frames_come_as_were_asked_for(self, laws: Bench) -> None:
        with laws.open() as camera:
            settings = camera.configure(CameraSettings())
            frames, capture = taken(camera, laws.frames)
        assert len(frames) == laws.frames
        assert all(laws.is_whole(frame) for frame in frames)
        assert {frame.pixels.shape for frame in frames} == {(settings.rows, settings.columns)}
        assert all(not frame.pixels.flags.writeable for frame in frames)
        span = frames[-1].number - frames[0].number + 1
        print(
            f"\n    asked {laws.frames}, whole {len(frames)}, counted lost {capture.lost_frames} "
            f"of {span} numbered"
        )

    def test_numbers_and_time_stamps_rise_and_every_gap_is_counted(self, laws: Bench) -> None:
        with laws.open() as camera:
            frames, capture = taken(camera, laws.frames)
        steps = np.diff([frame.number for frame in frames])
        assert np.all(steps >= 1)
        assert np.all(np.diff([frame.time_s for frame in frames]) > 0)
        assert capture.lost_frames == int(np.sum(steps - 1))
        assert capture.lost_frames == sum(map(len, capture.losses))
        there = {frame.number for frame in frames}
        missing = {number for loss in capture.losses for number in range(loss.first, loss.last + 1)}
        assert missing == set(range(frames[0].number, frames[-1].number + 1)) - there
        assert laws.loses or capture.lost_frames == 0

    def test_discarded_frames_are_not_handed_out(self, laws: Bench) -> None:
        with laws.open() as camera:
            frames, _ = taken(camera, 2, discard=3)
        assert len(frames) == 2
        assert frames[0].number >= laws.counts_from + 3

    def test_settings_are_read_back_and_stay_when_nothing_is_asked(self, laws: Bench) -> None:
        with laws.open() as camera:
            before = camera.configure(CameraSettings())
            assert camera.configure(CameraSettings()) == before
            for asked in laws.asked:
                given = {
                    name: value for name, value in vars(asked).items() if value not in (None, ())
                }
                read_back = camera.configure(asked)
                for name, value in given.items():
                    expected = value if isinstance(value, str) else pytest.approx(value, rel=0.01)
                    assert getattr(read_back, name) == expected, name
                frames, _ = taken(camera, 2)
                assert frames[0].pixels.shape == (read_back.rows, read_back.columns)
                camera.configure(_set_of(before, given))

    def test_what_it_cannot_do_is_refused_in_a_sentence_and_leaves_it_as_it_was(
        self, laws: Bench
    ) -> None:
        with laws.open() as camera:
            before = camera.configure(CameraSettings())
            for asked, rule in laws.refused:
                with pytest.raises(BadInput, match=rule):
                    camera.configure(asked)
            assert camera.configure(CameraSettings()) == before
            assert len(taken(camera, 1)[0]) == 1

    @pytest.mark.parametrize(("frames", "discard"), [(0, 0), (1, -1)])
    def test_a_capture_of_nothing_is_refused(self, laws: Bench, frames: int, discard: int) -> None:
        with laws.open() as camera, pytest.raises(BadInput, match="at least 1 frame"):
            camera.capture(frames=frames, discard=discard)

    def test_a_capture_left_early_or_by_an_error_leaves_the_camera_fit_for_the_next(
        self, laws: Bench
    ) -> None:
        with laws.open() as camera:
            with camera.capture(frames=laws.frames) as capture:
                next(iter(capture))
            with pytest.raises(ZeroDivisionError), camera.capture(frames=laws.frames) as capture:
                for _ in capture:
                    raise ZeroDivisionError
            frames, _ = taken(camera, 3)
        assert len(frames) == 3
        assert all(laws.is_whole(frame) for frame in frames)

    def test_it_opens_again_after_it_was_closed(self, laws: Bench) -> None:
        for _ in range(2):
            with laws.open() as camera:
                assert len(taken(camera, 2)[0]) == 2

    def test_a_camera_that_is_not_open_says_so(self, laws: Bench) -> None:
        with laws.open() as camera:
            pass
        with pytest.raises(CameraError, match="must be opened with a with block"):
            camera.configure(CameraSettings())
        with pytest.raises(CameraError, match="must be opened with a with block"):
            camera.capture(frames=1)


def _set_of(settings: CameraSettings, names: dict[str, Any]) -> CameraSettings:
    """The settings of the given names alone."""
    return CameraSettings(**{name: getattr(settings, name) for name in names})
