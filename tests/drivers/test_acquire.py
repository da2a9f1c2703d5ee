"""A plan becomes a session: in the order that spares the tube, with what was read back, and without losing a frame."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.acquire import acquire
from drivers.errors import InstrumentTripped
from drivers.interface import CameraError
from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.plan import Plan, Step, Wires
from labdata.session import open_session
from labdata.target import Target

_spec = importlib.util.spec_from_file_location("fake_rig", Path(__file__).with_name("fake_rig.py"))
fake_rig = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(fake_rig)
FakeRig = fake_rig.FakeRig


def step(label: str, *, frames: int = 4, kind: str = "flat", lux: float | None = 1e-4, **conditions) -> Step:
    asked = {"mcp_v": 700.0, "gate_ns": 1.6e7, **conditions}
    return Step(label=label, kind=kind, frames=frames, conditions=Conditions(illuminance_lux=lux, **asked))


PLAN = Plan(name="series", steps=(step("dark", kind="dark", lux=None), step("low"), step("high", mcp_v=800.0)))


# What no driver sets: on or off, a record of it would be a claim.
UNSETTABLE = (
    {"automatic_gain": True},
    {"automatic_gain": False},
    {"brightness_control": True},
    {"em_gain": 300.0},
    {"gain_control": 102.0},
)


def take(rig, folder, plan=PLAN, **options):
    return acquire(plan, folder, camera=rig.camera, bench=rig.bench, operator=rig.operator, **options)


def at_frame(number: int, error: BaseException):
    """Fail when the camera is to send its frame of this number, and never again."""
    count = iter(range(1, 10_000))
    return lambda event: error if event == "frame" and next(count) == number else None


def test_every_frame_of_the_plan_arrives_in_order(tmp_path):
    session = take(FakeRig(), tmp_path / "s")
    assert [entry.label for entry in session.stacks] == ["dark", "low", "high"]
    numbers = np.concatenate([entry.read().frame_number for entry in session.stacks])
    assert numbers.tolist() == list(range(1, 13))
    assert all((frame == number).all() for entry in session.stacks for frame, number in _frames(entry))


def test_asked_and_read_back_are_both_recorded(tmp_path):
    session = take(FakeRig(), tmp_path / "s", Plan(name="p", steps=(step("low", exposure_s=0.0162004),)))
    entry = session.stack("low")
    assert entry.asked.mcp_v == 700.0
    assert entry.conditions.mcp_v == 700.25
    assert entry.asked.exposure_s == 0.0162004
    assert entry.conditions.exposure_s == pytest.approx(0.0162, abs=1e-9)
    assert entry.conditions.illuminance_relative_sd == 0.03
    assert entry.conditions.gate_ns == 1.6e7


def test_light_is_out_while_gate_and_gain_move_and_the_gate_is_shut_while_targets_move(tmp_path):
    rig = FakeRig()
    take(rig, tmp_path / "s")
    assert [event for event in rig.diary if event.startswith("light ")] == ["light out"] * 3


def test_the_bench_opens_last_and_closes_first(tmp_path):
    rig = FakeRig()
    take(rig, tmp_path / "s")
    order = ["camera opens", "bench opens", "bench closes", "darkened", "camera closes"]
    assert [event for event in rig.diary if event in order] == order
    assert not rig.gate_open


@pytest.mark.parametrize("error", [CameraError("camera fake has gone"), KeyboardInterrupt(), OSError(28, "disk full")])
def test_any_end_shuts_the_gate_before_the_camera_is_stopped_and_keeps_the_frames(tmp_path, error):
    rig = FakeRig(fail=at_frame(7, error))
    with pytest.raises(type(error)):
        take(rig, tmp_path / "s")
    events = [event for event in rig.diary if event in ("made safe", "capture stops", "bench closes")]
    assert events[-3:] == ["made safe", "capture stops", "bench closes"]
    assert not rig.gate_open and rig.mcp_v == 0.0
    session = open_session(tmp_path / "s")
    assert [len(entry.read()) for entry in session.stacks] == [4, 2]
    assert not session.stack("low").finished


def test_a_bench_that_cannot_be_made_safe_does_not_hide_the_first_error(tmp_path):
    first, second = CameraError("camera fake has gone"), CameraError("the gate does not answer")
    rig = FakeRig(fail=lambda event: {"frame": first, "made safe": second}.get(event))
    with pytest.raises(CameraError, match="has gone") as caught:
        take(rig, tmp_path / "s")
    assert any("the gate does not answer" in note for note in caught.value.__notes__)


def test_a_trip_of_the_supply_ends_the_run_at_the_next_frame(tmp_path):
    checks = iter(range(1, 100))
    trip = CameraError("high-voltage supply tripped")
    rig = FakeRig(fail=lambda event: trip if event == "bench checked" and next(checks) == 6 else None)
    with pytest.raises(CameraError, match="tripped"):
        take(rig, tmp_path / "s")
    assert not rig.gate_open
    assert [len(entry.read()) for entry in open_session(tmp_path / "s").stacks] == [4, 1]


def test_lost_frames_are_counted_in_the_session(tmp_path):
    session = take(FakeRig(lose=3), tmp_path / "s")
    assert [entry.read().lost_frames for entry in session.stacks] == [3, 3, 3]


def test_a_resumed_run_repeats_nothing_and_fills_up_what_was_broken_off(tmp_path):
    with pytest.raises(CameraError):
        take(FakeRig(fail=at_frame(7, CameraError("gone"))), tmp_path / "s")
    before = [entry.read().data for entry in open_session(tmp_path / "s").stacks]
    rig = FakeRig()
    session = take(rig, tmp_path / "s", resume=True)
    assert rig.diary.count("frame") == 6
    assert [len(entry.read()) for entry in session.stacks] == [4, 4, 4]
    for old, entry in zip(before, session.stacks, strict=False):
        assert np.array_equal(entry.read().data[: len(old)], old)
    assert any("broken off after 2 frames" in note for note in session.stack("low").notes)


def test_what_was_taken_while_the_bench_failed_is_put_aside_and_taken_anew(tmp_path):
    """The gate is shut some frames before anybody is told: they are dark, and no light is measured in them."""
    checks = iter(range(1, 100))
    trip = InstrumentTripped("high-voltage supply tripped")
    rig = FakeRig(fail=lambda event: trip if event == "bench checked" and next(checks) == 7 else None)
    with pytest.raises(InstrumentTripped):
        take(rig, tmp_path / "s")
    broken = open_session(tmp_path / "s").stack("low")
    assert len(broken.read()) == 2
    assert any("may be dark" in note for note in broken.notes)
    rig = FakeRig()
    session = take(rig, tmp_path / "s", resume=True)
    assert rig.diary.count("frame") == 8
    assert session.stack("low").read().frame_number.tolist() == [1, 2, 3, 4]
    assert any("taken anew" in note and "low.aside-1.zarr" in note for note in session.stack("low").notes)
    assert (tmp_path / "s" / "frames" / "low.aside-1.zarr").is_dir()


def test_a_stack_that_is_full_when_the_bench_fails_is_doubted_as_well(tmp_path):
    sets = iter(range(1, 100))
    trip = InstrumentTripped("high-voltage supply tripped")
    rig = FakeRig(fail=lambda event: trip if event == "conditions set" and next(sets) == 4 else None)
    with pytest.raises(InstrumentTripped):
        take(rig, tmp_path / "s")
    assert len(open_session(tmp_path / "s").stack("low").read()) == 4
    assert any("taken anew" in note for note in take(FakeRig(), tmp_path / "s", resume=True).stack("low").notes)


def test_resuming_a_complete_run_switches_nothing_on(tmp_path):
    take(FakeRig(), tmp_path / "s")
    rig = FakeRig()
    take(rig, tmp_path / "s", resume=True)
    assert "conditions set" not in rig.diary
    assert "frame" not in rig.diary


def test_a_stack_filled_up_under_another_voltage_says_so(tmp_path):
    with pytest.raises(CameraError):
        take(FakeRig(fail=at_frame(7, CameraError("gone"))), tmp_path / "s")
    rig = FakeRig()
    honest = rig.bench.set_conditions
    rig.bench.set_conditions = lambda asked: replace(honest(asked), mcp_v=690.0)
    notes = take(rig, tmp_path / "s", resume=True).stack("low").notes
    assert any("mcp_v was 700.25 in the first run and 690 in the later one" in note for note in notes)


def test_a_changed_plan_is_not_resumed_but_other_wires_are(tmp_path):
    take(FakeRig(), tmp_path / "s")
    other = replace(PLAN, steps=(*PLAN.steps[:2], step("high", mcp_v=810.0)))
    with pytest.raises(BadInput, match="step 'high'"):
        take(FakeRig(), tmp_path / "s", other, resume=True)
    take(FakeRig(), tmp_path / "s", replace(PLAN, wires=Wires(camera="another")), resume=True)


def test_a_folder_with_a_session_is_not_written_over(tmp_path):
    take(FakeRig(), tmp_path / "s")
    with pytest.raises(BadInput, match="without a session"):
        take(FakeRig(), tmp_path / "s")


def test_what_was_never_begun_is_not_resumed(tmp_path):
    with pytest.raises(BadInput, match="must have been begun"):
        take(FakeRig(), tmp_path / "s", resume=True)


class Doubtful:
    """A judge who has seen every frame of the stack."""

    def __init__(self) -> None:
        self.seen = []

    def complaint(self, stack: FrameStack, step: Step) -> str | None:
        self.seen.append((step.label, len(stack)))
        return "too dark" if step.label == "low" else None


def test_a_judges_complaint_becomes_a_note_of_its_stack(tmp_path):
    judge = Doubtful()
    session = take(FakeRig(), tmp_path / "s", judge=judge)
    assert judge.seen == [("dark", 4), ("low", 4), ("high", 4)]
    assert [entry.notes for entry in session.stacks] == [(), ("too dark",), ()]


@pytest.mark.parametrize(
    ("wrong", "rule"),
    [
        (step("a/b"), "file name"),
        (step("dark", kind="dark", lux=1e-4), "without light"),
        (step("bars", kind="bars"), "must have its bars"),
        (step("gate", gate_ns=1.9e7, exposure_s=0.01), "must not exceed the exposure"),
        (step("much", frames=10**12), "disk"),
        *((step("wish", **wish), f"{name} must be left out") for wish in UNSETTABLE for name in wish),
    ],
)
def test_the_whole_plan_is_checked_before_anything_opens(tmp_path, wrong, rule):
    rig = FakeRig()
    plan = Plan(name="p", sensor="pulnix-ag5745ef3", steps=(step("good"), wrong))
    with pytest.raises(BadInput, match=rule):
        take(rig, tmp_path / "s", plan)
    assert rig.diary == []
    assert not (tmp_path / "s").exists()


def test_progress_grows_to_one(tmp_path):
    shares = []
    take(FakeRig(), tmp_path / "s", progress=lambda sentence, share: shares.append(share))
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_a_bar_target_is_kept_with_its_stack(tmp_path):
    bars = replace(step("bars", kind="bars"), target=Target(bars=4, frequency_cy_per_px=0.12, angle_deg=90.0))
    session = take(FakeRig(), tmp_path / "s", Plan(name="p", steps=(bars,)))
    assert session.stack("bars").target == bars.target


def _frames(entry):
    stack = entry.read()
    return zip(stack.data, stack.frame_number, strict=True)
