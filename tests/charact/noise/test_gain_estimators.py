"""Covariance gains without a model of the blur: complete where the blur is compact, honest where it has wings."""

from dataclasses import replace

import numpy as np
import pytest

from charact import noise
from charact.method import Context
from charact.noise.gain.lag_window import binned, windowed
from charact.noise.gain.reach import settled
from charact.study.flats.stacks import FlatScene

METHODS = ("covariance-window", "binning", "spectrum-plateau", "spectrum-parabola")


def scene(**more):
    return FlatScene(rows=128, cols=160, frames=12, photoelectrons=(4.0, 8.0, 16.0), **more)


def gain_by(method, session):
    (gain,) = noise.measure(session, method=method, context=Context(quick=True)).find("covariance_gain")
    return gain


@pytest.fixture(scope="module")
def compact(seed):
    return scene(blur_px=0.6).session_drawn(np.random.default_rng(seed))


@pytest.fixture(scope="module")
def winged(seed):
    return scene(blur_px=0.5, wings_cy_per_px=0.35).session_drawn(np.random.default_rng(seed))


@pytest.mark.parametrize("method", METHODS)
def test_compact_blur_leaves_the_gain_whole(method, compact):
    gain, truth = gain_by(method, compact), scene().truth_covariance_gain
    low, high = gain.interval68 or (0.0, 0.0)
    assert gain.status == "ok"
    assert gain.value is not None and abs(gain.value - truth) < 4.5 * 0.5 * (high - low)
    assert gain.value == pytest.approx(truth, rel=0.12)


def test_light_that_frames_share_is_not_lost_with_their_mean(seed):
    """A share of .4 a frame late: the mean of 16 frames takes nearly two frames' worth of noise with it, not one."""
    session = replace(scene(blur_px=0.4), lag=0.4, frames=16).session_drawn(np.random.default_rng(seed))
    gain = gain_by("covariance-window", session)
    low, high = gain.interval68 or (0.0, 0.0)
    assert abs((gain.value or 0.0) - scene().truth_covariance_gain) < 4.5 * 0.5 * (high - low)
    assert gain.value == pytest.approx(scene().truth_covariance_gain, rel=0.06)


@pytest.mark.parametrize("method", METHODS)
def test_wings_that_are_left_out_are_in_the_interval(method, winged):
    gain = gain_by(method, winged)
    low, high = gain.interval95 or (0.0, 0.0)
    assert low < scene().truth_covariance_gain < high
    assert (gain.value or 0.0) > 0.6 * scene().truth_covariance_gain


def test_every_estimator_gives_what_the_covariance_sum_gives(compact):
    names = [
        {m.quantity for m in noise.measure(compact, method=method, context=Context(quick=True)).measurements}
        for method in ("covariance-sum", "binning")
    ]
    assert names[0] == names[1]


def test_a_window_of_lags_is_short_by_its_share_of_the_frame(seed):
    """Noise of one variance whose exposures' means are gone: n of N lags hold v (1 - n/N)."""
    rng = np.random.default_rng(seed)
    noise_dn = rng.standard_normal((400, 48, 48), dtype=np.float32)
    change = noise_dn - noise_dn.mean(axis=(1, 2), keepdims=True)
    tile = windowed(change, [1, 4]) / 400
    for index, count in enumerate((9, 81)):
        error = tile[:, index].std(ddof=1) / np.sqrt(len(tile))
        assert tile[:, index].mean() == pytest.approx(1.0 - count / 48**2, abs=4.5 * error)
    # The wider one is noisier by the root of its lags.
    assert tile[:, 1].std() / tile[:, 0].std() == pytest.approx(3.0, rel=0.5)


def test_superpixels_of_white_noise_have_its_variance_over_their_area(seed):
    white = np.random.default_rng(seed).standard_normal((100, 64, 80), dtype=np.float32)
    tile = binned(white, [1, 2, 4, 8]) / 100
    error = np.sqrt(2 * np.array([1, 4, 16, 64]) / white.size)
    assert tile.shape == (80, 4)
    assert np.all(np.abs(tile.mean(axis=0) - 1.0) < 4.5 * error)


def test_the_data_say_how_far_to_reach():
    """Where steps bring nothing the first certain value is taken; where they do, a later one, with what is left out."""
    sure = np.diag([1e-4, 2e-4, 1e-2])
    value, sd = settled(np.array([1.0, 1.01, 1.1]), sure)
    assert value == 1.01 and sd < 0.025
    value, sd = settled(np.array([0.5, 0.8, 0.95]), sure)
    assert value == 0.95 and sd > 0.8 * 0.15
