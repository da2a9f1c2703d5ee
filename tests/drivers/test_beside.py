"""Light and temperature are read beside each stack; a silent meter is told, and ends a run only
where it is needed.
"""

import numpy as np
import pytest

from drivers.bench.local_bench import open_bench
from drivers.errors import BenchError, InstrumentTimeout
from drivers.instruments.models import lines_on
from drivers.interface import Bench, FrameLevels
from labdata import BadInput, Conditions, InstrumentConfig, Limits, Meters, Plan, Step, Target
from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.in_process import InProcessInstruments
from simulate.virtual_bench.instruments.meters import LUX_PER_W, NOISE_W, TEMPERATURE_C

pytestmark = pytest.mark.usefixtures("short_waits")
WIRES = InstrumentConfig(bench="in-process", light_meter="pm101", thermometer="ctc100")
TRUE_LUX = 2e-4


@pytest.fixture
def virtual():
    instruments = InProcessInstruments(WIRES, time_scale=60.0)
    instruments.ports["light-meter"].far_end().connect_light(lambda: TRUE_LUX)
    return instruments


def opened(virtual, tmp_path, **meters) -> Bench:
    limits = Limits(ramp_v_per_s=10000.0)
    lines = lines_on(virtual.ports, WIRES)
    return open_bench(
        WIRES,
        limits,
        log=tmp_path / "log",
        lines=lines,
        meters=Meters(lux_per_w=LUX_PER_W, **meters),
    )


def test_what_is_read_has_its_unit_and_its_time(virtual, tmp_path):
    with opened(virtual, tmp_path) as bench:
        read, silent = bench.read_meters()
    assert silent == ()
    assert read.metered_w == pytest.approx(TRUE_LUX / LUX_PER_W, abs=5 * NOISE_W)
    assert read.metered_lux == pytest.approx(TRUE_LUX, rel=0.02)
    assert read.temperature_c == pytest.approx(TEMPERATURE_C)
    assert (
        read.metered_time_s is not None
        and 0.0 <= (read.temperature_time_s or 0.0) - read.metered_time_s < 1.0
    )


@pytest.mark.parametrize(
    ("role", "kept"), [("light-meter", "temperature_c"), ("thermometer", "metered_w")]
)
def test_a_silent_meter_is_told_and_the_other_one_is_read(virtual, tmp_path, role, kept):
    with opened(virtual, tmp_path) as bench:
        virtual.ports[role].faults = Faults(silent=True)
        read, silent = bench.read_meters()
        assert len(silent) == 1 and "must answer" in silent[0]
        assert [
            name for name in ("temperature_c", "metered_w") if getattr(read, name) is not None
        ] == [kept]
        virtual.ports[role].faults = Faults()
        assert bench.read_meters()[1] == ()


@pytest.mark.parametrize(
    ("role", "key"), [("light-meter", "light_needed"), ("thermometer", "temperature_needed")]
)
def test_a_silent_meter_that_is_needed_ends_the_work(virtual, tmp_path, role, key):
    virtual.ports[role].faults = Faults(silent=True)
    with pytest.raises(InstrumentTimeout), opened(virtual, tmp_path, **{key: True}):
        pass


@pytest.mark.parametrize(
    ("role", "key"), [("light-meter", "light_needed"), ("thermometer", "temperature_needed")]
)
def test_a_meter_that_is_needed_may_not_fall_silent_either(virtual, tmp_path, role, key):
    with opened(virtual, tmp_path, **{key: True}) as bench:
        virtual.ports[role].faults = Faults(silent=True)
        with pytest.raises(InstrumentTimeout):
            bench.read_meters()


def test_a_meter_that_is_needed_must_be_there():
    step = Step(label="a", kind="dark", frames=1, conditions=Conditions())
    with pytest.raises(
        BadInput, match="a light_meter that a plan needs must be named in its wires, got none"
    ):
        Plan(name="p", meters=Meters(light_needed=True), steps=(step,))


class Blind:
    """An operator who believes that the light is out."""

    is_by_hand = False
    while_waiting = staticmethod(lambda: None)

    def darken(self) -> None: ...

    def place(self, *, kind, target, illuminance_lux, filter_density=None) -> Conditions:
        return Conditions(illuminance_lux=illuminance_lux)


def test_light_that_only_the_meter_sees_is_taken_for_light(virtual, tmp_path):
    """A door left open: the next command that wants the dark is refused, and far too much makes the
    tube safe.
    """
    with opened(virtual, tmp_path) as bench:
        light = bench.guard(Blind())
        light.place(kind="flat", target=Target(), illuminance_lux=0.0)
        bench.set_conditions(Conditions(mcp_v=700.0, gate_ns=1e6))
        bench.dark_frame_seen(FrameLevels.of(np.full((4, 6), 12, np.uint8), 255.0))
        bench.read_meters()
        with pytest.raises(BadInput, match="the light must be down before the gain goes up"):
            bench.set_conditions(Conditions(mcp_v=750.0))
        virtual.ports["light-meter"].far_end().connect_light(lambda: 5.0)
        with pytest.raises(BenchError, match="the tube was made safe: the light must"):
            bench.read_meters()
        assert not virtual.outputs().gate_open
