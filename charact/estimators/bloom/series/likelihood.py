"""Likelihood of a ring series under a halo model, with clipping at full scale."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from charact.estimators.bloom.series.halo_models import HaloModel, onto_nodes
from charact.estimators.bloom.series.rings import HARDLY_CUT, LevelRings, RingNoise
from charact.estimators.bloom.source_view import clipped_mean
from labdata import Array, Mask

# Trial values of the relative model error.
SHARES = np.concatenate([[1e-5], np.geomspace(5e-4, 0.2, 14)])


@dataclass(frozen=True, kw_only=True)
class Misfit:
    """Relative model error of the rings, the same in every model, since cameras are not
    rotationally symmetric.

    `outer`: relative error of rings beyond the core, dimensionless; `core`: relative error of rings
    near the core, at least that of the others, dimensionless.
    """

    outer: float
    core: float

    def of_rings(self, radius_px: Array) -> Array:
        """Return the relative model error of each ring, shape (ring,)."""
        return np.where(about_core(radius_px), self.core, self.outer)


def about_core(radius_px: Array) -> Mask:
    """Return which rings are near the core, shape (ring,)."""
    return radius_px < 4.0


# Standard error of a ring whose pixels are excluded, DN.
LOST_DN = 1e5
# Minimum signal of a ring for its relative error, DN.
LEAST_LIGHT_DN = 1e-6


@dataclass(frozen=True, kw_only=True)
class RingSeries:
    """Ring means of all stacks of one source.

    `labels`: labels of the stacks; `data`: ring means, shape (level, ring), DN; `cut`: rings with
    samples at full scale, shape (level, ring); `own_covariance`: covariance of the ring means due
    to noise alone, shape (level, ring, ring), DN^2; `node_sd`: standard deviation of a pixel at
    every node, shape (level, node), DN; `sector_sd`: root mean square deviation of sectors from
    their ring, shape (level, ring), DN; `averages`: matrix from signal at the nodes to ring means,
    shape (level, ring, node); `node_px`, `radius_px`: radii of the nodes and of the rings, column
    pitches; `full_dn`: full scale, DN.
    """

    labels: tuple[str, ...]
    data: Array
    cut: Mask
    own_covariance: Array
    node_sd: Array
    sector_sd: Array
    averages: Array
    node_px: Array
    radius_px: Array
    full_dn: float

    @cached_property
    def usable(self) -> Mask:
        """Rings outside a clipped core and its neighbour that are not lost, shape (level, ring)."""
        inside = np.cumsum(self.cut[:, ::-1], axis=1)[:, ::-1] > 0
        inside[:, 1:] |= inside[:, :-1]
        variance = np.diagonal(self.own_covariance, axis1=1, axis2=2)
        return ~inside & (variance < LOST_DN**2)

    @cached_property
    def light(self) -> Array:
        """Signal of each ring above the outermost rings of its stack, shape (level, ring), DN."""
        return np.abs(self.data - np.median(self.data[:, -6:], axis=1, keepdims=True))

    def covariance(self, misfit: Misfit) -> Array:
        """Covariance of the ring means with a relative model error, shape (level, ring, ring),
        DN^2.
        """
        out = self.own_covariance.copy()
        ring = np.arange(out.shape[1])
        out[:, ring, ring] += (
            misfit.of_rings(self.radius_px) * np.maximum(self.light, LEAST_LIGHT_DN)
        ) ** 2
        return out

    @cached_property
    def onto_nodes(self) -> Array:
        """Matrix from transfer functions to signal at the nodes, shape (frequency, node)."""
        return onto_nodes(self.node_px)


def series_of(levels: tuple[LevelRings, ...], noise: RingNoise, *, full_dn: float) -> RingSeries:
    """Combine the rings of all stacks into a series."""
    geometries = [level.geometry for level in levels]
    first = geometries[0]
    data = np.array([level.mean_dn for level in levels])
    covariances = [
        noise.covariance(means, of.count, level.frames)
        + np.diag(np.where(of.lost, LOST_DN**2, 0.0))
        for means, level, of in zip(data, levels, geometries, strict=True)
    ]
    nodes = np.array([np.interp(first.node_px, first.radius_px, means) for means in data])
    return RingSeries(
        labels=tuple(level.label for level in levels),
        data=data,
        cut=np.array([level.cut_share > HARDLY_CUT for level in levels]),
        own_covariance=np.array(covariances),
        node_sd=noise.pixel_sd(nodes),
        sector_sd=np.array([level.sector_sd for level in levels]),
        averages=np.array([geometry.averages for geometry in geometries]),
        node_px=first.node_px,
        radius_px=first.radius_px,
        full_dn=full_dn,
    )


@dataclass(frozen=True, kw_only=True)
class AmplitudeSolution:
    """Optimum amplitudes and residuals of every stack at some points.

    `amplitudes`: source signal, DN px^2, and background, DN, of each stack, shape (level,
    amplitude, point); `residual`: whitened residuals at the optimum amplitudes, shape (level, ring,
    point); `slopes`: derivatives of the whitened rings by the amplitudes, shape (amplitude, level,
    ring, point).
    """

    amplitudes: Array
    residual: Array
    slopes: Array

    @property
    def chi2(self) -> Array:
        """Chi squared of every stack, shape (level, point)."""
        return (self.residual**2).sum(axis=1)


@dataclass(frozen=True, kw_only=True)
class ModelParts:
    """Model of unit signal at some points, before the amplitudes.

    `unclipped`: signal at the nodes of a source of one DN px^2, shape (node, point); `white`,
    `uncut`: its ring means, whitened and weighted by the unclipped rings' precision, shape (level,
    ring, point).
    """

    unclipped: Array
    white: Array
    uncut: Array


def best_step(slopes: Array, residual: Array) -> tuple[Array, float]:
    """Least-squares step of source and background, shape (level, amplitude, point), and the largest
    predicted fall of any level's chi squared.

    `slopes`: derivatives of whitened rings, shape (amplitude, level, ring, point); `residual`:
    shape (level, ring, point).
    """
    source, background = slopes
    aa, ab, bb, ar, br = (
        np.einsum("lrp,lrp->lp", first, second)
        for first, second in (
            (source, source),
            (source, background),
            (background, background),
            (source, residual),
            (background, residual),
        )
    )
    determinant = np.maximum(aa * bb - ab**2, 1e-12 * aa * bb + 1e-300)
    first, second = (bb * ar - ab * br) / determinant, (aa * br - ab * ar) / determinant
    return np.stack([first, second], axis=1), float((first * ar + second * br).max())


@dataclass(frozen=True, kw_only=True)
class SeriesLikelihood:
    """Likelihood of a series under a model.

    `series`, `form`: series and halo model; `misfit`: relative model error of the rings; `steps`:
    maximum number of steps to the optimum amplitudes.
    """

    series: RingSeries
    form: HaloModel
    misfit: Misfit = Misfit(outer=0.02, core=0.02)
    steps: int = 2

    @cached_property
    def whitener(self) -> Array:
        """Whitening matrix of the residuals, shape (level, ring, ring)."""
        return np.asarray(
            np.linalg.inv(np.linalg.cholesky(self.series.covariance(self.misfit))), np.float64
        )

    @cached_property
    def uncut_weight(self) -> Array:
        """Reciprocal standard error of each unclipped ring, 0 of the others, shape (level, ring),
        1/DN.
        """
        variance = np.diagonal(self.series.covariance(self.misfit), axis1=1, axis2=2)
        return ~self.series.cut / np.sqrt(variance)

    @cached_property
    def weighted_rings(self) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Ring means as measured and of a uniform signal of 1 DN: whitened, and weighted by the
        unclipped rings' precision, shape (level, ring) each.
        """
        rings = self.series.data, self.series.averages.sum(axis=-1)
        white, even = ((self.whitener @ means[..., None])[..., 0] for means in rings)
        return (white, even), (self.uncut_weight * rings[0], self.uncut_weight * rings[1])

    def log_probability(self, points: Array) -> Array:
        """Log-posterior with the optimum amplitudes of every stack, shape (point,)."""
        prior = self.form.log_prior(points)
        within_bounds = np.isfinite(prior)
        out = np.full(len(points), -np.inf)
        if within_bounds.any():
            out[within_bounds] = prior[within_bounds] - 0.5 * self.solve_amplitudes(
                points[within_bounds]
            ).chi2.sum(axis=0)
        return out

    def parts(self, points: Array) -> ModelParts:
        """Return the model of unit signal at points."""
        return ModelParts(
            **self.unclipped_parts((self.form.transform(points) @ self.series.onto_nodes).T)
        )

    def unclipped_parts(self, unclipped: Array) -> dict[str, Array]:
        """Average signal at the nodes, shape (node, point), over rings."""
        rings = self.series.averages @ unclipped
        uncut = self.uncut_weight[..., None] * rings
        return {"unclipped": unclipped, "white": self.whitener @ rings, "uncut": uncut}

    def solve_amplitudes(self, points: Array) -> AmplitudeSolution:
        """Find the optimum amplitudes of all stacks at points."""
        return self.solve_amplitudes_of(self.parts(points))

    def solve_amplitudes_of(self, parts: ModelParts) -> AmplitudeSolution:
        """Find the optimum amplitudes of all stacks for given model parts."""
        # First those of the unclipped rings, correlations neglected.
        data, even = (
            np.broadcast_to(rings[..., None], parts.uncut.shape) for rings in self.weighted_rings[1]
        )
        amplitudes = best_step(np.stack([parts.uncut, even]), data)[0]
        residual, slopes = self.whiten(parts, amplitudes)
        for _ in range(self.steps):
            step, promise = best_step(slopes, residual)
            if promise < 1e-4:
                break
            amplitudes = amplitudes + step
            residual, slopes = self.whiten(parts, amplitudes)
        return AmplitudeSolution(amplitudes=amplitudes, residual=residual, slopes=slopes)

    def whiten(self, parts: ModelParts, amplitudes: Array) -> tuple[Array, Array]:
        """Whitened residuals, shape (level, ring, point), and their slopes, (amplitude, level,
        ring, point).
        """
        lost = self.lost(parts, amplitudes)
        levels, nodes, columns, points = lost.shape
        averages = self.series.averages[:, :, :nodes]
        rings = int(averages.any(axis=(0, 2)).sum())
        of_rings = averages[:, :rings] @ lost.reshape(levels, nodes, columns * points)
        white = self.whitener[:, :, :rings] @ of_rings
        loss, *falls = np.moveaxis(white.reshape(levels, -1, columns, points), 2, 0)
        data, even = (means[..., None] for means in self.weighted_rings[0])
        residual = data - parts.white * amplitudes[:, :1] - even * amplitudes[:, 1:] + loss
        return residual, np.stack([parts.white - falls[0], even - falls[1]])

    def lost(self, parts: ModelParts, amplitudes: Array) -> Array:
        """Clipped signal and its derivatives, shape (level, node, 1 + amplitude, point).

        The nodes end beyond the last clipped one.
        """
        light = self.light(parts, amplitudes)
        read, slope = clipped_mean(light, self.series.node_sd[..., None], self.series.full_dn)
        nodes = int(np.flatnonzero((slope < 1.0).any(axis=(0, 2))).max(initial=0)) + 1
        cut = 1.0 - slope[:, :nodes]
        lost = light[:, :nodes] - read[:, :nodes]
        return np.stack([lost, cut * parts.unclipped[:nodes], cut], axis=2)

    def light(self, parts: ModelParts, amplitudes: Array) -> Array:
        """Signal at the nodes, shape (level, node, point), DN."""
        return parts.unclipped * amplitudes[:, :1] + amplitudes[:, 1:]

    def rings(self, points: Array) -> Array:
        """Expected ring means with clipping, shape (level, ring, point), DN."""
        light = self.light_at(points)
        sd = self.series.node_sd[..., None]
        return self.series.averages @ clipped_mean(light, sd, self.series.full_dn)[0]

    def light_at(self, points: Array) -> Array:
        """Signal at the nodes with optimum amplitudes, shape (level, node, point), DN."""
        parts = self.parts(points)
        return self.light(parts, self.solve_amplitudes_of(parts).amplitudes)

    def likeliest_misfit(self, point: Array) -> tuple[Misfit, float]:
        """Return the most likely relative model errors at a point, and the log-likelihood."""
        residual = self.series.data - self.rings(point[None])[..., 0]
        is_core = about_core(self.series.radius_px)
        of_core, of_outer = (
            self._log_likelihoods(residual, rings) for rings in (is_core, ~is_core)
        )
        outer = int(np.argmax(of_outer))
        # Few rings near the core, to which the core was fitted, would underestimate the error.
        core = outer + int(np.argmax(of_core[outer:]))
        misfit = Misfit(outer=float(SHARES[outer]), core=float(SHARES[core]))
        return misfit, float(of_outer[outer] + of_core[core])

    def _log_likelihoods(self, residual: Array, rings: Mask) -> Array:
        """Log-likelihood of the residuals of some rings for each trial model error, shape
        (trial,).
        """
        at, own = residual[:, rings, None], self.series.own_covariance[:, rings][:, :, rings]
        light = np.maximum(self.series.light[:, rings], LEAST_LIGHT_DN)
        error = (SHARES[:, None, None] * light) ** 2
        covariance = own + error[..., None] * np.eye(light.shape[1])
        chi2 = np.sum(
            at * np.linalg.solve(covariance, np.broadcast_to(at, error[..., None].shape)),
            axis=(1, 2, 3),
        )
        return -0.5 * (chi2 + np.linalg.slogdet(covariance)[1].sum(axis=1))
