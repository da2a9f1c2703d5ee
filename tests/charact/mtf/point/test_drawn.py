"""The model that the report draws lies on what it draws of the pixels."""

import numpy as np
import pytest

from charact import mtf
from charact.method import Context
from charact.study.edge.scene import TrueBlur
from charact.study.point.scene import PointScene
from labdata.sensors import load_sensor

HALO = TrueBlur(form="exponential", frequency_cy_per_px=0.35, exponent=1.15)


@pytest.mark.parametrize("method", ["point-parametric", "point-forward"])
def test_rings_lie_on_the_model_where_rounding_hides_faint_light(method: str, seed: int) -> None:
    """Black between codes, noise of 0.15 DN: whatever the level of the fit, its rings are those of the pixels."""
    context = Context(quick=True, sensor=load_sensor("pulnix-ag5745ef3"), interlaced=True)
    for number in range(3):
        scene = PointScene(
            blur=HALO, photoelectrons=300.0, peak_dn=120.0, background=0.003, read_dn=0.15, frames=16, black_dn=12.3
        )
        stack = scene.frames_drawn(np.random.default_rng([seed, number]))
        shown = mtf.measure("point", stack, method=method, context=context).evidence["point-profile"]
        off = (np.array(shown["ring_dn"]) - shown["ring_model_dn"]) / shown["ring_sd_dn"]
        assert float(np.mean(off**2)) < 4.0, off
