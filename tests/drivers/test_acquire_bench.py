"""The same plan with the same seed gives the same frames, over real wires and without any."""

from dataclasses import replace

import numpy as np
import pytest

from drivers import acquire, bench_of
from drivers.cameras.aravis.camera import AravisCamera
from drivers.instruments.models import lines_on
from labdata import (
    BadInput,
    Conditions,
    InstrumentConfig,
    LampCalibration,
    Override,
    Plan,
    Step,
    Target,
    load_sensor,
    save_sensor,
)
from simulate.virtual_bench import aravis_library
from simulate.virtual_bench.bench import VirtualBench

STEPS = (
    Step(label="dark", kind="dark", frames=3, conditions=Conditions(mcp_v=650.0, gate_ns=1.6e7)),
    Step(
        label="flat",
        kind="flat",
        frames=3,
        conditions=Conditions(mcp_v=700.0, gate_ns=1.6e7, illuminance_lux=1e-4),
    ),
    Step(
        label="edge",
        kind="edge",
        frames=3,
        conditions=Conditions(mcp_v=680.0, gate_ns=1.2e7, illuminance_lux=2e-5),
        target=Target(angle_deg=5.0),
    ),
)

FAST = Override(
    limit="ramp_v_per_s", value=4000.0, reason="the virtual output moves faster than life"
)


OTHERS = InstrumentConfig(
    bench="in-process",
    gate="dg535",
    supply="iseg",
    light="dc2100",
    wheel="fw102c",
    light_meter="pm101",
    thermometer="ctc100",
)
LAMP = LampCalibration(
    source="photometer",
    current_a=(0.01, 1.0),
    illuminance_lux=(1e-2, 1.0),
    relative_sd=(0.03, 0.03),
    filter_density=(0.0, 1.0, 2.0, 3.0, 4.0, 5.0),
)


def taken(folder, wires, lamp=None):
    sensor = load_sensor("pulnix-ag5745ef3")
    small = replace(sensor, ccd=replace(sensor.ccd, rows=61, columns=84))
    folder.mkdir()
    save_sensor(small, folder / "small.toml")
    plan = Plan(
        name="twice",
        sensor=str(folder / "small.toml"),
        seed=5,
        overrides=(FAST,),
        wires=wires,
        lamp=lamp,
        steps=STEPS,
    )
    with VirtualBench(
        folder / "bench", small, plan.seed, wires=wires, lamp=lamp, time_scale=20.0
    ) as rig:
        lines = None
        camera = rig.in_process_camera()
        if inside := rig.inside:
            lines = lines_on(inside.ports, rig.wires)
        elif rig.camera:
            camera = AravisCamera(rig.camera.identifier, silence_s=rig.silence_s)
        out = folder / "session"
        bench = bench_of(plan, out, wires=rig.wires, log=folder / "safety.jsonl", lines=lines)
        session = acquire(plan, out, camera=camera, bench=bench, operator=rig.operator)
        left_open, left_v = rig.outputs().gate_open, rig.outputs().mcp_v
        return session, rig.left_out, left_open, left_v


@pytest.fixture(scope="module")
def inside(tmp_path_factory):
    return taken(tmp_path_factory.mktemp("inside") / "run", InstrumentConfig(bench="in-process"))


def test_a_run_without_wires_is_whole_and_says_what_it_left_out(inside):
    session, left_out, gate_open, mcp_v = inside
    assert [len(entry.read()) for entry in session.stacks] == [3, 3, 3]
    assert "no other process makes the tube safe" in left_out[0]
    assert not gate_open
    assert mcp_v < 5.0


def test_light_and_gain_show_in_the_frames(inside):
    session, *_ = inside
    dark, flat = (session.stack(label).read().data.mean() for label in ("dark", "flat"))
    assert flat > dark + 2.0


def test_a_run_without_wires_gives_the_same_frames_again(inside, tmp_path):
    again, *_ = taken(tmp_path / "again", InstrumentConfig(bench="in-process"))
    for entry in inside[0].stacks:
        assert np.array_equal(again.stack(entry.label).read().data, entry.read().data)


@pytest.mark.wires
@pytest.mark.aravis
@pytest.mark.skipif(
    not aravis_library.is_available(), reason="the Aravis library is not on this machine"
)
def test_a_run_over_real_wires_gives_the_same_frames_as_one_without(inside, tmp_path):
    wired, left_out, gate_open, mcp_v = taken(tmp_path / "wired", InstrumentConfig())
    assert left_out == ()
    assert not gate_open
    assert mcp_v < 5.0
    for entry in inside[0].stacks:
        other = wired.stack(entry.label)
        assert np.array_equal(other.read().data, entry.read().data)
        assert replace(other.conditions, exposure_s=None) == replace(
            entry.conditions, exposure_s=None
        )


def test_the_other_gate_and_supply_with_lamp_wheel_and_meters_make_a_whole_bench(tmp_path):
    session, _, gate_open, mcp_v = taken(tmp_path / "run", OTHERS, LAMP)
    assert [len(entry.read()) for entry in session.stacks] == [3, 3, 3]
    assert not gate_open and mcp_v < 11.0
    dark, flat, edge = (entry.conditions for entry in session.stacks)
    assert (flat.mcp_v, edge.mcp_v) == (
        pytest.approx(700.0, abs=2.0),
        pytest.approx(680.0, abs=2.0),
    )
    assert (dark.lamp_a, flat.lamp_a, flat.filter_density) == (0.0, pytest.approx(1.0), 4.0)
    assert edge.illuminance_lux == pytest.approx(2e-5)
    assert flat.metered_w is not None and edge.metered_w is not None and dark.metered_w is not None
    assert flat.metered_w > 3.0 * edge.metered_w > 3.0 * dark.metered_w
    assert {one.temperature_c for one in (dark, flat, edge)} == {23.4}
    lit, unlit = session.stack("flat").read().data.mean(), session.stack("dark").read().data.mean()
    assert lit > unlit + 3.0


def test_a_virtual_bench_keeps_its_specimen_and_refuses_another_seed(tmp_path):
    sensor = load_sensor("pulnix-ag5745ef3")
    inside = InstrumentConfig(bench="in-process")
    with VirtualBench(tmp_path / "bench", sensor, 5, wires=inside) as first:
        truth = first.truth()
    with VirtualBench(tmp_path / "bench", sensor, 5, wires=inside) as second:
        assert second.truth() == truth
    assert truth.light_per_reading != 1.0
    with (
        pytest.raises(BadInput, match="must keep its seed and sensor"),
        VirtualBench(tmp_path / "bench", sensor, 6, wires=inside),
    ):
        pass
