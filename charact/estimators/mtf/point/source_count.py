"""Number of sources in one spot: two images of a common round spread against one elliptical image.

An aberrated pupil is described by two round images hardly better than by one ellipse; two sources
are, from 0.7 of the spread's full width on.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from charact.estimators.mtf.point.spot_light import SpotLight
from charact.estimators.mtf.point.thresholds import SOURCES
from labdata import Array

# Gauss-Legendre nodes of a pixel and their weights.
NODES, WEIGHTS = (0.5 * part for part in np.polynomial.legendre.leggauss(3))


class TwoSources(NamedTuple):
    """Two sources in one spot."""

    distance_px: float
    ratio: float  # Light of the fainter over that of the brighter

    @property
    def reason(self) -> str:
        """What was seen, and what settles it."""
        return (
            f"the light is that of two sources {self.distance_px:.1f} px apart, 1 : "
            f"{self.ratio:.2g}; use `roi` around one of them, or a single source"
        )


class _Box(NamedTuple):
    """Light of a spot in pixels as wide as its size allows."""

    light: Array  # Shape (row, col), DN
    variance: Array  # The same, DN^2
    # x, y: positions of columns and rows, in these pixels, shape (col,) and (row,)
    x: Array
    y: Array
    step_px: float  # Width of these pixels, px

    def residual(self, images: list[Array]) -> tuple[Array, Array]:
        """Return the lights of images and a level at their optimum, and what they leave."""
        design = np.stack([*(image.ravel() for image in images), np.ones(self.light.size)], axis=1)
        lights = np.asarray(
            np.linalg.lstsq(design, self.light.ravel(), rcond=None)[0], dtype=np.float64
        )
        return lights, self.light.ravel() - design @ lights


def two_sources(spot: SpotLight) -> TwoSources | None:
    """Return the two sources that a spot consists of; None: one describes it as well.

    Notes
    -----
    Least squares of B + L (1 + r^2 / a^2)^-b averaged over pixels (Moffat 1969). With the sums of
    squared residuals S1 of one elliptical and S2 of two round images, and N expected of noise:
    S1 - S2 > 0.5 (S1 - N), at 0.7 full widths and more.
    """
    box = _box_of(spot)
    x, y, top = box.x, box.y, float(box.light.max())
    weight = np.maximum(box.light - SOURCES.core * top, 0.0)
    centre = np.array([(weight * x).sum(), (weight * y[:, None]).sum()]) / weight.sum()
    offsets = np.stack(np.broadcast_arrays(x - centre[0], y[:, None] - centre[1]))
    moments = np.einsum("iyx,jyx,yx->ij", offsets, offsets, weight) / weight.sum()
    axis = np.linalg.eigh(moments)[1][:, 1]
    width = 2.0 * float(np.sqrt(np.count_nonzero(box.light > 0.5 * top) / np.pi))

    def ellipse(theta: Array) -> list[Array]:
        return [_moffat(x - theta[2], y - theta[3], theta)]

    def pair(theta: Array) -> list[Array]:
        return [_moffat(x - col, y - row, theta[:2]) for col, row in (theta[2:4], theta[4:])]

    spread = [np.log(width), np.log(SOURCES.first_order)]
    position = (float(min(x[0], y[0])), float(max(x[-1], y[-1])))
    bounds = np.array([SOURCES.ln_width, SOURCES.ln_order, position, position])
    of_ellipse = np.concatenate([bounds, [SOURCES.stretch, SOURCES.tilt]])
    single, _ = _fit(box, ellipse, [*spread, *centre, 0.0, 0.0], of_ellipse)
    spread[0] += np.log(SOURCES.narrower)
    double, theta = min(
        (
            _fit(
                box,
                pair,
                [*spread, *(centre - side * width * axis), *(centre + 2.0 * side * width * axis)],
                np.concatenate([bounds, [position, position]]),
            )
            for side in SOURCES.sides
        ),
        key=lambda fit: fit[0],
    )
    lights = box.residual(pair(theta))[0][:2]
    order = 1.0 + np.exp(theta[1])
    full_width = 2.0 * np.exp(theta[0]) * np.sqrt(2.0 ** (1.0 / order) - 1.0)
    distance, ratio = np.hypot(*(theta[2:4] - theta[4:])), lights.min() / max(lights.max(), 1e-300)
    gain = single - double
    is_double = (
        gain > SOURCES.min_gain * (single - box.variance.sum())
        and gain > SOURCES.min_gain_sd**2 * box.variance.max()
        and distance > SOURCES.min_distance * max(full_width, 1.0)
        and ratio > SOURCES.min_ratio
        and order > SOURCES.min_order
    )
    return TwoSources(float(distance) * box.step_px, float(ratio)) if is_double else None


def _box_of(spot: SpotLight) -> _Box:
    """Return the box around the disc of a spot, its pixels summed where it is wide."""
    rows, cols = np.nonzero(spot.disc)
    step = int(np.ceil(max(np.ptp(rows), np.ptp(cols)) / SOURCES.max_pixels))
    row, col = (
        slice(at.min(), at.min() + max((np.ptp(at) + 1) // step, 1) * step) for at in (rows, cols)
    )

    def mean(values: Array) -> Array:
        part = values[row, col]
        shape = part.shape[0] // step, step, part.shape[1] // step, step
        return part.reshape(shape).mean(axis=(1, 3))

    light = spot.mean - spot.level
    return _Box(
        light=mean(light),
        variance=mean(spot.pixel_sd(light) ** 2) / step**2,
        x=mean(spot.x)[0] / step,
        y=mean(spot.y)[:, 0] / step,
        step_px=float(step),
    )


def _fit(
    box: _Box, images: Callable[[Array], list[Array]], start: list[float], bounds: Array
) -> tuple[float, Array]:
    """Return the sum of squared residuals of images, DN^2, and their parameters."""
    from scipy.optimize import least_squares

    margin = 1e-3 * np.ptp(bounds, axis=1)
    fit = least_squares(
        lambda theta: box.residual(images(theta))[1],
        np.clip(start, bounds[:, 0] + margin, bounds[:, 1] - margin),
        bounds=tuple(bounds.T),
        max_nfev=SOURCES.evaluations,
    )
    return 2.0 * float(fit.cost), fit.x


def _moffat(x: Array, y: Array, theta: Array) -> Array:
    """Return (1 + q / a^2)^-b averaged over pixels, shape (row, col).

    `theta`: ln a, ln(b - 1), and of an ellipse the position, s and c of q = x^2 e^s + y^2 e^-s +
    2 c x y.
    """
    order, out = 1.0 + np.exp(theta[1]), 0.0
    stretch, tilt = theta[4:6] if len(theta) > 2 else (0.0, 0.0)
    for row, row_weight in zip(NODES, WEIGHTS, strict=True):
        for col, col_weight in zip(NODES, WEIGHTS, strict=True):
            along, down = x + col, y[:, None] + row
            square = along**2 * np.exp(stretch) + down**2 * np.exp(-stretch)
            square = np.maximum(square + 2.0 * tilt * along * down, 0.0)
            out = out + row_weight * col_weight * (1.0 + square * np.exp(-2.0 * theta[0])) ** -order
    return np.asarray(out)
