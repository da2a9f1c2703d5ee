"""Whatever becomes of the program at the bench, a process that outlives it shuts gate and voltage within a second."""

import itertools
import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from simulate.rig.faults import Faults, provoke
from simulate.rig.outputs import read_outputs
from simulate.rig.process import VirtualInstruments

pytestmark = pytest.mark.wires

WITHIN_S = 1.0
CLIENT = """
    import sys, time
    from drivers.bench.setup import open_bench
    from labdata import Conditions
    from labdata.limits import Limits
    from labdata.wires import Wires
    gate, supply, log, step, then = sys.argv[1:]
    with open_bench(Wires(gate_port=gate, supply_port=supply), Limits(ramp_v_per_s=float(step)), log=log) as bench:
        print("open", flush=True)
        bench.set_conditions(Conditions(mcp_v=800.0, gate_ns=1.6e7))
        print("set", flush=True)
        while True:
            time.sleep(60.0 if then == "wait" else 0.02)
            bench.check()
"""


@pytest.fixture(scope="module")
def virtual(tmp_path_factory):
    with VirtualInstruments(tmp_path_factory.mktemp("bench"), time_scale=10.0) as instruments:
        yield instruments


@pytest.fixture
def log(tmp_path):
    return tmp_path / "safety.jsonl"


@pytest.fixture
def started(virtual, log):
    """Start a client, up to the word that it says; none is left behind."""
    clients = []

    def start(*, ramp_v_per_s: float = 8000.0, until: str = "set", then: str = "look") -> subprocess.Popen:
        arguments = [virtual.gate_port, virtual.supply_port, str(log), str(ramp_v_per_s), then]
        client = subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(CLIENT), *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        clients.append(client)
        assert client.stdout is not None
        for line in client.stdout:
            if line.strip() == until:
                return client
        raise AssertionError(client.communicate()[1])

    yield start
    for client in clients:
        client.kill()
        client.communicate()


def ended(client: subprocess.Popen) -> str:
    """What the client said on its error output, at its end."""
    return client.communicate(timeout=20)[1]


def events(log: Path) -> list[dict]:
    return [json.loads(line) for line in log.read_text().splitlines()]


def awaited(log: Path, event: str) -> dict:
    deadline_s = time.monotonic() + 20
    while time.monotonic() < deadline_s:
        if log.exists() and (found := [each for each in events(log) if each["event"] == event]):
            return found[0]
        time.sleep(0.02)
    raise AssertionError(f"{event!r} never came in {[each['event'] for each in events(log)]}")


def seconds_until_safe(virtual, since_s: float) -> float:
    """Time until the wires show a shut gate and a falling voltage, s."""
    high_v = read_outputs(virtual.folder).mcp_v
    while True:
        out = read_outputs(virtual.folder)
        if not out.gate_open and out.mcp_v < high_v:
            return time.monotonic() - since_s
        high_v = max(high_v, out.mcp_v)
        assert time.monotonic() - since_s < 10
        time.sleep(0.005)


def assert_followed_down(virtual, log: Path) -> None:
    end = awaited(log, "end")
    volts = [each["result"] for each in events(log) if each["event"] == "high voltage: VOUT?"]
    assert len(volts) >= 3
    assert all(after <= before for before, after in itertools.pairwise(volts))
    assert volts[-1] <= 10
    assert awaited(log, "made safe")["whole"]
    assert read_outputs(virtual.folder).mcp_v < 11
    deadline_s = time.monotonic() + 5
    while Path(f"/proc/{awaited(log, 'start')['pid']}").exists():
        assert time.monotonic() < deadline_s, f"the watchdog must end after {end}"
        time.sleep(0.02)


def test_a_killed_client_leaves_gate_shut_and_voltage_falling_within_a_second(virtual, log, started):
    client = started()
    assert read_outputs(virtual.folder).gate_open
    killed_s = time.monotonic()
    client.kill()
    assert seconds_until_safe(virtual, killed_s) < WITHIN_S
    ordered = [awaited(log, event)["monotonic_s"] for event in ("gate: TSRC 5", "high voltage: HVOF")]
    assert max(ordered) - killed_s < WITHIN_S
    assert awaited(log, "making safe")["reason"] == "the client is gone"
    assert_followed_down(virtual, log)


def test_a_client_killed_while_the_voltage_rises_is_seen_to_as_well(virtual, log, started):
    client = started(ramp_v_per_s=400, until="open")
    while read_outputs(virtual.folder).mcp_v < 200:
        time.sleep(0.01)
    killed_s = time.monotonic()
    client.kill()
    assert seconds_until_safe(virtual, killed_s) < WITHIN_S
    assert_followed_down(virtual, log)


def test_a_client_that_hangs_shows_no_sign_of_life_and_is_not_waited_for(virtual, log, started):
    client = started()
    stopped_s = time.monotonic()
    client.send_signal(signal.SIGSTOP)
    assert seconds_until_safe(virtual, stopped_s) < WITHIN_S
    assert awaited(log, "making safe")["reason"].startswith("the client was silent for 0.")
    client.kill()
    assert_followed_down(virtual, log)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_unwinds_the_client_and_leaves_the_bench_safe(virtual, log, started, number):
    client = started()
    sent_s = time.monotonic()
    client.send_signal(number)
    assert seconds_until_safe(virtual, sent_s) < WITHIN_S
    ended(client)
    assert client.returncode == (128 + number if number == signal.SIGTERM else -number)
    assert awaited(log, "making safe")["reason"] == "the client leaves"
    assert_followed_down(virtual, log)


def test_the_watchdog_told_to_stop_makes_safe_first(virtual, log, started):
    client = started()
    told_s = time.monotonic()
    os.kill(awaited(log, "start")["pid"], signal.SIGTERM)
    assert seconds_until_safe(virtual, told_s) < WITHIN_S
    assert "BenchServerLost" in ended(client)
    assert_followed_down(virtual, log)


def test_a_client_whose_watchdog_was_killed_takes_the_ports_and_makes_safe_itself(virtual, log, started):
    client = started()
    killed_s = time.monotonic()
    os.kill(awaited(log, "start")["pid"], signal.SIGKILL)
    assert seconds_until_safe(virtual, killed_s) < WITHIN_S
    assert "BenchServerLost" in ended(client)
    assert awaited(log, "the watchdog is gone; its client makes the bench safe")
    assert read_outputs(virtual.folder).mcp_v < 11


def test_a_client_that_waits_for_something_else_takes_the_ports_all_the_same(virtual, log, started):
    client = started(then="wait")
    assert read_outputs(virtual.folder).gate_open
    killed_s = time.monotonic()
    os.kill(awaited(log, "start")["pid"], signal.SIGKILL)
    assert seconds_until_safe(virtual, killed_s) < WITHIN_S
    assert client.poll() is None, "it never looked at its bench"
    assert awaited(log, "the watchdog is gone; its client makes the bench safe")


def test_a_silent_supply_does_not_hold_up_the_gate_when_the_client_is_killed(virtual, log, started):
    client = started()
    provoke(virtual.folder, "high_voltage", Faults(silent=True))
    killed_s = time.monotonic()
    client.kill()
    while read_outputs(virtual.folder).gate_open:
        time.sleep(0.005)
    assert time.monotonic() - killed_s < WITHIN_S
    provoke(virtual.folder, "high_voltage", Faults())
    assert awaited(log, "made safe")["whole"]  # the order is repeated until the supply hears it again
