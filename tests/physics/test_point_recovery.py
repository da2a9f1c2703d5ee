"""The MTF of the simulated intensified camera comes back from its picture of a pinhole, with honest
intervals.
"""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators.mtf.point.forward import point_forward
from charact.estimators.mtf.point.parametric import point_parametric
from charact.method import Context
from labdata import Conditions, Target, load_sensor
from simulate import LabBench
from simulate.camera import true_quantities
from simulate.virtual_bench import true_sensor

FAINT_LUX, OPEN_GATE_NS = 3e-3, 1.6e7


@pytest.fixture(scope="module")
def specimen(seed):
    """A specimen nobody chose, on a smaller chip."""
    drawn = true_sensor.draw_true_sensor(load_sensor("pulnix-ag5745ef3"), seed)
    return replace(drawn, ccd=replace(drawn.ccd, rows=200, columns=200))


@pytest.fixture(scope="module")
def bench(specimen):
    return LabBench(specimen)


def measured(bench, seed, illuminance_lux, method=point_forward):
    conditions = Conditions(mcp_v=800.0, gate_ns=OPEN_GATE_NS, illuminance_lux=illuminance_lux)
    frames = bench.expose("point", Target(pinhole_px=1.0), conditions, frames=8, seed=seed)
    # The description of the type, not of the specimen: only the sheet is known.
    context = Context(
        quick=True, camera=load_sensor("pulnix-ag5745ef3"), interlaced=True, full_scale_dn=255.0
    )
    return method(frames, region=(20, 20, 160, 160), pinhole_px=1.0, context=context)


@pytest.fixture(scope="module")
def faint(bench, seed):
    """The result of a pinhole that saturates nothing."""
    return measured(bench, seed, FAINT_LUX)


def test_mtf_of_a_pinhole_is_the_camera_s_in_both_directions(faint, specimen):
    for angle in (0.0, 90.0):
        for quantity, share in (("mtf50", 0.5), ("mtf10", 0.1)):
            (found,) = faint.find(quantity, orientation_deg=angle)
            expected = true_quantities.true_crossing_frequency(specimen, share, angle)
            error = (found.interval95[1] - found.interval95[0]) / 3.92
            assert abs(found.value - expected) < 4.5 * error
            assert found.value == pytest.approx(expected, rel=0.3 if share == 0.5 else 0.1)


def test_curves_of_a_pinhole_hold_the_true_mtf(faint, specimen):
    for name, direction in (("mtf", "horizontal"), ("mtf_vertical", "vertical")):
        curve = faint.curves[name]
        expected = true_quantities.true_mtf(specimen, curve.frequency_cy_per_px, direction)
        half = np.maximum((curve.interval95[1] - curve.interval95[0]) / 2, 1e-3)
        assert np.all(np.abs(curve.value - expected) < 2.5 * half)


@pytest.mark.parametrize("method", [point_forward, point_parametric])
@pytest.mark.parametrize("illuminance_lux", [0.015, 0.03])
def test_a_source_far_too_bright_is_never_ok(bench, seed, illuminance_lux, method):
    """The wells are full before the digitiser is, and the video filter moves what they cut off: 26
    to 43 % low.
    """
    assert all(
        m.status != "ok" for m in measured(bench, seed, illuminance_lux, method).measurements
    )
