"""From light at the nodes to whitened rings and back to a better light of each level: the inner
loops, compiled.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
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
    white: Array, even: Array, data: Array, amplitudes: Array, lost: Array, whitener: Array
) -> tuple[Array, Array]:
    """Return what light leaves of the measured rings, and how that falls with source and
    background.

    `white`: whitened ring means of one DN px^2 of source, shape (level, ring, point); `even`,
    `data`: those of an even light of 1 DN, and those measured, shape (level, ring); `amplitudes`:
    source and background of each level, shape (level, 2, point); `lost`: ring means of the light
    that is not read and of what it follows the amplitudes by, shape (level, ring, 3, point); rings
    end where nothing is lost any more; `whitener`: makes residuals independent and of unit
    variance, shape (level, ring, ring). Returns shape (level, ring, point). Shape (amplitude,
    level, ring, point).
    """
    levels, rings, points = white.shape
    residual, slopes = np.empty((levels, rings, points)), np.empty((2, levels, rings, points))
    for level in range(levels):
        for ring in range(rings):
            flat = even[level, ring]
            for point in range(points):
                source, given = white[level, ring, point], amplitudes[level, :, point]
                residual[level, ring, point] = (
                    data[level, ring] - source * given[0] - flat * given[1]
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
def lost_at_top(straight: Array, amplitudes: Array, sd: Array, full: float, near: float) -> Array:
    """Light that codes cut at the top do not show, and how it follows source and background.

    `straight`: light at the nodes of one DN px^2 of source, shape (node, point); `amplitudes`:
    source and background of each level, shape (level, 2, point); `sd`: standard deviation of a
    pixel, shape (level, node), DN; `full`: highest code, DN; `near`: standard deviations below the
    highest code within which codes are cut. Returns shape (level, node, 3, point); nodes end where
    nothing is lost any more.
    """
    levels, _, points = amplitudes.shape
    out = np.zeros((levels, _last_cut(straight, amplitudes, sd, full, near), 3, points))
    for level in range(levels):
        for node in range(out.shape[1]):
            for point in range(points):
                source = straight[node, point]
                light = source * amplitudes[level, 0, point] + amplitudes[level, 1, point]
                z = (full - light) / sd[level, node]
                if z >= near:
                    continue
                lost, share = light - full, 1.0
                if z > -near:
                    below = 0.5 * math.erfc(-z / math.sqrt(2.0))
                    lost += sd[level, node] * (
                        z * below + math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)
                    )
                    share = 1.0 - below
                out[level, node, 0, point] = lost
                out[level, node, 1, point] = share * source
                out[level, node, 2, point] = share
    return out


@njit(cache=True)
def _last_cut(straight: Array, amplitudes: Array, sd: Array, full: float, near: float) -> int:
    """Number of nodes up to the last one at which some level loses light."""
    levels, _, points = amplitudes.shape
    for node in range(len(straight) - 1, -1, -1):
        for level in range(levels):
            for point in range(points):
                light = (
                    straight[node, point] * amplitudes[level, 0, point]
                    + amplitudes[level, 1, point]
                )
                if light > full - near * sd[level, node]:
                    return node + 1
    return 0


@njit(cache=True)
def best_step(source: Array, even: Array, residual: Array) -> tuple[Array, float]:
    """Step of source and background that whitened rings ask for by least squares.

    `source`, `even`, `residual`: slopes of the rings and what is left of them, shape (level, ring,
    point). Returns shape (level, 2, point). Most that it promises of any level's chi squared.
    """
    levels, rings, points = residual.shape
    step, promise = np.empty((levels, 2, points)), -np.inf
    for level in range(levels):
        for point in range(points):
            a = b = d = right = level_right = 0.0
            for ring in range(rings):
                one, other, left = (
                    source[level, ring, point],
                    even[level, ring, point],
                    residual[level, ring, point],
                )
                a += one * one
                b += one * other
                d += other * other
                right += one * left
                level_right += other * left
            determinant = max(a * d - b * b, 1e-12 * a * d + 1e-300)
            first, second = (
                (d * right - b * level_right) / determinant,
                (a * level_right - b * right) / determinant,
            )
            step[level, 0, point], step[level, 1, point] = first, second
            promise = max(promise, first * right + second * level_right)
    return step, promise
