"""A target that moves from frame to frame: told by how its lines stand, and what it costs."""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators import mtf
from charact.estimators.mtf import TargetMotion, measure_target_motion, prepare_edge, thresholds
from charact.method import Context
from tests.truth import BarScene, EdgeScene, PointScene, PulseEdge, TrueBlur, level_crossing

QUICK = Context(quick=True)
PULSES = PulseEdge(
    blur=TrueBlur(sigma_px=1.0), photoelectrons=2.0, frames=12, rows=80, cols=80, angle_deg=6.0
)
POINT = PointScene(
    blur=TrueBlur(sigma_px=0.8), pulse_px=0.5, photoelectrons=3000.0, frames=12, rows=64, cols=64
)
BARS = BarScene(frames=8, frequency_cy_per_px=0.15)


def first(kind, stack, **asked):
    return mtf.measure(kind, stack, context=QUICK, **asked).measurements[0]


def test_places_at_rest_are_told_apart_from_motion_as_often_as_promised(seed):
    """Of 2,000 stacks at rest one in a hundred has a chance below a hundredth, and hardly one
    moves.
    """
    rng = np.random.default_rng(seed)
    chances = np.array(
        [measure_target_motion(0.1 * rng.standard_normal((8, 64))).chance for _ in range(2000)]
    )
    below = np.mean(chances < 0.01)
    assert below == pytest.approx(0.01, abs=4.0 * np.sqrt(0.01 * 0.99 / 2000))
    assert np.sum(chances < thresholds.LIMITS.motion_p_value) <= 3


@pytest.mark.parametrize("lines", [12, 64])
def test_how_far_is_the_scatter_of_the_places(lines, seed):
    """Motion of 0.2 px beneath noise of 0.1 px a line: mean square within four standard errors, and
    told.
    """
    rng, stacks = np.random.default_rng(seed), 200
    found = []
    for _ in range(stacks):
        moved = 0.2 * rng.standard_normal(8)
        left = measure_target_motion(
            moved[:, None] + 0.1 * rng.standard_normal((8, lines)) + rng.standard_normal(lines)
        )
        found.append((left.rms_px**2 - np.var(moved), left.moves))
    apart, moves = np.array(found).T
    assert apart.mean() == pytest.approx(0.0, abs=4.0 * apart.std() / np.sqrt(stacks))
    assert moves.mean() > (0.95 if lines > 40 else 0.5)


@pytest.mark.parametrize(
    "scene",
    [
        PULSES,
        replace(PULSES, flicker=0.2),
        replace(PULSES, row_noise_dn=6.0),
        replace(PULSES, lag=0.3),
    ],
    ids=["at rest", "flicker", "row noise", "lag"],
)
def test_an_edge_at_rest_stays_there(scene, seed):
    found = [
        prepare_edge(
            scene.frames_drawn(np.random.default_rng([seed, n])), None, QUICK
        ).target_motion
        for n in range(2)
    ]
    assert not any(one.moves and one.mtf_loss(scene.truth_mtf50) > 0.003 for one in found), found


@pytest.mark.parametrize("angle_deg", [6.0, 96.0, 200.0])
def test_an_edge_that_moves_is_told_by_as_much_as_it_moves(angle_deg, seed):
    """0.4 px along the rows: across an edge by its cosine, as the drawn places have it, within a
    tenth or 0.04 px.
    """
    scene = replace(PULSES, angle_deg=angle_deg, jitter_px=0.4)
    found = prepare_edge(scene.frames_drawn(np.random.default_rng(seed)), None, QUICK).target_motion
    drawn = 0.4 * np.random.default_rng(seed).standard_normal(scene.frames)
    across = float(np.std(drawn)) * abs(np.cos(np.deg2rad(angle_deg)))
    assert found.rms_px == pytest.approx(across, rel=0.1, abs=0.04)


def test_motion_lowers_mtf50_by_as_much_as_is_said():
    """Gaussians: the mean of frames blurred by their own places, by the product of transfers."""
    blur, moved = TrueBlur(sigma_px=1.2), 0.3
    at_rest = blur.mtf50(0.0)
    blurred = level_crossing(
        lambda f: blur.mtf(f, 0.0) * np.exp(-2.0 * (np.pi * f * moved) ** 2), 0.5
    )
    # The slope of a Gaussian with its pixel is steeper than one: at most half as much is lost.
    assert 0.5 < (1.0 - blurred / at_rest) / TargetMotion(rms_px=moved).mtf_loss(at_rest) < 1.0


@pytest.mark.parametrize("method", ["edge-parametric", "edge-free", "edge-slanted"])
@pytest.mark.parametrize("jitter_px", [0.0, 0.5])
def test_every_method_for_edges_says_that_the_edge_moves(method, jitter_px, seed):
    scene = EdgeScene(frames=6, rows=80, cols=80, snr=25.0, jitter_px=jitter_px, angle_deg=5.0)
    found = mtf.measure(
        "edge", scene.frames_drawn(np.random.default_rng(seed)), method=method, context=QUICK
    )
    told = found.measurements[0]
    assert any(note.startswith("drift: ") for note in told.notes) == (jitter_px > 0)
    assert told.interval95[0] < scene.truth_mtf50 < told.interval95[1] or told.status != "ok"


def test_bars_say_that_they_move(seed):
    stack = replace(BARS, jitter_px=0.7).frames_drawn(np.random.default_rng(seed))
    found = first("bars", stack, bars=4, frequency_cy_per_px=0.15)
    assert any(note.startswith("drift: ") for note in found.notes)
    assert found.interval95[0] < BARS.truth_mtf < found.interval95[1]


@pytest.mark.parametrize(
    ("method", "jitter_px"),
    [
        ("point-parametric", 0.0),
        ("point-parametric", 0.5),
        ("point-forward", 0.5),
        ("point-spread", 0.5),
    ],
)
def test_points_say_that_they_move(method, jitter_px, seed):
    stack = replace(POINT, jitter_px=jitter_px).frames_drawn(np.random.default_rng(seed))
    found = mtf.measure("point", stack, method=method, context=QUICK).measurements[0]
    assert ("drift" in found.flags) == (jitter_px > 0)
