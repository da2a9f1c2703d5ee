"""The conventional SFR beside another method's MTF: the stated causes account for the
difference.
"""

import numpy as np
import pytest

from charact.estimators import mtf
from charact.estimators.mtf.curve import REPORTED, crossing_frequency
from charact.estimators.mtf.edge.sfr_comparison import shifts_of_mtf50
from charact.method import Context
from labdata import BadInput, Curve, FrameStack
from tests.truth import EdgeScene, TrueBlur

QUICK = Context(quick=True)
TUBE = {"form": "exponential", "frequency_cy_per_px": 0.25, "exponent": 1.184}


def compared(scene):
    frames = scene.frames_drawn(np.random.default_rng(5))
    return mtf.measure("edge", frames, also="sfr", context=QUICK)


@pytest.mark.parametrize(
    ("blur", "cols"),
    [
        (TrueBlur(**TUBE), 100),
        (TrueBlur(**{**TUBE, "frequency_cy_per_px": 0.15}), 90),
        (TrueBlur(sigma_px=0.6), 60),
    ],
)
def test_window_bins_and_noise_account_for_the_difference(blur, cols):
    scene = EdgeScene(blur=blur, rows=100, cols=cols, snr=200.0, frames=4)
    result = compared(scene)
    (ours,), (sfr50,) = result.find("mtf50"), result.find("sfr50")
    (difference,) = result.find("sfr50_difference")
    percent = 100.0 * (sfr50.value / ours.value - 1.0)
    assert difference.value == pytest.approx(percent)
    half_window_px = sfr50.provenance.settings["half_window_px"]
    causes = shifts_of_mtf50(result.curves["mtf"], result.curves["sfr"], half_window_px)
    # What is left is noise of both, of some .2 % here.
    assert sum(causes.values()) == pytest.approx(percent, abs=0.6)
    assert ("within" if abs(percent) < difference.interval95[1] - percent else "beyond") in (
        difference.notes[0]
    )


def test_a_window_sharpens_a_blur_with_tails_as_its_integral_does():
    """Moffat of exponent 1.5 across a line, L = a^2 / 2 (x^2 + a^2)^-1.5, whose MTF is 2 pi f a
    K1(2 pi f a): the windowed transform by direct integration.
    """
    from scipy.special import k1

    width_px, half_px = 1.2, 12.0
    argument = 2.0 * np.pi * np.maximum(REPORTED, 1e-9) * width_px
    curve = Curve(frequency_cy_per_px=REPORTED, value=argument * k1(argument))
    x = np.linspace(-half_px, half_px, 40001)
    light = 0.5 * width_px**2 * (x**2 + width_px**2) ** -1.5
    light *= 0.54 + 0.46 * np.cos(np.pi * x / half_px)
    seen = np.cos(2.0 * np.pi * np.outer(REPORTED, x)) @ light
    before, after = crossing_frequency(REPORTED, np.stack([curve.value, seen / seen[0]]), 0.5)
    shift = shifts_of_mtf50(curve, curve, half_px)["Hamming window of ±12 px"]
    assert shift == pytest.approx(100.0 * (after / before - 1.0), abs=0.05)
    assert shift > 3.0


def test_an_sfr_of_nothing_else_is_one_sentence():
    frames = FrameStack(data=np.zeros((1, 60, 60)))
    with pytest.raises(BadInput, match="`also` must be sfr, of an edge, got 'sfr' of kind 'bars'"):
        mtf.measure("bars", frames, also="sfr", context=QUICK)
    scene = EdgeScene(rows=60, cols=60).frames_drawn(np.random.default_rng(1))
    with pytest.raises(BadInput, match="`also` must be another estimate"):
        mtf.measure("edge", scene, also="sfr", method="edge-slanted", context=QUICK)
    nothing = mtf.measure("edge", frames, also="sfr", context=QUICK)
    assert {m.status for m in nothing.measurements} == {"refused"}
