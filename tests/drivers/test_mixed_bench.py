"""Real and virtual instruments stand at one bench: an instrument whose port is named is real, the
rest is virtual.
"""

import pytest

from drivers.bench.local_bench import open_bench
from labdata import BadInput, Conditions, InstrumentConfig, Limits, load_sensor
from simulate.virtual_bench import aravis_library
from simulate.virtual_bench.bench import VirtualBench
from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.process import VirtualInstruments

pytestmark = pytest.mark.wires


@pytest.fixture
def somewhere_else(tmp_path):
    """An instrument that is no part of the virtual bench, as a real one at its own port."""
    with VirtualInstruments(tmp_path / "real", models=("ctc100",)) as instruments:
        yield instruments.port("thermometer")


def test_a_real_thermometer_is_read_next_to_a_virtual_tube(somewhere_else, tmp_path, monkeypatch):
    # the camera has no part in this
    monkeypatch.setattr(aravis_library, "is_available", lambda: False)
    told: list[str] = []
    wires = InstrumentConfig(thermometer="ctc100", thermometer_port=somewhere_else)
    with VirtualBench(
        tmp_path / "bench",
        load_sensor("pulnix-ag5745ef3"),
        3,
        wires=wires,
        time_scale=20.0,
        say=told.append,
    ) as virtual:
        assert virtual.wires.thermometer_port == somewhere_else
        assert str(virtual.wires.gate_port).startswith(str(tmp_path / "bench"))
        assert any("the thermometer is a real ctc100" in sentence for sentence in told)
        with open_bench(virtual.wires, Limits(ramp_v_per_s=8000.0), log=tmp_path / "log") as bench:
            bench.set_conditions(Conditions(mcp_v=200.0, gate_ns=1e6))
            read, silent = bench.read_meters()
            assert (read.temperature_c, silent) == (pytest.approx(23.4), ())
            assert virtual.outputs().gate_open
        with pytest.raises(BadInput, match="on the wires of this bench, got thermometer"):
            virtual.provoke("thermometer", Faults(silent=True))
