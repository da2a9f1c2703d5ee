"""A gate opens at each trigger that it was told to take, no more often than was asked, and says
where none comes.
"""

import time

import pytest

from drivers.acquisition.plan_check import check_plan
from drivers.errors import InstrumentRejected
from drivers.instruments import delay_generator, dg535, gate_limits
from labdata import BadInput, Conditions, Plan, Step
from labdata.gating import HOLDOFF, Gating
from simulate.virtual_bench.in_process import InProcessPort
from simulate.virtual_bench.instruments.delay_generator import FIELD_HZ
from simulate.virtual_bench.instruments.delay_generator import DelayGenerator as VirtualDg645
from simulate.virtual_bench.instruments.dg535 import Dg535 as VirtualDg535
from simulate.virtual_bench.prologix import PrologixAdapter

WIDTH_NS = 2e6


def dg645(**wired):
    port = InProcessPort(VirtualDg645(**wired))
    return delay_generator.MODEL.driver(delay_generator.MODEL.line(port, 0)), port


def test_a_triggered_gate_opens_once_for_each_field_and_holds_off_what_comes_too_early():
    gate, port = dg645()
    assert gate.open(
        width_ns=WIDTH_NS, rate_hz=FIELD_HZ, delay_ns=3e6, sync="triggered"
    ) == pytest.approx(WIDTH_NS)
    out = port.far_end().gate()
    assert (out.gate_trigger, out.gate_hz, out.gate_delay_ns) == (
        "camera",
        FIELD_HZ,
        pytest.approx(3e6),
    )
    assert float(gate.line.ask("HOLD?")) == pytest.approx(HOLDOFF / FIELD_HZ, abs=1e-9)
    ringing, port = dg645(external_hz=2.0 * FIELD_HZ)
    ringing.open(width_ns=WIDTH_NS, rate_hz=FIELD_HZ, sync="triggered")
    assert port.far_end().gate().gate_hz <= FIELD_HZ / HOLDOFF


def test_a_gate_at_whose_input_nothing_comes_is_told_and_left_shut():
    gate, port = dg645(external_hz=0.0)
    with pytest.raises(
        InstrumentRejected, match=r"must be triggered 59\.9401 times a second, got no trigger"
    ):
        gate.open(width_ns=WIDTH_NS, rate_hz=FIELD_HZ, sync="triggered")
    assert not port.far_end().gate().gate_open


@pytest.mark.parametrize("sync", ["triggered", "line-locked"])
def test_triggers_that_stay_away_are_reported_at_a_look_and_not_while_one_is_still_due(
    monkeypatch, sync
):
    gate, port = dg645()
    gate.open(width_ns=WIDTH_NS, rate_hz=FIELD_HZ, sync=sync)
    port.far_end()
    gate.look()
    monkeypatch.setattr(VirtualDg645, "_trigger_hz", lambda self: 0.0)
    gate._triggered_s, now_s = time.monotonic(), time.monotonic()
    monkeypatch.setattr(gate_limits.time, "monotonic", lambda: now_s + 1.9 / FIELD_HZ)
    gate.look()
    monkeypatch.setattr(gate_limits.time, "monotonic", lambda: now_s + 2.1 / FIELD_HZ)
    with pytest.raises(
        InstrumentRejected, match=r"must be triggered .* times a second, got no trigger"
    ):
        gate.look()


def test_a_gate_goes_from_one_trigger_to_another_and_keeps_nothing_of_the_first():
    gate, port = dg645()
    gate.open(width_ns=WIDTH_NS, rate_hz=FIELD_HZ, sync="triggered")
    gate.open(width_ns=WIDTH_NS, rate_hz=60.0, sync="line-locked")
    assert (port.far_end().gate().gate_trigger, port.far_end().gate().gate_hz) == ("mains", 60.0)
    gate.open(width_ns=WIDTH_NS, rate_hz=200.0)
    assert (port.far_end().gate().gate_trigger, port.far_end().gate().gate_hz) == ("clock", 200.0)


def test_the_older_generator_takes_the_mains_and_refuses_what_it_cannot_hold_off():
    port = InProcessPort(PrologixAdapter(15, VirtualDg535()))
    gate = dg535.MODEL.driver(dg535.MODEL.line(port, 15))
    gate.open(width_ns=WIDTH_NS, rate_hz=60.0, sync="line-locked")
    assert port.far_end().gate().gate_trigger == "mains"
    with pytest.raises(BadInput, match="has no trigger holdoff, got triggered"):
        gate.check_pulse(width_ns=WIDTH_NS, rate_hz=FIELD_HZ, sync="triggered")


@pytest.mark.parametrize(
    ("delay_ns", "fits"), [(0.0, False), (9e6, True), (1.4e7, True), (1.5e7, False)]
)
def test_a_triggered_gate_must_open_inside_the_exposure(tmp_path, delay_ns, fits):
    asked = Conditions(mcp_v=700.0, gate_ns=WIDTH_NS, exposure_s=0.008)
    step = Step(label="a", kind="dark", frames=1, conditions=asked)
    plan = Plan(name="p", gating=Gating(sync="triggered", delay_ns=delay_ns), steps=(step,))
    if fits:
        check_plan(plan, tmp_path, None)
    else:
        with pytest.raises(BadInput, match="delay_ns must open the gate inside the exposure"):
            check_plan(plan, tmp_path, None)
