"""`charact plan` tells what a plan would do and switches nothing on; what was taken agrees with
what was told.
"""

import numpy as np
import pytest

import drivers
from charact.reporting import page
from drivers.acquisition.plans import builtin_plan_names, load_plan
from drivers.instruments.models import lines_on
from labdata import BadInput, load_sensor, open_session
from labdata import Result as Measured
from labdata.tube_dose import FOLDER_VARIABLE, Dose, ledger_of
from simulate.virtual_bench.bench import VirtualBench
from tests.charact.cli.runner import (
    assert_one_sentence,
    charact,
    done_well,
    json_of,
    small_camera,
)

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
