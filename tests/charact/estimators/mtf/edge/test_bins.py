"""Bins of an edge: wider ones hold what the narrow ones held, and cost a noisy edge nothing."""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators.mtf import PreparedEdge, edge_parametric, prepare_edge
from charact.estimators.mtf.edge import thresholds
from charact.estimators.mtf.edge.pixels import profile
from charact.method import Context
from tests.truth import EdgeScene, TrueBlur

QUICK = Context(quick=True)
SCENE = EdgeScene(
    blur=TrueBlur(sigma_px=0.8),
    rows=120,
    cols=80,
    angle_deg=7.0,
    dark_dn=1000.0,
    bright_dn=2000.0,
    shot_share=0.0,
    full_scale_dn=65535.0,
)


def drawn(snr: float, seed: int):
    rng = np.random.default_rng([seed, round(snr)])
    return replace(SCENE, snr=snr, offset_px=float(rng.uniform(-2, 2))).frames_drawn(rng)


def found(snr: float, seed: int) -> PreparedEdge:
    edge = prepare_edge(drawn(snr, seed), None, QUICK)
    assert isinstance(edge, PreparedEdge)
    return edge


@pytest.mark.parametrize(("snr", "wide"), [(5.0, True), (30.0, False)])
def test_bins_are_as_narrow_as_the_noise_lets_them_tell_anything(snr, wide, seed):
    edge = prepare_edge(drawn(snr, seed), None, QUICK, quickly=True)
    assert isinstance(edge, PreparedEdge)
    assert (edge.profile.distance.size < 0.6 * found(snr, seed).profile.distance.size) == wide


def test_wider_bins_move_a_noisy_edge_by_a_small_part_of_its_error(seed, monkeypatch):
    """Six edges at a step of 6 standard deviations: the same number within a sixth of its error, on
    average none.
    """
    moved = []
    for number in range(6):
        stack = drawn(6.0, 100 * seed + number)
        monkeypatch.setattr(
            profile, "THRESHOLDS", replace(thresholds.THRESHOLDS, noisy_step_sd=8.0)
        )
        wide = edge_parametric(stack, context=QUICK).find("mtf50")[0]
        monkeypatch.setattr(
            profile, "THRESHOLDS", replace(thresholds.THRESHOLDS, noisy_step_sd=0.0)
        )
        narrow = edge_parametric(stack, context=QUICK).find("mtf50")[0]
        half = (narrow.interval68[1] - narrow.interval68[0]) / 2
        moved.append((wide.value - narrow.value) / half)
    assert np.std(moved) < 0.17
    assert abs(np.mean(moved)) < 0.1
