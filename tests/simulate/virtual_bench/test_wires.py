"""The virtual instruments' wires behave as serial cables do, and a public driver library,
which never heard of this project, drives them.
"""

import importlib
import os
import subprocess
import sys
import textwrap
import time
import warnings

import pytest
import serial

from simulate.virtual_bench.outputs import read_outputs
from simulate.virtual_bench.process import VirtualInstruments
from simulate.virtual_bench.pseudo_terminal import PseudoTerminal

# The virtual instruments' wires behave as serial cables do.


pytestmark = pytest.mark.wires


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    with VirtualInstruments(tmp_path_factory.mktemp("bench")) as virtual:
        yield virtual


def asked(bench, question: bytes, *, baud: int = 9600, timeout_s: float = 0.5) -> bytes:
    with serial.Serial(bench.gate_port, baud, timeout=timeout_s) as port:
        port.write(question)
        return port.read_until(b"\r\n")


def test_the_line_does_not_echo(bench):
    assert asked(bench, b"TSRC?\n") == b"5\r\n"


def test_what_the_instrument_says_to_nobody_does_not_come_back_to_it(tmp_path):
    terminal = PseudoTerminal(tmp_path / "line", baud=None)
    terminal.write(b"5\r\n")
    assert terminal.read(0.1) == b""
    terminal.close()
    assert not (tmp_path / "line").is_symlink()


def test_an_instrument_outlives_its_clients(bench):
    for _ in range(3):
        assert asked(bench, b"LERR?\n") == b"0\r\n"


def test_a_wrong_baud_rate_turns_bytes_to_garbage(bench):
    assert b"Stanford" not in asked(bench, b"*IDN?\n", baud=19200)
    assert asked(bench, b"\n*CLS\n*IDN?\n").startswith(b"Stanford")


def test_answers_take_their_time_on_the_line(bench):
    began_s = time.monotonic()
    answer = asked(bench, b"*IDN?\n")
    assert time.monotonic() - began_s >= len(answer) * 10 / 9600


def test_unplugging_takes_the_port_away_and_leaves_the_voltage_on_until_it_is_plugged_in_again(
    tmp_path,
):
    with VirtualInstruments(tmp_path / "bench", time_scale=20) as virtual:
        with serial.Serial(virtual.supply_port, 9600, timeout=0.2) as port:
            port.write(b"++auto 0\n++eoi 1\n++addr 14\nVSET 300;HVON;*OPC?\n++read eoi\n")
            assert port.read_until(b"\n") == b"1\n"
            while read_outputs(virtual.folder).mcp_v < 300:
                time.sleep(0.01)
            virtual.unplug("high_voltage")
            with pytest.raises((serial.SerialException, OSError)):
                port.read(1)
        assert read_outputs(virtual.folder).mcp_v == 300
        virtual.plug_in("high_voltage")
        with serial.Serial(virtual.supply_port, 9600, timeout=1) as port:
            port.write(b"++ver\n")
            assert port.read_until(b"\n").startswith(b"Prologix")
        assert read_outputs(virtual.folder).mcp_v == 0


def test_instruments_outlive_a_killed_bench_only_until_their_lines_are_quiet(tmp_path):
    script = f"""
        import os, signal, sys
        sys.path.insert(0, {os.getcwd()!r})
        from simulate.virtual_bench.process import VirtualInstruments
        virtual = VirtualInstruments({str(tmp_path / "bench")!r})
        virtual.__enter__()
        os.kill(os.getpid(), signal.SIGKILL)
    """
    subprocess.run([sys.executable, "-c", textwrap.dedent(script)], check=False, timeout=20)
    port = tmp_path / "bench" / "delay_generator"
    with serial.Serial(str(port), 9600, timeout=1) as line:
        line.write(b"TSRC?\n")
        assert line.read_until(b"\r\n") == b"5\r\n"
    deadline_s = time.monotonic() + 12
    while port.is_symlink():
        assert time.monotonic() < deadline_s
        time.sleep(0.1)


# A public driver library, which never heard of this project, drives the virtual instruments over
# their wires.


@pytest.fixture(scope="module")
def instruments():
    """The library, which takes seconds to import."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the library's own imports
        import instruments
        import instruments.abstract_instruments.comm
    return instruments


@pytest.fixture(scope="module")
def ureg(instruments):
    """The library's units; its attribute `instruments.units` is the registry or the module, by the
    order of imports.
    """
    return importlib.import_module("instruments.units").ureg


@pytest.fixture(scope="module")
def quick_bench(tmp_path_factory):
    with VirtualInstruments(tmp_path_factory.mktemp("bench"), time_scale=5.0) as virtual:
        yield virtual


@pytest.fixture
def delay_generator(quick_bench, instruments):
    srs = instruments.srs.SRSDG645.open_serial(quick_bench.gate_port, baud=9600, timeout=2)
    srs.terminator = "\n"
    yield srs
    srs._file._conn.close()


@pytest.fixture
def supply(quick_bench, instruments, ureg):
    comm = instruments.abstract_instruments.comm
    with serial.Serial(quick_bench.supply_port, 9600, timeout=1.0) as port:
        # this library ends an answer at a carriage return
        port.write(b"++eot_enable 1\r++eot_char 13\r")
        communicator = comm.GPIBCommunicator(comm.SerialCommunicator(port), 14, model="pl")
        communicator.timeout = 1 * ureg.second
        yield instruments.generic_scpi.SCPIInstrument(communicator)


def test_a_public_driver_knows_the_delay_generator(delay_generator):
    assert delay_generator.name.strip() == "Stanford Research Systems,DG645,s/n001234,ver1.00.00E"
    assert delay_generator.query("LERR?").strip() == "0"


def test_a_public_driver_sets_and_reads_delays_to_5_picoseconds(delay_generator, ureg):
    edges = delay_generator.Channels
    a, b = delay_generator.channel[edges.A], delay_generator.channel[edges.B]
    a.delay = (delay_generator.channel[edges.T0], 85 * ureg.ns)
    b.delay = (a, 16.000003 * ureg.ms)
    assert a.delay[0] == edges.T0
    assert b.delay[0] == edges.A
    assert a.delay[1].to("ps").magnitude == pytest.approx(85_000, abs=0.1)
    assert b.delay[1].to("ps").magnitude == pytest.approx(16_000_003_000, abs=5)


def test_a_public_driver_opens_and_shuts_the_gate(delay_generator, quick_bench, ureg):
    edges, sources = delay_generator.Channels, delay_generator.TriggerSource
    delay_generator.output["AB"].level_amplitude = 4.0 * ureg.V
    delay_generator.channel[edges.B].delay = (delay_generator.channel[edges.A], 10 * ureg.us)
    delay_generator.trigger_rate = 50 * ureg.Hz
    delay_generator.trigger_source = sources.internal
    assert delay_generator.trigger_source == sources.internal
    assert delay_generator.trigger_rate.to("Hz").magnitude == 50
    out = _after(delay_generator, quick_bench)
    assert (out.gate_open, out.gate_hz) == (True, 50)
    assert out.gate_ns == pytest.approx(10_000)
    delay_generator.trigger_source = sources.single_shot
    assert not _after(delay_generator, quick_bench).gate_open


def test_a_public_driver_sets_levels_polarity_and_bursts(delay_generator, ureg):
    output, polarity = delay_generator.output["CD"], delay_generator.LevelPolarity
    output.level_amplitude, output.level_offset, output.polarity = (
        3.3 * ureg.V,
        -0.5 * ureg.V,
        polarity.negative,
    )
    assert output.level_amplitude.magnitude == 3.3
    assert output.level_offset.magnitude == -0.5
    assert output.polarity == polarity.negative
    delay_generator.burst_count, delay_generator.burst_period = 7, 20 * ureg.us
    delay_generator.enable_burst_mode = True
    assert delay_generator.enable_burst_mode
    assert delay_generator.burst_count == 7
    assert delay_generator.burst_period.to("us").magnitude == pytest.approx(20)
    delay_generator.enable_burst_mode = False
    delay_generator.enable_adv_triggering = True
    delay_generator.holdoff = 2 * ureg.ms
    assert delay_generator.enable_adv_triggering
    assert delay_generator.holdoff.to("ms").magnitude == pytest.approx(2)
    delay_generator.enable_adv_triggering = False
    assert delay_generator.query("LERR?").strip() == "0"


def test_a_refused_level_keeps_its_value_and_queues_an_error(delay_generator, ureg):
    output = delay_generator.output["AB"]
    before = output.level_amplitude
    output.level_amplitude = 7.0 * ureg.V
    assert output.level_amplitude == before
    assert delay_generator.query("LERR?").strip() == "10"


def test_a_public_driver_reaches_the_supply_through_the_adapter(supply):
    assert supply.query("*IDN?") == "StanfordResearchSystems,PS350,2067,1.40"
    supply.sendcmd("VLIM 900")
    supply.sendcmd("VSET 650")
    assert float(supply.query("VSET?")) == 650
    assert float(supply.query("VLIM?")) == 900
    assert float(supply.query("VOUT?")) == 0
    supply.sendcmd("VSET 950")
    assert int(supply.query("*ESR?")) & 16  # refused, not clamped
    assert float(supply.query("VSET?")) == 650


def test_a_public_driver_raises_and_lowers_the_voltage(supply, quick_bench):
    supply.sendcmd("VSET 200")
    supply.sendcmd("HVON")
    while not int(supply.query("*STB? 0")):
        pass
    assert float(supply.query("VOUT?")) == 200
    assert read_outputs(quick_bench.folder).mcp_v == 200
    supply.sendcmd("HVOF")
    assert int(supply.query("*STB? 7")) == 0
    assert float(supply.query("VOUT?")) < 200


def _after(delay_generator, quick_bench):
    """The outputs once every command so far has been obeyed."""
    assert delay_generator.query("*OPC?").strip() == "1"
    return read_outputs(quick_bench.folder)
