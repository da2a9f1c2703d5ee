"""The plain ways to a halo's diameter: a plateau of diameters, a step of the profile, a Gaussian without an edge."""

import numpy as np
import pytest

from charact import bloom
from charact.method import Context
from charact.study.bloom.scene import session
from charact.study.bloom.source import BloomScene

QUICK = Context(seed=1, quick=True)
SERIES = (0.3, 30.0, 3e3, 1e5)


def halo(scene, method, seed, overloads=SERIES):
    rng = np.random.default_rng(seed)
    (found,) = bloom.measure(session(scene, overloads, rng), method=method, context=QUICK).find("halo_diameter")
    return found


@pytest.mark.parametrize("method", ["threshold", "radial-profile"])
@pytest.mark.parametrize("diameter_px", [30.0, 46.0])
def test_the_diameter_lies_in_the_interval(method, diameter_px, seed):
    found = halo(BloomScene(halo_diameter_px=diameter_px), method, seed)
    assert found.status == "ok"
    assert found.interval95 is not None
    assert found.interval95[0] - 1.0 < diameter_px < found.interval95[1] + 1.0


@pytest.mark.parametrize("wing_share", [0.0, 0.1])
@pytest.mark.parametrize("overloads", [SERIES, (0.6, 1e4, 1e5), (3.0, 30.0, 1e3, 1e5, 1e6)])
def test_cores_and_wings_grow_without_step_and_plateau(wing_share, overloads, seed):
    """D^2 of a Gaussian core is a line of ln light, a wing's bends upward: neither is taken for a halo."""
    scene = BloomScene(halo_fraction=0.0, wing_share=wing_share)
    assert halo(scene, "threshold", seed, overloads).status == "refused"


def test_a_plateau_needs_levels_and_their_light(seed):
    assert halo(BloomScene(), "threshold", seed, (3e3, 1e5)).status == "refused"


def test_a_gaussian_is_never_trusted(seed):
    for scene in (BloomScene(), BloomScene(halo_elastic_share=1.0)):
        found = halo(scene, "gaussian", seed, (300.0, 600.0))
        assert found.status == "refused" or "model-misfit" in found.flags
