"""A plan becomes a session: in the order that spares the tube, with what was read back, and without
losing a frame.
"""

from dataclasses import replace

import numpy as np
import pytest

from drivers import acquire
from drivers.acquisition.plan_check import bytes_of, check_plan, picture_of
from drivers.acquisition.run import Freshness
from drivers.errors import BenchError, CameraError, InstrumentTripped
from labdata import (
    BadInput,
    CameraSettings,
    Conditions,
    Frame,
    FrameFormat,
    InstrumentConfig,
    Plan,
    SaturationSearch,
    StackWriter,
    Step,
    StopCriterion,
    load_sensor,
    open_session,
    read_events,
    read_plan,
)
from labdata.storage_thread import Storage
from tests.drivers import fake_rig

FakeRig = fake_rig.FakeRig


def step(
    label: str, *, frames: int = 4, kind: str = "flat", lux: float | None = 1e-4, **conditions
) -> Step:
    asked = {"mcp_v": 700.0, "gate_ns": 1.6e7, **conditions}
    return Step(
        label=label, kind=kind, frames=frames, conditions=Conditions(illuminance_lux=lux, **asked)
    )


PLAN = Plan(
    name="series",
    steps=(step("dark", kind="dark", lux=None), step("low"), step("high", mcp_v=800.0)),
)


# What no driver sets: on or off, a record of it would be a claim.
UNSETTABLE = (
    {"automatic_gain": True},
    {"automatic_gain": False},
    {"brightness_control": True},
    {"em_gain": 300.0},
    {"gain_control": 102.0},
)


def take(rig, folder, plan=PLAN, **options):
    return acquire(
        plan, folder, camera=rig.camera, bench=rig.bench, operator=rig.operator, **options
    )


def at_frame(number: int, error: BaseException):
    """Fail when the camera is to send its frame of this number, and never again."""
    count = iter(range(1, 10_000))
    return lambda event: error if event == "frame" and next(count) == number else None


def test_every_frame_of_the_plan_arrives_in_order(tmp_path):
    session = take(FakeRig(), tmp_path / "s")
    assert [entry.label for entry in session.stacks] == ["dark", "low", "high"]
    numbers = np.concatenate([entry.read().frame_number for entry in session.stacks])
    assert numbers.tolist() == list(range(1, 13))
    assert all(
        (frame == number).all() for entry in session.stacks for frame, number in _frames(entry)
    )


def test_asked_and_read_back_are_both_recorded(tmp_path):
    session = take(
        FakeRig(), tmp_path / "s", Plan(name="p", steps=(step("low", exposure_s=0.0162004),))
    )
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


def test_the_tube_is_made_safe_before_all_else_and_before_anything_is_closed(tmp_path):
    rig = FakeRig()
    take(rig, tmp_path / "s")
    order = [
        "bench opens",
        "camera opens",
        "made safe",
        "darkened",
        "camera closes",
        "bench closes",
    ]
    assert [event for event in rig.diary if event in order] == order
    assert not rig.gate_open


@pytest.mark.parametrize(
    "error", [CameraError("camera fake has gone"), KeyboardInterrupt(), OSError(28, "disk full")]
)
def test_any_end_shuts_the_gate_before_the_camera_is_stopped_and_keeps_the_frames(tmp_path, error):
    rig = FakeRig(fail=at_frame(7, error))
    with pytest.raises(type(error)):
        take(rig, tmp_path / "s")
    events = [event for event in rig.diary if event in ("frame", "made safe", "capture stops")]
    assert events[events.index("made safe") - 1 :][:3] == ["frame", "made safe", "capture stops"]
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
    trip = BenchError("high-voltage supply tripped")
    rig = FakeRig(
        fail=lambda event: trip if event == "bench checked" and rig.frames_sent == 6 else None
    )
    with pytest.raises(BenchError, match="tripped"):
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
    """The gate is shut some frames before anybody is told: they are dark, and no light is measured
    in them.
    """
    trip = InstrumentTripped("high-voltage supply tripped")
    rig = FakeRig(
        fail=lambda event: trip if event == "bench checked" and rig.frames_sent == 6 else None
    )
    with pytest.raises(InstrumentTripped):
        take(rig, tmp_path / "s")
    broken = open_session(tmp_path / "s").stack("low")
    assert len(broken.read()) == 1
    assert any("may be dark" in note for note in broken.notes)
    rig = FakeRig()
    session = take(rig, tmp_path / "s", resume=True)
    assert rig.diary.count("frame") == 8
    assert session.stack("low").read().frame_number.tolist() == [1, 2, 3, 4]
    assert any(
        "acquired again" in note and "low.aside-1.zarr" in note
        for note in session.stack("low").notes
    )
    assert (tmp_path / "s" / "frames" / "low.aside-1.zarr").is_dir()


def test_a_stack_that_is_full_when_the_bench_fails_is_doubted_as_well(tmp_path):
    sets = iter(range(1, 100))
    trip = InstrumentTripped("high-voltage supply tripped")
    rig = FakeRig(
        fail=lambda event: trip if event == "conditions set" and next(sets) == 4 else None
    )
    with pytest.raises(InstrumentTripped):
        take(rig, tmp_path / "s")
    assert len(open_session(tmp_path / "s").stack("low").read()) == 4
    assert any(
        "acquired again" in note
        for note in take(FakeRig(), tmp_path / "s", resume=True).stack("low").notes
    )


def test_resuming_a_complete_run_switches_nothing_on(tmp_path):
    take(FakeRig(), tmp_path / "s")
    rig = FakeRig()
    take(rig, tmp_path / "s", resume=True)
    assert "conditions set" not in rig.diary
    assert "frame" not in rig.diary


def test_a_stack_is_not_gone_on_with_under_another_voltage(tmp_path):
    with pytest.raises(CameraError):
        take(FakeRig(fail=at_frame(7, CameraError("gone"))), tmp_path / "s")
    rig = FakeRig()
    honest = rig.bench.set_conditions
    rig.bench.set_conditions = lambda asked: replace(honest(asked), mcp_v=690.0)
    with pytest.raises(
        BadInput,
        match=r"must read back what it did in its first run, got mcp_v of 690 after 700\.25",
    ):
        take(rig, tmp_path / "s", resume=True)
    assert "frame" not in rig.diary
    assert len(open_session(tmp_path / "s").stack("low").read()) == 2


def test_a_changed_plan_is_not_resumed_but_other_wires_are(tmp_path):
    take(FakeRig(), tmp_path / "s")
    other = replace(PLAN, steps=(*PLAN.steps[:2], step("high", mcp_v=810.0)))
    with pytest.raises(BadInput, match="step 'high'"):
        take(FakeRig(), tmp_path / "s", other, resume=True)
    take(
        FakeRig(),
        tmp_path / "s",
        replace(PLAN, wires=InstrumentConfig(camera="another")),
        resume=True,
    )


def spotted(number, size):
    """Light on one pixel of some fifty, up to a ceiling below the top code."""
    light = np.zeros(size, np.uint8)
    light[2, 3] = 200
    return light


@pytest.mark.parametrize(
    ("first", "picture"), [(3, lambda n: 0), (3, lambda n: 90 + n // 99), (10, lambda n: n % 8)]
)
def test_pictures_that_come_again_under_new_numbers_end_the_run(tmp_path, first, picture):
    rig = FakeRig()
    rig.picture = lambda number: np.full(fake_rig.SIZE, picture(number), np.uint8)
    plan = replace(PLAN, steps=(step("low", frames=200),))
    with pytest.raises(BenchError, match="a new picture under each number"):
        take(rig, tmp_path / "s", plan)
    assert rig.frames_sent < first and not rig.gate_open
    assert "doubt = " in (tmp_path / "s/session.toml").read_text()
    # A dark may lie below one code, but is no such secret.
    rig, dark = FakeRig(), replace(PLAN, steps=PLAN.steps[:1])
    rig.picture = lambda number: np.full(fake_rig.SIZE, 12, np.uint8)
    session = take(rig, tmp_path / "dark", dark)
    assert "3 frames equal an earlier one" in session.stack("dark").notes


@pytest.mark.parametrize(("side", "ends_at"), [(8, None), (64, 4)])
def test_a_dark_whose_pictures_differ_everywhere_may_not_repeat_one(side, ends_at):
    """Pictures that differ in one spot repeat by chance, those that differ in 64 do not."""
    pictures: dict[int, int] = {}
    fresh = Freshness(pictures, is_bright=False, noise_dn=0.1)
    for number in range(1, 10):
        pixels = np.full((64, 64), 12, np.uint8)
        pixels[:side, :side] += number % 3
        frame = Frame(pixels=pixels, number=number, time_s=0.0)
        if number == ends_at:
            with pytest.raises(BenchError, match="a new picture under each number"):
                fresh.see(frame)
            return
        fresh.see(frame)
    assert fresh.complaint() == "6 frames equal an earlier one"


@pytest.mark.parametrize(
    ("light", "rule"),
    [(lambda n, size: 100, "keep the mean of a frame below"), (spotted, "at most 0.5% of the")],
)
def test_light_that_the_step_does_not_explain_ends_the_run(tmp_path, light, rule):
    rig = FakeRig()
    rig.bench.dark_seen, rig.bench.dark_frame_seen = False, lambda levels: None

    def after_the_dark(number):
        return np.full(fake_rig.SIZE, 12 + (number > 1) * light(number, fake_rig.SIZE), np.uint8)

    rig.picture = after_the_dark
    plan = replace(PLAN, steps=(step("low"),))
    with pytest.raises(BenchError, match=rule):
        take(rig, tmp_path / "s", plan, predict=lambda conditions: 7.0)
    assert rig.frames_sent == 2 and not rig.gate_open


def test_a_folder_with_a_session_is_not_written_over(tmp_path):
    take(FakeRig(), tmp_path / "s")
    with pytest.raises(BadInput, match="without a session"):
        take(FakeRig(), tmp_path / "s")


class Doubtful:
    """A judge who finds the flats at low light too dark, and has seen every frame."""

    def __init__(self, enough_after: int = 10**9, saturates_lux: float = np.inf) -> None:
        self.seen = {}
        self.enough_after, self.saturates_lux = enough_after, saturates_lux

    def watch(self, step: Step, full_scale_dn: float):
        judge = self
        judge.seen[step.label] = 0

        class Watcher:
            def see(self, pixels):
                judge.seen[step.label] += 1

            def enough(self):
                return (
                    "enough seen"
                    if step.until and judge.seen[step.label] >= judge.enough_after
                    else None
                )

            def is_saturated(self):
                return (step.conditions.illuminance_lux or 0.0) > judge.saturates_lux

            def complaint(self):
                return "too dark" if step.label == "low" else None

        return Watcher()


def test_a_judges_complaint_becomes_a_note_of_its_stack(tmp_path):
    judge = Doubtful()
    session = take(FakeRig(), tmp_path / "s", judge=judge)
    assert judge.seen == {"dark": 4, "low": 4, "high": 4}
    assert [entry.notes for entry in session.stacks] == [(), ("too dark",), ()]


ADAPTIVE = replace(step("level", frames=40), until=StopCriterion(mean_within_dn=0.1))


def test_a_level_stops_when_its_judge_has_seen_enough_and_says_so(tmp_path):
    rig = FakeRig()
    plan = Plan(name="p", steps=(ADAPTIVE, step("after")))
    session = take(rig, tmp_path / "s", plan, judge=Doubtful(enough_after=9))
    assert [len(entry.read()) for entry in session.stacks] == [9, 4]
    assert all(entry.finished for entry in session.stacks)
    assert session.stack("level").notes == ("enough seen",)
    (told,) = [
        each for each in read_events(tmp_path / "s" / "log.jsonl") if each.get("stopped_early")
    ]
    assert (told["step"], told["stopped_early"]) == ("level", "enough seen")


def test_a_level_broken_off_is_judged_with_the_frames_it_has(tmp_path):
    with pytest.raises(CameraError):
        plan = Plan(name="p", steps=(ADAPTIVE,))
        take(
            FakeRig(fail=at_frame(7, CameraError("gone"))),
            tmp_path / "s",
            plan,
            judge=Doubtful(enough_after=9),
        )
    rig = FakeRig()
    session = take(rig, tmp_path / "s", plan, judge=Doubtful(enough_after=9), resume=True)
    assert rig.diary.count("frame") == 3
    assert len(session.stack("level").read()) == 9


SEARCH = replace(
    step("sat", lux=1e-5), search=SaturationSearch(most_illuminance_lux=1e-3, within_percent=10.0)
)


def levels(session) -> list[float]:
    return [entry.conditions.illuminance_lux for entry in session.stacks]


def test_the_light_that_saturates_is_found_within_what_was_asked(tmp_path):
    session = take(
        FakeRig(),
        tmp_path / "s",
        Plan(name="p", steps=(SEARCH,)),
        judge=Doubtful(saturates_lux=3.3e-4),
    )
    lux = levels(session)
    assert lux[:6] == pytest.approx([1e-5 * 2**n for n in range(6)])
    below, above = max(x for x in lux if x <= 3.3e-4), min(x for x in lux if x > 3.3e-4)
    assert above <= 1.1 * below
    assert session.notes == (
        (
            f"search 'sat': saturation begins between {below:.4g} and {above:.4g} lux, after "
            f"{len(lux)} levels"
        ),
    )
    assert len(lux) <= SEARCH.search.most_levels(1e-5)


def test_a_search_goes_no_higher_than_it_may(tmp_path):
    session = take(FakeRig(), tmp_path / "s", Plan(name="p", steps=(SEARCH,)), judge=Doubtful())
    assert max(levels(session)) == 1e-3
    assert "no level up to 0.001 lux saturates" in session.notes[0]


def test_a_search_that_was_broken_off_goes_on_with_the_levels_it_has(tmp_path):
    judge, plan = Doubtful(saturates_lux=3.3e-4), Plan(name="p", steps=(SEARCH,))
    whole = levels(take(FakeRig(), tmp_path / "whole", plan, judge=judge))
    with pytest.raises(CameraError):
        take(FakeRig(fail=at_frame(31, CameraError("gone"))), tmp_path / "s", plan, judge=judge)
    rig = FakeRig()
    session = take(rig, tmp_path / "s", plan, judge=judge, resume=True)
    assert levels(session) == whole
    assert rig.diary.count("frame") == 4 * len(whole) - 30


def test_a_step_that_looks_at_its_frames_needs_a_judge(tmp_path):
    rig = FakeRig()
    with pytest.raises(BadInput, match="must have a judge, got none for 'level'"):
        take(rig, tmp_path / "s", Plan(name="p", steps=(ADAPTIVE,)))
    assert rig.diary == ["bench opens", "bench closes"]


def test_the_log_tells_what_happened(tmp_path):
    with pytest.raises(CameraError):
        take(FakeRig(fail=at_frame(7, CameraError("camera fake has gone")), lose=2), tmp_path / "s")
    take(FakeRig(), tmp_path / "s", resume=True)
    told = read_events(tmp_path / "s" / "log.jsonl")
    begins = [number for number, each in enumerate(told) if each["event"] == "run begins"]
    first, second = told[: begins[1]], told[begins[1] :]
    assert [each["step"] for each in first if each["event"] == "step finished"] == ["dark"]
    assert (first[-1]["event"], first[-1]["whole"], first[-1]["kind"]) == (
        "run ends",
        False,
        "CameraError",
    )
    assert "camera fake has gone" in first[-1]["reason"]
    assert next(each for each in second if each["event"] == "bench opened")["broken_off"] == {
        "low": 2
    }
    assert [each["step"] for each in second if each["event"] == "step finished"] == ["low", "high"]
    assert second[-1]["whole"] is True


def test_frames_lost_in_a_run_that_broke_off_are_recorded_too(tmp_path):
    with pytest.raises(CameraError):
        take(FakeRig(fail=at_frame(7, CameraError("gone")), lose=2), tmp_path / "s")
    take(FakeRig(lose=3), tmp_path / "s", resume=True)
    entry = open_session(tmp_path / "s").stack("low")
    assert [(one.first, one.last) for one in entry.losses] == [(1, 2), (1, 3)]
    assert entry.lost_frames == 5


def test_a_disk_may_take_longer_on_a_busy_machine(tmp_path, monkeypatch):
    monkeypatch.setattr(Storage, "stall_s", 1.5)
    with pytest.raises(BadInput, match=r"must take a frame within 1\.2 s, got 1\.5 s without one"):
        take(FakeRig(), tmp_path / "idle")
    (busy := FakeRig()).bench.slack_s = lambda: 0.5
    assert len(take(busy, tmp_path / "busy").stacks) == 3


def test_a_full_disk_shuts_the_gate_first_and_keeps_what_was_stored(tmp_path, monkeypatch):
    rig = FakeRig()
    extend = StackWriter.extend

    def full(stack, frames):
        if stack.label == "low":
            raise BadInput("the disk must take every frame, got 'No space left on device'")
        return extend(stack, frames)

    monkeypatch.setattr(StackWriter, "extend", full)
    with pytest.raises(BadInput, match="No space left"):
        take(rig, tmp_path / "s")
    assert not rig.gate_open and rig.mcp_v == 0.0
    assert open_session(tmp_path / "s").stack("dark").finished
    monkeypatch.undo()
    assert [len(entry.read()) for entry in take(FakeRig(), tmp_path / "s", resume=True).stacks] == [
        4,
        4,
        4,
    ]


@pytest.mark.parametrize(
    ("wrong", "rule"),
    [
        (step("a/b"), "file name"),
        (step("dark", kind="dark", lux=1e-4), "without light"),
        (step("bars", kind="bars"), "must have its bars"),
        (step("gate", gate_ns=1.9e7, exposure_s=0.01), "must not exceed the exposure"),
        (step("much", frames=10**12), "disk"),
        *(
            (step("wish", **wish), f"{name} must be left out")
            for wish in UNSETTABLE
            for name in wish
        ),
    ],
)
def test_the_whole_plan_is_checked_before_anything_opens(tmp_path, wrong, rule):
    rig = FakeRig()
    plan = Plan(name="p", sensor="pulnix-ag5745ef3", steps=(step("good"), wrong))
    with pytest.raises(BadInput, match=rule):
        take(rig, tmp_path / "s", plan)
    assert rig.diary == ["bench opens", "bench closes"], (
        "the tube is made safe, and nothing else opens"
    )
    assert not (tmp_path / "s").exists()


@pytest.mark.parametrize(
    ("picture", "rule"),
    [
        (
            {"rows": 494},
            r"first_row \+ rows of the picture must not exceed the sensor's 493, got 494",
        ),
        ({"first_column": 700, "columns": 69}, r"must not exceed the sensor's 768, got 769"),
        (
            {"first_row": 3, "rows": 20},
            "first_row of interlaced video must be even, so that fields keep order, got 3",
        ),
    ],
)
def test_a_picture_that_the_sensor_does_not_have_is_refused_before_anything_opens(
    tmp_path, picture, rule
):
    rig = FakeRig()
    with pytest.raises(BadInput, match=rule):
        plan = Plan(
            name="p",
            sensor="pulnix-ag5745ef3",
            picture=FrameFormat(**picture),
            steps=(step("good"),),
        )
        take(rig, tmp_path / "s", plan)
    assert rig.diary == ["bench opens", "bench closes"]


def test_the_camera_is_asked_for_the_picture_of_the_plan_and_for_the_whole_sensor_else(tmp_path):
    sensor = load_sensor("pulnix-ag5745ef3")
    plan = Plan(name="p", steps=(step("good"),))
    part = replace(
        plan, picture=FrameFormat(first_row=100, rows=200, pixel_format="Mono10p", trigger="Line1")
    )
    whole = CameraSettings(first_row=0, first_column=0, rows=493, columns=768, pixel_format="Mono8")
    assert picture_of(plan, sensor) == whole
    assert picture_of(plan, None) == CameraSettings()
    assert picture_of(part, sensor) == replace(
        whole, first_row=100, rows=200, pixel_format="Mono10p", trigger="Line1"
    )
    assert bytes_of(part, sensor) == 4 * 200 * 768 * 2
    rig = FakeRig()
    take(rig, tmp_path / "s", replace(plan, picture=FrameFormat(trigger="Line1")))
    assert rig.camera.settings.trigger == "Line1"
    assert read_plan(tmp_path / "s" / "plan.toml").picture.trigger == "Line1"


def test_codes_of_the_sensor_are_not_cut_to_a_narrower_format(tmp_path):
    sensor = load_sensor("pulnix-ag5745ef3")
    deep = replace(sensor, video=replace(sensor.video, bit_depth=12))
    plan = Plan(name="p", picture=FrameFormat(pixel_format="Mono10"), steps=(step("good"),))
    with pytest.raises(
        BadInput, match="pixel_format must hold the sensor's 12 bits, got Mono10 of 10"
    ):
        check_plan(plan, tmp_path, deep)


def test_progress_grows_to_one(tmp_path):
    shares = []
    take(FakeRig(), tmp_path / "s", progress=lambda sentence, share: shares.append(share))
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def _frames(entry):
    stack = entry.read()
    return zip(stack.data, stack.frame_number, strict=True)
