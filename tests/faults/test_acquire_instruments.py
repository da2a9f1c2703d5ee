"""Whatever fails in mid-run, the run ends in one sentence, the tube is safe within a second, and the frames stay."""

import importlib.util
import os
import signal
import time
from pathlib import Path

import pytest

from labdata.session import open_session
from simulate.rig import aravis_library
from simulate.rig.faults import Faults, provoke
from simulate.rig.outputs import read_outputs

_spec = importlib.util.spec_from_file_location("killing", Path(__file__).with_name("test_acquire_kill.py"))
killing = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(killing)

pytestmark = [
    pytest.mark.wires,
    pytest.mark.aravis,
    pytest.mark.skipif(not aravis_library.is_available(), reason="the Aravis library is not on this machine"),
]


def kill_camera(client, wires):
    pid = next(int(line.split("=")[1]) for line in client.told() if line.startswith("pids "))
    os.kill(pid, signal.SIGKILL)


def silence_gate(client, wires):
    provoke(wires, "delay_generator", Faults(silent=True))


def silence_supply(client, wires):
    provoke(wires, "high_voltage", Faults(silent=True))


def trip_supply(client, wires):
    provoke(wires, "high_voltage", Faults(tripped=True))


@pytest.mark.parametrize(
    ("fault", "sentence", "gate_can_shut"),
    [
        (kill_camera, "has gone", True),
        (silence_gate, "delay generator", False),
        (silence_supply, "high-voltage supply", True),
        (trip_supply, "high-voltage supply", True),
    ],
)
def test_a_fault_in_mid_run_ends_in_one_sentence_with_the_tube_safe(tmp_path, fault, sentence, gate_can_shut):
    killing.write_plan(tmp_path, frames=200)
    client = killing.Client(tmp_path, resume=False)
    client.wait_for_bench()
    while client.process.poll() is None and client.acknowledged().get("dark", 0) < 10:
        time.sleep(0.02)
    wires = client.wires()
    assert read_outputs(wires).gate_open
    failed_s = time.time()
    fault(client, wires)
    if gate_can_shut:
        assert killing.seconds_until_shut(wires, failed_s) < killing.SAFE_WITHIN_S + 0.2
    off_s = killing.seconds_until_ordered_off(tmp_path / "bench" / "safety.jsonl", failed_s)
    assert off_s < killing.SAFE_WITHIN_S + 0.2
    assert client.process.wait(timeout=60.0) == 1
    said = [line for line in client.told() if sentence in line]
    assert len(said) == 1
    assert client.told()[-1] == said[0], "the sentence must be the last word, without a traceback"
    stack = open_session(client.session).stack("dark")
    assert len(stack.read()) >= client.acknowledged()["dark"]
    assert not stack.finished
