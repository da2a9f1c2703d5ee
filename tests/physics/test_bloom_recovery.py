"""The halo of simulated specimens is found again, and is as wide at any light."""

from dataclasses import dataclass, replace
from pathlib import Path

from charact import bloom
from charact.method import Context
from labdata.conditions import Conditions
from labdata.frames import FrameStack
from labdata.sensors import load_sensor
from labdata.session import Session, StackEntry
from labdata.target import Target
from simulate.iiccd import truth
from simulate.lab import LabBench
from simulate.rig.truth import draw_truth

ROWS, COLUMNS = 200, 260
SETTINGS = Conditions(mcp_v=800.0, gate_ns=1.6e7)
# Two decades of light in which the halo stands out and does not saturate.
LIGHTS_LUX = (3e-4, 3e-2, 0.3, 3.0)


@dataclass(frozen=True, kw_only=True)
class HeldStack(StackEntry):
    """A stack that lies in memory."""

    held: FrameStack

    def read(self) -> FrameStack:
        return self.held


def test_the_halo_is_four_gaps_wide_over_two_decades_of_light(seed):
    sheet = load_sensor("pulnix-ag5745ef3")
    drawn = draw_truth(sheet, seed)
    sensor = replace(drawn, ccd=replace(drawn.ccd, rows=ROWS, columns=COLUMNS)).with_values(
        {"photocathode.halo_fraction": 0.1, "photocathode.halo_elastic_share": 0.3}
    )
    bench = LabBench(sensor)
    stacks = []
    for index, lux in enumerate(LIGHTS_LUX):
        conditions = replace(SETTINGS, illuminance_lux=lux)
        held = bench.expose("point", Target(pinhole_px=1.0), conditions, frames=8, seed=100 * seed + index)
        label = f"point-{index}"
        stacks.append(
            HeldStack(label=label, kind="point", frames="", conditions=conditions, folder=Path("."), held=held)
        )
    session = Session(folder=Path("."), name="simulated", stacks=tuple(stacks), interlaced=True)
    context = Context(seed=1, quick=True, sensor=sheet, interlaced=True, full_scale_dn=255.0)
    result = bloom.measure(session, method="series-forward", context=context)
    (halo,) = result.find("halo_diameter")
    low, high = halo.interval68
    known = truth.quantities(sensor, SETTINGS)["halo_diameter"]
    assert halo.status == "ok"
    assert abs(halo.value - known) < 4.5 * 0.5 * (high - low)
    assert 0.5 * (high - low) < 0.02 * known
    levels = result.evidence["halo-constancy"]
    assert {"point-1", "point-3"} <= set(levels["label"])
    for own, (below, above) in zip(levels["halo_diameter_px"], levels["interval95_px"], strict=True):
        assert abs(own - known) < 4.5 * (above - below) / 3.92
