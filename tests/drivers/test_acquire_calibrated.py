"""What is asked in luminous gain is set in volts, and what the supply reads back is recorded in
both.
"""

import tomllib
from dataclasses import replace

import pytest

from drivers import acquire
from labdata import (
    BadInput,
    Conditions,
    GainTable,
    Plan,
    Step,
    SweepRecord,
    by_calibration,
    in_volts,
    load_sensor,
    plan_of,
    plan_toml,
)
from tests.drivers.fake_rig import FakeRig

# A tube whose gain goes as the tenth power of its voltage, so that the volts of a gain are known
# without the table.
VOLTS = (500.0, 640.0, 800.0, 900.0)
TABLE = GainTable(
    source="integrating sphere",
    tube="0042",
    mcp_v=VOLTS,
    luminous_gain=tuple(2e4 * (volts / 800.0) ** 10 for volts in VOLTS),
    relative_sd=(0.05,) * 4,
)


def asking(table: GainTable | None = TABLE, *, tube: str | None = None, **asked) -> Plan:
    asked = Conditions(gate_ns=1.6e7, **asked)
    return Plan(
        name="p",
        tube=tube,
        gain_table=table,
        steps=(Step(label="a", kind="dark", frames=3, conditions=asked),),
    )


def test_a_gain_is_set_as_the_volts_that_give_it():
    for gain in (1e3, 5e3, 2e4, 6e4):
        volts = in_volts(asking(luminous_gain=gain), None).steps[0].conditions.mcp_v
        assert volts == round(800.0 * (gain / 2e4) ** 0.1)


def test_volts_asked_and_read_and_the_gain_of_what_was_read_are_recorded_with_their_source(
    tmp_path,
):
    rig = FakeRig()
    session = acquire(
        asking(luminous_gain=1e4),
        tmp_path / "s",
        camera=rig.camera,
        bench=rig.bench,
        operator=rig.operator,
    )
    entry = session.stack("a")
    assert (entry.asked.luminous_gain, entry.asked.mcp_v) == (1e4, 746.0)
    assert entry.conditions.mcp_v == 746.25
    assert entry.conditions.luminous_gain == pytest.approx(2e4 * (746.25 / 800.0) ** 10, rel=1e-9)
    assert entry.conditions.luminous_gain_relative_sd == pytest.approx(0.05)
    assert any("integrating sphere" in note for note in session.notes)


@pytest.mark.parametrize(
    ("plan", "rule"),
    [
        (
            asking(luminous_gain=1e6),
            r"luminous_gain must lie within the gain table, .* got 1e\+06, in step 'a'",
        ),
        (
            asking(mcp_v=480.0),
            "mcp_v must lie within the gain table, 500 to 900, got 480, in step 'a'",
        ),
        (asking(luminous_gain=1e4, mcp_v=700.0), "needs by the gain table, 746, got 700"),
        (
            asking(None, luminous_gain=1e4),
            "must have a gain table in the plan or its sensor, got none",
        ),
        (
            asking(tube="0043", luminous_gain=1e4),
            "must be of the plan's tube '0043', got one of '0042'",
        ),
    ],
)
def test_what_the_calibration_does_not_tell_is_refused(plan, rule):
    with pytest.raises(BadInput, match=rule):
        in_volts(plan, None)


def test_the_sensors_own_table_holds_where_the_plan_has_none():
    sensor = replace(load_sensor("pulnix-ag5745ef3"), gain_table=TABLE)
    assert in_volts(asking(None, luminous_gain=2e4), sensor).steps[0].conditions.mcp_v == 800.0


def test_a_supply_at_the_end_of_the_table_may_read_a_volt_beyond_it():
    assert by_calibration(TABLE, 901.0).luminous_gain == pytest.approx(2e4 * (901.0 / 800.0) ** 10)
    with pytest.raises(BadInput):
        by_calibration(TABLE, 905.0)
    assert by_calibration(TABLE, 8.0) == Conditions()  # what is left on a plate that is off


def test_a_plan_in_volts_is_kept_and_read_as_the_same_plan():
    sweep = SweepRecord(kind="flat", frames=3, luminous_gain=(1e3, 1e4), illuminance_lux=1e-5)
    plan = in_volts(Plan(name="p", gain_table=TABLE, steps=sweep.steps()), None)
    assert [step.label for step in plan.steps] == ["flat-gain1000", "flat-gain10000"]
    assert plan_of(tomllib.loads(plan_toml(plan))) == plan == in_volts(plan, None)
