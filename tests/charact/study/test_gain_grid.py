"""The grid of single photoelectrons: frames as the cascade wants them, a bound that means what it says, a table that
is what the method still does."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr

from charact.study.flats.gain_bound import heights_variance, least_relative_sd
from charact.study.flats.gain_grid import CELLS, EXPECTED, FIRST, TABLE, measured_once, read, scene_of, told
from charact.study.flats.pulse_frames import CELLS as CELLS_PER_PX
from charact.study.flats.pulse_frames import PulseScene, _place, integrals


def pixel_share(place, length, sigma):
    """Share of a Gaussian pulse that each pixel holds."""
    return np.diff(ndtr((np.arange(length + 1) - place) / sigma))


def autocovariance(lag, sigma):
    """Integral of the product of the shares of two pixels: the pixel's triangle under a Gaussian of both blurs."""
    x = np.linspace(-1.0, 1.0, 20001)
    wide = np.exp(-0.25 * ((x + lag) / sigma) ** 2) / (2.0 * sigma * np.sqrt(np.pi))
    return np.trapezoid((1.0 - np.abs(x)) * wide, x)


def test_a_photoelectron_is_integrated_over_the_pixels():
    frame = np.zeros((24, 30), np.float32)
    _place(frame, np.array([9.3]), np.array([14.85]), np.array([5.0], np.float32), 0.7)
    expected = 5.0 * np.outer(pixel_share(9.3, 24, 0.7), pixel_share(14.85, 30, 0.7))
    assert frame == pytest.approx(expected, abs=5e-6)


@pytest.mark.parametrize("sigma", [0.5, 0.7, 1.0, 2.0])
def test_cells_of_half_a_pixel_have_the_moments_of_photoelectrons_anywhere(sigma):
    """Campbell: the n-th cumulant of pixels is the integral over places of the product of n shares."""
    shares = integrals(9, 12, sigma).astype(float)
    places = np.linspace(-12.0, 21.0, 33 * 256, endpoint=False) + 1.0 / 512
    anywhere = np.array([pixel_share(place, 9, sigma) for place in places])
    for pixels in ([4], [4, 4], [4, 5], [4, 7], [4, 4, 4], [4, 4, 6], [4, 4, 5, 5]):
        by_cells = np.prod(shares[:, pixels], axis=1).sum() / CELLS_PER_PX
        within = 5e-5 if len(pixels) < 3 else 3e-3
        assert by_cells == pytest.approx(np.prod(anywhere[:, pixels], axis=1).sum() / 256, rel=within), pixels
    assert (shares[:, 4] ** 2).sum() / CELLS_PER_PX == pytest.approx(autocovariance(0, sigma), rel=2e-5)


@pytest.mark.parametrize("one_by_one", [True, False])
def test_frames_have_mean_variance_and_neighbours_of_the_cascade(one_by_one, seed):
    """k lam, k^2 F^2 lam times the shares' autocovariance; pixels as far apart as the blur reaches are independent."""
    scene = PulseScene(photoelectrons=2.0, excess_noise_factor=1.6, blur_px=0.7, rows=96, cols=96, frames=24)
    light = scene.light(np.random.default_rng(seed), one_by_one=one_by_one).astype(float)
    mean = scene.photoelectrons * scene.photoelectron_gain_dn
    change = light - mean
    scale = scene.photoelectron_gain_dn * scene.excess_noise_factor * mean
    for row, col in ((0, 0), (0, 1), (1, 1), (2, 0)):
        product = change[:, row:, col:] * change[:, : 96 - row, : 96 - col]
        of_frames = product.mean(axis=(1, 2))
        expected = scale * autocovariance(row, 0.7) * autocovariance(col, 0.7)
        assert of_frames.mean() == pytest.approx(expected, abs=4.5 * of_frames.std(ddof=1) / np.sqrt(24))
    of_frames = change.mean(axis=(1, 2))
    assert of_frames.mean() == pytest.approx(0.0, abs=4.5 * np.sqrt(scale / light.size))
    assert of_frames.var(ddof=0) * 96**2 == pytest.approx(scale, rel=4.5 * np.sqrt(2 / 24))


def test_the_bound_falls_with_the_root_of_the_frames_and_rises_with_blur_and_noise():
    scene = PulseScene(photoelectrons=10.0, excess_noise_factor=2.0, blur_px=1.0, frames=40)
    least = least_relative_sd(scene)
    # Two lags and a mean cost less, the more frames there are; priors help less.
    assert least_relative_sd(replace(scene, frames=160)) / least == pytest.approx(0.5, abs=0.03)
    assert least_relative_sd(replace(scene, blur_px=2.0)) > least
    assert least_relative_sd(replace(scene, photoelectrons=0.2)) > least
    # Exponential pulse heights: 2/N, as <g^n> = n!.
    assert heights_variance(scene) == pytest.approx(2.0 / (10.0 * 128 * 128 * 40))


def test_the_bound_of_white_noise_of_known_form_is_that_of_its_modes():
    """Where only the power is free its relative variance is one over the number of modes."""
    from charact.noise.stack.spectrum import bins_of
    from charact.study.flats.gain_bound import _information

    bins = bins_of(128, 128, 1.0)
    known = bins.modes * bins.efficiency
    information = _information(np.ones((1, len(known))), known, 12)
    assert information[0, 0] == pytest.approx(11 * known.sum())
    # A correlation of one exposure with the next is known from 11 pairs less what centring takes.
    assert 1 / np.sqrt(information[1, 1]) == pytest.approx(1 / np.sqrt(2 * 11 * known.sum()), rel=0.1)


@pytest.fixture(scope="module")
def outcomes():
    return read()


def test_the_grid_is_whole(outcomes):
    assert [(one.photoelectrons, one.excess_noise_factor, one.blur_px) for one in outcomes] == list(CELLS)
    assert min(one.repeats for one in outcomes) >= 40
    assert all(one.measured == one.repeats for one in outcomes)
    kept = json.loads(TABLE.read_text())["summary"]
    assert kept["covered_percent"] == pytest.approx(told(outcomes)["covered_percent"])


def test_covariance_gain_is_unbiased_near_the_bound_and_covered_as_promised(outcomes):
    """Bias within 1 % and scatter within 1.3 of the bound for every blur, pulse height and light; cells by chance."""
    summary = told(outcomes)
    for axis, parts in summary["by"].items():
        for at, part in parts.items():
            assert abs(part["bias_percent"]) < 1.0, (axis, at, part)
            assert part["scatter_over_bound"] < 1.3, (axis, at, part)
            assert 92.0 <= part["covered_percent"] <= 98.0, (axis, at, part)
    for one in outcomes:
        assert abs(one.bias_percent) < 1.0 + 3.5 * one.scatter_percent / np.sqrt(one.repeats), one
        assert one.scatter_percent < one.bound_percent * 1.3 * (1 + 2.5 / np.sqrt(2 * one.repeats)), one
    assert summary["silent"] == 0


def test_variance_is_flagged_in_every_correlated_cell(outcomes):
    for one in outcomes:
        assert one.variance_flagged == (one.repeats if one.correlated else 0), one


def test_drawings_of_five_cells_are_what_the_method_still_does(outcomes, seed):
    for number in np.random.default_rng(seed).choice(len(CELLS), 5, replace=False):
        before, truth = outcomes[number], scene_of(number).covariance_gain_dn
        for repeat in range(FIRST):
            covariance, plain = measured_once(number, repeat)
            assert covariance.value is not None
            off = 100.0 * (covariance.value / truth - 1.0)
            assert off == pytest.approx(before.first_percent[repeat], abs=0.1 * before.bound_percent), before
            assert set(covariance.flags) >= EXPECTED
            assert ("correlated-noise" in plain.flags) == before.correlated
