"""A night is rehearsed from the command line: a script of faults breaks the run off, and a resumed
one completes it.
"""

from dataclasses import replace

import pytest

from charact.cli.benches import acquire_session
from charact.cli.output import Progress
from labdata import (
    BadInput,
    Conditions,
    InstrumentConfig,
    Override,
    Plan,
    Step,
    load_sensor,
    open_session,
    read_events,
    save_sensor,
)
from simulate.virtual_bench.rehearsal import FaultScript, ScriptedFault

FAST = Override(limit="ramp_v_per_s", value=4000.0, reason="a rehearsal has no tube")
FRAMES = 200  # long enough for a fault that strikes as they begin
GARBAGE = ScriptedFault(instrument="high_voltage", kind="garbage", at_step="flat", for_s=4.0)


@pytest.fixture
def plan(tmp_path):
    sensor = load_sensor("pulnix-ag5745ef3")
    save_sensor(
        replace(sensor, ccd=replace(sensor.ccd, rows=31, columns=44)), tmp_path / "small.toml"
    )
    asked = Conditions(mcp_v=100.0, gate_ns=1.6e7)
    steps = (
        Step(label="dark", kind="dark", frames=3, conditions=asked),
        Step(
            label="flat",
            kind="flat",
            frames=FRAMES,
            conditions=replace(asked, illuminance_lux=1e-5),
        ),
    )
    wires = InstrumentConfig(bench="in-process")
    return Plan(
        name="night",
        sensor=str(tmp_path / "small.toml"),
        wires=wires,
        overrides=(FAST,),
        steps=steps,
    )


def quiet(sentence: str, share: float = 0.0) -> None:
    """Nobody looks."""


def test_a_script_breaks_a_run_off_and_the_resumed_run_completes_it(plan, tmp_path):
    folder, told = tmp_path / "s", []
    script = FaultScript(fault=(GARBAGE,))
    progress: Progress = quiet
    with pytest.raises(BadInput, match="the high-voltage supply"):
        acquire_session(
            plan, folder, resume=False, progress=progress, tell=told.append, inject_faults=script
        )
    assert "Rehearsal: garbage of high_voltage for 4 s." in told
    assert [entry.finished for entry in open_session(folder).stacks] == [True]
    session = acquire_session(
        plan, folder, resume=True, progress=progress, tell=told.append, inject_faults=script
    )
    assert [(entry.label, entry.finished, len(entry.read())) for entry in session.stacks] == [
        ("dark", True, 3),
        ("flat", True, FRAMES),
    ]
    struck = [each["event"] for each in read_events(tmp_path / "s.bench" / "rehearsal.jsonl")]
    assert struck.count("fault strikes") == 1


def test_a_door_that_opens_in_mid_stack_breaks_a_run_off(plan, tmp_path):
    dark, flat = plan.steps
    at_gain = replace(
        plan, steps=(dark, replace(flat, conditions=replace(flat.conditions, mcp_v=650.0)))
    )
    door = ScriptedFault(
        instrument="surroundings", kind="room light", value=1.0, at_step="flat", for_s=4.0
    )
    with pytest.raises(BadInput, match=r"keep the mean of a frame below|pixels may be saturated"):
        acquire_session(
            at_gain,
            tmp_path / "s",
            resume=False,
            progress=quiet,
            tell=quiet,
            inject_faults=FaultScript(fault=(door,)),
        )


def test_no_real_bench_and_no_instrument_that_is_not_there_is_struck(plan, tmp_path):
    real = replace(plan, wires=InstrumentConfig(bench="real"))
    with pytest.raises(BadInput, match="fault injection needs a virtual bench, got a real one"):
        acquire_session(
            real,
            tmp_path / "s",
            resume=False,
            progress=quiet,
            inject_faults=FaultScript(fault=(GARBAGE,)),
        )
    absent = FaultScript(fault=(ScriptedFault(instrument="light_source", kind="silence"),))
    with pytest.raises(BadInput, match="on the wires of this bench, got light_source"):
        acquire_session(plan, tmp_path / "t", resume=False, progress=quiet, inject_faults=absent)
