"""Faults from outside an instrument's line: its panel, its obedience, its triggers, its port, and
the room's light.
"""

import time
from dataclasses import replace

import numpy as np
import pytest
import serial

from labdata import InstrumentConfig, Target, load_sensor
from simulate.virtual_bench.bench import VirtualBench
from simulate.virtual_bench.faults import Faults, inject_faults
from simulate.virtual_bench.in_process import InProcessInstruments
from simulate.virtual_bench.instruments.meters import LUX_PER_W
from simulate.virtual_bench.outputs import read_outputs
from simulate.virtual_bench.process import VirtualInstruments

FAST = 1e4
OPEN = ("LAMP 1,4", "DLAY 3,2,0.016", "TRAT 60")
SUPPLY_ON = "VSET 650;HVON"


@pytest.fixture
def instruments():
    return InProcessInstruments(time_scale=FAST)


def told(port, *commands: str) -> None:
    for command in commands:
        port.send(command.encode() + b"\n")


def asked(port, question: str) -> str:
    port.send(question.encode() + b"\n")
    return port.receive(0.01).decode().strip()


def supply_told(instruments, *commands: str) -> None:
    told(instruments.supply_port, "++auto 0", "++addr 14", *commands)


def supply_asked(instruments, question: str) -> str:
    supply_told(instruments, question)
    return asked(instruments.supply_port, "++read eoi")


def settled_v(instruments) -> float:
    """Output once it has moved, V."""
    time.sleep(0.01)
    return instruments.outputs().mcp_v


def test_what_is_entered_at_a_panel_is_done_once_and_shows_on_the_line(instruments):
    gate = instruments.gate_port
    gate.faults = Faults(panel=("LOFF 1,2",))
    assert float(asked(gate, "LOFF? 1")) == 2.0
    assert instruments.outputs().gate_open
    told(gate, "LOFF 1,0")
    gate.faults = Faults(panel=("LOFF 1,2",), mute=True)
    assert not instruments.outputs().gate_open, "it was entered once"
    instruments.supply_port.faults = Faults(panel=("VSET 650", "HVON"))
    assert settled_v(instruments) == 650.0
    assert float(supply_asked(instruments, "VSET?")) == 650.0


def test_a_disobedient_supply_takes_orders_and_its_output_stays(instruments):
    supply_told(instruments, SUPPLY_ON)
    assert settled_v(instruments) == 650.0
    instruments.supply_port.faults = Faults(disobedient=True)
    supply_told(instruments, "HVOF")
    assert settled_v(instruments) == 650.0
    assert not int(supply_asked(instruments, "*STB?")) & 128, "it says that it is off"
    assert float(supply_asked(instruments, "VOUT?")) == 650.0, "what it measures is true"
    instruments.supply_port.faults = Faults()
    assert settled_v(instruments) < 650.0


def test_a_disobedient_gate_answers_what_was_set_and_stays_open(instruments):
    gate = instruments.gate_port
    told(gate, *OPEN, "TSRC 0")
    gate.faults = Faults(disobedient=True)
    told(gate, "TSRC 5")
    assert asked(gate, "TSRC?") == "5"
    assert instruments.outputs().gate_open
    gate.faults = Faults()
    assert not instruments.outputs().gate_open


@pytest.mark.parametrize(("source", "opens"), [("1", False), ("0", True)])
def test_without_pulses_at_its_input_only_a_gate_of_its_own_clock_opens(instruments, source, opens):
    gate = instruments.gate_port
    told(gate, *OPEN, f"TSRC {source}")
    assert instruments.outputs().gate_open
    gate.faults = Faults(untriggered=True)
    assert instruments.outputs().gate_open is opens


def test_room_light_falls_on_darks_and_on_the_meter_through_an_open_gate(tmp_path, seed):
    sensor = load_sensor("pulnix-ag5745ef3")
    sensor = replace(sensor, ccd=replace(sensor.ccd, rows=31, columns=44))
    wires = InstrumentConfig(bench="in-process", light_meter="pm101")
    with VirtualBench(tmp_path / "bench", sensor, seed, wires=wires, time_scale=FAST) as bench:
        assert bench.inside is not None
        bench.operator.place(kind="dark", target=Target(), illuminance_lux=0.0)
        told(bench.inside.gate_port, *OPEN, "TSRC 0")
        supply_told(bench.inside, SUPPLY_ON)
        assert settled_v(bench.inside) == 650.0
        camera, full_dn = bench.in_process_camera(), 2**sensor.video.bit_depth - 1

        def saturated_share() -> float:
            with camera.capture(frames=1) as capture:
                return float(np.mean(next(iter(capture)).pixels >= full_dn))

        assert saturated_share() == 0.0
        bench.provoke("surroundings", Faults(room_light_lux=1.0))
        assert saturated_share() > 0.5
        watts = float(asked(bench.inside.ports["light-meter"], "MEAS:POW?"))
        assert watts * LUX_PER_W == pytest.approx(1.0, rel=1e-3)
        bench.provoke("surroundings", Faults())
        assert saturated_share() == 0.0


@pytest.mark.wires
def test_a_port_goes_to_another_name_and_comes_back_with_its_outputs_unchanged(tmp_path):
    with VirtualInstruments(tmp_path / "bench") as virtual:
        with serial.Serial(virtual.gate_port, 9600, timeout=0.5) as port:
            port.write("\n".join((*OPEN, "TSRC 0\n")).encode())
            port.write(b"TSRC?\n")
            assert port.read_until(b"\r\n") == b"0\r\n"
        inject_faults(virtual.folder, "delay_generator", Faults(port_name="renamed"))
        _await(lambda: (virtual.folder / "renamed").is_symlink())
        with pytest.raises(serial.SerialException):
            serial.Serial(virtual.gate_port)
        with serial.Serial(virtual.port("renamed"), 9600, timeout=0.5) as port:
            port.write(b"TSRC?\n")
            assert port.read_until(b"\r\n") == b"0\r\n"
        inject_faults(virtual.folder, "delay_generator", Faults())
        _await((virtual.folder / "delay_generator").is_symlink)
        assert not (virtual.folder / "renamed").is_symlink()
        assert read_outputs(virtual.folder).gate_open


def _await(reached) -> None:
    until_s = time.monotonic() + 5.0
    while not reached():
        assert time.monotonic() < until_s
        time.sleep(0.01)
