"""Whatever becomes of the program at the bench, the process that outlives it puts the lamp out
within a second.
"""

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

from drivers.bench.client import BenchClient
from drivers.bench.local_bench import open_bench
from drivers.bench.tube_bench import TubeBench
from drivers.errors import BenchError
from drivers.interface import Bench, FrameLevels
from labdata import Conditions, InstrumentConfig, LampCalibration, Limits, Target, read_events
from simulate.virtual_bench.faults import Faults, inject_faults
from simulate.virtual_bench.outputs import VirtualOperator, read_outputs
from simulate.virtual_bench.process import VirtualInstruments

pytestmark = pytest.mark.wires

WITHIN_S = 1.0
LAMP = LampCalibration(
    source="photometer",
    current_a=(0.01, 1.0),
    illuminance_lux=(1e-2, 1.0),
    relative_sd=(0.03, 0.03),
    filter_density=(0.0, 1.0, 2.0, 3.0, 4.0, 5.0),
)
CLIENT = """
    import sys, time
    from pathlib import Path
    sys.path.insert(0, {root!r})
    from tests.faults.test_serial_lamp import bench_at, light_up
    with bench_at(Path(sys.argv[1]), Path(sys.argv[2])) as bench:
        light_up(bench, Path(sys.argv[1]))
        print("lit", flush=True)
        while True:
            time.sleep(0.02)
            bench.check()
"""


def bench_at(folder: Path, log: Path) -> BenchClient | TubeBench:
    wires = InstrumentConfig(
        gate_port=f"{folder}/delay_generator",
        supply_port=f"{folder}/high_voltage",
        light="dc2100",
        light_port=f"{folder}/light_source",
        wheel="fw102c",
        wheel_port=f"{folder}/filter_wheel",
    )
    return open_bench(wires, Limits(ramp_v_per_s=8000.0), log=log, lamp=LAMP)


def light_up(bench: Bench, folder: Path) -> None:
    light = bench.guard(VirtualOperator(folder))
    light.place(kind="flat", target=Target(), illuminance_lux=0.0)
    bench.set_conditions(Conditions(mcp_v=700.0, gate_ns=1.6e7))
    bench.dark_frame_seen(FrameLevels.of(np.full((4, 6), 12, np.uint8), 255.0))
    light.place(kind="flat", target=Target(), illuminance_lux=1e-4)


@pytest.fixture(scope="module")
def virtual(tmp_path_factory):
    models = ("dg645", "ps350", "dc2100", "fw102c")
    folder = tmp_path_factory.mktemp("bench")
    with VirtualInstruments(folder, models=models, time_scale=10.0) as instruments:
        yield instruments


@pytest.fixture
def log(tmp_path):
    return tmp_path / "safety.jsonl"


def seconds_until_dark(virtual, since_s: float) -> float:
    """Time until lamp and gate are out and shut, s."""
    while (out := read_outputs(virtual.folder)).lamp_a or out.gate_open:
        assert time.monotonic() - since_s < 10.0
        time.sleep(0.005)
    return time.monotonic() - since_s


def await_end(log: Path) -> None:
    deadline_s = time.monotonic() + 20.0
    while read_events(log)[-1]["event"] not in ("end", "made safe"):
        assert time.monotonic() < deadline_s
        time.sleep(0.05)


@pytest.mark.parametrize("killed", ["client", "server"])
def test_a_kill_puts_the_lamp_out_within_a_second(virtual, log, killed):
    root = str(Path(__file__).parents[2])
    client = subprocess.Popen(
        [
            sys.executable,
            "-c",
            textwrap.dedent(CLIENT.format(root=root)),
            str(virtual.folder),
            str(log),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        assert client.stdout is not None and client.stdout.readline() == "lit\n"
        assert read_outputs(virtual.folder).lamp_a == pytest.approx(1.0)
        killed_s = time.monotonic()
        os.kill(client.pid if killed == "client" else read_events(log)[0]["pid"], signal.SIGKILL)
        assert seconds_until_dark(virtual, killed_s) < WITHIN_S
        await_end(log)
    finally:
        client.kill()
        client.communicate()


@pytest.mark.parametrize("struck", ["filter_wheel"])
def test_an_instrument_that_falls_silent_ends_the_work_and_whatever_hears_is_made_safe(
    virtual, log, struck
):
    with pytest.raises(BenchError, match="must answer"), bench_at(virtual.folder, log) as bench:
        light_up(bench, virtual.folder)
        inject_faults(virtual.folder, struck, Faults(mute=True))
        struck_s = time.monotonic()
        while time.monotonic() < struck_s + 5.0:
            time.sleep(0.02)
            bench.check()
    inject_faults(virtual.folder, struck, Faults())
    told = {
        each["event"]: each["monotonic_s"] - struck_s
        for each in read_events(log)
        if "monotonic_s" in each
    }
    # The answer is waited for as long as an answer may take; then everything goes at once.
    assert told["light: o 0"] - told["making safe"] < WITHIN_S
    out = read_outputs(virtual.folder)
    assert (out.lamp_a, out.gate_open) == (0.0, False) and out.mcp_v < 11.0
