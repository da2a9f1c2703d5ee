"""Light of earlier exposures to its end: what few frames hide of it, and how well their sum is
known.
"""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from charact.estimators.noise.gain.pooled_noise import lag_of, lag_sum_correction
from charact.frames.spectrum import bins_of
from charact.frames.temporal import autocovariance, centring, usable_lags


def order(frames: int, fields: int):
    """Times and parities of the exposures, and the lags that they tell."""
    time, parity = np.arange(frames * fields), np.tile(np.arange(fields), frames)
    return time, parity, usable_lags(time, parity, 12)


def level(time, parity, lags, bins=None) -> Any:
    return SimpleNamespace(
        time=time, parity=parity, many_lags=SimpleNamespace(lags=lags), bins=bins
    )


def screen(time, first: float, kept: float):
    """Covariance of exposures of a screen that keeps a share from one exposure to the next after
    the first.
    """
    distance = np.abs(time[:, None] - time[None, :])
    return np.where(distance == 0, 1.0, first * kept ** (distance - 1.0))


@pytest.mark.parametrize(("frames", "fields"), [(13, 1), (17, 1), (12, 2), (25, 1)])
@pytest.mark.parametrize("kept", [0.3, 0.6, 0.75])
def test_what_few_frames_hide_of_an_even_decay_is_put_back(frames, fields, kept):
    time, parity, lags = order(frames, fields)
    project = centring(parity)
    measured = autocovariance(project @ screen(time, 0.28, kept) @ project, time, parity, lags)
    correlation = measured[1:] / measured[0]
    lacking, _ = lag_sum_correction(
        [level(time, parity, lags)], np.ones(1), lags, correlation, 1e-6 * np.eye(len(lags) - 1)
    )
    whole = (1.0 + 2.0 * 0.28 / (1.0 - kept)) / measured[0]
    assert 1.0 + 2.0 * correlation.sum() + lacking == pytest.approx(whole, rel=0.005)


@pytest.mark.parametrize(("frames", "fields"), [(12, 2), (17, 1)])
def test_the_error_of_the_sum_over_lags_is_the_scatter_of_sums(frames, fields, seed):
    """Normal modes of a screen of known decay; 150 stacks scatter as much as each of them says."""
    rng, stacks = np.random.default_rng(seed), 150
    time, parity, lags = order(frames, fields)
    bins = bins_of(144 // fields, 128, float(fields))
    root = np.linalg.cholesky(screen(time, 0.28, 0.6)) / np.sqrt(2.0)
    project = centring(parity)
    found = []
    edges = np.cumsum(2 * bins.modes).astype(int)[:-1]
    for _ in range(stacks):
        modes = rng.standard_normal((int(2 * bins.modes.sum()), len(time))) @ root.T
        products = np.array([part.T @ part / (0.5 * len(part)) for part in np.split(modes, edges)])
        power = autocovariance(project @ products @ project, time, parity, lags)
        found.append(
            lag_of(power, lags, np.zeros(len(power)), [level(time, parity, lags, bins)], np.ones(1))
        )
    factor, told = (
        np.array([getattr(lag, name) for lag in found]) for name in ("factor", "factor_sd")
    )
    scatter = factor.std(ddof=1)
    # Beyond the scatter each says how little it knows of the end of the sum.
    assert 0.88 * scatter < np.sqrt(np.mean(told**2)) < 1.45 * scatter
    assert abs(factor.mean() - 2.4) < 4.0 * scatter / np.sqrt(stacks) + 0.04
