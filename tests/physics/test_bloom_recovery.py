"""The halo of simulated specimens is found again, and is as wide at any light."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from charact import bloom
from charact.method import Context
from labdata.conditions import Conditions
from labdata.frames import FrameStack
from labdata.sensors import load_sensor
from labdata.session import Session, StackEntry
from labdata.target import Target
from simulate.iiccd import truth
from simulate.iiccd.camera import IntensifiedCamera
from simulate.lab import LabBench
from simulate.rig.truth import draw_truth

ROWS, COLUMNS = 200, 260
SETTINGS = Conditions(mcp_v=800.0, gate_ns=1.6e7)
# Two decades of light in which the halo stands out and does not saturate.
LIGHTS_LUX = (3e-4, 3e-2, 0.3, 3.0)
LIGHTS_TO_TIRE_LUX = tuple(float(lux) for lux in np.geomspace(1e-3, 30.0, 9))


@dataclass(frozen=True, kw_only=True)
class HeldStack(StackEntry):
    """A stack that lies in memory."""

    held: FrameStack

    def read(self) -> FrameStack:
        return self.held


def series(sensor, lights_lux, seed, *, frames, depletes=False):
    """A point series of a specimen, in memory."""
    bench = LabBench(sensor)
    bench.camera = replace(bench.camera, local_depletion=depletes)
    stacks = []
    for index, lux in enumerate(lights_lux):
        conditions = replace(SETTINGS, illuminance_lux=lux)
        held = bench.expose("point", Target(pinhole_px=1.0), conditions, frames=frames, seed=100 * seed + index)
        label = f"point-{index}"
        stacks.append(
            HeldStack(label=label, kind="point", frames="", conditions=conditions, folder=Path("."), held=held)
        )
    return Session(folder=Path("."), name="simulated", stacks=tuple(stacks), interlaced=True)


def specimen(sheet, seed, **values):
    drawn = draw_truth(sheet, seed)
    return replace(drawn, ccd=replace(drawn.ccd, rows=ROWS, columns=COLUMNS)).with_values(
        {"photocathode.halo_fraction": 0.1, "photocathode.halo_elastic_share": 0.3, **values}
    )


def test_the_halo_is_four_gaps_wide_over_two_decades_of_light(seed):
    sheet = load_sensor("pulnix-ag5745ef3")
    sensor = specimen(sheet, seed)
    session = series(sensor, LIGHTS_LUX, seed, frames=8)
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


def test_a_plate_that_tires_in_its_bright_cores_tells_its_saturation_and_the_gap(seed):
    """The strip current limits a place: density, share of the halo and gap from one series of over three decades."""
    sheet = load_sensor("pulnix-ag5745ef3")
    sensor = specimen(sheet, seed)
    session = series(sensor, LIGHTS_TO_TIRE_LUX, seed, frames=12, depletes=True)
    context = Context(seed=1, quick=True, sensor=sheet, interlaced=True, full_scale_dn=255.0)
    result = bloom.measure(session, method="series-forward", context=context)
    camera = IntensifiedCamera(sensor)
    plate = camera.plate(SETTINGS)
    at_half_gain_pe = plate.saturation_e_per_s_cm2 * plate.field_s * truth.field_pixel_area_cm2(camera) / plate.gain
    density_dn = at_half_gain_pe * truth.quantities(sensor, SETTINGS)["photoelectron_gain"]
    (found,) = result.find("plate_saturation_density")
    assert abs(found.value - density_dn) < 0.25 * density_dn
    assert abs(found.value - density_dn) < 4.5 * 0.5 * (found.interval68[1] - found.interval68[0])
    (halo,) = result.find("halo_diameter")
    gap_mm = halo.value / 4e3 * float(sensor.ccd.pitch_x_um) * float(sensor.taper.demagnification)
    assert abs(gap_mm - float(sensor.photocathode.gap_mm)) < 0.03 * float(sensor.photocathode.gap_mm)
    (share,) = result.find("halo_fraction")
    assert abs(share.value - 0.1) < 4.5 * 0.5 * (share.interval68[1] - share.interval68[0])
