"""The lamp of the bench is lit and put out in the order that spares the tube, and is out in the
safe state.
"""

import numpy as np
import pytest

from drivers.bench.local_bench import open_bench
from drivers.bench.state import InterlockRefused, TurnFilter
from drivers.errors import BenchError, InstrumentRejected
from drivers.instruments.filter_wheel import FilterWheel, PromptLine
from drivers.instruments.models import lines_on
from drivers.interface import FrameLevels
from labdata import BadInput, Conditions, InstrumentConfig, LampCalibration, Limits, Target
from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.in_process import InProcessInstruments

pytestmark = pytest.mark.usefixtures("short_waits")
WIRES = InstrumentConfig(bench="in-process", light="dc2100", wheel="fw102c")
LAMP = LampCalibration(
    source="photometer",
    current_a=(0.01, 0.1, 1.0),
    illuminance_lux=(1e-2, 1e-1, 1.0),
    relative_sd=(0.03, 0.03, 0.03),
    filter_density=(0.0, 1.0, 2.0, 3.0, 4.0, 5.0),
)
LIMITS = Limits(ramp_v_per_s=10000.0)
DARK = {"kind": "flat", "target": Target(), "illuminance_lux": 0.0}


class Hands:
    """Places targets and nothing else."""

    is_by_hand = False
    while_waiting = staticmethod(lambda: None)

    def __init__(self) -> None:
        self.placed: list[float] = []

    def darken(self) -> None: ...

    def place(self, *, kind, target, illuminance_lux, filter_density=None) -> Conditions:
        self.placed.append(illuminance_lux)
        return Conditions(illuminance_lux=0.0)


@pytest.fixture
def virtual():
    return InProcessInstruments(WIRES, time_scale=60.0)


@pytest.fixture
def bench(virtual, tmp_path):
    return open_bench(
        WIRES, LIMITS, log=tmp_path / "log", lines=lines_on(virtual.ports, WIRES), lamp=LAMP
    )


def at_gain(bench, hands):
    """The bench's light, with the gate open at gain and a dark frame seen."""
    light = bench.guard(hands)
    light.place(**DARK)
    bench.set_conditions(Conditions(mcp_v=700.0, gate_ns=1e6))
    bench.dark_frame_seen(FrameLevels.of(np.full((4, 6), 12, np.uint8), 255.0))
    return light


def test_the_light_asked_for_is_made_by_current_and_filter_and_read_back(bench, virtual):
    hands = Hands()
    with bench:
        light = at_gain(bench, hands)
        read = light.place(kind="flat", target=Target(), illuminance_lux=2.5e-5)
        assert (read.lamp_a, read.filter_density) == (pytest.approx(0.25), 4.0)
        assert read.illuminance_lux == pytest.approx(2.5e-5)
        out = virtual.outputs()
        assert (out.lamp_a, out.filter_position) == (pytest.approx(0.25), 5)
    assert set(hands.placed) == {0.0}  # a person only places targets


def test_a_filter_turns_in_the_dark_only(bench, virtual):
    with bench:
        light = at_gain(bench, Hands())
        light.place(kind="flat", target=Target(), illuminance_lux=2.5e-5)
        with pytest.raises(
            InterlockRefused, match=r"the light must be out while a filter turns, got up to 2.5e-05"
        ):
            bench.interlock.permit(TurnFilter())
        lit: list[float] = []
        turns = virtual.ports["filter-wheel"]
        send, turns.send = (
            turns.send,
            lambda data: (lit.append(virtual.outputs().lamp_a), send(data)),
        )
        light.place(kind="flat", target=Target(), illuminance_lux=2.5e-4, filter_density=3.0)
        assert lit and set(lit) == {0.0}
        assert virtual.outputs().filter_position == 4


def test_the_gain_goes_up_only_when_the_lamp_is_out(bench):
    with bench:
        light = at_gain(bench, Hands())
        light.place(kind="flat", target=Target(), illuminance_lux=1e-4)
        with pytest.raises(
            InterlockRefused, match="the light must be down before the gain goes up"
        ):
            bench.set_conditions(Conditions(mcp_v=800.0))
        light.place(**DARK)
        assert bench.set_conditions(Conditions(mcp_v=800.0)).mcp_v == 800.0


@pytest.mark.parametrize("door", [None, RuntimeError, KeyboardInterrupt])
def test_every_door_leaves_the_lamp_out(bench, virtual, door):
    try:
        with bench:
            at_gain(bench, Hands()).place(kind="flat", target=Target(), illuminance_lux=1e-4)
            assert virtual.outputs().lamp_a > 0.0
            if door:
                raise door
    except (RuntimeError, KeyboardInterrupt) as error:
        assert type(error) is door
    out = virtual.outputs()
    assert (out.lamp_a, out.gate_open) == (0.0, False)


def test_making_safe_puts_the_lamp_out_and_a_lamp_that_cannot_be_heard_is_told(bench, virtual):
    with pytest.raises(BenchError, match="the lamp may burn"), bench:
        at_gain(bench, Hands()).place(kind="flat", target=Target(), illuminance_lux=1e-4)
        virtual.ports["light-source"].faults = Faults(mute=True)
    assert virtual.outputs().lamp_a == 0.0  # it obeyed all the same


def test_a_wheel_that_somebody_turned_is_told(virtual):
    ours, theirs = (
        FilterWheel(PromptLine(virtual.ports["filter-wheel"], name="filter wheel"))
        for _ in range(2)
    )
    ours.look()
    ours.look()
    theirs.turn_to(4)
    with pytest.raises(
        InstrumentRejected, match="filter wheel must stay at 1, got 4: somebody turned it"
    ):
        ours.look()


def test_a_lamp_without_a_calibration_and_a_wheel_without_enough_filters_are_refused(
    virtual, tmp_path
):
    lines = lines_on(virtual.ports, WIRES)
    with pytest.raises(BadInput, match="a light source must have its calibration, got None"):
        open_bench(WIRES, LIMITS, log=tmp_path / "log", lines=lines)
    many = LampCalibration(
        **{**vars(LAMP), "filter_density": tuple(float(each) for each in range(9))}
    )
    with (
        pytest.raises(BadInput, match="a position for each filter, got 6 for 9"),
        open_bench(WIRES, LIMITS, log=tmp_path / "log", lines=lines, lamp=many),
    ):
        pass
