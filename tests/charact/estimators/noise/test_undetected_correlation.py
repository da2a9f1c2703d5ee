"""What lowers a variance without showing in it is found, or is in the interval, or is said to be
beyond the frames.
"""

import numpy as np
import pytest

from charact.estimators import noise
from labdata import FrameStack
from tests.truth.counted_pulses import (
    METHODS,
    QUICK,
    Pulses,
    errors,
    flat_series,
    memory_of,
    one,
    session_of,
)

ELECTRONS = (400.0, 1500.0, 4000.0)


@pytest.fixture
def ccd():
    """A camera without intensifier, K = 0.5 DN."""
    return lambda **more: Pulses(gain_dn=0.0, electron_gain_dn=0.5, **more)


@pytest.mark.parametrize("smoothing_px", [0.3, 0.7])
def test_a_little_smoothing_lowers_the_variance_and_is_seen(ccd, seed, smoothing_px):
    """At 0.3 px a neighbour holds 0.8 % of the noise, and the variance is 3 % low."""
    session = flat_series(ccd(smoothing_px=smoothing_px), np.random.default_rng(seed), ELECTRONS)
    plain = one(noise.measure(session, method="variance", context=QUICK), "system_gain")
    assert plain.value < 0.98 * 0.5
    assert "correlated-noise" in plain.flags
    summed = noise.measure(session, method="covariance-sum", context=QUICK)
    # The gain of the standard is given as it is, with what it lacks and with the one that lacks
    # nothing.
    assert "correlated-noise" in one(summed, "system_gain").flags
    assert one(summed, "system_gain").value < 0.98 * 0.5
    assert abs(errors(one(summed, "covariance_gain"), 0.5)) < 4.5


@pytest.mark.parametrize("frames", [2, 3, 8])
def test_a_camera_that_hides_nothing_is_not_accused(ccd, seed, frames):
    session = flat_series(ccd(), np.random.default_rng(seed), (*ELECTRONS, 8000.0), frames=frames)
    for method in METHODS:
        gain = one(noise.measure(session, method=method, context=QUICK), "system_gain")
        assert gain.status == "ok", method
        assert abs(errors(gain, 0.5)) < 4.5
        assert (gain.interval68[1] - gain.interval68[0]) / 2 < 0.04 * 0.5


@pytest.mark.parametrize(("share", "frames"), [(0.05, 8), (0.2, 3), (0.2, 2), (0.8, 16)])
def test_light_that_stays_in_the_next_frames_never_passes_unseen(seed, share, frames):
    session = flat_series(
        Pulses(memory=memory_of(share), shape=(144, 160)),
        np.random.default_rng(seed),
        (5.0, 15.0, 30.0),
        frames=frames,
    )
    for method in METHODS:
        result = noise.measure(session, method=method, context=QUICK)
        gain = one(result, "system_gain")
        told = (*gain.flags, *gain.notes)
        assert gain.status == "refused" or any(text.startswith("lag") for text in told), method
        for found in result.find("covariance_gain"):
            assert found.status != "ok" or abs(errors(found, Pulses().covariance_gain_dn)) < 4.5


def test_frames_that_come_twice_are_lag(ccd, seed):
    session = flat_series(ccd(), np.random.default_rng(seed), ELECTRONS, frames=4)
    twice = session_of(
        [
            (s.label, s.kind, FrameStack(data=np.repeat(s.read().data, 2, axis=0)), s.conditions)
            for s in session.stacks
        ]
    )
    for method in METHODS:
        assert "lag" in one(noise.measure(twice, method=method, context=QUICK), "system_gain").flags


def test_what_a_handful_of_pixels_cannot_exclude_is_in_the_interval(ccd, seed):
    session = flat_series(ccd(shape=(6, 8)), np.random.default_rng(seed), ELECTRONS)
    gain = one(noise.measure(session, method="variance", context=QUICK), "system_gain")
    assert gain.status == "ok" and gain.interval95[0] < 0.5 < gain.interval95[1]
    assert np.ptp(gain.interval95) > 0.1 * gain.value


def test_codes_that_pile_up_are_the_end_of_the_range_though_nobody_told(ccd, seed):
    """A camera of 12 bits in words of 16: the topmost level is cut at 4095."""
    camera = ccd(full_scale_dn=4095.0)
    session = flat_series(
        camera, np.random.default_rng(seed), (1500.0, 3000.0, 5000.0, 7930.0), frames=6
    )
    untold = session_of(
        [(s.label, s.kind, FrameStack(data=s.read().data), s.conditions) for s in session.stacks]
    )
    result = noise.measure(untold, method="variance", context=QUICK)
    assert result.evidence["photon-transfer"]["fitted"] == [True, True, True, False]
    assert abs(errors(one(result, "system_gain"), 0.5)) < 4.5
