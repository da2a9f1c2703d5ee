"""Noise reduction that follows the picture: noise stays where an edge is steep and goes from its
plateaus.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, median_filter

from charact.estimators import mtf
from charact.estimators.mtf import edge_findings, prepare_edge
from charact.method import Context
from tests.truth import EdgeScene, PulseEdge, TrueBlur

QUICK = Context(quick=True)
EDGE = EdgeScene(frames=8, snr=25.0, rows=90, cols=90)
PULSES = PulseEdge(
    blur=TrueBlur(sigma_px=1.0), photoelectrons=2.0, frames=12, rows=80, cols=80, angle_deg=6.0
)


def median(frames):
    return median_filter(frames, (1, 3, 3))


def coring(frames):
    """Detail below one and a half deviations of the noise is taken off."""
    low = gaussian_filter(frames, (0, 1.0, 1.0))
    return low + np.sign(frames - low) * np.maximum(np.abs(frames - low) - 9.0, 0.0)


@pytest.mark.parametrize("method", ["edge-parametric", "edge-free", "edge-forward", "edge-slanted"])
@pytest.mark.parametrize("filtered", [median, coring, None], ids=["median", "coring", "none"])
def test_every_method_says_that_noise_was_reduced(method, filtered, seed):
    """By `edge-free` MTF50 was up to 23 % off, ok."""
    stack = EDGE.frames_drawn(np.random.default_rng(seed))
    if filtered:
        stack = replace(stack, data=np.rint(filtered(stack.data.astype(float))).astype(np.uint8))
    found = mtf.measure("edge", stack, method=method, context=QUICK).measurements[0]
    assert ("processed" in found.flags) == bool(filtered)


@pytest.mark.parametrize(
    "scene",
    [
        EDGE,
        replace(EDGE, snr=200.0),
        replace(EDGE, noise_blur_px=0.9),
        replace(EDGE, jitter_px=0.05),
        replace(EDGE, jitter_px=0.5),
        PULSES,
        replace(PULSES, flicker=0.2),
        replace(PULSES, row_noise_dn=6.0),
        replace(PULSES, jitter_px=0.4),
        replace(PULSES, lag=0.3),
    ],
    ids=[
        "light",
        "little noise",
        "tied",
        "trembling",
        "shaken",
        "pulses",
        "flicker",
        "row noise",
        "moving",
        "lag",
    ],
)
def test_noise_of_light_is_not(scene, seed):
    """The ratio is one where pixels are independent, and smaller where they are tied."""
    for number in range(2):
        edge = prepare_edge(scene.frames_drawn(np.random.default_rng([seed, number])), None, QUICK)
        assert not any(
            finding.flag == "processed"
            for finding in edge_findings(edge, np.nan, QUICK, np.inf, np.inf)
        )
        if scene is EDGE:
            ratio = edge.slope_noise
            assert ratio.ratio == pytest.approx(1.0, abs=4.5 * ratio.sd)
