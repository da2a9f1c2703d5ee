"""The virtual instruments' wires behave as serial cables do."""

import os
import subprocess
import sys
import textwrap
import time

import pytest
import serial

from simulate.virtual_bench.outputs import read_outputs
from simulate.virtual_bench.process import VirtualInstruments
from simulate.virtual_bench.pseudo_terminal import PseudoTerminal

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
