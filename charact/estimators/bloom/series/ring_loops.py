"""From light at the nodes to whitened rings and back to a better light of each level: the inner
loops, compiled.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from labdata import Array

Places = NDArray[np.intp]


@njit(cache=True)
def ring_means(light: Array, averages: Array, begin: Places, end: Places) -> Array:
    """Average light at the nodes over rings.

    `light`: shape (level, node, column); nodes may end early, where light is none; `averages`:
    weight of each node in each ring, shape (level, ring, node); `begin`, `end`: first node that has
    a part in each ring, and the one behind the last, shape (level, ring). Returns shape (level,
    ring, column); rings end where the nodes have no part in them.
    """
    levels, nodes, columns = light.shape
    rings = averages.shape[1]
    while rings and begin[:, rings - 1].min() >= nodes:
        rings -= 1
    out = np.zeros((levels, rings, columns))
    for level in range(levels):
        for ring in range(rings):
            for node in range(begin[level, ring], min(end[level, ring], nodes)):
                weight = averages[level, ring, node]
                for column in range(columns):
                    out[level, ring, column] += weight * light[level, node, column]
    return out


@njit(cache=True)
def whiten_rings(rings: Array, whitener: Array) -> Array:
    """Multiply rings, shape (level, ring, column), by lower triangles, shape (level, ring,
    ring).
    """
    levels, count, columns = rings.shape
    out = np.zeros((levels, count, columns))
    for level in range(levels):
        for ring in range(count):
            for other in range(ring + 1):
                weight = whitener[level, ring, other]
                for column in range(columns):
                    out[level, ring, column] += weight * rings[level, other, column]
    return out


@njit(cache=True)
def residuals_and_slopes(
    white: Array,
    unit_background: Array,
    data: Array,
    amplitudes: Array,
    lost: Array,
    whitener: Array,
) -> tuple[Array, Array]:
    """Return the whitened residuals of the rings, and minus their derivatives by source and
    background.

    `white`: whitened ring means of one DN px^2 of source, shape (level, ring, point);
    `unit_background`, `data`: those of a uniform background of 1 DN, and those measured, shape
    (level, ring); `amplitudes`: source and background of each level, shape (level, 2, point);
    `lost`: ring means of the signal lost by clipping and of its derivatives by the amplitudes,
    shape (level, ring, 3, point), up to the last ring that is clipped; `whitener`: makes residuals
    independent and of unit variance, shape (level, ring, ring). Returns shapes (level, ring, point)
    and (amplitude, level, ring, point).
    """
    levels, rings, points = white.shape
    residual, slopes = np.empty((levels, rings, points)), np.empty((2, levels, rings, points))
    for level in range(levels):
        for ring in range(rings):
            flat = unit_background[level, ring]
            for point in range(points):
                source, source_background = white[level, ring, point], amplitudes[level, :, point]
                residual[level, ring, point] = (
                    data[level, ring] - source * source_background[0] - flat * source_background[1]
                )
                slopes[0, level, ring, point], slopes[1, level, ring, point] = source, flat
            for other in range(min(ring + 1, lost.shape[1])):
                weight = whitener[level, ring, other]
                for point in range(points):
                    residual[level, ring, point] += weight * lost[level, other, 0, point]
                    slopes[0, level, ring, point] -= weight * lost[level, other, 1, point]
                    slopes[1, level, ring, point] -= weight * lost[level, other, 2, point]
    return residual, slopes


@njit(cache=True)
def lost_at_top(
    unclipped: Array, amplitudes: Array, sd: Array, full: float, near_sd: float
) -> Array:
    """Signal lost by clipping at full scale, and its derivatives by source and background.

    `unclipped`: signal at the nodes of a source of 1 DN px^2, shape (node, point); `amplitudes`:
    source and background of each level, shape (level, 2, point); `sd`: standard deviation of a
    pixel, shape (level, node), DN; `full`: full scale, DN; `near_sd`: standard deviations around
    full scale within which clipping is partial. Returns shape (level, node, 3, point), up to the
    last clipped node.
    """
    levels, _, points = amplitudes.shape
    out = np.zeros((levels, _last_cut(unclipped, amplitudes, sd, full, near_sd), 3, points))
    for level in range(levels):
        for node in range(out.shape[1]):
            for point in range(points):
                source = unclipped[node, point]
                light = source * amplitudes[level, 0, point] + amplitudes[level, 1, point]
                z = (full - light) / sd[level, node]
                if z >= near_sd:
                    continue
                lost, clipped_fraction = light - full, 1.0
                if z > -near_sd:
                    below_probability = 0.5 * math.erfc(-z / math.sqrt(2.0))
                    lost += sd[level, node] * (
                        z * below_probability + math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)
                    )
                    clipped_fraction = 1.0 - below_probability
                out[level, node, 0, point] = lost
                out[level, node, 1, point] = clipped_fraction * source
                out[level, node, 2, point] = clipped_fraction
    return out


@njit(cache=True)
def _last_cut(unclipped: Array, amplitudes: Array, sd: Array, full: float, near_sd: float) -> int:
    """Number of nodes up to the last one at which the signal of some level is clipped."""
    levels, _, points = amplitudes.shape
    for node in range(len(unclipped) - 1, -1, -1):
        for level in range(levels):
            for point in range(points):
                light = (
                    unclipped[node, point] * amplitudes[level, 0, point]
                    + amplitudes[level, 1, point]
                )
                if light > full - near_sd * sd[level, node]:
                    return node + 1
    return 0


@njit(cache=True)
def best_step(source: Array, background: Array, residual: Array) -> tuple[Array, float]:
    """Least-squares step of source and background from whitened rings.

    `source`, `background`, `residual`: derivatives and residuals of the rings, shape (level, ring,
    point). Returns shape (level, 2, point) and the largest predicted fall of any level's chi
    squared.
    """
    levels, rings, points = residual.shape
    step, promise = np.empty((levels, 2, points)), -np.inf
    for level in range(levels):
        for point in range(points):
            a = b = d = right = level_right = 0.0
            for ring in range(rings):
                source_slope, background_slope, ring_residual = (
                    source[level, ring, point],
                    background[level, ring, point],
                    residual[level, ring, point],
                )
                a += source_slope * source_slope
                b += source_slope * background_slope
                d += background_slope * background_slope
                right += source_slope * ring_residual
                level_right += background_slope * ring_residual
            determinant = max(a * d - b * b, 1e-12 * a * d + 1e-300)
            first, second = (
                (d * right - b * level_right) / determinant,
                (a * level_right - b * right) / determinant,
            )
            step[level, 0, point], step[level, 1, point] = first, second
            promise = max(promise, first * right + second * level_right)
    return step, promise
