"""A measured vector of the simulated kind passes as often as it should, and one of another kind does not."""

import numpy as np

from charact.validation.frame_features import Features, compare

SIZE, DRAWS, REPEATED = 5, 12, 499


def _vectors(rng: np.random.Generator, spread: float, count: int) -> list[Features]:
    """Vectors with correlated sampling errors whose mean one parameter of the posterior moves."""
    root = np.linalg.cholesky(0.5 * np.eye(SIZE) + 0.5)
    out = []
    for _ in range(count):
        value = root @ rng.standard_normal(SIZE) + spread * rng.standard_normal() * np.linspace(0.5, 1.5, SIZE)
        errors = rng.standard_normal((15, SIZE)) @ root.T
        out.append(Features(value=value, covariance=errors.T @ errors / 15, freedom=15))
    return out


def _p_values(seed: int, spread: float, shift: float = 0.0, count: int = 60) -> np.ndarray:
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(count):
        measured, *simulated = _vectors(rng, spread, DRAWS + 1)
        moved = Features(value=measured.value + shift, covariance=measured.covariance, freedom=15)
        out.append(compare(moved, simulated, rng=rng, replicates=REPEATED).p_value)
    return np.array(out)


def test_a_right_sensor_is_seldom_refused_however_wide_its_posterior(seed: int) -> None:
    p_values = [_p_values(seed, spread) for spread in (0.0, 5.0)]
    for p in p_values:
        # At most 1 % below 0.01 and 4.5 standard errors.
        assert np.mean(p < 0.01) < 0.01 + 4.5 * np.sqrt(0.01 * 0.99 / p.size)
    assert 0.3 < np.mean(p_values[0]) < 0.8
    assert np.mean(p_values[0] < 0.5) > 0.15


def test_a_shift_of_twelve_standard_errors_is_refused(seed: int) -> None:
    # The least that so many repetitions can tell.
    assert np.all(_p_values(seed, 0.0, shift=12.0, count=30) < 1.5 / REPEATED)
