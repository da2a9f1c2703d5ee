"""Client and server of a bench, starved of what processes need: where one is killed, the other
makes safe.
"""

import json
import resource
import signal
import subprocess
import sys
import textwrap
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from drivers.bench.bare_ports import make_bench_safe
from labdata import InstrumentConfig
from simulate.virtual_bench.faults import Faults, inject_faults
from simulate.virtual_bench.outputs import read_outputs
from simulate.virtual_bench.process import VirtualInstruments

pytestmark = pytest.mark.wires

WITHIN_S = 1.0
CLIENT = """
    import sys, time
    from drivers.bench.local_bench import open_bench
    from labdata import Conditions
    from labdata.limits import Limits
    from labdata.instrument_config import InstrumentConfig
    gate, supply, log = sys.argv[1:]
    wires = InstrumentConfig(gate_port=gate, supply_port=supply)
    with open_bench(wires, Limits(ramp_v_per_s=8000.0), log=log) as bench:
        bench.set_conditions(Conditions(mcp_v=800.0, gate_ns=1.6e7))
        print(bench.process.pid, flush=True)
        while True:
            bench.check()
            time.sleep(0.02)
"""
HUNG = CLIENT.replace("bench.check()", "pass")
STARVED = {
    "descriptors": (resource.RLIMIT_NOFILE, 3),
    "threads": (resource.RLIMIT_NPROC, 0),
    "memory": (resource.RLIMIT_AS, 50 << 20),
}


@pytest.fixture(scope="module")
def virtual(tmp_path_factory):
    with VirtualInstruments(tmp_path_factory.mktemp("bench"), time_scale=10.0) as instruments:
        yield instruments


@pytest.fixture
def pair(virtual, tmp_path, request):
    """A client with a hot tube, and the process of its server; its ports are free at the end."""
    arguments = [virtual.gate_port, virtual.supply_port, str(tmp_path / "safety.jsonl")]
    program = getattr(request, "param", CLIENT)
    command = [sys.executable, "-c", textwrap.dedent(program), *arguments]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as client:
        assert client.stdout is not None and client.stderr is not None
        server_pid = client.stdout.readline()
        assert server_pid, client.stderr.read()
        yield client, int(server_pid)
        client.kill()
    deadline_s = time.monotonic() + 30.0
    while runs(int(server_pid)):
        assert time.monotonic() < deadline_s
        time.sleep(0.02)


def runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def ms_until_safe(virtual, since_s: float) -> float:
    high_v = read_outputs(virtual.folder).mcp_v
    while (out := read_outputs(virtual.folder)).gate_open or out.mcp_v >= high_v:
        high_v = max(high_v, out.mcp_v)
        assert time.monotonic() - since_s < 10.0
        time.sleep(0.005)
    return 1e3 * (time.monotonic() - since_s)


def ms_until_shut_after_opened_by_hand(virtual) -> float:
    inject_faults(virtual.folder, "delay_generator", Faults())
    time.sleep(0.1)  # what is new at a panel is done
    inject_faults(virtual.folder, "delay_generator", Faults(panel=("LOFF 1,2",)))
    opened_s = time.monotonic()
    while not read_outputs(virtual.folder).gate_open:
        assert time.monotonic() - opened_s < 0.5
    while read_outputs(virtual.folder).gate_open:
        assert time.monotonic() - opened_s < 10.0
    return 1e3 * (time.monotonic() - opened_s)


@pytest.mark.parametrize("of", [*STARVED, "everything"])
@pytest.mark.parametrize("killed", ["client", "server"])
def test_a_starved_process_makes_safe_within_a_second_of_the_death_of_the_other(
    virtual, pair, tmp_path, killed, of
):
    client, server_pid = pair
    assert read_outputs(virtual.folder).gate_open
    for pid in (client.pid, server_pid):
        for limit, most in STARVED.values() if of == "everything" else [STARVED[of]]:
            resource.prlimit(pid, limit, (most, most))
    time.sleep(0.3)
    assert read_outputs(virtual.folder).gate_open
    killed_s = time.monotonic()
    subprocess.run(
        ["kill", f"-{signal.SIGKILL.value}", str(client.pid if killed == "client" else server_pid)],
        check=True,
    )
    took_ms = ms_until_safe(virtual, killed_s)
    print(f"{killed} killed, both starved of {of}: safe after {took_ms:.0f} ms")
    assert took_ms < 1e3 * WITHIN_S
    deadline_s = time.monotonic() + 10.0
    while read_outputs(virtual.folder).mcp_v > 11.0:
        assert time.monotonic() < deadline_s
        time.sleep(0.02)
    if killed == "client":
        events = [json.loads(line) for line in (tmp_path / "safety.jsonl").read_text().splitlines()]
        assert "the client is gone" in [event.get("reason") for event in events]


def test_the_server_stands_guard_until_silent_instruments_answer(virtual, pair, tmp_path):
    for instrument in ("delay_generator", "high_voltage"):
        inject_faults(virtual.folder, instrument, Faults(silent=True))
    pair[0].kill()
    time.sleep(5.0)  # longer than the attempts of one safe action
    assert read_outputs(virtual.folder).gate_open
    for instrument in ("delay_generator", "high_voltage"):
        inject_faults(virtual.folder, instrument, Faults())
    assert ms_until_safe(virtual, time.monotonic()) < 2e3
    while '"end"' not in (log := (tmp_path / "safety.jsonl").read_text()):
        time.sleep(0.1)
    assert "standing guard" in log


@pytest.mark.parametrize("pair", [HUNG], indirect=True)
@pytest.mark.parametrize("is_server_killed", [True, False])
def test_a_gate_opened_by_hand_is_shut_again_while_a_run_hangs(virtual, pair, is_server_killed):
    if is_server_killed:
        subprocess.run(["kill", f"-{signal.SIGKILL.value}", str(pair[1])], check=True)
    ms_until_safe(virtual, time.monotonic())
    time.sleep(2.0)  # until the safe action is over
    assert ms_until_shut_after_opened_by_hand(virtual) < 1e3 * WITHIN_S
    inject_faults(virtual.folder, "delay_generator", Faults())


@pytest.mark.parametrize("client_lives", [True, False])
def test_ports_that_come_back_swapped_are_told_apart_by_who_answers(virtual, pair, client_lives):
    silent, gone = Faults(silent=True), Faults(silent=True, unplugged=True)
    instruments = ("delay_generator", "high_voltage")
    swapped = [Faults(port_name=name) for name in instruments[::-1]]
    for faults in ([silent] * 2, [gone] * 2, swapped, [gone] * 2, [Faults()] * 2):
        for instrument, fault in zip(instruments, faults, strict=True):
            inject_faults(virtual.folder, instrument, fault)
        if faults is swapped:
            assert read_outputs(virtual.folder).gate_open
            took_ms = ms_until_safe(virtual, time.monotonic())
            print(f"client lives: {client_lives}, safe {took_ms:.0f} ms after the ports are back")
            assert took_ms < 2e3
        elif not client_lives:
            pair[0].kill()
        time.sleep(0.1)


def test_what_is_at_hand_is_followed_while_ports_alone_are_made_safe(virtual):
    wires = InstrumentConfig(gate_port=virtual.gate_port, supply_port=virtual.supply_port)
    inject_faults(virtual.folder, "high_voltage", Faults(unplugged=True))
    with ThreadPoolExecutor(1) as pool:
        report = pool.submit(make_bench_safe, wires, lambda *_, **__: None)
        time.sleep(1.0)
        for _ in range(2):
            assert ms_until_shut_after_opened_by_hand(virtual) < 1e3 * WITHIN_S
        for instrument in ("delay_generator", "high_voltage"):
            inject_faults(virtual.folder, instrument, Faults())
        assert report.result(30.0).whole


def test_the_manual_steps_are_said_within_a_second_of_the_loss_of_a_port(virtual, pair):
    inject_faults(virtual.folder, "delay_generator", Faults(unplugged=True))
    lost_s = time.monotonic()
    assert "may be open, " in (words := pair[0].stderr.readline()) and "by hand, now" in words
    assert time.monotonic() - lost_s < WITHIN_S
    inject_faults(virtual.folder, "delay_generator", Faults())
    assert ms_until_safe(virtual, time.monotonic()) < 2e3
