"""Predicted MTF curves are those of edges in both directions, of pixels that are not square."""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators import mtf
from charact.fitting.mtf_observations import Points
from charact.fitting.prior import values_of_description
from charact.method import Context
from labdata import Conditions, FrameStack, Target, load_camera
from simulate.lab import LabBench
from tests.truth.sessions import stack_in_memory


@pytest.mark.parametrize("angle_deg", [5.0, 95.0, 265.0])
def test_the_mtf_of_an_edge_is_predicted_along_its_normal(angle_deg: float, seed: int) -> None:
    """The pulnix camera's rows are 1.18 column pitches apart."""
    camera = load_camera("pulnix-ag5745ef3")
    camera = replace(camera, ccd=replace(camera.ccd, rows=200, columns=260))
    assert camera.pitch_ratio > 1.15
    known = Conditions(mcp_v=800.0, gate_ns=1.6e7, exposure_s=0.0167, illuminance_lux=2e-4)
    target = Target(angle_deg=angle_deg)
    mean_dn = LabBench(camera).mean("edge", target, known)
    noise = 0.2 * np.random.default_rng(seed).standard_normal((2, *mean_dn.shape))
    frames = FrameStack(data=(mean_dn + noise).astype(np.float32))
    context = Context(camera=camera, interlaced=False, quick=True)
    result = mtf.measure("edge", frames, method="edge-slanted", context=context)
    curve = result.curves["mtf"]
    entry = stack_in_memory("edge", frames, known, target=target)
    shown = np.interp([0.1, 0.2, 0.3], curve.frequency_cy_per_px, curve.value)
    points = Points(
        camera=camera, frequency=np.array([0.1, 0.2, 0.3]), angle_deg=angle_deg, entry=entry
    )
    predicted = points.mtf(values_of_description(camera))[0]
    print(shown, predicted)
    assert shown == pytest.approx(predicted, abs=0.03)
