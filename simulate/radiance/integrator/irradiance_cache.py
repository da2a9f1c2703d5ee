"""Irradiance cache of diffuse surfaces: computed at nodes of the frame, smoothed and interpolated.

Indirect irradiance varies slowly along a surface. Nodes, one for four pixels or one for each,
gather it in two independent halves of rays, minus the unoccluded sky irradiance, which is exact.
Each half is smoothed by local plane fits; the window of a node is the one in which each half best
predicts the other. Contact shadows thus keep their shape while large walls lose their noise, and
the prediction error is an error estimate: nodes above the limit gather more rays. The mean that
noise-dependent windows lose is restored with the largest window (twicing).
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import gcd

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.geometry.viewpoint import Viewpoint
from simulate.radiance.integrator.cache_smoothing import Nodes, all_alike
from simulate.radiance.integrator.integrator_settings import (
    LIMITS,
    IntegratorSettings,
    Run,
    additional_rays,
    excess_variance,
)
from simulate.radiance.integrator.outgoing_radiance import outgoing_radiance
from simulate.radiance.integrator.sampling import (
    R2,
    SequenceSlice,
    fraction,
    low_discrepancy_points,
)
from simulate.radiance.integrator.spectral_scene import ShadingPoints, SpectralScene

Array = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class IrradianceCache:
    """Irradiance of diffuse surfaces in a frame, without lamps and discs."""

    stage: SpectralScene
    nodes: Nodes
    change: NDArray[
        np.float32
    ]  # irradiance minus that of an unoccluded sky, shape (row, col, band), W m-2 nm-1
    variance: Array  # estimated squared error of the signal of a white surface, shape (row, col)
    rays: NDArray[np.int64]  # gather rays of each node, shape (row, col)
    fine: bool = False  # whether each pixel is a node

    def at(
        self, points: ShadingPoints, row: Array, col: Array
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Return which points have a cached irradiance, and that irradiance, shape (cached point,
        band).

        Image coordinates of the rays that meet the points, shape (point,), are integers at the
        corners of pixels.
        """
        row, col = (
            np.floor(axis) if self.fine else axis / LIMITS.cache_step_px - 0.5
            for axis in (row, col)
        )
        light, has = self.nodes.between(self.change, row, col, points.place_m, points.normal)
        shares = np.flatnonzero(has & points.is_diffuse)
        light = light[shares]
        if not self.stage.lighting.environment_map.dark:
            light += self.stage.lighting.environment_map.irradiance(points.normal[shares])
        return shares, light


def build_irradiance_cache(
    stage: SpectralScene,
    view: Viewpoint,
    effort: IntegratorSettings,
    sky_control_fraction: Array,
    *,
    rays: int,
    max_rays: int,
    error_limit: Callable[[Array], Array] | None,
    weight: Array,
    seed: int,
    run: Run,
    fine: bool = False,
) -> IrradianceCache:
    """Return the irradiance cache of a frame.

    Parameters
    ----------
    stage, view, effort
        Scene, camera and integrator settings.
    sky_control_fraction
        Control-variate fraction of the sky of each pixel, see `ShadingPoints`, shape (row, col).
    rays, max_rays
        First and most rays of each node.
    error_limit
        Allowed variance of a pixel's signal, as a function of the signal: the mean of variance over
        limit is 1 over the nodes. None: no node gets more rays.
    weight
        Signal of each band's radiance, shape (band,).
    seed, run
        Seed, and the runner of jobs.
    fine
        Whether each pixel is a node with ray origins spread over the pixel: for shadows narrower
        than two pixels.
    """
    step = 1 if fine else LIMITS.cache_step_px
    traced = _trace_nodes(stage, view, sky_control_fraction, step)
    white = traced.points.on_white_surface()
    origins = _NodeOrigins(stage, view, traced, white, fine)
    grid = Nodes.of(traced.row, traced.col, traced.shape, white.place_m, white.normal, white.face)
    direct, reflected = _known_signal(stage, traced.points, effort, weight)
    light = np.zeros((2, len(white), stage.bands), np.float32)
    sent, half, turn = np.zeros(len(white), np.int64), np.full(len(white), max(rays // 2, 1)), 0
    while True:
        for part in (0, 1):
            for ray_count in np.unique(half[half > 0]).tolist():
                which, seeds = (
                    np.flatnonzero(half == ray_count),
                    [[seed, kind, turn, part, ray_count] for kind in (5, 6)],
                )
                sequence = low_discrepancy_points(
                    traced.row[which], traced.col[which], ray_count, seeds[0]
                )
                gathered = _gather(stage, origins, which, effort, sequence, seeds[1], run)
                new_weight = (ray_count / (sent[which] + ray_count)).astype(np.float32)[:, None]
                light[part, which] += new_weight * (gathered - light[part, which])
        sent += half
        signals = np.stack([grid.spread(part @ weight) for part in light], axis=2).astype(
            np.float64
        )
        width, variance, smooth = _windows(grid, signals, run)
        turn += 1
        if error_limit is None or turn == LIMITS.max_cache_turns or not len(white):
            break
        signal = direct + reflected * smooth[traced.row, traced.col]
        excess = excess_variance(
            reflected**2 * variance[traced.row, traced.col], signal, error_limit
        )
        grids = grid.spread(excess), np.maximum(grid.spread(sent), 1)
        half = additional_rays(*grids, (grid.there,), max_rays // 2)[traced.row, traced.col]
        if not half.any():
            break
    change = _smooth(grid, grid.spread(light.mean(axis=0)), width, run)
    return IrradianceCache(
        stage=stage,
        nodes=grid,
        change=change,
        variance=variance,
        rays=grid.spread(2 * sent),
        fine=fine,
    )


def _known_signal(
    stage: SpectralScene, points: ShadingPoints, effort: IntegratorSettings, weight: Array
) -> tuple[Array, Array]:
    """Return the signal of nodes by direct light and open sky, and their mean reflectance over the
    sensor's weights.
    """
    reflected = stage.bsdfs.diffuse_brdf(points) @ weight / max(float(weight.sum()), 1e-30)
    sky = stage.lighting.environment_map
    rng = np.random.default_rng(0)
    signal = (
        outgoing_radiance(stage, points, effort, rng, rays=0, light="lamps and discs").total()
        @ weight
    )
    return (
        signal if sky.dark else signal + reflected * (sky.irradiance(points.normal) @ weight)
    ), reflected


@dataclass(frozen=True)
class _NodePoints:
    """Points on diffuse surfaces, and the rows and columns of their nodes."""

    points: ShadingPoints
    row: NDArray[np.int64]
    col: NDArray[np.int64]
    shape: tuple[int, int]


def _trace_nodes(
    stage: SpectralScene, view: Viewpoint, sky_control_fraction: Array, step: int
) -> _NodePoints:
    """Trace the centres of nodes."""
    shape = (-(-view.shape[0] // step), -(-view.shape[1] // step))
    row, col = (axis.ravel() for axis in np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"))
    origin, towards = view.rays(step * (row + 0.5), step * (col + 0.5))
    hit = stage.surfaces.tracer.hits(origin, towards)
    met = hit.met
    control_fraction = sky_control_fraction[
        np.minimum(step * row[met], view.shape[0] - 1),
        np.minimum(step * col[met], view.shape[1] - 1),
    ]
    points = stage.points(hit, origin, towards, met, control_fraction)
    diffuse = np.flatnonzero(points.is_diffuse)
    return _NodePoints(points.some(diffuse), row[met[diffuse]], col[met[diffuse]], shape)


@dataclass(frozen=True)
class _NodeOrigins:
    """Ray origins of nodes: their centres or, for fine nodes, points spread over their pixels."""

    stage: SpectralScene
    view: Viewpoint
    traced: _NodePoints
    white: ShadingPoints
    fine: bool

    def each(self, rays: int) -> int:
        """Return the number of origins of a node's rays."""
        return (
            gcd(rays, max(LIMITS.min_ray_origins, rays // LIMITS.max_rays_per_origin))
            if self.fine
            else 1
        )

    def of(
        self, nodes: NDArray[np.int64], origins_per_node: int, rng: np.random.Generator
    ) -> ShadingPoints:
        """Return ray origins of some nodes, node by node.

        An origin on another surface than the node's centre is replaced by that centre.
        """
        start = rng.random((2, len(nodes), 1))
        nodes = np.repeat(nodes, origins_per_node)
        middle = self.white.some(nodes)
        if not self.fine:
            return middle
        at = fraction(start + R2[:, None, None] * np.arange(origins_per_node)).reshape(2, -1)
        origin, towards = self.view.rays(
            self.traced.row[nodes] + at[0], self.traced.col[nodes] + at[1]
        )
        hit = self.stage.surfaces.tracer.hits(origin, towards)
        met = hit.met
        position = origin[met] + hit.range_m[met, None] * towards[met]
        face = hit.face[met]
        normal, _ = self.stage.surfaces.tracer.facing(face, towards[met])
        same = all_alike(middle.place_m[met], middle.normal[met], position, normal)
        for values, met_values in (
            (middle.place_m, position),
            (middle.face, face),
            (middle.normal, normal),
        ):
            values[met[same]] = met_values[same]
        return middle


def _gather(
    stage: SpectralScene,
    start_from: _NodeOrigins,
    nodes: NDArray[np.int64],
    effort: IntegratorSettings,
    sequence: SequenceSlice,
    seed: list[int],
    run: Run,
) -> NDArray[np.float32]:
    """Gather at nodes: irradiance minus that of an unoccluded sky, shape (node, band)."""
    sky, origins_per_node = stage.lighting.environment_map, start_from.each(sequence.rays)

    def gather_part(start: int) -> NDArray[np.float32]:
        part = np.arange(start, min(start + count, len(nodes)))
        rng = np.random.default_rng([*seed, start])
        origins, shared = (
            start_from.of(nodes[part], origins_per_node, rng),
            sequence.some(part).divide(origins_per_node),
        )
        asked = {"rays": shared.rays, "sequence": shared, "light": "surroundings"}
        light = outgoing_radiance(stage, origins, effort, rng, **asked).total()
        light *= np.float32(np.pi)
        if not sky.dark:
            light -= sky.irradiance(origins.normal)
        return light.reshape(len(part), origins_per_node, -1).mean(axis=1)

    count = max(1, LIMITS.cache_batch_rays // sequence.rays)
    parts = list(run(gather_part, list(range(0, len(nodes), count))))
    return np.concatenate(parts) if parts else np.zeros((0, stage.bands), np.float32)


def _smooth(
    grid: Nodes, values: NDArray[np.float32], width: NDArray[np.int64], run: Run
) -> NDArray[np.float32]:
    """Return values of nodes smoothed over their windows, plus the smoothed residual.

    Windows chosen from noisy values avoid rare bright light, which biases the mean. The residual,
    smoothed over the largest window, restores it (twicing, Tukey 1977).
    """
    evened = grid.smooth(values, width, run).astype(np.float32)
    evened += grid.smooth(
        values - evened, np.full(width.shape, LIMITS.smoothing_half_widths[-1]), run
    )
    return evened


def _windows(grid: Nodes, signals: Array, run: Run) -> tuple[NDArray[np.int64], Array, Array]:
    """Choose each node's window by cross-validation of the two halves; return it, its squared error
    and the fit.

    (A - B)^2 / 2 is the variance of a half; a fit of A deviates from B by its error and by B's
    noise. The mean of both halves has half of the error, and at least the noise of a mean over the
    window.
    """
    noise = grid.near(0.5 * (signals[..., 0] - signals[..., 1]) ** 2, LIMITS.error_half_width)
    best, width, fit = (
        np.full(noise.shape, np.inf),
        np.zeros(noise.shape, np.int64),
        np.zeros(noise.shape),
    )
    for half_width in LIMITS.smoothing_half_widths:
        smooth = (
            grid.smooth(signals, np.full(noise.shape, half_width), run) if half_width else signals
        )
        missed = (
            grid.near(
                0.5 * ((smooth - signals[..., ::-1]) ** 2).sum(axis=-1), LIMITS.error_half_width
            )
            - noise
        )
        better = missed < best
        best[better], width[better], fit[better] = (
            missed[better],
            half_width,
            smooth[better].mean(axis=-1),
        )
    return width, 0.5 * np.maximum(best, noise / (2.0 * width + 1.0) ** 2), fit
