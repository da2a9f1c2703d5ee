"""Making safe tries every step on each line, and neither line waits for the other."""

import getpass
import shutil
import subprocess
import sys
import time
from importlib import resources

import pytest

from drivers.bench.safe_state import make_safe
from drivers.errors import InstrumentDisconnected
from drivers.instruments import delay_generator, high_voltage
from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.in_process import InProcessInstruments, InProcessPort


@pytest.fixture
def virtual():
    return InProcessInstruments(time_scale=60.0)


@pytest.fixture
def drivers(virtual):
    gate = delay_generator.MODEL.line(virtual.gate_port, 0)
    supply = high_voltage.MODEL.line(virtual.supply_port, 14)
    gate.write("DLAY 3,2,1e-3;LAMP 1,4;TSRC 0")
    supply.write("VSET 600;HVON")
    return {"gate": delay_generator.MODEL.driver(gate), "supply": high_voltage.MODEL.driver(supply)}


@pytest.fixture
def record():
    def told(event: str, **details: object) -> None:
        told.events.append((event, details))

    told.events = []
    return told


def order(record, event: str) -> int:
    return next(place for place, (step, _) in enumerate(record.events) if step == event)


def test_a_silent_gate_does_not_hold_up_the_voltage(virtual, drivers, record):
    virtual.gate_port.faults = Faults(silent=True)
    safety = make_safe(**drivers, record=record)
    assert order(record, "high voltage: HVOF") < order(record, "gate: shut and read back")
    assert (safety.gate_shut, safety.off_ordered, safety.whole) == (False, True, False)
    assert virtual.outputs().mcp_v < 11
    assert "the delay generator must answer" in safety.failures[0]


def test_a_supply_that_hears_again_is_switched_off_after_all(virtual, drivers, record):
    virtual.supply_port.faults = Faults(silent=True)

    def healing(event: str, **details: object) -> None:
        record(event, **details)
        if event == "high voltage: VOUT?" and not details["ok"]:
            virtual.supply_port.faults = Faults()

    assert make_safe(**drivers, record=healing).whole
    assert virtual.outputs().mcp_v < 11


def test_a_gate_opened_at_its_panel_is_shut_again_while_the_supply_is_still_silent(
    virtual, drivers, record
):
    virtual.supply_port.faults, gate = Faults(silent=True), drivers["gate"]

    def shut_then_open() -> None:
        shut()
        if len(opened) < 3:
            gate.line.order("LOFF 1,2")
            opened.append(virtual.outputs().gate_open)

    shut, opened = gate.shut, []
    gate.shut = shut_then_open
    safety = make_safe(**drivers, record=record)
    assert (opened, safety.gate_shut, safety.whole) == ([True] * 3, True, False)
    assert not virtual.outputs().gate_open
    steps = [step for step, _ in record.events]
    assert steps.count("gate: shut and read back") == 1  # a log holds what is news


def test_an_order_that_was_lost_is_given_again(virtual, drivers, record):
    line = drivers["supply"].line
    order, lost = line.order, []
    line.order = lambda command: order(command) if lost else lost.append(command)
    began_s = time.monotonic()
    assert make_safe(**drivers, record=record).whole
    assert lost == ["HVOF"] and virtual.outputs().mcp_v < 11
    assert time.monotonic() - began_s < 2.0


def test_a_line_that_could_not_be_opened_leaves_the_other_to_be_made_safe(virtual, drivers, record):
    safety = make_safe(gate=None, supply=drivers["supply"], record=record)
    assert virtual.outputs().mcp_v < 11
    assert (
        safety.sentence()
        == f"the gate may be open, the high voltage is off and down to {safety.residual_v:g} V"
    )
    assert safety.failures == ("the delay generator could not be reached",)


def test_instruments_that_try_each_others_ports_do_not_keep_each_other_out(virtual, record):
    """The supply's port is back before the gate's, whose task then asks at the supply's."""
    instruments = {"gate": virtual.gate_port, "supply": virtual.supply_port}
    held, began_s = dict[str, str](), time.monotonic()

    class LostPort:
        def __init__(self, path: str, *, lost_s: float, back_s: float) -> None:
            self.path, self.lost_s = path, lost_s
            backs_s[path] = began_s + back_s

        def send(self, data: bytes) -> None:
            self.at_hand().send(data)

        def receive(self, timeout_s: float) -> bytes:
            return self.at_hand().receive(timeout_s)

        def at_hand(self) -> InProcessPort:
            path = next((path for path, holder in list(held.items()) if holder == self.path), None)
            if path is None:
                time.sleep(max(0.0, began_s + self.lost_s - time.monotonic()))
                raise InstrumentDisconnected(f"the port {self.path} is gone")
            return instruments[path]

        def reopen(self, path: str | None = None) -> None:
            self.close()
            path = path or self.path
            if time.monotonic() < backs_s[path] or held.setdefault(path, self.path) != self.path:
                raise InstrumentDisconnected(f"the port {path} is not free")

        def close(self) -> None:
            for path in [path for path, holder in list(held.items()) if holder == self.path]:
                del held[path]

    backs_s: dict[str, float] = {}
    drivers = {
        "gate": delay_generator.MODEL.driver(
            delay_generator.MODEL.line(LostPort("gate", lost_s=0.0, back_s=0.3), 0)
        ),
        "supply": high_voltage.MODEL.driver(
            high_voltage.MODEL.line(LostPort("supply", lost_s=0.23, back_s=0.0), 14)
        ),
    }
    virtual.gate_port.send(b"DLAY 3,2,1e-3;LAMP 1,4;TSRC 0\n")
    assert virtual.outputs().gate_open
    assert make_safe(**drivers, record=record).whole
    assert time.monotonic() - began_s < 2.0 and not virtual.outputs().gate_open


def test_a_wrong_polarity_is_put_right(virtual, drivers, record):
    drivers["gate"].line.write("TSRC 5;LPOL 1,0")
    assert virtual.outputs().gate_open
    assert make_safe(**drivers, record=record).whole
    assert not virtual.outputs().gate_open


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not here")
def test_the_unit_that_makes_safe_at_start_is_one_that_systemd_takes(tmp_path):
    unit = resources.files("drivers.bench").joinpath("charact-safe.service").read_text()
    assert unit.count("/home/lab/charact/.venv/bin/charact safe") == 2
    mine = unit.replace("/home/lab/charact/.venv/bin/charact", sys.executable)
    (path := tmp_path / "charact-safe.service").write_text(
        mine.replace("User=lab", f"User={getpass.getuser()}")
    )
    checked = subprocess.run(
        ["systemd-analyze", "verify", str(path)], capture_output=True, text=True, timeout=60
    )
    assert (checked.returncode, checked.stderr) == (0, "")
