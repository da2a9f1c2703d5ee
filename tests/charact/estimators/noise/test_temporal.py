"""Covariance in time from few exposures, whose mean had to be taken away first."""

import numpy as np
import pytest

from charact.frames.temporal import autocovariance, centring, n_effective_samples

LAGS = np.arange(4)
TRUTH = np.array([1.0, 0.5, 0.2, 0.1])


def covariance(time):
    gap = np.abs(time[:, None] - time)
    return np.where(gap < len(TRUTH), TRUTH[np.minimum(gap, len(TRUTH) - 1)], 0.0)


@pytest.mark.parametrize("interlaced", [False, True])
def test_the_expectation_is_the_truth_whatever_the_mean_took_away(interlaced):
    time = np.arange(14)
    parity = time % 2 if interlaced else np.zeros(14, int)
    project = centring(parity)
    found = autocovariance(project @ covariance(time) @ project, time, parity, LAGS)
    assert found == pytest.approx(TRUTH, abs=1e-12)


def test_a_lost_frame_leaves_the_expectation_alone():
    time = np.delete(np.arange(14), 5)
    parity = np.zeros(13, int)
    project = centring(parity)
    found = autocovariance(project @ covariance(time) @ project, time, parity, LAGS)
    assert found == pytest.approx(TRUTH, abs=1e-12)


def test_without_lag_n_frames_count_as_n_minus_one():
    time, parity = np.arange(9), np.zeros(9, int)
    assert n_effective_samples(time, parity, np.zeros(1, int), np.empty(0)) == pytest.approx(8.0)
