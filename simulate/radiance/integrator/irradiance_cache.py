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

from simulate.arrays import Array, Array32, Index
from simulate.radiance.geometry.viewpoint import Viewpoint
from simulate.radiance.integrator.cache_smoothing import Nodes, same_surface_pairs
from simulate.radiance.integrator.integrator_settings import (
    LIMITS,
    IntegratorSettings,
    Run,
    additional_rays,
    excess_variance,
    local_mean,
)
from simulate.radiance.integrator.outgoing_radiance import outgoing_radiance
from simulate.radiance.integrator.sampling import (
    R2,
    SequenceSlice,
    fraction,
    low_discrepancy_points,
)
from simulate.radiance.integrator.spectral_scene import ShadingPoints, SpectralScene


@dataclass(frozen=True, kw_only=True)
class IrradianceCache:
    """Irradiance of diffuse surfaces in a frame, without lamps and discs."""

    scene: SpectralScene
    nodes: Nodes
    change: (
        Array32  # irradiance minus that of an unoccluded sky, shape (row, col, band), W m-2 nm-1
    )
    variance: Array  # estimated squared error of the signal of a white surface, shape (row, col)
    rays: Index  # gather rays of each node, shape (row, col)
    fine: bool = False  # whether each pixel is a node

    def irradiance(self, points: ShadingPoints, row: Array, col: Array) -> tuple[Index, Array32]:
        """Return which points have a cached irradiance, and that irradiance, shape (cached point,
        band).

        Image coordinates of the rays that meet the points, shape (point,), are integers at the
        corners of pixels.
        """
        row, col = (
            np.floor(axis) if self.fine else axis / LIMITS.cache_step_px - 0.5
            for axis in (row, col)
        )
        light, has_node = self.nodes.interpolate(
            self.change, row, col, points.position_m, points.normal
        )
        cached = np.flatnonzero(has_node & points.is_diffuse)
        light = light[cached]
        if not self.scene.lighting.environment_map.is_dark:
            light += self.scene.lighting.environment_map.irradiance(points.normal[cached])
        return cached, light


def build_irradiance_cache(
    scene: SpectralScene,
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
    scene, view, effort
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
    centres = _trace_nodes(scene, view, sky_control_fraction, step)
    white = centres.points.on_white_surface()
    origins = _NodeOrigins(scene, view, centres, white, fine)
    grid = Nodes.of(
        centres.row, centres.col, centres.shape, white.position_m, white.normal, white.face
    )
    direct, reflected = _known_signal(scene, centres.points, effort, weight)
    light = np.zeros((2, len(white), scene.bands), np.float32)
    node_rays, new_rays = np.zeros(len(white), np.int64), np.full(len(white), max(rays // 2, 1))
    iteration = 0
    while True:
        for half in (0, 1):
            for ray_count in np.unique(new_rays[new_rays > 0]).tolist():
                nodes = np.flatnonzero(new_rays == ray_count)
                seeds = [[seed, kind, iteration, half, ray_count] for kind in (5, 6)]
                sequence = low_discrepancy_points(
                    centres.row[nodes], centres.col[nodes], ray_count, seeds[0]
                )
                new_light = _gather(scene, origins, nodes, effort, sequence, seeds[1], run)
                new_weight = (ray_count / (node_rays[nodes] + ray_count)).astype(np.float32)
                light[half, nodes] += new_weight[:, None] * (new_light - light[half, nodes])
        node_rays += new_rays
        signals = np.stack(
            [grid.on_grid(half_light @ weight) for half_light in light], axis=2
        ).astype(np.float64)
        width, variance, smooth = _windows(grid, signals, run)
        iteration += 1
        if error_limit is None or iteration == LIMITS.max_cache_turns or not len(white):
            break
        cells = centres.row, centres.col
        signal = direct + reflected * smooth[cells]
        excess = excess_variance(reflected**2 * variance[cells], signal, error_limit)
        grids = grid.on_grid(excess), np.maximum(grid.on_grid(node_rays), 1)
        new_rays = additional_rays(*grids, (grid.has_surface,), max_rays // 2)[cells]
        if not new_rays.any():
            break
    change = _smooth(grid, grid.on_grid(light.mean(axis=0)), width, run)
    return IrradianceCache(
        scene=scene,
        nodes=grid,
        change=change,
        variance=variance,
        rays=grid.on_grid(2 * node_rays),
        fine=fine,
    )


def _known_signal(
    scene: SpectralScene, points: ShadingPoints, effort: IntegratorSettings, weight: Array
) -> tuple[Array, Array]:
    """Return the signal of nodes by direct light and open sky, and their mean reflectance over the
    sensor's weights.
    """
    reflected = scene.bsdfs.diffuse_brdf(points) @ weight / max(float(weight.sum()), 1e-30)
    sky = scene.lighting.environment_map
    rng = np.random.default_rng(0)
    signal = (
        outgoing_radiance(scene, points, effort, rng, rays=0, light="lamps and discs").total()
        @ weight
    )
    return (
        signal if sky.is_dark else signal + reflected * (sky.irradiance(points.normal) @ weight)
    ), reflected


@dataclass(frozen=True)
class _NodePoints:
    """Points on diffuse surfaces, and the rows and columns of their nodes."""

    points: ShadingPoints
    row: Index
    col: Index
    shape: tuple[int, int]


def _trace_nodes(
    scene: SpectralScene, view: Viewpoint, sky_control_fraction: Array, step: int
) -> _NodePoints:
    """Trace the centres of nodes."""
    shape = (-(-view.shape[0] // step), -(-view.shape[1] // step))
    row, col = (axis.ravel() for axis in np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"))
    origin, direction = view.rays(step * (row + 0.5), step * (col + 0.5))
    hit = scene.surfaces.tracer.hits(origin, direction)
    control_fraction = sky_control_fraction[
        np.minimum(step * row[hit.rays], view.shape[0] - 1),
        np.minimum(step * col[hit.rays], view.shape[1] - 1),
    ]
    points = scene.points(hit, origin, direction, hit.rays, control_fraction)
    diffuse = np.flatnonzero(points.is_diffuse)
    nodes = hit.rays[diffuse]
    return _NodePoints(points.select(diffuse), row[nodes], col[nodes], shape)


@dataclass(frozen=True)
class _NodeOrigins:
    """Ray origins of nodes: their centres or, for fine nodes, points spread over their pixels."""

    scene: SpectralScene
    view: Viewpoint
    centres: _NodePoints
    white: ShadingPoints
    fine: bool

    def count(self, rays: int) -> int:
        """Return the number of origins of a node's rays."""
        return (
            gcd(rays, max(LIMITS.min_ray_origins, rays // LIMITS.max_rays_per_origin))
            if self.fine
            else 1
        )

    def points(
        self, nodes: Index, origins_per_node: int, rng: np.random.Generator
    ) -> ShadingPoints:
        """Return ray origins of some nodes, node by node.

        An origin on another surface than the node's centre is replaced by that centre.
        """
        start = rng.random((2, len(nodes), 1))
        nodes = np.repeat(nodes, origins_per_node)
        origins = self.white.select(nodes)
        if not self.fine:
            return origins
        offset = fraction(start + R2[:, None, None] * np.arange(origins_per_node)).reshape(2, -1)
        lens, direction = self.view.rays(
            self.centres.row[nodes] + offset[0], self.centres.col[nodes] + offset[1]
        )
        hit = self.scene.surfaces.tracer.hits(lens, direction)
        rays = hit.rays
        position = lens[rays] + hit.range_m[rays, None] * direction[rays]
        face = hit.face[rays]
        normal, _ = self.scene.surfaces.tracer.sided_normals(face, direction[rays])
        is_same = same_surface_pairs(
            origins.position_m[rays], origins.normal[rays], position, normal
        )
        for values, hit_values in (
            (origins.position_m, position),
            (origins.face, face),
            (origins.normal, normal),
        ):
            values[rays[is_same]] = hit_values[is_same]
        return origins


def _gather(
    scene: SpectralScene,
    node_origins: _NodeOrigins,
    nodes: Index,
    effort: IntegratorSettings,
    sequence: SequenceSlice,
    seed: list[int],
    run: Run,
) -> Array32:
    """Gather at nodes: irradiance minus that of an unoccluded sky, shape (node, band)."""
    sky, origins_per_node = scene.lighting.environment_map, node_origins.count(sequence.rays)

    def gather_part(start: int) -> Array32:
        rows = np.arange(start, min(start + batch_nodes, len(nodes)))
        rng = np.random.default_rng([*seed, start])
        origins = node_origins.points(nodes[rows], origins_per_node, rng)
        slices = sequence.select(rows).divide(origins_per_node)
        light = outgoing_radiance(
            scene,
            origins,
            effort,
            rng,
            rays=slices.rays,
            sequence=slices,
            light="surroundings",
        ).total()
        light *= np.float32(np.pi)
        if not sky.is_dark:
            light -= sky.irradiance(origins.normal)
        return light.reshape(len(rows), origins_per_node, -1).mean(axis=1)

    batch_nodes = max(1, LIMITS.cache_batch_rays // sequence.rays)
    parts = list(run(gather_part, list(range(0, len(nodes), batch_nodes))))
    return np.concatenate(parts) if parts else np.zeros((0, scene.bands), np.float32)


def _smooth(grid: Nodes, values: Array32, width: Index, run: Run) -> Array32:
    """Return values of nodes smoothed over their windows, plus the smoothed residual.

    Windows chosen from noisy values avoid rare bright light, which biases the mean. The residual,
    smoothed over the largest window, restores it (twicing, Tukey 1977).
    """
    smoothed = grid.smooth(values, width, run).astype(np.float32)
    largest_width = np.full(width.shape, LIMITS.smoothing_half_widths[-1])
    smoothed += grid.smooth(values - smoothed, largest_width, run)
    return smoothed


def _windows(grid: Nodes, signals: Array, run: Run) -> tuple[Index, Array, Array]:
    """Choose each node's window by cross-validation of the two halves; return it, its squared error
    and the fit.

    (A - B)^2 / 2 is the variance of a half; a fit of A deviates from B by its error and by B's
    noise. The mean of both halves has half of the error, and at least the noise of a mean over the
    window.
    """
    difference = 0.5 * (signals[..., 0] - signals[..., 1]) ** 2
    noise = local_mean(difference, grid.has_surface, LIMITS.error_half_width)
    min_error, fit = np.full(noise.shape, np.inf), np.zeros(noise.shape)
    width = np.zeros(noise.shape, np.int64)
    for half_width in LIMITS.smoothing_half_widths:
        smooth = (
            grid.smooth(signals, np.full(noise.shape, half_width), run) if half_width else signals
        )
        deviation = 0.5 * ((smooth - signals[..., ::-1]) ** 2).sum(axis=-1)
        error = local_mean(deviation, grid.has_surface, LIMITS.error_half_width) - noise
        is_better = error < min_error
        min_error[is_better], width[is_better] = error[is_better], half_width
        fit[is_better] = smooth[is_better].mean(axis=-1)
    return width, 0.5 * np.maximum(min_error, noise / (2.0 * width + 1.0) ** 2), fit
