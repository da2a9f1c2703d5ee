"""Likelihood of clipped pixels: lower limits of the light, and their frequency."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LIGHT_STEPS = 25


@dataclass(frozen=True, kw_only=True)
class Censored:
    """Pixels that are clipped in at least one frame.

    Parameters
    ----------
    matrix
        From a transfer at the nodes to their height at unit light, background and position at their optimum for the
        other pixels, shape (pixel, node).
    limit
        Full scale above the background, shape (pixel,), DN.
    sd
        Standard deviation of one frame, shape (pixel,), DN.
    cut, left
        Number of frames in which the pixel is clipped, and is not, shape (pixel,).
    mean
        Mean of the latter above the background, shape (pixel,), DN.
    """

    matrix: Array
    limit: Array
    sd: Array
    cut: Array
    left: Array
    mean: Array

    def terms(self, height: Array) -> tuple[Array, Array, float]:
        """Return slope and minus curvature of ln likelihood, each pixel's, and its sum, for heights (pixel,).

        Notes
        -----
        ln L = k ln Phi((h - c)/s) - (n - k) (v - h)^2 / (2 s^2): k of n frames are clipped at c, the mean of the others
        is v.
        """
        slope, curvature, value = self._terms(height[None])
        return slope[0], np.maximum(curvature[0], 1e-12 / self.sd**2), float(value[0])

    def _terms(self, height: Array) -> tuple[Array, Array, Array]:
        from scipy.special import log_ndtr

        z = (height - self.limit) / self.sd
        log_tail = log_ndtr(z)
        # Inverse Mills ratio phi/Phi, from logarithms to remain finite far below the limit.
        mills = np.exp(-0.5 * z**2 - 0.5 * np.log(2.0 * np.pi) - log_tail)
        off = (self.mean - height) / self.sd
        slope = (self.cut * mills + self.left * off) / self.sd
        curvature = (self.cut * mills * (mills + z) + self.left) / self.sd**2
        value = np.sum(self.cut * log_tail - 0.5 * self.left * off**2, axis=-1)
        return slope, curvature, value

    def light(self, data: Array, unit: Array, hidden: Array, start: float) -> float:
        """Return the most probable light of whitened pixels and clipped ones of unit heights."""
        best, _ = self._lights(np.array([unit @ data]), np.array([unit @ unit]), hidden[None], np.array([start]))
        return float(best[0])

    def _lights(self, overlap: Array, curvature: Array, hidden: Array, start: Array) -> tuple[Array, Array]:
        """Return the most probable lights by Newton's method, and the curvature there, shape (n,)."""
        light = np.maximum(start, 1e-12)
        bend = curvature
        for _ in range(LIGHT_STEPS):
            slope, weight, _ = self._terms(light[:, None] * hidden)
            bend = curvature + np.sum(weight * hidden**2, axis=1)
            step = (overlap - light * curvature + np.sum(slope * hidden, axis=1)) / np.maximum(bend, 1e-300)
            # The logarithm is concave: long steps are only shortened.
            light = light + np.clip(step, -0.5 * light, light)
            if np.all(np.abs(step) < 1e-9 * light):
                break
        return light, bend

    def log_likelihood(self, overlap: Array, curvature: Array, hidden: Array) -> Array:
        """Return ln likelihood of shapes, the light marginalised by Laplace's approximation, shape (n,)."""
        light, bend = self._lights(overlap, curvature, hidden, np.maximum(overlap / curvature, 1e-12))
        value = self._terms(light[:, None] * hidden)[2]
        return overlap * light - 0.5 * curvature * light**2 + value - 0.5 * np.log(np.maximum(bend, 1e-300))
