"""Transfer functions and the spreads they stand for, against closed forms; a video's low pass of a
bandwidth known within a range.
"""

import math

import numpy as np
import pytest
from scipy.special import kv

from charact.estimators.mtf.edge.fit import esf_from_mtf
from charact.transfer import VideoFilter, aperture, halo, powers, spreads
from labdata import load_sensor

ERF = np.vectorize(math.erf)
DISTANCE = np.concatenate(
    [np.arange(-12.0, 12.0, 0.125), np.arange(-100.0, -12.0, 1.0), np.arange(12.0, 100.0, 1.0)]
)


@pytest.fixture(scope="module")
def weights():
    grid = esf_from_mtf.nodes(fine=True)
    even, _ = esf_from_mtf.edge_weights(grid, DISTANCE, np.zeros_like(DISTANCE))
    return grid, even


def test_edge_spread_of_a_gaussian_transfer_is_the_error_function(weights):
    grid, even = weights
    for sigma in (0.5, 1.0, 3.0):
        expected = 0.5 * ERF(DISTANCE / sigma / np.sqrt(2))
        assert np.abs(even @ np.exp(-2 * (np.pi * grid * sigma) ** 2) - expected).max() < 2e-4


def test_edge_spread_of_the_halo_is_its_ramp(weights):
    """A shell's shadow has a box for a line spread (Archimedes); uniform energies sum boxes of all
    widths.
    """
    grid, even = weights
    for diameter, share in ((47.0, 1.0), (47.0, 0.0), (60.0, 0.3)):
        blurred = halo(np.pi * diameter * grid, np.array(share)) * np.exp(
            -2 * (np.pi * grid * 1.0) ** 2
        )
        # A ramp, and for uniform energies x (1 - ln|x|)/2, x = d/R.
        x = np.clip(2.0 * DISTANCE / diameter, -1.0, 1.0)
        expected = 0.5 * x * (share + (1.0 - share) * (1.0 - np.log(np.maximum(np.abs(x), 1e-12))))
        away = (np.abs(DISTANCE) > 5) & (np.abs(np.abs(DISTANCE) - diameter / 2) > 4)
        # Uniform energies bend the ramp everywhere a little; the blur of the test feels that.
        assert np.abs(even @ blurred - expected)[away].max() < 5e-4 + 3e-3 * (1 - share)


def test_halo_transfer_at_low_frequency_follows_its_second_moment():
    """1 - 2 (pi f)^2 <d^2>: boxes of half width R have <d^2> = R^2/3; uniform energies R^2/9."""
    f, radius = np.array([1e-3]), 23.5
    for share, moment in ((1.0, radius**2 / 3), (0.0, radius**2 / 9)):
        drop = 1 - halo(np.pi * 2 * radius * f, np.array(share))[0]
        assert drop == pytest.approx(2 * (np.pi * f[0]) ** 2 * moment, rel=0.02)


@pytest.mark.parametrize("exponent", [1.1, 1.105, 1.5, 2.5, 4.0])
def test_the_transfer_of_a_moffat_wing_is_its_hankel_transform(exponent):
    """2^(1-m)/Gamma(m) x^m K_m(x), m = b - 1 and x = 2 pi a f; exp(-x) at b = 3/2."""
    frequency, radius = np.concatenate([[0.0], np.geomspace(1e-4, 1.25, 200)]), 3.0
    x, order = 2.0 * np.pi * radius * frequency[1:], exponent - 1.0
    expected = 2.0 ** (1.0 - order) / math.gamma(order) * x**order * kv(order, x)
    found = spreads.moffat(frequency, np.array([radius]), np.array([exponent]))[0]
    assert found == pytest.approx(np.append(1.0, expected), abs=2e-6)
    assert exponent != 1.5 or found[1:] == pytest.approx(np.exp(-x), abs=2e-6)


def test_aperture_vanishes_where_a_whole_period_falls_on_the_pixel():
    assert aperture(np.array([1.0]), 0.0)[0] == pytest.approx(0.0, abs=1e-12)
    assert aperture(np.array([0.5]), 0.0, along_px=2.0)[0] == pytest.approx(0.0, abs=1e-12)
    assert aperture(np.array([0.5]), 0.0)[0] == pytest.approx(2 / np.pi)


def test_node_interpolation_is_exact_for_cubics():
    grid, points = esf_from_mtf.nodes(fine=False), np.array([0.013, 0.21, 0.9, 3.3])
    matrix = esf_from_mtf.interpolation(grid, points)
    for power in range(4):
        assert np.allclose(matrix @ grid**power, points**power)


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
