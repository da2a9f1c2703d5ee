"""Renderer: spectral radiance of a scene, with an error estimate for each pixel.

Rays through the pixel centres give the auxiliary layers. Each pixel gets a few rays, more at edges;
their variance gives the error, and where it is above the limit rays are added, turn by turn.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simulate.arrays import Array, Array32, Index, Mask
from simulate.radiance.cube import RadianceCube
from simulate.radiance.geometry.viewpoint import Viewpoint
from simulate.radiance.integrator.auxiliary_layers import AuxiliaryLayers, truth
from simulate.radiance.integrator.camera_rays import radiance_along
from simulate.radiance.integrator.integrator_settings import (
    LIMITS,
    IntegratorSettings,
    Run,
    SamplingSettings,
    additional_rays,
    excess_variance,
    local_mean,
    one_by_one,
)
from simulate.radiance.integrator.irradiance_cache import IrradianceCache, build_irradiance_cache
from simulate.radiance.integrator.sampling import R2, fraction
from simulate.radiance.integrator.spectral_scene import SpectralScene
from simulate.radiance.integrator.subpixel_sources import add_small_sources


@dataclass(frozen=True, kw_only=True)
class Rendering:
    """A rendering with its error estimate."""

    cube: RadianceCube  # spectral radiance
    # Sensor signal of each pixel, and its estimated variance from slices of the pixel's rays, shape
    # (row, col): on average too large where objects meet; the variance of the irradiance cache is
    # not included.
    signal: Array32
    variance: Array32
    rays: NDArray[np.int32]  # rays of each pixel, shape (row, col)
    truth: AuxiliaryLayers  # auxiliary layers
    # Number of pixels with negative radiance in some band, because of the control variate. They are
    # set to zero.
    below_zero: int


@dataclass(frozen=True)
class _Batch:
    """Pixels (indices of shape (pixel,)) with the same number of rays.

    Where surfaces meet, irradiance varies within a pixel: with `uncached` its rays do not use the
    cache and gather more.
    """

    pixels: Index
    rays: int
    uncached: bool
    iteration: int


@dataclass(frozen=True, kw_only=True)
class _BatchRenderer:
    """Renders batches of pixels."""

    scene: SpectralScene
    view: Viewpoint
    effort: IntegratorSettings
    weight: Array32
    gather_rays: int
    seed: int
    control: Array32  # control-variate fraction of the sky, shape (row, col)
    cache: IrradianceCache | None = None

    @property
    def only_shadow(self) -> bool:
        """Whether only sky shadowing is computed, which is cheap without a cache."""
        return self.effort.max_bounces == 0 and self.scene.lighting.panels is None

    def batches(
        self, new_rays: NDArray[np.integer], uncached: Mask, iteration: int
    ) -> Iterator[_Batch]:
        """Yield batches in frame order, from maps of shape (row, col)."""
        kinds = 2 * new_rays.ravel() + uncached.ravel()
        for kind in np.unique(kinds[kinds > 1]).tolist():
            pixels, count = np.flatnonzero(kinds == kind), kind // 2
            batch_pixels = max(1, LIMITS.batch_rays // (count * max(self.gather_rays, 1)))
            for start in range(0, len(pixels), batch_pixels):
                yield _Batch(pixels[start : start + batch_pixels], count, bool(kind % 2), iteration)

    def render(self, batch: _Batch) -> tuple[Array32, Array32]:
        """Return the pixels' radiance, shape (pixel, band), and the variance of their signal, shape
        (pixel,).
        """
        rng = np.random.default_rng(
            [self.seed, batch.rays, int(batch.pixels[0]), batch.uncached, batch.iteration]
        )
        count, columns, factor, cache = len(batch.pixels), self.view.shape[1], 1, self.cache
        if batch.uncached:
            factor = (
                LIMITS.sky_shadow_ray_factor if self.only_shadow else LIMITS.uncached_ray_factor
            )
        offset = fraction(rng.random((count, 1, 2)) + np.arange(batch.rays)[:, None] * R2)
        row = (batch.pixels[:, None] // columns + offset[..., 0]).ravel()
        col = (batch.pixels[:, None] % columns + offset[..., 1]).ravel()
        light = radiance_along(
            self.scene,
            *self.view.rays(row, col),
            self.effort,
            rng,
            gather_rays=self.gather_rays * factor,
            sky_control_fraction=np.repeat(self.control.ravel()[batch.pixels], batch.rays),
            cached_irradiance=None
            if cache is None or batch.uncached
            else lambda points, rays: cache.irradiance(points, row[rays], col[rays]),
        ).total()
        ray_signals = (light @ self.weight).reshape(count, batch.rays)
        return light.reshape(count, batch.rays, -1).mean(axis=1), _variance_of_mean(ray_signals)


def _variance_of_mean(ray_signals: Array32) -> Array32:
    """Return the variance of the mean of signals (pixel, ray), from means of slices."""
    rays = ray_signals.shape[1]
    starts = (
        np.arange(min(rays, LIMITS.variance_slices)) * rays // min(rays, LIMITS.variance_slices)
    )
    length = np.diff(starts, append=rays)
    slice_deviations = np.add.reduceat(ray_signals, starts, axis=1) / length - ray_signals.mean(
        axis=1, keepdims=True
    )
    return (length * slice_deviations**2).sum(axis=1) / (max(len(starts) - 1, 1) * rays)


def sky_control_fraction(scene: SpectralScene, view: Viewpoint, seed: int) -> Array32:
    """Return the unoccluded fraction of the hemisphere at the surfaces in view, averaged over a
    tile, shape (row, col).

    It is the control-variate fraction of the sky, estimated from a few points of each tile with
    independent random numbers.
    """
    rng = np.random.default_rng([seed, 1])
    side, (rows, columns) = max(1, min(LIMITS.control_tile_px, min(view.shape) // 16)), view.shape
    tiles = (-(-rows // side), -(-columns // side))
    corner = side * np.indices(tiles).reshape(2, -1, 1)
    position = corner + side * rng.random((2, corner.shape[1], LIMITS.control_pixels))
    row, col = (
        np.minimum(axis, length - 1e-3).ravel()
        for axis, length in zip(position, view.shape, strict=True)
    )
    origin, direction = view.rays(row, col)
    hit = scene.surfaces.tracer.hits(origin, direction)
    points = scene.points(hit, origin, direction, hit.rays)
    start = scene.surfaces.tracer.ray_starts(points.face, points.position_m, points.normal)
    occluded = np.zeros(len(row))
    for _ in range(LIMITS.control_rays):
        direction, _ = scene.bsdfs.sample(points, rng.random((len(points), 2)), rng)
        is_occluded = scene.surfaces.tracer.is_occluded(start, direction)
        occluded[hit.rays] += is_occluded / LIMITS.control_rays
    unoccluded = 1.0 - occluded.reshape(*tiles, -1).mean(axis=-1)
    return unoccluded.repeat(side, axis=0).repeat(side, axis=1)[:rows, :columns].astype(np.float32)


def render_scene(
    scene: SpectralScene,
    view: Viewpoint,
    rays: SamplingSettings,
    effort: IntegratorSettings,
    *,
    weight: Array,
    seed: int,
    run: Run = one_by_one,
    progress: Callable[[float], None] = lambda fraction: None,
    announce: Callable[[float], None] = lambda seconds: None,
) -> Rendering:
    """Render a scene.

    Parameters
    ----------
    scene, view
        The scene on its bands, and the camera.
    rays, effort
        Numbers of rays, and integrator settings.
    weight
        Signal of each band's radiance (`RenderSensor.weight`), in which variances are stated, shape
        (band,).
    seed
        Seed; the rendering does not depend on the number of threads.
    run
        Runs jobs, see `workers`.
    progress
        Called with the fraction completed, after the first turn.
    announce
        Called with the expected time in one thread, s, from that of the first turn.

    Notes
    -----
    Memory: two cubes and one batch of rays.
    """
    weight = np.asarray(weight, np.float32)
    layers, control = truth(scene, view), sky_control_fraction(scene, view, seed)
    renderer = _BatchRenderer(
        scene=scene,
        view=view,
        effort=effort,
        weight=weight,
        gather_rays=rays.gather_rays,
        seed=seed,
        control=control,
    )
    if rays.cache_rays is not None and effort.gathers:
        renderer, rays = _with_cache(renderer, rays, rays.cache_rays, run)
    edges = layers.edges()
    uncached = layers.edges(shadows=False) & (
        renderer.cache is not None and (rays.refine or renderer.only_shadow)
    )
    new_rays = np.minimum(
        np.where(edges, max(rays.edge, rays.min_rays), rays.min_rays), rays.max_rays
    )
    radiance = np.zeros((control.size, scene.bands), np.float32)
    variance, pixel_rays = np.zeros(control.size, np.float32), np.zeros(control.size, np.int32)
    max_total = np.inf if rays.total_rays is None else rays.total_rays + int(new_rays.sum())
    n_traced, seconds = 0, 0.0
    for iteration in range(LIMITS.max_turns):
        batches, start = (
            list(renderer.batches(new_rays, uncached, iteration)),
            time.perf_counter(),
        )
        n_requested = n_traced + int(new_rays.sum())
        results = run(renderer.render, batches)
        for batch, (light, batch_variance) in zip(batches, results, strict=True):
            pixels = batch.pixels
            new_weight = (batch.rays / (pixel_rays[pixels] + batch.rays)).astype(np.float32)
            variance[pixels] = (
                new_weight**2 * batch_variance + (1.0 - new_weight) ** 2 * variance[pixels]
            )
            radiance[pixels] += new_weight[:, None] * (light - radiance[pixels])
            pixel_rays[pixels] += batch.rays
            n_traced += len(pixels) * batch.rays
            if iteration:
                progress(n_traced / n_requested)
        seconds += time.perf_counter() - start
        if rays.error_limit is None:
            break
        shape = view.shape
        excess = excess_variance(variance, radiance @ weight, rays.error_limit).reshape(shape)
        if not excess.mean() > 1.0:
            break
        groups = edges, ~edges
        excess = np.where(
            edges, *(local_mean(excess, group, LIMITS.error_half_width) for group in groups)
        )
        new_rays = additional_rays(
            excess, pixel_rays.reshape(shape), groups, rays.max_rays, max_total
        )
        if not new_rays.any():
            break
        if iteration == 0:
            announce(seconds * (1.0 + float(new_rays.sum()) / n_traced))
    if iteration == 0:
        announce(seconds)
    progress(1.0)
    add_small_sources(scene, view, radiance)
    below_zero = int(np.count_nonzero((radiance < 0.0).any(axis=1)))
    signal = (radiance @ weight).astype(np.float32).reshape(view.shape)
    np.maximum(radiance, 0.0, out=radiance)
    cube = np.ascontiguousarray(radiance.T).reshape(scene.bands, *view.shape)
    return Rendering(
        cube=RadianceCube(wavelength_nm=scene.bsdfs.wavelength_nm, radiance=cube, averaged=True),
        signal=signal,
        variance=variance.reshape(view.shape),
        rays=pixel_rays.reshape(view.shape),
        truth=layers,
        below_zero=below_zero,
    )


def _with_cache(
    renderer: _BatchRenderer, rays: SamplingSettings, cache_rays: int, run: Run
) -> tuple[_BatchRenderer, SamplingSettings]:
    """Build the irradiance cache, and leave the rest of the allowed variance to the camera rays."""
    fine = rays.refine and not renderer.only_shadow
    limit, cache_fraction = rays.error_limit, LIMITS.cache_variance_fraction
    cache = build_irradiance_cache(
        renderer.scene,
        renderer.view,
        renderer.effort,
        renderer.control,
        rays=max(cache_rays // 2, 2) if fine else cache_rays,
        max_rays=rays.max_cache_rays,
        error_limit=None if limit is None else lambda signal: cache_fraction * limit(signal),
        weight=renderer.weight,
        seed=renderer.seed,
        run=run,
        fine=fine,
    )
    camera_ray_limit = (
        None if limit is None else lambda signal: (1.0 - cache_fraction) * limit(signal)
    )
    return replace(renderer, cache=cache), replace(rays, error_limit=camera_ray_limit)
