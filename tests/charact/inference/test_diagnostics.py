"""What chains say of themselves, against series whose answer is known."""

import numpy as np
import pytest

from charact.inference import diagnostics


def test_autocorrelation_time_of_an_autoregressive_series_is_its_closed_form(seed):
    """AR(1) with coefficient a has tau = (1 + a) / (1 - a)."""
    rng, a = np.random.default_rng(seed), 0.8
    series = np.zeros((4000, 40, 1))
    series[0, :, 0] = rng.standard_normal(40) / np.sqrt(1 - a**2)
    for step in range(1, 4000):
        series[step, :, 0] = a * series[step - 1, :, 0] + rng.standard_normal(40)
    # Relative error of tau with window M = 5 tau: sqrt(2 (2 M + 1) / N), Sokal 1996.
    assert diagnostics.autocorrelation_time(series)[0] == pytest.approx(
        9.0, rel=4.5 * np.sqrt(2 * 91 / 160000) + 0.01
    )


def test_a_parameter_that_never_moves_has_no_finite_autocorrelation_time():
    chain = np.random.default_rng(1).standard_normal((200, 10, 2))
    chain[:, :, 1] = 3.0
    tau = diagnostics.autocorrelation_time(chain)
    assert np.isfinite(tau[0])
    assert np.isinf(tau[1])


def test_r_hat_is_one_where_chains_agree_and_large_where_one_is_elsewhere():
    chains = np.random.default_rng(2).standard_normal((2, 1000, 8, 1))
    assert diagnostics.ensemble_r_hat(chains)[0] < 1.005
    chains[1] += 1.0
    assert diagnostics.ensemble_r_hat(chains)[0] > 1.05
    drifting = np.linspace(0, 3, 1000)[None, :, None, None] + chains * 0.3
    assert diagnostics.ensemble_r_hat(drifting)[0] > 1.1


@pytest.mark.parametrize("apart", [0.0, 1.0, 6.0])
def test_second_peaks_are_seen_where_a_valley_parts_them(apart, seed):
    rng = np.random.default_rng(seed)
    draws = rng.standard_normal((2000, 2))
    draws[:400] += apart * np.array([0.7, 0.7])
    assert diagnostics.has_several_peaks(draws) == (apart > 5)


def test_walls_far_from_the_draws_are_not_leant_on():
    draws = np.random.default_rng(4).normal(10.0, 1.0, (1000, 1))
    assert not diagnostics.crowds_at_bound(draws, np.array([[0.0, 1e6]])).any()
    assert diagnostics.crowds_at_bound(np.abs(draws - 10.0), np.array([[0.0, 1e6]])).all()
    uniform = np.random.default_rng(5).uniform(0, 1, (4000, 1))
    assert not diagnostics.crowds_at_bound(uniform, np.array([[0.0, 1.0]])).any()
