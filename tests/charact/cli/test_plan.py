"""Plans are told before they run, and a person at the prompt may take their time."""

import io
import os
import pty
import sys
import threading
import time
from collections.abc import Callable
from contextlib import closing

import numpy as np
import pytest

import drivers
from charact.cli.benches import PromptingOperator, TargetPlacer
from charact.reporting import page
from drivers.acquisition.plans import builtin_plan_names, load_plan
from drivers.instruments.models import lines_on
from labdata import BadInput, Target, load_sensor, open_session
from labdata import Result as Measured
from labdata.tube_dose import FOLDER_VARIABLE, Dose, ledger_of
from simulate.virtual_bench.bench import VirtualBench
from tests.charact.cli.runner import assert_one_sentence, charact, done_well, json_of, small_camera

# `charact plan` tells what a plan would do and switches nothing on; what was taken agrees with
# what was told.


PLAN = """
name = "small"
sensor = "pulnix-ag5745ef3.toml"
tube = "SN 7"
seed = 3
[wires]
bench = "in-process"
[[override]]
limit = "ramp_v_per_s"
value = 400.0
reason = "a rehearsal on the virtual bench"
[[sweep]]
kind = "flat"
frames = 2
mcp_v = 600.0
gate_ns = 1.6e7
illuminance_lux = [1e-4, 2e-4]
"""


@pytest.fixture
def plan(tmp_path, monkeypatch):
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "tubes"))
    small_camera(tmp_path, 61, 84)
    (tmp_path / "plan.toml").write_text(PLAN)
    return tmp_path / "plan.toml"


def test_the_plan_is_told_in_steps_time_disk_dose_and_hottest_step(plan, tmp_path):
    before = sorted(path.name for path in tmp_path.iterdir())
    document = json_of("plan", plan)
    assert [step["label"] for step in document["steps"]] == ["flat-0.0001lux", "flat-0.0002lux"]
    assert document["hottest"]["label"] == "flat-0.0002lux"
    assert document["bytes"] == 4 * 61 * 84
    assert 2.0 < document["seconds"] < 5.0  # 600 V at 400 V/s, and ten frames
    assert document["dose"]["screen_c_per_cm2"] > 0.0
    assert document["limits"]["ramp_v_per_s"] == 400.0
    assert "a rehearsal on the virtual bench" in document["overridden"][0]
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_what_was_taken_agrees_with_what_was_told_and_the_report_prints_the_override(
    plan, tmp_path
):
    document = json_of("plan", plan)
    done_well("acquire", plan, tmp_path / "session")
    session = open_session(tmp_path / "session")
    assert [entry.label for entry in session.stacks] == [
        step["label"] for step in document["steps"]
    ]
    assert any(
        note.endswith("was overridden to 400: a rehearsal on the virtual bench.")
        for note in session.notes
    )
    spent = ledger_of("SN 7").total()
    assert spent.screen_c_per_cm2 > 0.0 and spent.hours_at_gain > 0.0
    assert json_of("plan", plan)["dose_before"]["screen_c_per_cm2"] == spent.screen_c_per_cm2
    html = page(session, Measured(measurements=(), curves={}, evidence={}))
    assert "was overridden to 400: a rehearsal on the virtual bench." in html
    (tmp_path / "session" / "notes.txt").write_text("mine")
    (tmp_path / "session" / "results.json").write_text("of the run before")
    done_well("acquire", plan, tmp_path / "session", "--force")
    again = open_session(tmp_path / "session")
    assert [entry.label for entry in again.stacks] == [entry.label for entry in session.stacks]
    assert (tmp_path / "session" / "notes.txt").is_file() and not (
        tmp_path / "session" / "results.json"
    ).exists()
    # The dose of the first run stays in the tube's ledger.
    assert ledger_of("SN 7").total().hours_at_gain > spent.hours_at_gain


def test_a_life_nearly_used_up_is_warned_of(plan):
    ledger_of("SN 7").append(Dose(screen_c_per_cm2=0.28))
    assert "93% of the 0.3 C/cm2" in json_of("plan", plan)["warnings"][0]
    assert "93% of the 0.3 C/cm2" in charact("plan", plan).stdout


@pytest.mark.parametrize("name", builtin_plan_names())
def test_every_shipped_plan_passes_its_check(name):
    assert len(json_of("plan", name)["steps"]) == len(load_plan(name).steps)


@pytest.mark.parametrize(
    ("line", "rule"),
    [
        ("mcp_v = 950.0", "mcp_v must not exceed the limit 900, got 950, in step"),
        (
            "illuminance_lux = 0.5",
            "illuminance_lux must not exceed the limit 0.01, got 0.5, in step",
        ),
        ("gate_ns = 1.6668e7", "the gate must be open for at most 0.999 of the time"),
        (
            "mcp_v = 890.0\nilluminance_lux = 9e-3",
            "must not exceed 120 nA/cm2 of MCP output, got 169",
        ),
    ],
)
def test_what_the_interlock_would_refuse_is_refused_before(plan, line, rule):
    changed = line.split(" =")[0]
    kept = [
        one
        for one in PLAN.splitlines()
        if not one.startswith((changed, *line.split("\n")[-1].split(" =")[:1]))
    ]
    plan.write_text("\n".join(kept) + f"\n{line}\n")
    assert_one_sentence(charact("plan", plan), rule)


def test_reports_and_frames_of_the_functions_are_those_of_the_verbs(plan, tmp_path):
    report, document = drivers.plan_report(plan), json_of("plan", plan)
    assert drivers.plan_report(report.plan) == report
    assert document["hottest"]["share_of_limit"] == report.hottest.share_of_limit
    assert document["dose"]["screen_c_per_cm2"] == report.dose.screen_c_per_cm2
    assert [step["seconds"] for step in document["steps"]] == [
        round(step.seconds, 3) for step in report.steps
    ]
    dark = '[[step]]\nlabel = "dark"\nkind = "dark"\nframes = 2\ngate_ns = 1e4\n'
    plan.write_text(PLAN.split("[[override]]")[0] + dark)
    loaded, out = load_plan(plan), tmp_path / "python"
    sensor = load_sensor(loaded.sensor)
    with VirtualBench(tmp_path / "rig", sensor, loaded.seed, wires=loaded.wires) as virtual:
        lines = lines_on(virtual.inside.ports, virtual.wires)
        session = drivers.acquire(
            plan,
            out,
            bench=drivers.bench_of(loaded, out, wires=virtual.wires, lines=lines),
            camera=virtual.in_process_camera(),
            operator=virtual.operator,
        )
    done_well("acquire", plan, tmp_path / "verb")
    for entry, other in zip(session.stacks, open_session(tmp_path / "verb").stacks, strict=True):
        assert np.array_equal(entry.read().data, other.read().data)
    with pytest.raises(BadInput, match="whose bench is in-process, got no bench for 'small'"):
        drivers.acquire(plan, tmp_path / "none", operator=virtual.operator)


# A person at the prompt may take their time: the run is called meanwhile, and may end the prompt.


@pytest.fixture(params=["terminal", "pipe"])
def typed(request, monkeypatch):
    """Standard input that is a terminal or a pipe; what is called types on it, nothing closes
    it.
    """
    keyboard, there = pty.openpty() if request.param == "terminal" else os.pipe()[::-1]
    open_ends = {keyboard, there}
    with open(there, closefd=False) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)

        def type_(text: str) -> None:
            if text:
                os.write(keyboard, text.encode())
            elif request.param == "pipe":
                os.close(keyboard)
                open_ends.discard(keyboard)
            else:
                os.write(keyboard, b"\x04")

        yield type_
    for end in open_ends:
        os.close(end)


def reading(operator: PromptingOperator) -> float | None:
    return operator.place(kind="flat", target=Target(), illuminance_lux=2e-5).illuminance_lux


def later(act: Callable[[], None], seconds: float) -> threading.Timer:
    timer = threading.Timer(seconds, act)
    timer.start()
    return timer


def test_answers_are_read_line_by_line_whenever_they_are_typed(typed, capfd):
    operator = PromptingOperator()
    typed("1e-5\n2e-5\n")
    assert [reading(operator), reading(operator)] == [1e-5, 2e-5]
    later(lambda: typed("3e-"), 0.05)
    timer = later(lambda: typed("5\n"), 0.3)
    assert reading(operator) == 3e-5
    timer.join()
    assert capfd.readouterr().err.count("What does the meter read, in lux? ") == 3


def test_the_run_is_called_ten_times_a_second_and_what_it_raises_ends_the_prompt(typed):
    operator, calls_s = PromptingOperator(), []

    def waiting() -> None:
        calls_s.append(time.monotonic())
        if len(calls_s) == 6:
            raise ZeroDivisionError

    operator.while_waiting = waiting
    began_s = time.monotonic()
    with pytest.raises(ZeroDivisionError):
        reading(operator)
    # A bench makes safe after 0.6 s without a sign of life.
    assert (
        max(after - before for before, after in zip([began_s, *calls_s], calls_s, strict=False))
        < 0.5
    )
    operator.while_waiting = lambda: None
    typed("4e-5\n")
    assert reading(operator) == 4e-5


def test_the_end_of_the_input_is_one_sentence(typed):
    typed("")
    with pytest.raises(
        BadInput, match="a person must answer what the meter reads, got the end of the input"
    ):
        reading(PromptingOperator())
    typed_placer = TargetPlacer()
    with pytest.raises(BadInput, match="once the edge target is placed, got the end"):
        sys.stdin = io.StringIO("")
        typed_placer.place(kind="edge", target=Target(), illuminance_lux=1.0)


def test_a_terminal_that_takes_no_more_is_waited_for_in_slices_and_not_at_all_to_darken(
    monkeypatch,
):
    there, full = os.pipe()
    os.set_blocking(full, False)
    with closing(os.fdopen(there, "rb")), open(full, "w", closefd=True) as stderr:
        with pytest.raises(BlockingIOError):
            while True:
                os.write(full, bytes(4096))
        os.set_blocking(full, True)
        monkeypatch.setattr(sys, "stderr", stderr)
        operator, calls = PromptingOperator(), []

        def waiting() -> None:
            calls.append(1)
            if len(calls) == 3:
                raise ZeroDivisionError

        operator.while_waiting = waiting
        operator.darken()
        assert not calls
        with pytest.raises(ZeroDivisionError):
            reading(operator)


def test_targets_are_placed_once_and_a_dark_needs_none(typed, capfd):
    placer = TargetPlacer()
    typed("\n")
    for kind in ("edge", "dark", "edge"):
        placer.place(kind=kind, target=Target(angle_deg=5.0), illuminance_lux=1.0)
    assert capfd.readouterr().err.count("press Enter") == 1
    assert (PromptingOperator.is_by_hand, TargetPlacer.is_by_hand) == (True, False)
