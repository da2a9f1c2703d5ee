"""The screen's decay: residuals of P20 by field, shares of pulses at random times, and steady
scenes left alone.
"""

import numpy as np
import pytest

from labdata import BadInput
from simulate.camera import PhosphorDecay, StageImage

FIELD_S = 0.01668


def _p20(gate_s: float = FIELD_S) -> PhosphorDecay:
    return PhosphorDecay(
        components=((0.95, 1.45e-3), (0.05, 35e-3)), gate_s=gate_s, field_s=FIELD_S
    )


def test_early_and_late_halves_have_the_mean_products_of_random_pulses():
    glow = _p20()
    exact = glow.pulse_shares.T @ glow.pulse_shares / len(glow.pulse_shares)
    halves = glow.halves.T @ glow.halves / 2.0
    for lag in (0, 1, 2):
        assert np.trace(halves, lag) == pytest.approx(np.trace(exact, lag), rel=0.01)
    assert glow.halves.min() >= 0.0


def test_pulses_at_random_times_have_those_shares(seed):
    """Against decays of single pulses at random times, not the even ones of the stage."""
    glow = _p20()
    arrival = np.random.default_rng(seed).uniform(0.0, FIELD_S, 40_000)
    tau, share = np.array([1.45e-3, 35e-3]), np.array([0.95 * 1.45, 0.05 * 35.0])
    left = np.exp(-(FIELD_S - arrival)[:, None] / tau) @ (share / share.sum())
    squares = (1.0 - left) ** 2
    expected = np.mean(glow.pulse_shares[:, 0] ** 2)
    assert abs(squares.mean() - expected) < 4.5 * squares.std() / np.sqrt(len(squares))


def test_steady_scene_stays_and_a_flash_decays():
    glow = _p20()
    steady = StageImage(values=np.full((6, 3, 4), 7.0, np.float32))
    assert np.allclose(glow.mean(steady).values, 7.0, rtol=1e-5)
    flash = np.zeros((30, 2, 2), np.float32)
    flash[1] = 1.0
    seen = glow.mean(StageImage(values=flash)).values[:, 0, 0]
    assert seen[0] == 0.0
    assert seen[1 : 1 + glow.n_lag_fields + 1] == pytest.approx(glow.weights, rel=1e-4)
    assert seen.sum() == pytest.approx(1.0, rel=1e-5)


def test_screen_without_decay_keeps_nothing():
    glow = PhosphorDecay(components=((1.0, 0.0),), gate_s=FIELD_S, field_s=FIELD_S)
    assert glow.n_lag_fields <= 1
    assert glow.weights[0] == pytest.approx(1.0, abs=1e-6)


def test_gate_longer_than_a_field_is_refused():
    with pytest.raises(BadInput, match="at most one field"):
        _p20(2 * FIELD_S)
