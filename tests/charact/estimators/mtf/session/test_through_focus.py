"""Best focus of a series of targets, and what a series that does not show one is told."""

import numpy as np
import pytest

from charact.estimators.mtf.session.through_focus import through_focus
from charact.method import Context
from charact.session_measurement import measure
from labdata import Conditions, Result
from labdata.measurement import Curve, measurement_from_sd
from tests.truth import EdgeScene, TrueBlur, session_in_memory, stack_in_memory

BEST_MM, SD = 0.13, 0.004
FORMS = {
    "parabola": lambda z: 0.25 - 0.15 * z**2,
    "Lorentzian": lambda z: 0.25 / (1.0 + (z / 0.6) ** 2),
    "squares": lambda z: 0.25 / np.sqrt(1.0 + (z / 0.4) ** 2),
}


def best_focus(positions, mtf50, seed=0):
    """Return the best focus of targets with MTF50 of normal errors."""
    curve = Curve(frequency_cy_per_px=np.arange(2.0), value=np.ones(2))
    labels = [f"{z:.3f}" for z in positions]
    result = Result(
        measurements=tuple(
            measurement_from_sd("mtf50", "cy/px", m, SD, method="edge-free", stack=label)
            for m, label in zip(mtf50, labels, strict=True)
        ),
        curves={f"mtf:{label}": curve for label in labels},
    )
    conditions = {label: Conditions(focus_mm=z) for z, label in zip(positions, labels, strict=True)}
    kinds = dict.fromkeys(labels, "edge")
    return through_focus(result, kinds, conditions, Context(seed=seed)).measurements[0]


@pytest.mark.parametrize("form", FORMS)
def test_intervals_hold_the_best_focus_of_every_form(form):
    rng, positions, trials, held = np.random.default_rng(3), np.linspace(-1.0, 1.0, 7), 150, 0
    widths = []
    for seed in range(trials):
        best = rng.uniform(-0.4, 0.4)
        found = best_focus(positions, FORMS[form](positions - best) + rng.normal(0.0, SD, 7), seed)
        low, high = found.interval95
        held += low <= best <= high
        widths.append(high - low)
    assert np.mean(widths) < 0.1
    # Four standard errors of a binomial of 95 % below; 99.5 % is too wide.
    assert 0.95 - 4.0 * np.sqrt(0.95 * 0.05 / trials) < held / trials <= 0.995


@pytest.mark.parametrize(
    ("positions", "words"),
    [
        ([-0.5, 0.0, 0.5], "4 positions of focus, got 3"),
        ([-1.0, -0.7, -0.4, -0.1, 0.1], "at its end, 0.1 mm"),
    ],
)
def test_a_series_that_shows_no_peak_is_refused(positions, words):
    refused = best_focus(np.array(positions), FORMS["squares"](np.array(positions) - BEST_MM))
    assert refused.status == "refused" and words in refused.reason


def test_edges_through_focus_have_one_best_focus_and_no_joint_mtf():
    """Defocus as a Gaussian blur of 2 px per mm beside .7 px."""
    rng = np.random.default_rng(1)
    stacks = []
    for z in np.linspace(-0.8, 0.8, 5):
        blur = TrueBlur(sigma_px=float(np.hypot(0.7, 2.0 * (z - BEST_MM))))
        scene = EdgeScene(blur=blur, rows=80, cols=80, snr=60.0, frames=2)
        at = Conditions(focus_mm=float(z))
        stacks.append(stack_in_memory("edge", scene.frames_drawn(rng), at, label=f"z{z:.1f}"))
    result = measure(session_in_memory(stacks), quick=True)
    (found,) = result.find("best_focus")
    low, high = found.interval95
    assert found.status == "ok" and low < BEST_MM < high and high - low < 0.1
    assert not any(m.stack is None for m in result.find("mtf50"))
    assert len(result.evidence["focus:edge along rows"]["focus_mm"]) == 5
