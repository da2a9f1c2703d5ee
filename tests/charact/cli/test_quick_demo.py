"""What a quick demonstration leaves out, and what its loops cost a new machine."""

import numpy as np
import pytest

from charact.cli.demo_loop import demo_plan
from labdata import Conditions, Target
from labdata.sensors import load_sensor
from simulate.camera.fast_sampler.charge_rows import charge_rows
from simulate.camera.fast_sampler.phosphor_rows import find_cells
from simulate.camera.fast_sampler.single_pulses import SparseLight
from simulate.lab import LabBench


def test_a_quick_plan_is_part_of_the_demonstration_with_all_its_kinds():
    quick, full = (demo_plan(3, quick=quick) for quick in (True, False))
    labels = [step.label for step in full.steps]
    kept = [labels.index(step.label) for step in quick.steps]
    assert kept == sorted(kept) and len(kept) < len(labels)
    assert {step.kind for step in quick.steps} == {step.kind for step in full.steps}
    assert max(step.frames for step in quick.steps) < max(step.frames for step in full.steps)
    assert quick.seed == full.seed == 3


@pytest.mark.parametrize("kind", ["dark", "flat", "edge"])
def test_rows_of_charge_are_compiled_once_for_a_camera(kind):
    camera = load_sensor("pulnix-ag5745ef3")
    before = set(charge_rows.signatures)
    bench = LabBench(camera)
    conditions = Conditions(illuminance_lux=2e-4, mcp_v=800.0, gate_ns=1.6e7)
    bench.expose(kind, Target(angle_deg=5.0), conditions, frames=1, seed=1)
    # Codes of cameras of other bit depths are of another type.
    of_bytes = [form for form in charge_rows.signatures if "uint8" in str(form[-1])]
    assert len(of_bytes) == 1 and len(set(charge_rows.signatures) - before) <= 1


@pytest.mark.parametrize("expected", [(0.3, 0.0, 1e-6, 2.0, 0.0, 0.7, 0.0), (0.0, 0.0, 5.0)])
def test_the_search_for_the_cell_of_a_pulse_begins_before_no_wrong_one(expected):
    light = object.__new__(SparseLight)
    object.__setattr__(light, "expected", np.array(expected, np.float32))
    sums = np.linspace(0.0, light.cumulative_pe[-1], 1001, endpoint=False)
    cells = np.searchsorted(light.cumulative_pe, sums, side="right")
    assert (find_cells(sums, light.cumulative_pe, light.guide) == cells).all()
