"""The covariance summed to frequency zero is the gain, whatever blur, lag or pattern does to the
variance.
"""

import numpy as np
import pytest

from charact.estimators import noise
from charact.method import Context
from tests.truth.counted_pulses import QUICK, Pulses, errors, flat_series, gaussian, one


def gaussian_power(sigma_px: float) -> float:
    """Sum of the squared samples' transfer over the band: the share of variance that blur on the
    grid leaves.
    """
    f = np.fft.fftfreq(512)
    return float(np.mean(np.exp(-4.0 * (np.pi * f * sigma_px) ** 2)) ** 2)


@pytest.mark.parametrize("sigma_px", [0.5, 1.0, 2.0])
def test_blur_after_the_gain_lowers_the_variance_but_not_the_covariance_sum(seed, sigma_px):
    camera = Pulses(transfer=gaussian(sigma_px))
    session = flat_series(camera, np.random.default_rng(seed), (4.0, 12.0, 30.0))
    result = noise.measure(session, method="covariance-sum", context=QUICK)
    gain, blur = one(result, "covariance_gain"), one(result, "blur_factor")
    assert gain.status == "ok"
    assert abs(errors(gain, camera.covariance_gain_dn)) < 4.5
    assert abs(errors(blur, gaussian_power(sigma_px))) < 4.5
    assert (gain.interval68[1] - gain.interval68[0]) / 2 < 0.06 * gain.value


def test_variance_alone_reads_the_gain_low_by_the_blur_factor_and_says_so(seed):
    camera = Pulses(transfer=gaussian(1.0))
    session = flat_series(camera, np.random.default_rng(seed), (4.0, 12.0, 30.0))
    gain = one(noise.measure(session, method="variance", context=QUICK), "system_gain")
    # Physics reference, section 10: 0.080 at sigma 1 px.
    assert gain.value / camera.covariance_gain_dn == pytest.approx(0.080, abs=0.004)
    assert gain.status == "suspect" and "correlated-noise" in gain.flags
    refused = one(noise.measure(session, method="covariance-sum", context=QUICK), "system_gain")
    assert refused.status == "refused" and "is correlated" in refused.reason


def test_wings_beyond_any_window_of_lags_are_extrapolated(seed):
    """Johnson's tube form: 17 x 17 lags hold only 95 % of the sum (physics reference, 5.2)."""
    camera = Pulses(transfer=lambda f: np.exp(-((f / 0.35) ** 1.184)))
    session = flat_series(camera, np.random.default_rng(seed), (4.0, 12.0, 30.0))
    result = noise.measure(session, method="covariance-sum", context=QUICK)
    assert abs(errors(one(result, "covariance_gain"), camera.covariance_gain_dn)) < 4.5


def test_a_camera_without_intensifier_has_covariance_gain_equal_to_its_system_gain(seed):
    camera = Pulses(gain_dn=0.0, electron_gain_dn=0.5)
    levels = (400.0, 1500.0, 4000.0, 9000.0)
    session = flat_series(camera, np.random.default_rng(seed), levels, frames=4)
    result = noise.measure(session, method="covariance-sum", context=QUICK)
    for quantity, truth in (("covariance_gain", 0.5), ("system_gain", 0.5), ("blur_factor", 1.0)):
        assert one(result, quantity).status == "ok", quantity
        assert abs(errors(one(result, quantity), truth)) < 4.5, quantity
    electrons = [m for m in result.find("read_noise") if m.unit == "e-"]
    assert abs(errors(electrons[0], 2.0 / 0.5)) < 4.5


def test_light_of_earlier_frames_is_summed_over_lags(seed):
    """A share of each frame's light comes one and two frames late: the variance falls by the sum of
    squares.
    """
    memory = (0.6, 0.25, 0.15)
    camera = Pulses(transfer=gaussian(0.7), memory=memory)
    session = flat_series(camera, np.random.default_rng(seed), (6.0, 15.0, 30.0), frames=16)
    result = noise.measure(session, method="covariance-sum", context=QUICK)
    factor = result.evidence["autocorrelation"]["lag_factor"]
    assert factor == pytest.approx(1.0 / np.sum(np.square(memory)), rel=0.06)
    assert abs(errors(one(result, "covariance_gain"), camera.covariance_gain_dn)) < 4.5
    assert abs(errors(one(result, "blur_factor"), gaussian_power(0.7))) < 4.5


def test_weighted_draws_agree_with_the_curvature_where_the_posterior_is_nearly_normal(seed):
    camera = Pulses(transfer=gaussian(0.7), shape=(90, 180))
    session = flat_series(camera, np.random.default_rng(seed), (10.0, 30.0))
    slow = one(noise.measure(session, context=Context(seed=1)), "covariance_gain")
    fast = one(noise.measure(session, context=QUICK), "covariance_gain")
    assert slow.posterior.sampler == "importance" and not slow.posterior.flags
    width = 0.5 * (fast.interval68[1] - fast.interval68[0])
    assert abs(slow.value - fast.value) < 0.5 * width
    assert 0.5 * (slow.interval68[1] - slow.interval68[0]) == pytest.approx(width, rel=0.35)


def test_the_same_seed_gives_the_same_bytes(seed):
    session = flat_series(
        Pulses(shape=(96, 128)), np.random.default_rng(seed), (5.0, 15.0), frames=4
    )
    first, second = (noise.measure(session, context=QUICK) for _ in range(2))
    assert [m.value for m in first.measurements] == [m.value for m in second.measurements]
