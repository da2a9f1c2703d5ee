"""A script of faults strikes at its times and at its steps, heals what is over, and strikes nothing
twice.
"""

import time

import pytest

from labdata import BadInput, EventLog, from_mapping
from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.rehearsal import FaultScript, Rehearsal, ScriptedFault


class Bench:
    """Notes which faults each instrument was given."""

    def __init__(self) -> None:
        self.given: dict[str, list[Faults]] = {}

    def provoke(self, instrument: str, faults: Faults) -> None:
        self.given.setdefault(instrument, []).append(faults)

    def await_faults(self, instrument: str, faults: Faults) -> None:
        until_s = time.monotonic() + 3.0
        while self.given[instrument][-1] != faults:
            assert time.monotonic() < until_s, self.given[instrument]
            time.sleep(0.005)


def rehearsal(bench, folder, *strikes) -> Rehearsal:
    script = FaultScript(fault=strikes)
    return Rehearsal(
        script, provoke=bench.provoke, steps=folder / "log.jsonl", log=folder / "rehearsal.jsonl"
    )


@pytest.fixture
def closing_after():
    logs = []
    yield lambda log: logs.append(log) or log
    for log in logs:
        log.close()


def test_a_fault_strikes_when_its_step_begins_holds_its_time_and_is_healed(tmp_path, closing_after):
    bench, log = Bench(), closing_after(EventLog(tmp_path / "log.jsonl"))
    log("step begins", step="late")  # of an earlier run: it says nothing of this one
    log.flush()
    late = ScriptedFault(
        instrument="high_voltage", kind="late answers", value=0.3, at_step="late", for_s=0.15
    )
    with rehearsal(bench, tmp_path, late):
        time.sleep(0.1)
        assert bench.given["high_voltage"] == [Faults()]
        log("step begins", step="late")
        bench.await_faults("high_voltage", Faults(late_s=0.3))
        struck_s = time.monotonic()
        bench.await_faults("high_voltage", Faults())
        assert 0.1 < time.monotonic() - struck_s < 1.0


def test_faults_that_meet_hold_together_and_a_power_cycle_is_once(tmp_path):
    bench = Bench()
    mute = ScriptedFault(instrument="delay_generator", kind="no answers", for_s=0.3)
    cycle = ScriptedFault(instrument="delay_generator", kind="power cycle", at_s=0.1, for_s=0.05)
    with rehearsal(bench, tmp_path, mute, cycle):
        bench.await_faults("delay_generator", Faults(mute=True, power_cycles=1))
        bench.await_faults("delay_generator", Faults(power_cycles=1))


def test_leaving_heals_and_a_resumed_run_goes_on_with_what_has_not_struck(tmp_path):
    first = ScriptedFault(instrument="camera", kind="stalled camera", for_s=60.0)
    second = ScriptedFault(instrument="camera", kind="packet loss", value=0.1, at_s=0.3)
    bench = Bench()
    with rehearsal(bench, tmp_path, first, second):
        bench.await_faults("camera", Faults(stalled=True))
    assert bench.given["camera"][-1] == Faults()
    bench = Bench()
    with rehearsal(bench, tmp_path, first, second):
        bench.await_faults("camera", Faults(lost_packet_share=0.1))
    assert Faults(stalled=True) not in bench.given["camera"]


@pytest.mark.parametrize(
    ("fault", "rule"),
    [
        ({"instrument": "camera", "kind": "garbage"}, "a camera must suffer one of packet loss"),
        (
            {"instrument": "high_voltage", "kind": "clock jump", "value": 1.0},
            "a camera must suffer one of packet loss",
        ),
        (
            {"instrument": "delay_generator", "kind": "trip"},
            "must be of high_voltage or light_source, got trip of",
        ),
        (
            {"instrument": "high_voltage", "kind": "no triggers"},
            "must be of delay_generator, got no triggers of",
        ),
        (
            {"instrument": "surroundings", "kind": "silence"},
            "the surroundings must suffer room light",
        ),
        (
            {"instrument": "delay_generator", "kind": "front panel"},
            "panel must hold commands for a front panel",
        ),
        (
            {"instrument": "surroundings", "kind": "room light"},
            "value must be given for late answers",
        ),
        (
            {"instrument": "high_voltage", "kind": "late answers"},
            "value must be given for late answers",
        ),
        (
            {"instrument": "camera", "kind": "packet loss", "value": 1.5},
            "must lie between 0 and 1, got 1.5",
        ),
        ({"instrument": "high_voltage", "kind": "sabotage"}, "sabotage"),
        (
            {"instrument": "high_voltage", "kind": "garbage", "for_s": 0.0},
            "strike at 0 s or later for some time",
        ),
    ],
)
def test_a_script_that_makes_no_sense_is_refused_in_a_sentence(fault, rule):
    with pytest.raises(BadInput, match=rule):
        from_mapping({"fault": [fault]}, FaultScript, where="faults.toml")
