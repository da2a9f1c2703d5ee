"""Ctrl-C once finishes the step, twice shuts the gate now; a paused run waits with the gate shut
and the light out.
"""

import ctypes
import os
import signal
import threading
import time

import numpy as np
import pytest

from drivers import acquire
from drivers.acquisition.run_control import PAUSED, STOPPING, RunControl
from drivers.errors import InstrumentTripped
from labdata import Conditions, Plan, Step, open_session, read_events
from tests.drivers import fake_rig

LIT = Conditions(mcp_v=700.0, gate_ns=1.6e7, illuminance_lux=1e-4)
PLAN = Plan(
    name="p",
    steps=tuple(Step(label=label, kind="flat", frames=4, conditions=LIT) for label in "abc"),
)


def rig_that_signals(*numbers: signal.Signals, at_frame: int):
    """A rig at whose frame of a number signals reach this process."""
    count = iter(range(1, 100))

    def happens(event: str) -> None:
        if event == "frame" and next(count) == at_frame:
            for number in numbers:
                os.kill(os.getpid(), number)

    return fake_rig.FakeRig(fail=happens)


def take(rig, folder, **options):
    return acquire(
        PLAN, folder, camera=rig.camera, bench=rig.bench, operator=rig.operator, **options
    )


def lengths(folder) -> list[int]:
    return [len(entry.read()) for entry in open_session(folder).stacks]


def test_one_interrupt_finishes_the_step_and_leaves_the_tube_safe(tmp_path):
    said, rig = [], rig_that_signals(signal.SIGINT, at_frame=6)
    with pytest.raises(KeyboardInterrupt):
        take(rig, tmp_path / "s", requests=RunControl(said.append))
    assert said == [STOPPING]
    assert lengths(tmp_path / "s") == [4, 4]
    assert all(entry.finished for entry in open_session(tmp_path / "s").stacks)
    assert not rig.gate_open and rig.mcp_v == 0.0
    assert lengths(take(fake_rig.FakeRig(), tmp_path / "s", resume=True).folder) == [4, 4, 4]


def test_a_second_interrupt_shuts_the_gate_at_once(tmp_path):
    rig = rig_that_signals(signal.SIGINT, signal.SIGINT, at_frame=6)
    with pytest.raises(KeyboardInterrupt):
        take(rig, tmp_path / "s")
    assert rig.diary.count("frame") == 6
    assert rig.diary[rig.diary.index("made safe") - 1] == "frame"
    assert lengths(tmp_path / "s") == [4, 1]
    assert read_events(tmp_path / "s" / "log.jsonl")[-1]["kind"] == "KeyboardInterrupt"


def test_two_interrupts_that_a_hanging_main_thread_sees_as_one_leave_no_dark_frame(tmp_path):
    libc, mutex, numbers = ctypes.CDLL(None), ctypes.create_string_buffer(64), iter(range(1, 100))
    libc.pthread_mutex_init(mutex, None)
    libc.pthread_mutex_lock(mutex)

    def interrupt_twice() -> None:
        for _ in range(2):
            time.sleep(0.05)
            os.kill(os.getpid(), signal.SIGINT)
        while rig.gate_open:
            time.sleep(0.005)
        libc.pthread_mutex_unlock(mutex)

    def hang(event: str) -> None:
        if event == "frame" and next(numbers) == 6:
            threading.Thread(target=interrupt_twice).start()
            libc.pthread_mutex_lock(mutex)  # signals neither end nor interrupt this call

    rig = fake_rig.FakeRig(fail=hang)
    rig.picture = lambda number: np.full(fake_rig.SIZE, 100 * rig.gate_open + number, np.uint8)
    with pytest.raises(KeyboardInterrupt):
        take(rig, tmp_path / "s")
    frames = [entry.read().data for entry in open_session(tmp_path / "s").stacks]
    assert [len(stack) for stack in frames] == [4, 1]
    assert all(np.all(stack > 100) for stack in frames)
    assert "doubt" not in (tmp_path / "s" / "session.toml").read_text()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_camera_whose_stop_looks_at_the_bench_leaves_the_signal_to_end_the_run(tmp_path, number):
    def happens(event: str):
        if event == "frame" and rig.diary.count("frame") == 6:
            os.kill(os.getpid(), number)
        return rig.bench.fault if event == "capture stops" else None

    rig = fake_rig.FakeRig(fail=happens)
    with pytest.raises(SystemExit) as end:
        take(rig, tmp_path / "s")
    assert end.value.code == 128 + number
    assert read_events(tmp_path / "s" / "log.jsonl")[-1]["kind"] == "SystemExit"


def test_an_interrupt_while_the_tube_is_made_safe_does_not_keep_that_up(tmp_path):
    rig = fake_rig.FakeRig(
        fail=lambda event: os.kill(os.getpid(), signal.SIGINT) if event == "bench closes" else None
    )
    assert [len(entry.read()) for entry in take(rig, tmp_path / "s").stacks] == [4, 4, 4]


def test_the_handlers_of_before_come_back(tmp_path):
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGUSR1)
    take(fake_rig.FakeRig(), tmp_path / "s")
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGUSR1)) == before


def test_a_paused_run_waits_dark_and_shut_and_goes_on_at_the_next_signal(tmp_path):
    rig, state = rig_that_signals(signal.SIGUSR1, at_frame=6), []

    def say(sentence: str) -> None:
        if sentence == PAUSED:
            state.append((rig.gate_open, rig.light_lux, rig.diary.count("frame")))
            threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGUSR1)).start()

    began_s = time.monotonic()
    session = take(rig, tmp_path / "s", requests=RunControl(say))
    assert state == [(False, 0.0, 8)]
    assert time.monotonic() - began_s > 0.2
    assert [len(entry.read()) for entry in session.stacks] == [4, 4, 4]


def test_a_paused_run_still_looks_at_its_bench(tmp_path):
    requests, looks = RunControl(), iter(range(100))
    requests.pause = True

    def trip(event: str):
        return (
            InstrumentTripped("high-voltage supply tripped")
            if event == "bench checked" and next(looks) == 3
            else None
        )

    with pytest.raises(InstrumentTripped):
        take(fake_rig.FakeRig(fail=trip), tmp_path / "s", requests=requests)
