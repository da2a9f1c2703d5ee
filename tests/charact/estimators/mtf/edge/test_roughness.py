"""An edge that wanders along its length: told by its rows' places, beside what noise makes of
them.
"""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators import mtf
from charact.estimators.mtf import prepare_edge
from charact.method import Context
from tests.truth import EdgeScene, PulseEdge, TrueBlur

QUICK = Context(quick=True)
ROUGH = EdgeScene(blur=TrueBlur(sigma_px=1.3), frames=4, snr=25.0, roughness_px=0.7)
PULSES = PulseEdge(
    blur=TrueBlur(sigma_px=1.0), photoelectrons=2.0, frames=12, rows=80, cols=80, angle_deg=6.0
)


@pytest.mark.parametrize("method", ["edge-parametric", "edge-free", "edge-forward", "edge-slanted"])
@pytest.mark.parametrize("roughness_px", [0.0, 0.7])
def test_every_method_says_that_the_edge_is_rough(method, roughness_px, seed):
    """0.7 px rms lower MTF50 by a seventh and more: the interval reaches to the straight edge's."""
    scene = replace(ROUGH, roughness_px=roughness_px)
    found = mtf.measure(
        "edge", scene.frames_drawn(np.random.default_rng(seed)), method=method, context=QUICK
    )
    told = found.measurements[0]
    assert any(note.startswith("curved-edge: ") for note in told.notes) == (roughness_px > 0)
    assert told.interval95[0] < scene.truth_mtf50 < told.interval95[1] or told.status != "ok"


@pytest.mark.parametrize("angle_deg", [5.0, 96.0, 205.0])
def test_how_rough_is_the_scatter_of_its_course(angle_deg, seed):
    """0.3 px rms along the normal, within a fifth: rows average what they see of it."""
    scene = replace(ROUGH, roughness_px=0.3, roughness_length_px=4.0, angle_deg=angle_deg)
    found = prepare_edge(scene.frames_drawn(np.random.default_rng(seed)), None, QUICK).roughness
    assert found.moves
    assert found.rms_px == pytest.approx(0.3, rel=0.2)


@pytest.mark.parametrize(
    "scene",
    [
        replace(ROUGH, roughness_px=0.0),
        replace(ROUGH, roughness_px=0.0, frames=1, noise_blur_px=0.9, snr=10.0),
        replace(ROUGH, roughness_px=0.0, frames=16, snr=400.0),
        replace(ROUGH, roughness_px=0.0, blur=TrueBlur(sigma_px=0.4), snr=100.0),
        PULSES,
        replace(PULSES, row_noise_dn=6.0),
        replace(PULSES, lag=0.3),
    ],
    ids=["noise", "tied noise", "rounding", "sharp", "pulses", "row noise", "lag"],
)
def test_straight_edges_are_straight(scene, seed):
    found = [
        prepare_edge(scene.frames_drawn(np.random.default_rng([seed, n])), None, QUICK).roughness
        for n in range(3)
    ]
    assert not any(one.moves and one.mtf_loss(scene.truth_mtf50) > 1e-4 for one in found), found
