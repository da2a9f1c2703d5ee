"""The gradient estimator of edges: slopes of light have the transform of the blur, and little
noise.
"""

import numpy as np
import pytest

from benchmarks.studies.edge_coverage import measure_mixed_scene
from benchmarks.studies.edge_peers import answers
from charact.estimators import mtf
from charact.method import Context
from labdata import FrameStack
from tests.truth import EdgeScene, TrueBlur

QUICK = Context(quick=True)


LEVELS = {"dark_dn": 1000.0, "bright_dn": 3000.0, "black_dn": 0.0, "full_scale_dn": 4095.0}


def measured(frame):
    return mtf.measure("edge", FrameStack(data=frame[None]), method="edge-gradient", context=QUICK)


@pytest.mark.parametrize("angle_deg", [3.3, -7.0, 97.0])
@pytest.mark.parametrize("sigma_px", [0.5, 1.5])
def test_without_noise_the_curve_is_the_transform_of_the_blur(sigma_px, angle_deg):
    """Within 0.4 %: where rows step by nearly an eighth of a pixel, as at 7 degrees, bins are
    filled unevenly.
    """
    pose = {"rows": 128, "cols": 96, "angle_deg": angle_deg, "offset_px": 0.3}
    scene = EdgeScene(blur=TrueBlur(sigma_px=sigma_px), **pose, **LEVELS)
    result = measured(scene.mean())
    found, curve = result.find("mtf50")[0], result.curves["mtf"]
    assert found.value == pytest.approx(scene.truth_mtf50, rel=4e-3)
    assert found.status == "ok"
    away = curve.value - scene.blur.mtf(curve.frequency_cy_per_px, angle_deg)
    assert np.sqrt(np.mean(away**2)) < 4e-3


def test_light_outside_the_window_of_the_blur_counts():
    """A tube's tails: a tool that normalises to a window this narrow reads 4 % too much."""
    blur = TrueBlur(form="exponential", frequency_cy_per_px=0.25, exponent=1.1)
    scene = EdgeScene(blur=blur, rows=128, cols=128, **LEVELS)
    found = measured(scene.mean()).find("mtf50")[0]
    assert found.value == pytest.approx(scene.truth_mtf50, rel=0.012)


def test_it_stands_noise_better_than_a_differentiated_profile(seed):
    """On the same frames; reference: 2.7 % for the gradient tool and 5.3 % for the profile tool at
    a step of 10 sd.
    """
    wanted = dict.fromkeys(("edge-gradient", "edge-slanted"), seed + 14)
    trials = [trial for one in range(14) for trial in answers(seed + one, 10.0, wanted)]
    rms = {
        name: np.sqrt(
            np.mean([trial.relative_error**2 for trial in trials if trial.method == name])
        )
        for name in ("edge-gradient", "edge-slanted")
    }
    # 2.5 standard errors of an RMS of 14.
    assert rms["edge-gradient"] < 0.031 * (1 + 2.5 / np.sqrt(28))
    assert rms["edge-gradient"] < rms["edge-slanted"]


@pytest.mark.parametrize("method", ["edge-gradient", "edge-slanted"])
def test_plain_intervals_hold_where_noise_makes_the_response_uneven(method, seed):
    """Mixed blurs, noises and light; three standard errors of a share of about 20 are 15 points at
    95 %.
    """
    trials = [trial for one in range(32) for trial in measure_mixed_scene(seed + one, (method,))]
    sure = [trial for trial in trials if trial.status == "ok"]
    assert len(sure) > 12
    assert np.mean([trial.covers95 for trial in sure]) > 0.95 - 0.15
    assert not any(trial.silent for trial in trials)


def test_noise_alone_is_refused(seed):
    frame = 900.0 + 100.0 * np.random.default_rng(seed).standard_normal((90, 90))
    assert all(m.status == "refused" for m in measured(frame).measurements)
