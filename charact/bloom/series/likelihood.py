"""How likely the rings of a series are under a form: codes cut at the top count as what they are.

A pixel of level x with noise s reads on average E[min(x + s n, c)] = c - s (z Phi(z) + phi(z)), z = (c - x)/s, at the
highest code c: a ring wholly cut says "at least so bright", one partly cut tells where the light crosses the top. The
light of each level and its background are found for every point anew (Gauss-Newton), so that what a level's source
really gave need not be known.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.bloom.series.forms import Form
from charact.bloom.series.hankel import onto_nodes
from charact.bloom.series.levels import HARDLY_CUT, Level, Noise
from charact.bloom.series.rings import Geometry

Array = NDArray[np.float64]

# Standard deviations of a pixel from the highest code within which some of its codes are cut.
NEAR_TOP = 5.0
# Standard error of a ring that says nothing, DN.
LOST_DN = 1e5
STEPS = 2
# Share of the light by which rings may be off in every form, as cameras are not round: first guess, and all tried.
FIRST_SHARE = 0.02
SHARES = np.concatenate([[1e-5], np.geomspace(5e-4, 0.2, 14)])


@dataclass(frozen=True, kw_only=True)
class Series:
    """All levels of one source.

    Parameters
    ----------
    labels
        Their stacks.
    data
        Ring means, shape (level, ring), DN.
    cut
        Rings with samples at the highest code, shape (level, ring).
    own_covariance
        Covariance of the ring means by noise alone, shape (level, ring, ring), DN^2.
    node_sd
        Standard deviation of a pixel at every node, shape (level, node), DN.
    sector_sd
        Root mean square of what sectors are brighter or darker than their ring, shape (level, ring), DN.
    averages
        Takes light at the nodes to ring means, shape (level, ring, node).
    node_px, radius_px
        Radii of the nodes and of the rings, column pitches.
    full_dn
        Highest code, DN.
    model_share
        Share of the light by which rings of any form are off.
    """

    labels: tuple[str, ...]
    data: Array
    cut: NDArray[np.bool_]
    own_covariance: Array
    node_sd: Array
    sector_sd: Array
    averages: Array
    node_px: Array
    radius_px: Array
    full_dn: float
    model_share: float = FIRST_SHARE

    @cached_property
    def light(self) -> Array:
        """Level of each ring above the farthest ones of its stack, shape (level, ring), DN."""
        return np.abs(self.data - np.median(self.data[:, -6:], axis=1, keepdims=True))

    def covariance(self, share: float) -> Array:
        """Covariance of the ring means when a form is off by a share of the light, shape (level, ring, ring), DN^2."""
        out = self.own_covariance.copy()
        ring = np.arange(out.shape[1])
        out[:, ring, ring] += (share * self.light) ** 2
        return out

    @cached_property
    def whitener(self) -> Array:
        """Makes residuals independent and of unit variance, shape (level, ring, ring)."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariance(self.model_share))), np.float64)

    @cached_property
    def white_data(self) -> Array:
        """Ring means, whitened, shape (level, ring)."""
        return (self.whitener @ self.data[..., None])[..., 0]

    @cached_property
    def white_averages(self) -> Array:
        """Takes light at the nodes to whitened ring means, shape (level, ring, node)."""
        return self.whitener @ self.averages

    @cached_property
    def onto_nodes(self) -> Array:
        """Takes transforms to light at the nodes, shape (frequency, node)."""
        return onto_nodes(self.node_px)


PER_LEVEL = ("data", "cut", "own_covariance", "node_sd", "sector_sd", "averages")


def some(series: Series, which: NDArray[np.bool_]) -> Series:
    """Return some levels of a series."""
    labels = tuple(label for label, one in zip(series.labels, which, strict=True) if one)
    return replace(series, labels=labels, **{name: getattr(series, name)[which] for name in PER_LEVEL})


def series_of(levels: tuple[Level, ...], noise: Noise, *, full_dn: float, rings: int) -> Series:
    """Gather the innermost rings of all levels."""
    geometries = [level.geometry.within(rings) for level in levels]
    first = geometries[0]
    data = np.array([level.mean_dn[:rings] for level in levels])
    nodes = np.array([np.interp(first.node_px, first.radius_px, one) for one in data])
    return Series(
        labels=tuple(level.label for level in levels),
        data=data,
        cut=np.array([level.cut_share[:rings] > HARDLY_CUT for level in levels]),
        own_covariance=np.array(
            [
                _own_covariance(one, level.frames, of, noise)
                for one, level, of in zip(data, levels, geometries, strict=True)
            ]
        ),
        node_sd=noise.pixel_sd(nodes),
        sector_sd=np.array([level.sector_sd[:rings] for level in levels]),
        averages=np.array([one.averages for one in geometries]),
        node_px=first.node_px,
        radius_px=first.radius_px,
        full_dn=full_dn,
    )


def _own_covariance(data: Array, frames: int, geometry: Geometry, noise: Noise) -> Array:
    out = noise.covariance(data, geometry.count, frames)
    return out + np.diag(np.where(geometry.lost, LOST_DN**2, 0.0))


@dataclass(frozen=True, kw_only=True)
class Solved:
    """What a form says of every level at some points.

    Parameters
    ----------
    residual
        What the best amplitudes leave of the rings, whitened, shape (level, ring, point).
    amplitudes
        Light, DN px^2, and background, DN, of each level, shape (level, amplitude, point).
    normal
        Curvature of chi2/2 in them, shape (level, amplitude, amplitude, point).
    """

    residual: Array
    amplitudes: Array
    normal: Array

    @property
    def chi2(self) -> Array:
        """Sum of squares of every level, shape (level, point)."""
        return (self.residual**2).sum(axis=1)


@dataclass(frozen=True, kw_only=True)
class Parts:
    """What a form gives at some points, before levels have their light.

    Parameters
    ----------
    straight
        Light at the nodes of one DN px^2 of source, and background, shape (amplitude, node, point).
    """

    straight: Array


@dataclass(frozen=True, kw_only=True)
class Problem:
    """A form put to a series."""

    series: Series
    form: Form
    steps: int = STEPS

    def log_probability(self, points: Array) -> Array:
        """Log of the posterior with every level's own light at its best, shape (point,)."""
        prior = self.form.log_prior(points)
        inside = np.isfinite(prior)
        out = np.full(len(points), -np.inf)
        if inside.any():
            out[inside] = prior[inside] - 0.5 * self.solved(points[inside]).chi2.sum(axis=0)
        return out

    def parts(self, points: Array) -> Parts:
        """Return what the form gives at points."""
        light = (self.form.transform(points) @ self.series.onto_nodes).T
        return Parts(straight=np.array([light, np.ones_like(light)]))

    def solved(self, points: Array) -> Solved:
        """Find the best amplitudes of all levels at points."""
        parts = self.parts(points)
        amplitudes = self._of_uncut_rings(parts.straight)
        residual, slopes = self._white(parts, amplitudes)
        for step in range(self.steps):
            # Levels that are not cut are straight: they are there after one step.
            which = np.flatnonzero(self.series.cut.any(axis=1)) if step else np.arange(len(amplitudes))
            if not len(which):
                break
            normal = np.einsum("lkjp,lmjp->lkmp", slopes[which], slopes[which])
            right = np.einsum("lkjp,ljp->lkp", slopes[which], residual[which])
            amplitudes[which] += _solved(normal, right)
            residual[which], slopes[which] = self._white(parts, amplitudes[which], which)
        normal = np.einsum("lkjp,lmjp->lkmp", slopes, slopes)
        return Solved(residual=residual, amplitudes=amplitudes, normal=normal)

    def _of_uncut_rings(self, straight: Array) -> Array:
        """First amplitudes, from the rings that are not cut, each with its own variance alone."""
        rings = np.einsum("lin,knp->likp", self.series.averages, straight, optimize=True)
        own = np.diagonal(self.series.covariance(self.series.model_share), axis1=1, axis2=2)
        weight = ~self.series.cut / own
        normal = np.einsum("li,likp,limp->lkmp", weight, rings, rings, optimize=True)
        return _solved(normal, np.einsum("li,likp->lkp", weight * self.series.data, rings, optimize=True))

    def _white(
        self, parts: Parts, amplitudes: Array, which: NDArray[np.intp] | slice = slice(None)
    ) -> tuple[Array, Array]:
        """Whitened residuals, shape (level, ring, point), and slopes of the rings, (level, amplitude, ring, point)."""
        levels, count, points = amplitudes.shape
        nodes = len(self.series.node_px)
        light, follows = self.light(parts, amplitudes)
        read, slope = self.read(light, self.series.node_sd[which])
        together = np.empty((levels, nodes, count + 1, points))
        together[:, :, 0] = read
        np.multiply(slope[:, :, None], follows, out=together[:, :, 1:])
        white = (self.series.white_averages[which] @ together.reshape(levels, nodes, -1)).reshape(
            levels, -1, count + 1, points
        )
        return self.series.white_data[which][..., None] - white[:, :, 0], white[:, :, 1:].transpose(0, 2, 1, 3)

    def light(self, parts: Parts, amplitudes: Array) -> tuple[Array, Array]:
        """Light at the nodes, (level, node, point), and how it follows the amplitudes, (.., node, amplitude, point)."""
        return np.einsum("knp,lkp->lnp", parts.straight, amplitudes), parts.straight.transpose(1, 0, 2)

    def read(self, light_dn: Array, sd_dn: Array) -> tuple[Array, Array]:
        """Mean code and its slope at nodes of some light, shape (level, node, point), and noise, (level, node)."""
        from scipy.special import ndtr

        full = self.series.full_dn
        z = (full - light_dn) / sd_dn[..., None]
        read, slope = np.minimum(light_dn, full), (z > 0).astype(float)
        near = np.flatnonzero(np.abs(z) < NEAR_TOP)
        if len(near):
            at = z.ravel()[near]
            below = ndtr(at)
            sd = np.repeat(sd_dn.ravel(), z.shape[-1])[near]
            slope.ravel()[near] = below
            read.ravel()[near] = full - sd * (at * below + np.exp(-0.5 * at**2) / np.sqrt(2 * np.pi))
        return read, slope

    def rings(self, points: Array) -> Array:
        """Ring means that the form expects, cut codes as read, shape (level, ring, point), DN."""
        light, _ = self.light(self.parts(points), self.solved(points).amplitudes)
        return self.series.averages @ self.read(light, self.series.node_sd)[0]

    def share_of_misfit(self, point: Array) -> tuple[float, float]:
        """Share of the light by which rings are off that makes a point most likely, and the log-likelihood then."""
        residual = self.series.data - self.rings(point[None])[..., 0]
        values = [_log_likelihood(residual, self.series.covariance(float(share))) for share in SHARES]
        return float(SHARES[int(np.argmax(values))]), max(values)


def _log_likelihood(residual: Array, covariance: Array) -> float:
    root = np.linalg.cholesky(covariance)
    white = np.linalg.solve(root, residual[..., None])
    return float(-0.5 * (white**2).sum() - np.log(np.diagonal(root, axis1=1, axis2=2)).sum())


def _solved(normal: Array, right: Array) -> Array:
    """Solve two equations for numbers of very unlike size, shapes (level, 2, 2, point) and (level, 2, point)."""
    (a, b), (_, d) = (normal[:, 0, 0], normal[:, 0, 1]), (normal[:, 1, 0], normal[:, 1, 1])
    determinant = np.maximum(a * d - b * b, 1e-12 * a * d + 1e-300)
    return (
        np.stack([d * right[:, 0] - b * right[:, 1], a * right[:, 1] - b * right[:, 0]], axis=1) / determinant[:, None]
    )
