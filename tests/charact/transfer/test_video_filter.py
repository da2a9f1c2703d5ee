"""A video's low pass of a bandwidth known within a range: its transfer at any bandwidth, and what
is left to find.
"""

import numpy as np
import pytest

from charact.transfer import VideoFilter, powers
from labdata import load_sensor

CLOCK_MHZ, ORDER = 14.318, 3
SHEET = load_sensor("pulnix-ag5745ef3")


def sampled(frequency, bandwidth_mhz):
    """The filter's transfer from its analogue one: stairs one clock wide, read once a clock,
    replicas summed.
    """
    at = np.asarray(frequency)[:, None] + np.arange(-400, 401)
    s = 1j * at * CLOCK_MHZ / bandwidth_mhz
    return np.sum(np.sinc(at) * np.exp(-1j * np.pi * at) / ((1.0 + s) * (1.0 + s + s**2)), axis=1)


def without_delay(transfer, frequency):
    """Modulus, and the phase less what a delay explains, from a frequency near none."""
    phase = np.unwrap(np.angle(transfer))
    return np.abs(transfer), phase - frequency * phase[0] / frequency[0]


@pytest.mark.parametrize("bandwidth_mhz", [5.9, 6.2, 6.5, 6.8, 7.1])
def test_the_transfer_of_another_bandwidth_is_that_of_the_described_one_bent(bandwidth_mhz):
    video, frequency = VideoFilter.of(SHEET), np.concatenate([[1e-4], np.linspace(0.02, 0.5, 25)])
    bent = (
        video(frequency) * np.exp(powers(np.log([bandwidth_mhz / 6.5])) @ video.bend(frequency))[0]
    )
    (modulus, phase), (true_modulus, true_phase) = (
        without_delay(one, frequency) for one in (bent, sampled(frequency, bandwidth_mhz))
    )
    assert modulus == pytest.approx(true_modulus, abs=0.001)
    assert phase == pytest.approx(true_phase, abs=0.003)


def test_a_described_range_is_a_prior_and_an_exact_or_digital_video_leaves_nothing_to_find():
    video = VideoFilter.of(SHEET)
    bandwidth = SHEET.video.bandwidth_mhz
    assert video.ln_bandwidth_sd * 6.5 * 2 * 1.96 == pytest.approx(
        bandwidth.high - bandwidth.low, rel=1e-3
    )
    assert set(video.parameters) == {"ln_video_bandwidth"}
    x = np.linspace(*video.parameters["ln_video_bandwidth"][1], 4001)
    assert np.trapezoid(np.exp(video.log_prior(x)), x) == pytest.approx(1.0, abs=1e-4)
    exact = SHEET.with_values({"video.bandwidth_mhz": 6.5})
    assert VideoFilter.of(exact).parameters == {}
    assert VideoFilter.of(None) is None
    assert VideoFilter.of(load_sensor("gen3-digital-iccd")) is None
