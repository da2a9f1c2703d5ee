"""The plain slanted-edge estimator on edges of closed form, and what it cannot do told;
`test_burns` has a real one.
"""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators import mtf
from charact.method import Context
from labdata import FrameStack
from tests.truth import EdgeScene, TrueBlur

PLAIN = EdgeScene(
    blur=TrueBlur(sigma_px=0.9),
    rows=120,
    cols=100,
    dark_dn=600.0,
    bright_dn=2100.0,
    black_dn=0.0,
    full_scale_dn=4095.0,
    shot_share=0.5,
)


def measured(stack):
    return mtf.measure("edge", stack, method="edge-slanted", context=Context(quick=True))


def test_a_clean_edge_is_its_closed_form(seed):
    rng = np.random.default_rng(seed)
    for angle in (5.0, 95.0, 186.0):
        scene = replace(PLAIN, angle_deg=angle, snr=300.0)
        found = measured(scene.frames_drawn(rng)).find("mtf50")[0]
        assert found.value == pytest.approx(scene.truth_mtf50, rel=0.02)
        assert found.interval95[0] < scene.truth_mtf50 < found.interval95[1]


def test_the_colour_plane_measured_is_on_record():
    stack = FrameStack(data=PLAIN.mean()[None], plane="b")
    assert all(m.provenance.settings["plane"] == "b" for m in measured(stack).measurements)


def test_noise_is_refused_and_a_weak_edge_never_trusted(seed):
    rng = np.random.default_rng(seed)
    noise = measured(FrameStack(data=rng.normal(900.0, 100.0, (1, 90, 90))))
    assert all(m.status == "refused" for m in noise.measurements)
    weak = replace(PLAIN, rows=90, cols=90, dark_dn=900.0, bright_dn=1400.0, snr=5.0)
    assert all(m.status != "ok" for m in measured(weak.frames_drawn(rng)).measurements)


def test_uneven_light_is_told(seed):
    scene = replace(PLAIN, cols=120, gradient=0.3, snr=100.0)
    found = measured(scene.frames_drawn(np.random.default_rng(seed)))
    assert "gradient" in found.find("mtf50")[0].flags
