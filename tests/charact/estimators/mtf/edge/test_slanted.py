"""The plain slanted-edge estimator on edges of closed form, and what it cannot do told;
`test_burns` has a real one.
"""

import numpy as np
import pytest

from charact.estimators import mtf
from charact.method import Context
from labdata import FrameStack
from tests.truth import gaussian_edges as edges


def measured(stack):
    return mtf.measure("edge", stack, method="edge-slanted", context=Context(quick=True))


def test_a_clean_edge_is_its_closed_form(seed):
    rng = np.random.default_rng(seed)
    for angle in (5.0, 95.0, 186.0):
        mean = edges.mean_edge(120, 100, angle_deg=angle, dark=600.0, bright=2100.0)
        found = measured(edges.noisy(mean, rng, snr=300.0, step=1500.0)).find("mtf50")[0]
        assert found.value == pytest.approx(edges.frequency_at(0.5, 0.9, angle), rel=0.02)
        assert found.interval95[0] < edges.frequency_at(0.5, 0.9, angle) < found.interval95[1]


def test_the_colour_plane_measured_is_on_record():
    stack = FrameStack(data=edges.mean_edge(120, 100, dark=600.0, bright=2100.0)[None], plane="b")
    assert all(m.provenance.settings["plane"] == "b" for m in measured(stack).measurements)


def test_noise_is_refused_and_a_weak_edge_never_trusted(seed):
    rng = np.random.default_rng(seed)
    noise = measured(edges.noisy(np.full((90, 90), 900.0), rng, snr=5.0, step=500.0))
    assert all(m.status == "refused" for m in noise.measurements)
    mean = edges.mean_edge(90, 90, dark=900.0, bright=1400.0)
    assert all(
        m.status != "ok" for m in measured(edges.noisy(mean, rng, snr=5.0, step=500.0)).measurements
    )


def test_uneven_light_is_told(seed):
    mean = edges.mean_edge(120, 120, dark=600.0, bright=2100.0, gradient=0.3)
    found = measured(edges.noisy(mean, np.random.default_rng(seed), snr=100.0, step=1500.0)).find(
        "mtf50"
    )[0]
    assert "gradient" in found.flags
