"""Client and server of a bench, starved of what processes need: where one is killed, the other
makes safe.
"""

import json
import os
import resource
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivers.bench.bare_ports import make_bench_safe
from drivers.bench.connection import SchedulingDelay
from labdata import InstrumentConfig
from simulate.virtual_bench.faults import Faults, inject_faults
from simulate.virtual_bench.outputs import GATE_FILE, read_outputs
from simulate.virtual_bench.process import VirtualInstruments

pytestmark = pytest.mark.wires

WITHIN_S, BACK_WITHIN_S = 1.0, 2.0
LOOK_S = 0.005
PATIENCE_S = 20.0  # until something happens at all
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


@pytest.fixture(scope="module", autouse=True)
def delay():
    """How late this machine schedules a process that sleeps, measured all the time."""
    measured, over = SchedulingDelay(lambda *_, **__: None, time.monotonic), threading.Event()

    def measure() -> None:
        while not over.is_set():
            slept_s = time.monotonic()
            time.sleep(LOOK_S)
            measured.take(time.monotonic() - slept_s - LOOK_S)

    thread = threading.Thread(target=measure)
    thread.start()
    yield measured
    over.set()
    thread.join()


def await_that(condition: Callable[[], bool]) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < until_s
        time.sleep(LOOK_S)


def await_safe(virtual) -> None:
    """Wait until the gate is shut and the voltage falls."""
    highest_v = 0.0

    def is_safe() -> bool:
        nonlocal highest_v
        out = read_outputs(virtual.folder)
        highest_v = max(highest_v, out.mcp_v)
        return not out.gate_open and out.mcp_v < highest_v

    await_that(is_safe)


@contextmanager
def in_time(delay: SchedulingDelay, what: str, limit_s: float = WITHIN_S):
    """Require the block to take no longer than its limit, which grows as those of the bench do."""
    began_s = time.monotonic()
    yield
    took_s, slack_s = time.monotonic() - began_s, delay.slack_s()
    print(f"{what} after {took_s:.2f} s, slack {slack_s:.2f} s")
    assert took_s < limit_s + slack_s


def open_gate_by_hand(virtual) -> None:
    """Open the gate at its panel, and wait until it was open: it may be shut again by then."""
    inject_faults(virtual.folder, "delay_generator", Faults())
    time.sleep(0.1)  # what is new at a panel is done
    before = (virtual.folder / GATE_FILE).stat().st_mtime_ns
    inject_faults(virtual.folder, "delay_generator", Faults(panel=("LOFF 1,2",)))
    await_that(lambda: (virtual.folder / GATE_FILE).stat().st_mtime_ns != before)


@pytest.mark.parametrize("of", [*STARVED, "everything"])
@pytest.mark.parametrize("killed", ["client", "server"])
def test_a_starved_process_makes_safe_within_a_second_of_the_death_of_the_other(
    virtual, pair, tmp_path, delay, killed, of
):
    client, server_pid = pair
    assert read_outputs(virtual.folder).gate_open
    for pid in (client.pid, server_pid):
        for limit, most in STARVED.values() if of == "everything" else [STARVED[of]]:
            resource.prlimit(pid, limit, (most, most))
    time.sleep(0.3)
    assert read_outputs(virtual.folder).gate_open
    with in_time(delay, f"{killed} killed, both starved of {of}: safe"):
        os.kill(client.pid if killed == "client" else server_pid, signal.SIGKILL)
        await_safe(virtual)
    await_that(lambda: read_outputs(virtual.folder).mcp_v <= 11.0)
    if killed == "client":
        events = [json.loads(line) for line in (tmp_path / "safety.jsonl").read_text().splitlines()]
        assert "the client is gone" in [event.get("reason") for event in events]


def test_the_server_stands_guard_until_silent_instruments_answer(virtual, pair, tmp_path, delay):
    for instrument in ("delay_generator", "high_voltage"):
        inject_faults(virtual.folder, instrument, Faults(silent=True))
    pair[0].kill()
    time.sleep(5.0)  # longer than the attempts of one safe action
    assert read_outputs(virtual.folder).gate_open
    with in_time(delay, "instruments answer: safe", BACK_WITHIN_S):
        for instrument in ("delay_generator", "high_voltage"):
            inject_faults(virtual.folder, instrument, Faults())
        await_safe(virtual)
    while '"end"' not in (log := (tmp_path / "safety.jsonl").read_text()):
        time.sleep(0.1)
    assert "standing guard" in log


@pytest.mark.parametrize("pair", [HUNG], indirect=True)
@pytest.mark.parametrize("is_server_killed", [True, False])
def test_a_gate_opened_by_hand_is_shut_again_while_a_run_hangs(
    virtual, pair, delay, is_server_killed
):
    if is_server_killed:
        os.kill(pair[1], signal.SIGKILL)
    await_safe(virtual)
    time.sleep(2.0)  # until the safe action is over
    open_gate_by_hand(virtual)
    with in_time(delay, "gate opened: shut"):
        await_that(lambda: not read_outputs(virtual.folder).gate_open)
    inject_faults(virtual.folder, "delay_generator", Faults())


@pytest.mark.parametrize("client_lives", [True, False])
def test_ports_that_come_back_swapped_are_told_apart_by_who_answers(
    virtual, pair, delay, client_lives
):
    silent, gone = Faults(silent=True), Faults(silent=True, unplugged=True)
    instruments = ("delay_generator", "high_voltage")
    swapped = [Faults(port_name=name) for name in instruments[::-1]]
    for faults in ([silent] * 2, [gone] * 2, swapped, [gone] * 2, [Faults()] * 2):
        for instrument, fault in zip(instruments, faults, strict=True):
            inject_faults(virtual.folder, instrument, fault)
        if faults is swapped:
            assert read_outputs(virtual.folder).gate_open
            with in_time(delay, f"client lives: {client_lives}, ports back: safe", BACK_WITHIN_S):
                await_safe(virtual)
        elif not client_lives:
            pair[0].kill()
        time.sleep(0.1)


def test_what_is_at_hand_is_followed_while_ports_alone_are_made_safe(virtual, delay):
    wires = InstrumentConfig(gate_port=virtual.gate_port, supply_port=virtual.supply_port)
    inject_faults(virtual.folder, "high_voltage", Faults(unplugged=True))
    with ThreadPoolExecutor(1) as pool:
        report = pool.submit(make_bench_safe, wires, lambda *_, **__: None)
        time.sleep(1.0)
        for _ in range(2):
            open_gate_by_hand(virtual)
            with in_time(delay, "gate opened: shut"):
                await_that(lambda: not read_outputs(virtual.folder).gate_open)
        for instrument in ("delay_generator", "high_voltage"):
            inject_faults(virtual.folder, instrument, Faults())
        assert report.result(30.0).whole


def test_the_manual_steps_are_said_within_a_second_of_the_loss_of_a_port(virtual, pair, delay):
    with in_time(delay, "port lost: said"):
        inject_faults(virtual.folder, "delay_generator", Faults(unplugged=True))
        words = pair[0].stderr.readline()
    assert "may be open, " in words and "by hand, now" in words
    with in_time(delay, "port back: safe", BACK_WITHIN_S):
        inject_faults(virtual.folder, "delay_generator", Faults())
        await_safe(virtual)
