"""Cores, extended components and their spreads are transforms of each other."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import gamma, j0, j1, kv, sici

from charact.estimators.mtf.edge.fit import esf_from_mtf
from charact.estimators.mtf.edge.fit.model_fit import _flat, _linearise, _shift_derivatives
from charact.transfer import spreads
from charact.transfer.blur_model import BlurModel
from charact.transfer.cores import (
    AIRY,
    CORES,
    EXPONENTIAL,
    GAUSSIAN,
    MOFFAT,
    ON_BARS,
    ON_POINTS,
    TwoGaussians,
)
from charact.transfer.extended import (
    DiscComponent,
    HaloComponent,
    ScatterComponent,
    UnresolvedGlareComponent,
    disc,
    halo,
)
from charact.transfer.form import Core
from charact.transfer.pupil import pupil
from charact.transfer.stages import aperture
from charact.transfer.video_filter import VideoFilter, powers
from labdata import load_sensor

# Forms of blurs: closed forms, compiled tables, slopes that are theirs, and the transfer of a
# pupil against prysm's propagation of a sampled one.


BAND = np.geomspace(0.01, 1.0, 40)
THETA = {"exponential": [1.4], "moffat": [2.6], "two gaussians": [0.2, 1.2]}


@pytest.mark.parametrize("core", [GAUSSIAN, EXPONENTIAL, MOFFAT, AIRY], ids=lambda core: core.name)
def test_a_stated_transfer_and_its_slopes_are_those_of_the_attenuation(core):
    theta = np.array([[np.log(0.2), *THETA.get(core.name, [])]])
    implied = Core.transfer(core, theta, BAND)
    assert core.transfer(theta, BAND) == pytest.approx(implied, abs=1e-3)
    slopes = Core.derivatives(core, theta[0], BAND)
    assert core.derivatives(theta[0], BAND) == pytest.approx(slopes, abs=0.02)


@pytest.mark.parametrize(
    "core", [*CORES.values(), *(core for core, _ in ON_POINTS.values()), TwoGaussians()]
)
def test_a_core_is_one_at_zero_and_one_half_at_its_half_frequency(core):
    shape = [0.0 if "_square" in part.name else part.start for part in core.shape]
    at = core.transfer(np.array([[np.log(0.2), *shape]]), np.array([1e-5, 0.2]))[0]
    assert at == pytest.approx([1.0, 0.5], abs=3e-3)


@pytest.mark.parametrize("form", ON_BARS, ids=lambda form: form.name)
def test_a_form_of_bars_has_its_attenuation_at_the_bar_frequency_and_slopes_that_are_its_own(form):
    start = form.first.start, form.second.start
    for attenuation in (0.3, 2.0):
        ln, by_ln_attenuation, *_ = form.derivatives(np.zeros(1), attenuation, *start)
        assert ln[0] == pytest.approx(-attenuation, rel=2e-3)
        assert by_ln_attenuation[0] == pytest.approx(-attenuation, rel=0.02)


FREQUENCY = np.concatenate([[1e-5, 1e-3], np.linspace(0.01, 4.3, 60)])
WIDES = (
    None,
    HaloComponent(size_px=(6.0, 90.0)),
    DiscComponent(size_px=(6.0, 200.0)),
    ScatterComponent(size_px=(2.0, 12.0)),
    UnresolvedGlareComponent(size_px=(20.0, 200.0)),
)
FAMILIES = [
    BlurModel(core=core, wide=wide)
    for core in ("gaussian", "exponential", "moffat")
    for wide in WIDES
]


@pytest.mark.parametrize("family", FAMILIES, ids=[family.name for family in FAMILIES])
def test_a_prior_is_flat_but_for_its_gaussian_part(family, seed):
    rng, bounds = np.random.default_rng(seed), family.bounds
    theta = bounds[:, 0] + (bounds[:, 1] - bounds[:, 0]) * rng.random((7, len(bounds)))
    mean, precision = family.prior_precision
    pull = 0.5 * (theta - mean) ** 2 @ precision
    assert family.log_prior(theta) == pytest.approx(_flat(family) - pull)


@pytest.mark.parametrize("family", FAMILIES, ids=[family.name for family in FAMILIES])
def test_a_form_alone_is_the_form_of_many_points_and_its_slopes_are_differences(family, seed):
    """Tables are linear between places: where a difference meets a kink it is off by some of the
    table's bend.
    """
    rng, bounds = np.random.default_rng(seed), family.bounds
    for _ in range(5):
        theta = bounds[:, 0] + (bounds[:, 1] - bounds[:, 0]) * rng.uniform(0.05, 0.95, len(bounds))
        value, *slopes = family.derivatives(theta, FREQUENCY)
        assert value == pytest.approx(family.modulus(theta[None], FREQUENCY)[0], abs=1e-12)
        for slope, move in zip(slopes, np.diag(1e-6 * (bounds[:, 1] - bounds[:, 0])), strict=True):
            ahead, behind = family.modulus(np.stack([theta + move, theta - move]), FREQUENCY)
            difference = (ahead - behind) / (2.0 * move.sum())
            assert slope == pytest.approx(difference, abs=0.02 * np.abs(difference).max() + 1e-9)


def test_halo_and_disc_are_made_of_scipys_sines_and_bessel_functions():
    x, share = (
        np.concatenate([np.linspace(1e-6, 399.9, 3000), np.linspace(400.1, 3000.0, 500)]),
        0.3,
    )
    expected = share * np.sin(x) / x + (1.0 - share) * sici(x)[0] / x
    assert halo(x, share) == pytest.approx(expected, abs=1e-8)
    assert disc(x)[0] == pytest.approx(2.0 * j1(x) / x, abs=1e-8)


@pytest.mark.parametrize("exponent", [1.3, 1.5, 2.5, 6.0])
def test_a_moffat_spread_has_scipys_bessel_function_for_a_transfer(exponent):
    """2^(2-b) / Gamma(b-1) x^(b-1) K_(b-1)(x), one half at the half frequency."""

    def transfer(x):
        return (
            2.0 ** (2.0 - exponent)
            / gamma(exponent - 1.0)
            * x ** (exponent - 1.0)
            * kv(exponent - 1.0, x)
        )

    half_x = brentq(lambda x: transfer(x) - 0.5, 1e-6, 30.0)
    frequency = np.array([0.003, 0.02, 0.1, 0.2, 0.3, 0.5, 1.0])
    found = MOFFAT.transfer(np.array([[np.log(0.2), exponent]]), frequency)[0]
    assert found == pytest.approx(transfer(half_x * frequency / 0.2), abs=1e-3)
    assert found[3] == pytest.approx(0.5, abs=1e-3)


def test_the_model_made_linear_moves_as_the_model_itself(seed):
    """Residuals of a small step are those the design foretells, up to the square of the step."""
    rng = np.random.default_rng(seed)
    grid, family = np.linspace(0.01, 1.0, 40), BlurModel(core="exponential")
    fixed = np.stack([np.sinc(grid), 0.1 * grid])
    white, levels = rng.standard_normal((80, 60)), rng.standard_normal((3, 60))
    point, move = np.array([0.1, np.log(0.2), 1.4]), np.array([1e-4, -1e-4, 2e-4])
    data = 30.0 * (
        _shift_derivatives(family.derivatives(point[1:], grid), point[0], grid, fixed)[0] @ white
    ) + rng.standard_normal(60)
    prior = np.zeros(7), np.full(7, 1e-9)

    def at(where):
        return _linearise(
            _shift_derivatives(family.derivatives(where[1:], grid), where[0], grid, fixed),
            where,
            white,
            levels,
            data,
            *prior,
        )

    _, _, _, residual, design, amplitude, _ = at(point)
    _, _, _, moved, _, other, _ = at(point + move)
    foretold = residual - np.concatenate([move, other - amplitude]) @ design
    assert np.abs(moved - foretold).max() < 1e-3 * np.abs(moved - residual).max()


RATIO = np.linspace(0.0, 1.2, 61)


def sampled(obscuration, defocus, samples=512, padding=4):
    """Return ratios to the cut-off and prysm's transfer at them, the pupil sampled on a grid."""
    otf = pytest.importorskip("prysm.otf")
    propagation = pytest.importorskip("prysm.propagation")
    step = 2.0 / samples
    x = (np.arange(samples) - samples // 2 + 0.5) * step
    # A border pixel counts by the share of it inside.
    sub = (np.arange(8) - 3.5) / 8 * step
    radius = np.hypot((x[:, None] + sub)[:, None, :, None], (x[:, None] + sub)[None, :, None, :])
    amplitude = ((radius <= 1.0) & (radius >= obscuration)).mean(axis=(2, 3))
    phase = 2.0 * np.pi * defocus * (x[:, None] ** 2 + x**2)
    # Wavelength 1 um, pupil 2 mm across, focal length 2 mm: f/1, so that the cut-off is 1 / um,
    # 1000 cycles / mm.
    wave = propagation.Wavefront(amplitude * np.exp(1j * phase), 1.0, step)
    psf = wave.focus(2.0, Q=padding).intensity
    found = otf.otf_from_psf(psf.data, psf.dx).data.real
    middle = found.shape[0] // 2
    line = found[middle, middle:] / found[middle, middle]
    frequency = np.arange(line.size) / (found.shape[0] * psf.dx) * 1000.0
    return frequency / 1000.0, line


def test_a_clear_pupil_in_focus_has_the_closed_form():
    v = np.minimum(RATIO, 1.0)
    assert np.allclose(
        pupil(0.45 * RATIO, 0.45)[0], 2 / np.pi * (np.arccos(v) - v * np.sqrt(1 - v**2)), atol=1e-12
    )


def test_a_pupil_with_a_hole_has_the_transform_of_its_spread():
    """The spread is ((2 J1(u)/u - e^2 2 J1(eu)/(eu)) / (1 - e^2))^2; its volume over that of the
    clear one is known.
    """
    hole, u = 0.4, np.maximum(np.linspace(0.0, 4000.0, 400001), 1e-9)
    spread = ((2 * j1(u) / u - hole**2 * 2 * j1(hole * u) / (hole * u)) / (1 - hole**2)) ** 2

    for ratio in (0.1, 0.3, 0.55, 0.9):
        # Frequency v of the cut-off is 2 v in units of u; the tail of spread x u falls as 1/u^2.
        at = np.trapezoid(spread * u * j0(2 * ratio * u), u) / np.trapezoid(spread * u, u)
        assert pupil(np.array([ratio]), 1.0, hole)[0, 0] == pytest.approx(at, abs=2e-3)


@pytest.mark.parametrize("obscuration", [0.0, 0.35])
@pytest.mark.parametrize("defocus", [0.0, 0.9])
def test_it_is_what_prysm_propagates(obscuration, defocus):
    ratio, line = sampled(obscuration, defocus)
    assert np.abs(pupil(ratio, 1.0, obscuration, defocus)[0] - line).max() < 2e-3


def test_far_out_of_focus_it_is_the_transform_of_an_even_disc():
    """Geometrical optics: 2 J1(a)/a with a = 8 pi W v near frequency 0 (Hopkins)."""
    v = np.array([0.01, 0.02, 0.03])
    a = 8 * np.pi * 3.0 * v
    assert np.allclose(pupil(v, 1.0, 0.0, 3.0)[0], 2 * j1(a) / a, atol=0.06)


def test_it_is_one_at_zero_and_nothing_beyond_the_cut_off():
    every = pupil(
        np.array([0.0, 0.5, 1.0, 1.3]),
        np.full(5, 1.0),
        np.linspace(0.0, 0.8, 5),
        np.linspace(0.0, 3.0, 5),
    )
    assert np.allclose(every[:, 0], 1.0) and np.all(every[:, 2:] == 0.0)


# Transfer functions and the spreads they stand for, against closed forms; a video's low pass of a
# bandwidth known within a range.


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


def sampled_filter(frequency, bandwidth_mhz):
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
        without_delay(one, frequency) for one in (bent, sampled_filter(frequency, bandwidth_mhz))
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
