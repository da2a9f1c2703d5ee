"""The screen of any phosphor: residuals by field, gates shorter than a decay, and steady scenes
left alone.
"""

import numpy as np
import pytest

from labdata import BadInput, load_phosphor
from simulate.camera import PhosphorDecay, StageImage, decay_components, grid

# The screen's decay: residuals of P20 by field, shares of pulses at random times, and steady
# scenes left alone.


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


# Screens other than P20, and gates shorter than a decay: shares of later fields and what they do
# to the noise.


def _glow(name: str, field_s: float, gate_s: float | None = None) -> PhosphorDecay:
    components = decay_components(load_phosphor(name))
    return PhosphorDecay(components=components, gate_s=gate_s or field_s, field_s=field_s)


@pytest.mark.parametrize("name", ["P20", "P43", "P46", "P47"])
@pytest.mark.parametrize("field_s", [1 / 25, 1 / 60, 1e-3])
def test_every_screen_gives_all_its_light_at_any_rate(name, field_s):
    glow = _glow(name, field_s)
    assert glow.weights.sum() == pytest.approx(1.0, abs=1e-12)
    assert glow.weights.min() >= 0.0
    # What is remembered reaches as far as the slow component does.
    exact = _late(glow, glow.n_lag_fields + 1)
    assert exact < grid.ACCURACY.max_lag_fraction


def _late(glow: PhosphorDecay, fields: int) -> float:
    """Share of light later than so many fields, of pulses spread over the gate, by the closed
    integral.
    """
    weight, tau = np.array(glow.components).T
    share = weight * tau
    left = (
        np.exp(-(fields * glow.field_s - glow.gate_s) / tau)
        * -np.expm1(-glow.gate_s / tau)
        * tau
        / glow.gate_s
    )
    return float(left @ (share / share.sum()))


@pytest.mark.parametrize("name", ["P20", "P43", "P46", "P47"])
@pytest.mark.parametrize("gate_s", [1e-9, 1e-6, 1e-4, 1e-2])
def test_gates_shorter_than_a_decay_leave_what_the_closed_integral_says(name, gate_s):
    glow = _glow(name, 0.01668, gate_s)
    for fields in range(1, min(glow.n_lag_fields, 5) + 1):
        assert glow.residuals(5)[fields - 1] == pytest.approx(
            _late(glow, fields), abs=1e-4 + grid.ACCURACY.max_lag_fraction
        )
