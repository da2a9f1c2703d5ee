"""The bench raises and lowers the gain in the order that spares the tube, and leaves it safe."""

import itertools
import json
import os
import signal
import threading
import time
from contextlib import nullcontext

import numpy as np
import pytest

from drivers.acquisition.run_control import RunControl
from drivers.bench import safe_state
from drivers.bench.local_bench import open_bench
from drivers.bench.setup import FIELD_RATE_HZ
from drivers.bench.state import InterlockRefused, OpenGate
from drivers.errors import BenchError, InstrumentTimeout, InstrumentTripped
from drivers.instruments.models import lines_on
from drivers.interface import FrameLevels
from labdata import BadInput, Conditions, InstrumentConfig, Limits, Target
from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.in_process import InProcessInstruments

pytestmark = pytest.mark.usefixtures("short_waits")
LIMITS = Limits(mcp_v=900.0, gate_ns=1.65e7, illuminance_lux=1e-2, ramp_v_per_s=10000.0)


class Witness:
    """Looks at the wires at every write to an instrument."""

    def __init__(self, instruments) -> None:
        self._instruments = instruments
        self.seen: list = []

    def wrap(self, line):
        instruments, seen, write = self._instruments, self.seen, line.write

        def watched(command: str) -> None:
            write(command)
            seen.append((command, instruments.outputs()))

        line.write = watched
        return line


@pytest.fixture
def virtual():
    return InProcessInstruments(time_scale=60.0)


@pytest.fixture
def lines(virtual):
    return lines_on(virtual.ports, InstrumentConfig())


@pytest.fixture
def bench(lines, tmp_path):
    return open_bench(
        InstrumentConfig(bench="in-process"), LIMITS, log=tmp_path / "safety.jsonl", lines=lines
    )


def test_conditions_are_read_back_and_reach_the_tube(bench, virtual):
    with bench:
        read = bench.set_conditions(
            Conditions(mcp_v=780.0, gate_ns=1.6e7, illuminance_lux=1e-4, exposure_s=0.0167)
        )
        assert read == Conditions(
            mcp_v=780.0, gate_ns=1.6e7, illuminance_lux=1e-4, exposure_s=0.0167
        )
        out = virtual.outputs()
        assert out.mcp_v == 780
        assert out.open_ns(1 / FIELD_RATE_HZ) == pytest.approx(1.6e7, rel=1e-6)


def test_what_is_not_asked_for_is_off(bench, virtual):
    with bench:
        bench.set_conditions(Conditions(mcp_v=700, gate_ns=1e6))
        read = bench.set_conditions(Conditions())
        assert not virtual.outputs().gate_open
        assert read.gate_ns == 0
        assert read.mcp_v is not None and read.mcp_v < 11


@pytest.mark.parametrize(("first_v", "then_v"), [(600, 800), (800, 600), (800, 0), (700, 700)])
def test_the_gate_is_shut_whenever_the_gain_moves(virtual, lines, tmp_path, first_v, then_v):
    witness = Witness(virtual)
    lines = {role: witness.wrap(line) for role, line in lines.items()}
    with open_bench(
        InstrumentConfig(bench="in-process"), LIMITS, log=tmp_path / "log", lines=lines
    ) as bench:
        bench.set_conditions(Conditions(mcp_v=first_v, gate_ns=1e6))
        witness.seen.clear()
        bench.set_conditions(Conditions(mcp_v=then_v, gate_ns=2e6))
    moves = [out for command, out in witness.seen if command.startswith(("VSET", "HV"))]
    assert not any(out.gate_open for out in moves)
    opened = [out.mcp_v for command, out in witness.seen if command == "TSRC 0"]
    assert len(opened) == 1
    assert opened[0] == pytest.approx(then_v, abs=11 if then_v == 0 else 1)


def test_no_step_up_is_larger_than_50_v_nor_faster_than_the_limit(virtual, lines, tmp_path):
    witness = Witness(virtual)
    lines = {role: witness.wrap(line) for role, line in lines.items()}
    with open_bench(
        InstrumentConfig(), Limits(ramp_v_per_s=1000), log=tmp_path / "log", lines=lines
    ) as bench:
        began_s = time.monotonic()
        bench.set_conditions(Conditions(mcp_v=650))
        assert time.monotonic() - began_s >= 0.6
    levels = [
        float(command.split()[1]) for command, _ in witness.seen if command.startswith("VSET")
    ]
    assert levels[0] == 50
    assert max(after - before for before, after in itertools.pairwise(levels)) <= 50


@pytest.mark.parametrize(
    ("conditions", "rule"),
    [
        (Conditions(mcp_v=901), "mcp_v must not exceed the limit 900, got 901"),
        (Conditions(mcp_v=30), "mcp_v must be 0 \\(off\\) or at least 50, got 30"),
        (Conditions(mcp_v=780.4), "mcp_v must be a multiple of the supply's 1 V, got 780.4"),
        (
            Conditions(mcp_v=600, gate_ns=10.003),
            "gate_ns must be a multiple of the generator's 0.005 ns, got 10.003",
        ),
        (
            Conditions(mcp_v=600, gate_ns=1.66e7),
            "gate_ns must not exceed the limit 1.65e\\+07, got 1.66e\\+07",
        ),
    ],
)
def test_nothing_beyond_a_limit_is_done_even_in_part(bench, virtual, conditions, rule):
    with bench:
        bench.set_conditions(Conditions(mcp_v=500, gate_ns=1e6))
        before = virtual.outputs()
        with pytest.raises(BadInput, match=rule):
            bench.set_conditions(conditions)
        assert virtual.outputs() == before


@pytest.mark.parametrize("door", [None, RuntimeError, KeyboardInterrupt, SystemExit, BadInput])
def test_every_door_leaves_the_tube_safe(bench, virtual, door):
    with pytest.raises(door) if door else nullcontext(), bench:
        bench.set_conditions(Conditions(mcp_v=700, gate_ns=1e6))
        if door:
            raise door("out")
    out = virtual.outputs()
    assert not out.gate_open
    assert out.mcp_v < 11


def test_sigterm_is_a_door_too(bench, virtual):
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(SystemExit) as end, RunControl().listen(), bench:
        bench.set_conditions(Conditions(mcp_v=700, gate_ns=1e6))
        threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGTERM)).start()
        time.sleep(5)
    assert end.value.code == 128 + signal.SIGTERM
    assert signal.getsignal(signal.SIGTERM) is before
    assert not virtual.outputs().gate_open
    assert virtual.outputs().mcp_v < 11


def test_opening_makes_a_bench_safe_that_was_left_on(virtual, lines, bench):
    gate, supply = lines["gate"], lines["supply"]
    gate.write("DLAY 3,2,1e-3;LAMP 1,4;TSRC 0")
    supply.write("VSET 600;HVON")
    time.sleep(0.05)
    assert virtual.outputs().gate_open
    with bench:
        assert not virtual.outputs().gate_open
        assert virtual.outputs().mcp_v < 600


def test_safe_can_be_asked_for_and_work_go_on(bench, virtual):
    with bench:
        bench.set_conditions(Conditions(mcp_v=700, gate_ns=1e6))
        bench.safe()
        assert not virtual.outputs().gate_open
        assert virtual.outputs().mcp_v < 11
        assert bench.set_conditions(Conditions(mcp_v=600, gate_ns=1e6)).mcp_v == 600


def test_a_trip_ends_the_work_and_says_so(bench, virtual):
    with (
        pytest.raises(
            InstrumentTripped, match="high-voltage supply must stay on, got a trip on current"
        ),
        bench,
    ):
        bench.set_conditions(Conditions(mcp_v=700, gate_ns=1e6))
        bench.check()
        virtual.supply_port.faults = Faults(tripped=True)
        virtual.outputs()
        bench.check()
    assert not virtual.outputs().gate_open


def test_a_supply_that_cannot_be_verified_is_told_on_leaving(bench, virtual, monkeypatch):
    monkeypatch.setattr(safe_state, "DEAF_S", 1.0)
    with pytest.raises(BenchError, match="high voltage was ordered off but not verified"), bench:
        bench.set_conditions(Conditions(mcp_v=700, gate_ns=1e6))
        virtual.supply_port.faults = Faults(mute=True)
    assert not virtual.outputs().gate_open
    assert virtual.outputs().mcp_v < 11  # it obeyed all the same


def test_what_fails_on_leaving_is_a_note_on_what_ended_the_work(bench, virtual):
    with pytest.raises(InstrumentTimeout, match="delay generator must answer") as end, bench:
        bench.set_conditions(Conditions(mcp_v=700, gate_ns=1e6))
        virtual.gate_port.faults = Faults(silent=True)
        bench.set_conditions(Conditions(mcp_v=700, gate_ns=1e6))
    assert "the gate may be open, the high voltage is off" in end.value.__notes__[0]
    assert virtual.outputs().mcp_v < 11


def test_every_safety_step_is_logged(bench, tmp_path):
    with bench:
        bench.set_conditions(Conditions(mcp_v=300))
    events = [json.loads(line) for line in (tmp_path / "safety.jsonl").read_text().splitlines()]
    steps = [event["event"] for event in events]
    assert steps.count("gate: TSRC 5") == 1
    # given again until the output is seen to fall
    assert 1 <= steps.count("high voltage: HVOF") <= 2
    volts = [event["result"] for event in events if event["event"] == "high voltage: VOUT?"]
    assert volts == sorted(volts, reverse=True)
    assert volts[-1] <= 10


def test_the_wires_left_out_are_named(bench, tmp_path):
    assert bench.wires_left_out
    on_wires = open_bench(
        InstrumentConfig(gate_port="/dev/a", supply_port="/dev/b"), LIMITS, log=tmp_path / "log"
    )
    assert on_wires.wires_left_out == ()


def test_a_bench_needs_ports(tmp_path):
    with pytest.raises(
        BadInput, match="must have its serial port, got none for gate_port and supply_port"
    ):
        open_bench(InstrumentConfig(), LIMITS, log=tmp_path / "log")


@pytest.mark.parametrize("top", [180, 235, 250, 255, 300])
@pytest.mark.parametrize("area", [0.048, 1.0])
def test_light_at_the_datas_own_ceiling_is_saturation_and_noise_is_not(top, area):
    scene = np.random.default_rng(7).normal(70.0, 3.0, (200, 300))
    assert FrameLevels.of(np.rint(scene), 255.0).saturated == 0.0
    scene[: round(200 * area)] += 1e3
    lit = np.minimum(np.rint(scene), min(top, 255))
    assert FrameLevels.of(lit, 255.0, black_dn=12.0).saturated == pytest.approx(area, abs=0.01)
    assert FrameLevels.of(np.full((9, 9), 12, np.uint8), 255.0, black_dn=12.0).saturated == 0.0


class Hands:
    """An operator whose meter reads what is asked times a factor."""

    is_by_hand = False
    while_waiting = staticmethod(lambda: None)

    def __init__(self, factor: float = 1.0) -> None:
        self.factor, self.placed = factor, []

    def darken(self) -> None:
        self.placed.append(0.0)

    def place(self, *, kind, target, illuminance_lux, filter_density=None) -> Conditions:
        self.placed.append(illuminance_lux)
        return Conditions(illuminance_lux=self.factor * illuminance_lux)


def dark_frame():
    return np.full((4, 6), 12, np.uint8)


def lit(bench, hands, lux: float, **conditions):
    """Light at the end of the proper order."""
    light = bench.guard(hands)
    light.place(kind="flat", target=Target(), illuminance_lux=0.0)
    bench.set_conditions(Conditions(mcp_v=700.0, gate_ns=1e6, **conditions))
    bench.dark_frame_seen(FrameLevels.of(dark_frame(), 255.0))
    return light.place(kind="flat", target=Target(), illuminance_lux=lux)


def test_no_light_before_a_dark_frame_was_seen_through_the_open_gate(bench):
    hands = Hands()
    with bench:
        light = bench.guard(hands)
        light.place(kind="flat", target=Target(), illuminance_lux=0.0)
        bench.dark_frame_seen(FrameLevels.of(dark_frame(), 255.0))
        assert not bench.dark_seen  # behind a shut gate every frame is dark
        with pytest.raises(
            InterlockRefused, match="a dark frame must be seen through the open gate"
        ):
            light.place(kind="flat", target=Target(), illuminance_lux=1e-4)
        assert hands.placed == [0.0]


def test_light_goes_on_in_the_proper_order_and_not_further_than_the_gain_bears(bench):
    with bench:
        hands = Hands()
        assert lit(bench, hands, 1e-4).illuminance_lux == 1e-4
        assert hands.placed == [0.0, 1e-4]
        with pytest.raises(
            InterlockRefused, match="the light must be down before the gain goes up"
        ):
            bench.set_conditions(Conditions(mcp_v=800.0))


def test_light_that_reads_too_bright_makes_the_tube_safe(bench, virtual):
    hands = Hands(factor=1e5)
    with bench, pytest.raises(BenchError, match="the tube was made safe: the light must"):
        lit(bench, hands, 1e-4)
    assert hands.placed[-1] == 0.0
    assert not virtual.outputs().gate_open
    assert virtual.outputs().mcp_v < 11


def test_a_bright_frame_without_light_ends_the_work(bench, virtual):
    with bench:
        bench.set_conditions(Conditions(mcp_v=700.0, gate_ns=1e6))
        with pytest.raises(BenchError, match=r"mean below 25% of full scale .* got 78% and 100.0%"):
            bench.dark_frame_seen(FrameLevels.of(np.full((4, 6), 200, np.uint8), 255.0))
        with pytest.raises(BenchError, match="a frame without light must"):
            bench.set_conditions(Conditions(mcp_v=600.0, gate_ns=1e6))
        assert not virtual.outputs().gate_open


def test_after_a_trip_nothing_gets_hotter_before_the_bench_is_opened_anew(bench, virtual):
    with bench:
        bench.set_conditions(Conditions(mcp_v=700.0, gate_ns=1e6))
        virtual.supply_port.faults = Faults(tripped=True)
        virtual.outputs()
        with pytest.raises(InstrumentTripped):
            bench.check()
        with pytest.raises(BadInput, match="reopened after a failure"):
            bench.interlock.permit(OpenGate(width_ns=1e6, rate_hz=50.0))
