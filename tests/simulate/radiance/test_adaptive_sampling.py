"""Rays go where single ones differ, as many as the picture's error needs and no more; influences
are free of specks.
"""

from dataclasses import replace

import numpy as np
import pytest

from simulate.radiance.integrator import RenderSensor, additional_rays, integrator_settings
from simulate.radiance.outdoor import render_settings

SHAPE = (32, 96)
LEFT = np.broadcast_to(np.arange(SHAPE[1]) < SHAPE[1] // 2, SHAPE)
GROUPS = (LEFT, ~LEFT)


def sent_for(variance, allowed, max_rays=100_000, total=np.inf):
    """Rays of pixels whose single rays have a variance, turn by turn, and the number of turns."""
    sent, turns = np.full(SHAPE, 8, np.int64), 0
    while (more := additional_rays(variance / sent / allowed, sent, GROUPS, max_rays, total)).any():
        assert (more <= integrator_settings.LIMITS.max_growth * sent).all(), (
            "few rays are not trusted for many times as many"
        )
        sent, turns = sent + more, turns + 1
    return sent, turns


def test_rays_are_as_the_root_of_the_variance_and_bring_its_mean_to_what_is_allowed():
    variance = np.where(LEFT, 0.1, 40.0)
    sent, turns = sent_for(variance, 0.01)
    assert 1 < turns < 8
    assert 0.4 < np.mean(variance / sent) / 0.01 < 1.1
    assert 10.0 < sent[~LEFT].mean() / sent[LEFT].mean() < 40.0, "as the root, in powers of two"
    assert sent.mean() < 0.75 * np.mean(variance) / 0.01, (
        "the same error by as many rays everywhere costs more"
    )


def test_a_pixel_that_met_nothing_bright_goes_on_with_those_around_it_that_did():
    met = np.where(np.random.default_rng(4).random(SHAPE) < 0.1, 100.0, 0.0)
    more = additional_rays(np.where(LEFT, met, 0.0), np.full(SHAPE, 64), GROUPS, 100_000)
    assert (more[LEFT] > 0).mean() > 0.95
    assert not more[~LEFT].any(), "nor do those of another group"


def test_no_limit_is_broken_for_the_errors_sake():
    assert sent_for(np.ones(SHAPE), 1e-6, max_rays=64)[0].max() <= 64
    assert sent_for(np.ones(SHAPE), 1e-6, total=64 * LEFT.size)[0].sum() < 1.5 * 64 * LEFT.size
    assert not additional_rays(np.full(SHAPE, 0.9), np.full(SHAPE, 8), GROUPS, 64).any(), (
        "what is good is left alone"
    )


def test_differences_are_weighed_by_noise_or_by_a_share_of_the_signal():
    eye = RenderSensor(
        response_nm=(500.0,), response=(1.0,), dark_variance=4.0, variance_per_signal=3.0
    )
    assert eye.noise_floor(0.0) == 2.0
    assert eye.noise_floor(20.0) == pytest.approx(8.0)
    assert eye.noise_floor(1e6) == pytest.approx(integrator_settings.KNOWN * 1e6)
    blurred = replace(eye, noise_averaging_factor=0.3)
    assert blurred.noise_floor(20.0) == eye.noise_floor(20.0), (
        "blur evens what differs by chance like the noise"
    )
    assert blurred.noise_floor(20.0, smooth=True) == pytest.approx(0.3 * 8.0)
    assert blurred.noise_floor(1e6, smooth=True) == pytest.approx(integrator_settings.KNOWN * 1e6)


def test_the_influence_of_a_part_is_its_size_where_it_is_largest_and_specks_have_none():
    shape, rng = (40, 40), np.random.default_rng(6)
    part = np.zeros(shape)
    part[
        : shape[0] // render_settings.RENDER_LIMITS.regions,
        : shape[1] // render_settings.RENDER_LIMITS.regions,
    ] = 0.3
    twice = np.repeat(part.reshape(-1, 1), 2, axis=1)
    assert render_settings._influence(twice, shape) == pytest.approx(0.3)
    # Each ray in a hundred is a speck of 10: the mean of two rays makes 0.7 of that, their product
    # rarely anything.
    many = [np.where(rng.random((1600, 2)) < 0.01, 10.0, 0.0) - 0.1 for _ in range(15)]
    assert np.median(
        [render_settings._influence(twice + specks, shape) for specks in many]
    ) == pytest.approx(0.3, abs=0.15)
    assert np.median([np.sqrt(np.mean(specks.mean(axis=1) ** 2)) for specks in many]) > 0.6
