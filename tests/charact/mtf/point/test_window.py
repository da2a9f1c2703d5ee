"""Windows of a described camera that cut its halo say so."""

import numpy as np
import pytest

from charact import mtf
from charact.method import Context
from charact.study.point.scene import PointScene
from labdata.sensors import load_sensor


@pytest.mark.parametrize("method", ["point-parametric", "point-forward"])
def test_a_window_inside_a_described_halo_is_too_small(method: str) -> None:
    """Its light is then missing from the normalisation: MTF50 comes out high by the halo's share."""
    context = Context(quick=True, sensor=load_sensor("pulnix-ag5745ef3"), interlaced=True)
    stack = PointScene(photoelectrons=3000.0).frames_drawn(np.random.default_rng(1))
    for region, cut in (((30, 30, 37, 37), True), ((0, 0, 96, 96), False)):
        found = mtf.measure("point", stack, method=method, region=region, context=context).measurements
        assert all(("window-too-small" in one.flags) == cut for one in found)


def test_every_form_before_a_described_intensifier_has_a_halo() -> None:
    """Faint as it is beside steps of the digitiser, evidence may prefer none: MTF50 is then surely too high."""
    context = Context(quick=True, sensor=load_sensor("pulnix-ag5745ef3"), interlaced=True)
    stack = PointScene(photoelectrons=300.0, read_dn=0.2).frames_drawn(np.random.default_rng(3))
    found = mtf.measure("point", stack, method="point-parametric", context=context)
    (forms,) = {note for note in found.measurements[0].notes if note.startswith("Blur models by evidence")}
    assert all("halo" in form for form in forms.partition(": ")[2].split(", ")), forms
