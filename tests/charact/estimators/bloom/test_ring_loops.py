"""The compiled loops of the series' likelihood, against dense sums, drawn noise and least
squares.
"""

import numpy as np
import pytest

from charact.estimators.bloom.series import (
    best_step,
    lost_at_top,
    residuals_and_slopes,
    ring_means,
    whiten_rings,
)

LEVELS, RINGS, NODES, POINTS = 3, 7, 12, 4


@pytest.fixture
def rng(seed):
    return np.random.default_rng([seed, 71])


def averages(rng):
    """Weights of three nodes a ring, farther out ring by ring."""
    out = np.zeros((LEVELS, RINGS, NODES))
    begin = np.broadcast_to(np.arange(RINGS), (LEVELS, RINGS)).astype(np.intp)
    for ring in range(RINGS):
        out[:, ring, ring : ring + 3] = rng.random((LEVELS, 3))
    return out, begin, begin + 3


@pytest.mark.parametrize("nodes", [NODES, 5, 0])
def test_ring_means_are_sums_over_nodes_and_end_where_light_ends(rng, nodes):
    weights, begin, end = averages(rng)
    light = rng.random((LEVELS, nodes, POINTS))
    dense = weights[:, :, :nodes] @ light
    found = ring_means(light, weights, begin, end)
    assert np.allclose(found, dense[:, : found.shape[1]])
    assert not dense[:, found.shape[1] :].any()


def test_whitening_multiplies_by_lower_triangles(rng):
    triangles = np.tril(rng.standard_normal((LEVELS, RINGS, RINGS)))
    rings = rng.standard_normal((LEVELS, RINGS, POINTS))
    assert np.allclose(whiten_rings(rings, triangles), triangles @ rings)


def test_light_lost_at_the_top_is_what_cut_noise_loses_on_average(rng):
    sd, full, light = 3.0, 255.0, np.array([230.0, 250.0, 255.0, 261.0, 290.0])
    ones = np.ones((1, 2, 1)) * np.array([[[1.0], [0.0]]])
    lost = lost_at_top(light[:, None], ones, np.full((1, light.size), sd), full, 5.0)[0, :, :, 0]
    draws = light[:, None] + sd * rng.standard_normal((light.size, 400_000))
    cut = draws - np.minimum(draws, full)
    assert np.all(
        np.abs(lost[:, 0] - cut.mean(axis=1))
        <= 4.0 * cut.std(axis=1) / np.sqrt(draws.shape[1]) + 1e-5
    )
    over = (draws > full).mean(axis=1)
    assert np.all(
        np.abs(lost[:, 2] - over) <= 4.0 * np.sqrt(over * (1 - over) / draws.shape[1]) + 1e-5
    )


def test_what_is_left_over_falls_with_the_light_as_it_says(rng):
    triangles = np.tril(rng.standard_normal((LEVELS, RINGS, RINGS)))
    weights, begin, end = averages(rng)
    straight, sd = (
        np.sort(rng.uniform(1.0, 4.0, (NODES, POINTS)), axis=0)[::-1].copy(),
        np.full((LEVELS, NODES), 4.0),
    )
    light = np.repeat(straight[None], LEVELS, axis=0)
    white = whiten_rings(ring_means(light, weights, begin, end), triangles)
    even = (triangles @ weights.sum(axis=-1)[..., None])[..., 0]

    def left(amplitudes):
        lost = lost_at_top(straight, amplitudes, sd, 100.0, 5.0)
        rings = ring_means(lost.reshape(LEVELS, lost.shape[1], -1), weights, begin, end)
        return residuals_and_slopes(
            white,
            even,
            np.zeros_like(even),
            amplitudes,
            rings.reshape(LEVELS, -1, 3, POINTS),
            triangles,
        )

    at = np.stack([np.full((LEVELS, POINTS), 40.0), np.full((LEVELS, POINTS), 5.0)], axis=1)
    _, slopes = left(at)
    for amplitude, step in ((0, 1e-4), (1, 1e-3)):
        move = np.zeros_like(at)
        move[:, amplitude] = step
        assert np.allclose(
            (left(at - move)[0] - left(at + move)[0]) / (2 * step),
            slopes[amplitude],
            rtol=1e-4,
            atol=1e-5,
        )


def test_the_best_step_is_that_of_least_squares(rng):
    source, even, residual = rng.standard_normal((3, LEVELS, RINGS, POINTS))
    step, promise = best_step(source, even, residual)
    gains = []
    for level, point in np.ndindex(LEVELS, POINTS):
        design = np.column_stack([source[level, :, point], even[level, :, point]])
        best, *_ = np.linalg.lstsq(design, residual[level, :, point], rcond=None)
        assert np.allclose(step[level, :, point], best)
        gains.append(residual[level, :, point] @ design @ best)
    assert promise == pytest.approx(max(gains))
