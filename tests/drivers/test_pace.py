"""Where the time of a step goes, and how long the others will take."""

import time

import pytest

from drivers.acquisition.run_progress import RunProgress, StepClock, duration


@pytest.fixture
def lasts(monkeypatch):
    """Let time pass, s; none passes otherwise."""
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])

    def pass_by(seconds: float) -> None:
        now[0] += seconds

    return pass_by


def test_only_what_is_neither_wire_nor_settling_is_our_own(lasts):
    clock = StepClock()
    with clock.timing("wire_s"):
        lasts(0.03)
    with clock.timing("settling_s"):
        lasts(0.02)

    def frames():
        for number in range(3):
            lasts(0.01)
            yield number

    seen = []
    for number in clock.waiting_for(frames()):
        seen.append(number)
        lasts(0.005)
    assert seen == [0, 1, 2]
    assert clock.wire_s == pytest.approx(0.06)
    assert clock.settling_s == pytest.approx(0.02)
    assert clock.overhead_s == pytest.approx(0.015)


def test_the_time_left_follows_from_the_pace_so_far(lasts):
    pace = RunProgress(frames=400, done=100)
    pace.step_begins()
    lasts(5.0)
    assert pace.words(1) == ""
    lasts(5.0)
    assert pace.share(101) == pytest.approx(0.5025)
    # 100 frames in 5 s once they came; 101 frames in the 10 s of the run so far, 199 are left.
    assert pace.words(101) == ", 20.0 frames/s, 20 s left"


@pytest.mark.parametrize(
    ("seconds", "words"), [(12.4, "12 s"), (200.0, "3 min 20 s"), (7500.0, "2 h 5 min")]
)
def test_durations_are_said_as_a_person_would(seconds, words):
    assert duration(seconds) == words
