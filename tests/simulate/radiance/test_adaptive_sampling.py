"""Rays go where single ones differ, as many as the picture's error needs and no more; influences are free of specks."""

from dataclasses import replace

import numpy as np
import pytest

from simulate.radiance.integrator.adaptive_sampling import SamplingSettings, allocate_samples, further
from simulate.radiance.integrator.auxiliary_layers import AuxiliaryLayers
from simulate.radiance.integrator.integrator_settings import LIMITS
from simulate.radiance.integrator.render_sensor import KNOWN, RenderSensor
from simulate.radiance.outdoor.render_settings import RENDER_LIMITS, _influence

SHAPE = (32, 64)
ALLOWED = 0.01


def halves() -> AuxiliaryLayers:
    """Two objects side by side on one plane, so that only their border is an edge."""
    right = np.broadcast_to(np.arange(SHAPE[1]) >= SHAPE[1] // 2, SHAPE)
    return AuxiliaryLayers(
        material=right.astype(np.int16),
        object=right.astype(np.int32),
        range_m=np.ones(SHAPE, np.float32),
        normal=np.broadcast_to(np.float32([0.0, 0.0, 1.0]), (*SHAPE, 3)),
        shadow=np.zeros(SHAPE, np.uint32),
        temperature_k=np.full(SHAPE, np.nan, np.float32),
        materials=("a", "b"),
        objects=("a", "b"),
        sources=(),
    )


def tried(variance):
    """Trials whose single rays have a variance by pixel, (row, col), around a signal of 1."""
    return lambda pixels, rays, together=False: (np.ones(len(pixels)), variance.ravel()[pixels])


def spread(left: float, right: float) -> np.ndarray:
    return np.where(halves().object == 0, left, right)


def test_rays_are_as_the_root_of_the_variance_and_bring_its_mean_to_what_is_allowed():
    variance = spread(0.04, 1.0)
    rays = SamplingSettings(max_rays=10_000, edge=2, error_limit=lambda signal: np.full_like(signal, ALLOWED))
    wanted = allocate_samples(halves(), rays, tried(variance), 1)
    plain = ~halves().edges()
    left, right = (wanted[plain & (halves().object == side)] for side in (0, 1))
    assert np.ptp(left) == 0 and np.ptp(right) == 0
    assert right[0] / left[0] == pytest.approx(5.0, rel=0.2), "numbers are steps of 2^(1/2)"
    assert np.mean((variance / ALLOWED / wanted)[plain]) == pytest.approx(1.0, rel=0.2)
    even = np.mean(variance) / ALLOWED
    assert wanted[plain].mean() < 0.75 * even, "the same error by as many rays everywhere costs more"


def test_where_nothing_differs_and_where_nobody_asks_pixels_get_the_fewest():
    for rays in (SamplingSettings(error_limit=lambda signal: np.full_like(signal, ALLOWED)), SamplingSettings()):
        wanted = allocate_samples(halves(), rays, tried(spread(0.0, 0.0)), 1)
        assert set(wanted[~halves().edges()]) == {rays.min_rays}
        assert set(wanted[halves().edges()]) == {rays.edge}


def test_at_edges_only_what_lies_apart_is_evened_out_by_rays_that_are_spread():
    edges = halves().edges()
    rays = SamplingSettings(max_rays=10_000, edge=2, error_limit=lambda signal: np.full_like(signal, ALLOWED))
    grain = allocate_samples(halves(), rays, tried(spread(1.0, 1.0)), 1)
    assert np.ptp(grain) == 0, "rays that differ at the same place do so at edges as elsewhere"

    def steps(pixel, rays, together=False):
        return np.ones(len(pixel)), np.full(len(pixel), 0.0 if together else 1.0)

    step = allocate_samples(halves(), rays, steps, 1)
    assert step[edges].max() < 0.8 * grain[edges].min()


@pytest.mark.parametrize("limit", [{"max_rays": 16}, {"max_rays": 10_000, "total_rays": 10_000}])
def test_limits_are_kept_and_what_is_missing_goes_to_nobody(limit):
    rays = SamplingSettings(edge=2, error_limit=lambda signal: np.full_like(signal, 1e-6), **limit)
    wanted = allocate_samples(halves(), rays, tried(spread(0.0, 1.0)), 1)
    assert wanted.max() <= rays.max_rays
    assert wanted.sum() < 1.2 * (rays.total_rays or np.inf)
    assert set(wanted[:, :24].ravel()) == {rays.min_rays}


def test_rare_bright_rays_are_found_by_longer_trials():
    rng = np.random.default_rng(5)
    pixels = []

    def specks(pixel, rays, together=False):
        pixels.append(len(pixel))
        return np.ones(len(pixel)), np.where(rng.random(len(pixel)) < 0.01, 100.0, 0.0)

    rays = SamplingSettings(max_rays=10_000, edge=2, error_limit=lambda signal: np.full_like(signal, ALLOWED))
    wanted = allocate_samples(halves(), rays, specks, 1)
    assert len(pixels) > 5
    assert wanted.sum() == pytest.approx(100 * wanted.size, rel=0.5)


def test_rays_go_on_until_the_error_measured_is_what_was_allowed():
    rays = SamplingSettings(max_rays=100_000, edge=2, error_limit=lambda signal: np.full_like(signal, ALLOWED))
    single, signal = spread(0.1, 40.0), np.ones(SHAPE)
    sent, turns = np.full(SHAPE, 8, np.int32), 0
    while (more := further(halves(), rays, signal, single / sent, sent)).any():
        assert (sent + more <= 1.5 * LIMITS.max_ray_growth * sent).all(), (
            "few rays are not trusted for many times as many"
        )
        sent, turns = sent + more, turns + 1
    assert 2 < turns < 8
    assert np.mean(single / sent) / ALLOWED == pytest.approx(1.0, rel=0.15)
    plain = ~halves().edges()
    left, right = (sent[plain & (halves().object == side)].mean() for side in (0, 1))
    assert right / left == pytest.approx(20.0, rel=0.4), "as the root of the variance"
    assert not further(halves(), rays, signal, 0.9 * spread(ALLOWED, ALLOWED), sent).any()


def test_a_pixel_that_met_nothing_bright_goes_on_with_those_around_it_that_did():
    rays = SamplingSettings(max_rays=100_000, edge=2, error_limit=lambda signal: np.full_like(signal, ALLOWED))
    sent = np.full(SHAPE, 64, np.int32)
    met = np.where(np.random.default_rng(4).random(SHAPE) < 0.1, 100.0 * ALLOWED, 0.0)
    more = further(halves(), rays, np.ones(SHAPE), np.where(halves().object == 0, met, 0.0), sent)
    assert (more[:, :24] > 0).mean() > 0.95
    assert not more[:, 40:].any(), "nor do those of another thing"


@pytest.mark.parametrize("limit", [{"max_rays": 64}, {"max_rays": 10_000, "total_rays": 64 * SHAPE[0] * SHAPE[1]}])
def test_no_limit_is_broken_for_the_errors_sake(limit):
    rays = SamplingSettings(edge=2, error_limit=lambda signal: np.full_like(signal, ALLOWED), **limit)
    sent = np.full(SHAPE, 64, np.int32)
    assert not further(halves(), rays, np.ones(SHAPE), np.ones(SHAPE), sent).any()


def test_differences_are_weighed_by_noise_or_by_a_share_of_the_signal():
    eye = RenderSensor(response_nm=(500.0,), response=(1.0,), dark_variance=4.0, variance_per_signal=3.0)
    assert eye.noise_floor(0.0) == 2.0
    assert eye.noise_floor(20.0) == pytest.approx(8.0)
    assert eye.noise_floor(1e6) == pytest.approx(KNOWN * 1e6)
    blurred = replace(eye, noise_averaging_factor=0.3)
    assert blurred.noise_floor(20.0) == eye.noise_floor(20.0), "blur evens what differs by chance like the noise"
    assert blurred.noise_floor(20.0, smooth=True) == pytest.approx(0.3 * 8.0)
    assert blurred.noise_floor(1e6, smooth=True) == pytest.approx(KNOWN * 1e6)


def test_the_influence_of_a_part_is_its_size_where_it_is_largest_and_specks_have_none():
    shape, rng = (40, 40), np.random.default_rng(6)
    part = np.zeros(shape)
    part[: shape[0] // RENDER_LIMITS.regions, : shape[1] // RENDER_LIMITS.regions] = 0.3
    twice = np.repeat(part.reshape(-1, 1), 2, axis=1)
    assert _influence(twice, shape) == pytest.approx(0.3)
    # Each ray in a hundred is a speck of 10: the mean of two rays makes 0.7 of that, their product rarely anything.
    many = [np.where(rng.random((1600, 2)) < 0.01, 10.0, 0.0) - 0.1 for _ in range(15)]
    assert np.median([_influence(twice + specks, shape) for specks in many]) == pytest.approx(0.3, abs=0.15)
    assert np.median([np.sqrt(np.mean(specks.mean(axis=1) ** 2)) for specks in many]) > 0.6
