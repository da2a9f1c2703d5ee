"""An instrument that fails ends the work in one sentence, and the other one is made safe within a second."""

import json
import time

import pytest

from drivers.bench.setup import open_bench
from drivers.errors import BenchError, BenchServerLost, InstrumentDisconnected, InstrumentTimeout, InstrumentTripped
from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.limits import Limits
from labdata.wires import Wires
from simulate.rig.faults import Faults, provoke
from simulate.rig.outputs import read_outputs
from simulate.rig.process import VirtualInstruments

pytestmark = pytest.mark.wires

WITHIN_S = 1.0
LIMITS = Limits(ramp_v_per_s=8000.0)


@pytest.fixture
def virtual(tmp_path):
    with VirtualInstruments(tmp_path / "bench", time_scale=30.0) as instruments:
        yield instruments


@pytest.fixture
def log(tmp_path):
    return tmp_path / "safety.jsonl"


@pytest.fixture
def bench(virtual, log):
    return open_bench(Wires(gate_port=virtual.gate_port, supply_port=virtual.supply_port), LIMITS, log=log)


def run_until_failure(bench, provoked) -> float:
    """Set the bench up, provoke a fault, and look at the bench as acquisition does; when it was provoked, s."""
    with bench:
        bench.set_conditions(Conditions(mcp_v=800.0, gate_ns=1.6e7))
        bench.check()
        run_until_failure.since_s = time.monotonic()
        provoked()
        while time.monotonic() < run_until_failure.since_s + 5.0:
            time.sleep(0.02)
            bench.check()
        raise AssertionError("the fault was never told")


def ordered_s(log, step: str) -> float:
    """When a step of the safe action went out, s after the fault."""
    events = [json.loads(line) for line in log.read_text().splitlines()]
    return next(each["monotonic_s"] for each in events if each["event"] == step) - run_until_failure.since_s


def assert_one_sentence(error: BaseException, rule: str) -> None:
    assert rule in str(error)
    assert "\n" not in str(error)


def test_a_silent_gate_line_ends_the_work_and_the_voltage_goes_within_a_second(bench, virtual, log):
    with pytest.raises(InstrumentTimeout) as end:
        run_until_failure(bench, lambda: provoke(virtual.folder, "delay_generator", Faults(silent=True)))
    assert_one_sentence(end.value, "the delay generator must answer TSRC? within 0.4 s, got nothing")
    assert ordered_s(log, "high voltage: HVOF") < WITHIN_S
    assert read_outputs(virtual.folder).mcp_v < 11
    assert "the gate may be open" in end.value.__notes__[0]


def test_a_silent_supply_ends_the_work_and_the_gate_is_shut_within_a_second(bench, virtual, log):
    with pytest.raises(InstrumentTimeout) as end:
        run_until_failure(bench, lambda: provoke(virtual.folder, "high_voltage", Faults(silent=True)))
    assert_one_sentence(end.value, "the high-voltage supply must answer *STB? within 0.4 s, got nothing")
    assert ordered_s(log, "gate: TSRC 5") < WITHIN_S
    assert not read_outputs(virtual.folder).gate_open
    assert "ordered off but not verified" in end.value.__notes__[0]


def test_a_supply_that_obeys_but_does_not_answer_is_off_all_the_same(bench, virtual, log):
    with pytest.raises(InstrumentTimeout):
        run_until_failure(bench, lambda: provoke(virtual.folder, "high_voltage", Faults(mute=True)))
    assert ordered_s(log, "high voltage: HVOF") < WITHIN_S
    assert read_outputs(virtual.folder).mcp_v < 11


def test_a_trip_ends_the_work_with_everything_verified_safe(bench, virtual, log):
    with pytest.raises(InstrumentTripped) as end:
        run_until_failure(bench, lambda: provoke(virtual.folder, "high_voltage", Faults(tripped=True)))
    assert_one_sentence(end.value, "the high-voltage supply must stay on, got a trip on current")
    assert ordered_s(log, "gate: TSRC 5") < WITHIN_S
    assert ordered_s(log, "high voltage: HVOF") < WITHIN_S
    assert not read_outputs(virtual.folder).gate_open
    assert not hasattr(end.value, "__notes__")


@pytest.mark.parametrize("instrument", ["delay_generator", "high_voltage"])
def test_an_unplugged_instrument_ends_the_work_and_the_other_is_made_safe(bench, virtual, log, instrument):
    with pytest.raises(InstrumentDisconnected) as end:
        run_until_failure(bench, lambda: virtual.unplug(instrument))
    assert_one_sentence(end.value, "must stay on")
    out = read_outputs(virtual.folder)
    if instrument == "delay_generator":
        assert ordered_s(log, "high voltage: HVOF") < WITHIN_S
        assert out.mcp_v < 11
    else:
        assert ordered_s(log, "gate: TSRC 5") < WITHIN_S
        assert not out.gate_open


def test_answers_that_come_late_end_the_work_but_the_line_gets_into_step_to_verify(bench, virtual, log):
    def late() -> None:
        provoke(virtual.folder, "delay_generator", Faults(late_s=0.5))
        time.sleep(0.7)
        provoke(virtual.folder, "delay_generator", Faults())

    with pytest.raises(InstrumentTimeout):
        run_until_failure(bench, late)
    assert ordered_s(log, "high voltage: HVOF") < WITHIN_S
    assert not read_outputs(virtual.folder).gate_open


def test_a_port_that_is_missing_is_told_at_once(virtual, log):
    bench = open_bench(Wires(gate_port=virtual.gate_port, supply_port="/dev/no-such-port"), LIMITS, log=log)
    with (
        pytest.raises(InstrumentDisconnected, match="the port /dev/no-such-port of the high-voltage supply must"),
        bench,
    ):
        pass


def test_a_port_in_use_is_told_at_once(bench, virtual, log, tmp_path):
    second = open_bench(
        Wires(gate_port=virtual.gate_port, supply_port=virtual.supply_port), LIMITS, log=tmp_path / "second.jsonl"
    )
    with bench:
        bench.set_conditions(Conditions(mcp_v=300.0, gate_ns=1e6))
        with pytest.raises(InstrumentDisconnected, match="must be free to open"), second:
            pass
        bench.check()
        assert read_outputs(virtual.folder).gate_open


def test_swapped_cables_are_noticed_before_anything_is_switched_on(virtual, log):
    bench = open_bench(Wires(gate_port=virtual.supply_port, supply_port=virtual.gate_port), LIMITS, log=log)
    with pytest.raises(BenchError), bench:
        pass
    assert read_outputs(virtual.folder).mcp_v == 0


def test_a_client_that_talks_nonsense_to_its_watchdog_is_made_safe_from(bench, virtual, log):
    with pytest.raises(BenchServerLost), bench:
        bench.set_conditions(Conditions(mcp_v=300.0, gate_ns=1e6))
        bench._reach.guard._connection.sendall(b"nonsense\n")
        while True:
            time.sleep(0.02)
            bench.check()
    assert "the watchdog itself failed" in log.read_text()
    assert not read_outputs(virtual.folder).gate_open
    assert read_outputs(virtual.folder).mcp_v < 11


def test_a_log_that_cannot_be_written_is_told_before_anything_is_opened(virtual, tmp_path):
    wires = Wires(gate_port=virtual.gate_port, supply_port=virtual.supply_port)
    with pytest.raises(BadInput, match="must be a file that can be written"), open_bench(wires, LIMITS, log=tmp_path):
        pass
