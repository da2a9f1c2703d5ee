"""Fitting a point source: pixels of the core and means of rings, weighed by the noise that is in them."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.mtf.point_data import Window
from charact.mtf.point_model import Optics, PointModel
from charact.mtf.point_noise import Noise, memory_of, noise_of
from charact.mtf.point_prior import prior_of
from charact.posterior import maximum

Array = NDArray[np.float64]

# Share by which a screen's own pattern makes pixels unequal, and over how many pixels it is alike.
PATTERN, PATTERN_PX = 0.015, 1.5
# Share of a code by which the mean of rounded values may be off where there is little noise.
ROUNDING_DN = 0.06
CLIMBS = 3


@dataclass(frozen=True, kw_only=True)
class PointFit:
    """The most probable transfer of a point source.

    Parameters
    ----------
    model
        The forward model.
    data, white
        Values used, shape (value,), and the matrix that whitens them.
    keep
        Which pixels of the core are used, shape (row, col).
    point, covariance
        Peak of the posterior and inverse of the curvature.
    light, pedestal
        Best light, DN px^2, and level, DN.
    light_sd
        Standard error of the light.
    chi2, free
        At the peak, and the values less what the data fix.
    noise
        Noise of the core.
    """

    model: PointModel
    data: Array
    white: Array
    keep: NDArray[np.bool_]
    point: Array = field(default_factory=lambda: np.empty(0))
    covariance: Array = field(default_factory=lambda: np.empty(0))
    light: float = 0.0
    pedestal: float = 0.0
    light_sd: float = 0.0
    chi2: float = 0.0
    free: int = 1
    noise: Noise | None = None

    def shapes(self, theta: Array) -> Array:
        """Return values of unit light, shape (n, value)."""
        core = self.model.core(theta)[:, self.keep]
        return np.concatenate([core, self.model.rings(theta)], axis=1) if self.model.ring_px.size else core

    def linear(self, theta: Array) -> tuple[Array, Array, Array]:
        """Return chi squared, best light and pedestal (n, 2), and their normal matrix (n, 2, 2)."""
        unit = self.shapes(theta) @ self.white.T
        flat, data = self.white.sum(axis=1), self.white @ self.data
        normal = np.empty((len(theta), 2, 2))
        normal[:, 0, 0] = (unit**2).sum(axis=1)
        normal[:, 0, 1] = normal[:, 1, 0] = unit @ flat
        normal[:, 1, 1] = flat @ flat
        right = np.stack([unit @ data, np.full(len(theta), flat @ data)], axis=1)
        best = np.linalg.solve(normal, right[..., None])[..., 0]
        return data @ data - (best * right).sum(axis=1), best, normal

    def log_probability(self, theta: Array) -> Array:
        """Return ln of the posterior with light and pedestal marginalised, shape (n,)."""
        value = self.model.prior.log_density(theta)
        inside = np.isfinite(value)
        if inside.any():
            chi2, _, normal = self.linear(theta[inside])
            # The prior of light is flat in its logarithm: a wide core is not favoured for taking more of it.
            value[inside] += -0.5 * chi2 - 0.5 * np.linalg.slogdet(normal)[1]
        return value


def fit(window: Window, context: Context, optics: Optics, progress=None) -> PointFit:
    """Fit a window; noise and transfer in turns."""
    prior = prior_of(context, halo_seen=window.holds_halo)
    model = PointModel(optics=optics, prior=prior, x=window.x, y=window.y, ring_px=window.ring_px)
    memory = memory_of(context, window.frames)
    point = _first(model, window)
    noise = None
    found = _weighted(model, window, point, None, memory)
    for turn in range(CLIMBS):
        point, covariance = maximum(found.log_probability, point, prior.bounds[prior.chosen])
        found = _at(found, point, covariance, noise)
        if turn == CLIMBS - 1:
            break
        if window.frames > 2:
            shares = (0.8,) if context.sensor is not None and turn == 0 else (0.4, 0.6, 0.8, 1.0)
            noise = noise_of(model, point, max(found.light, 1e-9), window.deviations, window.floor,
                             window.parity, memory, shares)  # fmt: skip
        found = _weighted(model, window, point, noise, memory, light=found.light)
    return found


def _first(model: PointModel, window: Window) -> Array:
    """Return where to climb from: the centre of light."""
    start = model.prior.centre[model.prior.chosen].copy()
    start[0], start[1] = window.centre
    return start


def _weighted(model, window: Window, point: Array, noise: Noise | None, memory, light: float = 0.0) -> PointFit:
    """Return a problem whose weights follow from noise and pattern at a point."""
    keep = window.keep
    count = window.frames
    mean = light * model.core(point[None])[0] if light else np.maximum(window.core - np.median(window.core), 0.0)
    bright = mean.ravel()
    if noise is None:
        covariance = np.diag(window.floor + 0.1 * bright**1.0 * max(float(bright.max()), 1.0) * 0.2) / count
    else:
        same = window.parity[:, None] == window.parity[None, :]
        factor = np.where(same, memory.mean_same, memory.mean_other) / count
        covariance = noise.gain * max(light, 0.0) * noise.pulse * factor
    covariance = covariance + np.diag(np.full(bright.size, window.floor / count + ROUNDING_DN**2 / 4))
    covariance = covariance + PATTERN**2 * np.outer(bright, bright) * np.exp(-0.5 * window.distances**2 / PATTERN_PX**2)
    covariance = covariance[np.ix_(keep.ravel(), keep.ravel())]
    size, rings = len(covariance), window.ring_dn.size
    whole = np.zeros((size + rings,) * 2)
    whole[:size, :size] = covariance
    whole[size:, size:] = _ring_covariance(window, noise, light, model, point)
    root = np.linalg.inv(np.linalg.cholesky(whole))
    return PointFit(model=model, data=np.concatenate([window.core[keep], window.ring_dn]), white=root, keep=keep)


def _ring_covariance(window: Window, noise: Noise | None, light: float, model: PointModel, point: Array) -> Array:
    """Return the covariance of the rings' means: scatter of their sectors, and rounding that all share but the last."""
    rings = window.ring_dn.size
    if not rings:
        return np.zeros((0, 0))
    outer = np.append(np.ones(rings - 1), 0.0)
    return np.diag(window.ring_variance) + ROUNDING_DN**2 * np.outer(outer, outer) * window.quiet


def _at(found: PointFit, point: Array, covariance: Array, noise: Noise | None) -> PointFit:
    """Return the fit at a peak."""
    chi2, best, normal = found.linear(point[None])
    return PointFit(
        model=found.model,
        data=found.data,
        white=found.white,
        keep=found.keep,
        point=point,
        covariance=covariance,
        light=float(best[0, 0]),
        pedestal=float(best[0, 1]),
        light_sd=float(np.sqrt(np.linalg.inv(normal[0])[0, 0])),
        chi2=float(chi2[0]),
        free=max(found.data.size - 2 - min(point.size, 5), 1),
        noise=noise,
    )
