"""Points of a described camera: windows that cut its halo say so, and the drawn model lies on the
rings.
"""

import numpy as np
import pytest

from charact.estimators import mtf
from charact.method import Context
from labdata import load_sensor
from tests.truth.blur import TrueBlur
from tests.truth.point import PointScene

CONTEXT = Context(quick=True, camera=load_sensor("pulnix-ag5745ef3"), interlaced=True)


@pytest.mark.parametrize("method", ["point-parametric", "point-forward"])
def test_a_window_inside_a_described_halo_is_too_small(method: str) -> None:
    """Its light is then missing from the normalisation: MTF50 comes out high by the halo's
    share.
    """
    stack = PointScene(photoelectrons=3000.0).frames_drawn(np.random.default_rng(1))
    for region, cut in (((30, 30, 37, 37), True), ((0, 0, 96, 96), False)):
        found = mtf.measure(
            "point", stack, method=method, region=region, context=CONTEXT
        ).measurements
        assert all(("window-too-small" in one.flags) == cut for one in found)


def test_every_form_before_a_described_intensifier_has_a_halo() -> None:
    """Faint as it is beside steps of the digitiser, evidence may prefer none: MTF50 is then surely
    too high.
    """
    stack = PointScene(photoelectrons=300.0, read_dn=0.2).frames_drawn(np.random.default_rng(3))
    found = mtf.measure("point", stack, method="point-parametric", context=CONTEXT)
    (forms,) = {
        note for note in found.measurements[0].notes if note.startswith("Blur models by evidence")
    }
    assert all("halo" in form for form in forms.partition(": ")[2].split(", ")), forms


FAINT_HALO = TrueBlur(form="exponential", frequency_cy_per_px=0.35, exponent=1.15)


@pytest.mark.parametrize("method", ["point-parametric", "point-forward"])
def test_rings_lie_on_the_model_where_rounding_hides_faint_light(method: str, seed: int) -> None:
    """Black between codes, noise of 0.15 DN: whatever the level of the fit, its rings are those of
    the pixels.
    """
    scene = PointScene(
        blur=FAINT_HALO,
        photoelectrons=300.0,
        peak_dn=120.0,
        background=0.003,
        read_dn=0.15,
        frames=16,
        black_dn=12.3,
    )
    stack = scene.frames_drawn(np.random.default_rng(seed))
    shown = mtf.measure("point", stack, method=method, context=CONTEXT).evidence["point-profile"]
    off = (np.array(shown["ring_dn"]) - shown["ring_model_dn"]) / shown["ring_sd_dn"]
    assert float(np.mean(off**2)) < 4.0, off
