"""A bench that cannot be opened says why in one sentence, with nothing switched on."""

import threading
import time

import pytest

from drivers.bench.local_bench import open_bench
from drivers.errors import BenchError, BenchServerLost, InstrumentDisconnected
from labdata import BadInput, Conditions, InstrumentConfig, Limits
from simulate.virtual_bench.outputs import read_outputs
from simulate.virtual_bench.process import VirtualInstruments

pytestmark = pytest.mark.wires

LIMITS = Limits(ramp_v_per_s=8000.0)


@pytest.fixture
def virtual(tmp_path):
    with VirtualInstruments(tmp_path / "bench", time_scale=30.0) as instruments:
        yield instruments


@pytest.fixture
def log(tmp_path):
    return tmp_path / "safety.jsonl"


def ends(server) -> bool:
    """Whether a bench server ends by itself, so that the next run finds its ports free."""
    return server.process.wait(20.0) == 0


@pytest.fixture
def bench(virtual, log):
    return open_bench(
        InstrumentConfig(gate_port=virtual.gate_port, supply_port=virtual.supply_port),
        LIMITS,
        log=log,
    )


def test_a_port_that_is_missing_is_told_at_once(virtual, log):
    bench = open_bench(
        InstrumentConfig(gate_port=virtual.gate_port, supply_port="/dev/no-such-port"),
        LIMITS,
        log=log,
    )
    with (
        pytest.raises(
            InstrumentDisconnected,
            match="the port /dev/no-such-port of the high-voltage supply must",
        ),
        bench,
    ):
        pass
    assert ends(bench)


def test_a_port_in_use_is_told_at_once(bench, virtual, log, tmp_path):
    second = open_bench(
        InstrumentConfig(gate_port=virtual.gate_port, supply_port=virtual.supply_port),
        LIMITS,
        log=tmp_path / "second.jsonl",
    )
    ends = []

    def enter() -> None:
        with pytest.raises(InstrumentDisconnected) as end, second:
            pass
        ends.append(str(end.value))

    with bench:
        bench.set_conditions(Conditions(mcp_v=300.0, gate_ns=1e6))
        refused = threading.Thread(target=enter, daemon=True)
        refused.start()
        while refused.is_alive():
            time.sleep(0.05)
            bench.check()
        assert read_outputs(virtual.folder).gate_open
    assert "must be free to open" in ends[0]


def test_swapped_cables_are_noticed_before_anything_is_switched_on(virtual, log):
    bench = open_bench(
        InstrumentConfig(gate_port=virtual.supply_port, supply_port=virtual.gate_port),
        LIMITS,
        log=log,
    )
    with pytest.raises(BenchError), bench:
        pass
    assert read_outputs(virtual.folder).mcp_v == 0
    assert ends(bench)


def test_a_client_that_talks_nonsense_to_its_server_loses_it_with_the_tube_safe(
    bench, virtual, log
):
    with pytest.raises(BenchServerLost), bench:
        bench.set_conditions(Conditions(mcp_v=300.0, gate_ns=1e6))
        bench._server._socket.send(b"nonsense")
        until_s = time.monotonic() + 5.0
        while time.monotonic() < until_s:
            time.sleep(0.02)
            bench.check()
    assert "the server itself failed" in log.read_text()
    assert not read_outputs(virtual.folder).gate_open
    assert read_outputs(virtual.folder).mcp_v < 11


def test_a_log_that_cannot_be_written_is_told_before_anything_is_opened(virtual, tmp_path):
    wires = InstrumentConfig(gate_port=virtual.gate_port, supply_port=virtual.supply_port)
    with (
        pytest.raises(BadInput, match="must be a file that can be written"),
        open_bench(wires, LIMITS, log=tmp_path),
    ):
        pass
