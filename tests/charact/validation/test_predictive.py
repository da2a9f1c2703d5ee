"""Sets of the simulated kind pass as often as stated, others do not, and several tests hold one
level.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from charact.validation import VALIDATION, ensemble

SIZE, SETS = 6, 16
ROOT = np.linalg.cholesky(0.5 * np.eye(SIZE) + 0.5)


@pytest.fixture(autouse=True)
def few_replicates(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ensemble, "VALIDATION", replace(VALIDATION, replicates=1000))


def _ensemble(rng: np.random.Generator) -> ensemble.Ensemble:
    values = rng.standard_normal((SETS, SIZE)) @ ROOT.T
    return ensemble.Ensemble(values=values, least_sd=np.zeros(SIZE), seed=int(rng.integers(2**31)))


def _p_values(seed: int, shift: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    return np.array(
        [_ensemble(rng).p_value(rng.standard_normal(SIZE) @ ROOT.T + shift) for _ in range(count)]
    )


def test_p_values_of_right_simulations_are_uniform(seed: int) -> None:
    p_values = _p_values(seed, np.zeros(SIZE), 200)
    for at in (0.05, 0.2, 0.5, 0.8):
        share = np.mean(p_values < at)
        error = 4.5 * np.sqrt(at * (1.0 - at) / p_values.size)
        assert share < at + error
        # Halved correlations make p-values of correlated numbers larger, by up to a tenth.
        assert share > at - error - 0.1 * at


@pytest.mark.parametrize("shift", [np.full(SIZE, 12.0), 12.0 * np.eye(SIZE)[2]], ids=["all", "one"])
def test_a_shift_of_twelve_standard_deviations_is_refused(
    seed: int, shift: NDArray[np.float64]
) -> None:
    # The least p-value that a thousand replicates give is 0.001.
    assert np.all(_p_values(seed, shift, 20) < 0.003)


def test_an_error_of_one_number_of_forty_is_found_where_chi_squared_is_usual(seed: int) -> None:
    """Seven standard deviations of one number are a chi-squared that 40 usual numbers often
    exceed.
    """
    rng = np.random.default_rng(seed)
    one = ensemble.Ensemble(
        values=rng.standard_normal((SETS, 40)), least_sd=np.zeros(40), seed=seed
    )
    moved = one.values.mean(axis=0) + 7.0 * np.eye(40)[7] * one.sd
    assert np.mean(one.null[:, 0, 0] >= 40.0 * one.distance(moved) ** 2) > 0.02
    assert one.p_value(moved) < 0.005


def test_the_most_deviating_of_several_places_fails_no_more_often_than_stated(seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = [rng.standard_normal((5, SIZE)) @ ROOT.T for _ in range(100)]
    p_values = np.array([_ensemble(rng).p_value(own) for own in places])
    for at in (0.05, 0.2, 0.5):
        assert np.mean(p_values < at) < at + 4.5 * np.sqrt(at * (1.0 - at) / p_values.size)
    # One place of five that is far outside is as plain as one of one.
    one = _ensemble(rng)
    moved = places[0] + 20.0 * np.eye(5)[3][:, None] * one.sd
    assert one.p_value(moved) < 0.003


def test_a_number_that_one_set_lacks_is_left_out_and_a_constant_one_has_its_least_spread() -> None:
    sets = [{"a": float(i), "b": 2.0, "c": np.nan if i == 3 else 1.0} for i in range(SETS)]
    labels, found = ensemble.ensemble_of(sets, 0.5, 1)
    assert labels == ("a", "b")
    assert found.sd[1] == pytest.approx(0.5 * np.sqrt(1.0 + 1.0 / SETS), rel=1e-9)
    assert found.z_scores(np.array([7.5, 4.0]))[1] == pytest.approx(
        4.0 / np.sqrt(1.0 + 1.0 / SETS), rel=1e-9
    )


def test_holm_refuses_in_order_of_p_until_one_passes() -> None:
    """p-values of 0.005 and 0.01 fail at 0.05 / 4 and 0.05 / 3, 0.03 passes 0.05 / 2 and so does
    all above it.
    """
    p_values = (0.01, 0.04, 0.03, 0.005)
    levels = ensemble.holm_levels(p_values, 0.05)
    assert [p < level for p, level in zip(p_values, levels, strict=True)] == [
        True,
        False,
        False,
        True,
    ]
    assert [levels[i] for i in (3, 0, 2)] == pytest.approx([0.05 / 4, 0.05 / 3, 0.05 / 2])
