"""Renderer: spectral radiance of a scene, with an error estimate for each pixel.

Rays through the pixel centres give the auxiliary layers; a pilot run estimates the variance of single rays and
allocates the camera rays (`adaptive_sampling`). The rendering uses independent rays. Their variance gives the error;
pixels above the limit get more rays, turn by turn.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.cube import RadianceCube
from simulate.radiance.geometry.viewpoint import Viewpoint
from simulate.radiance.integrator.adaptive_sampling import SamplingSettings, Tiles, allocate_samples, further
from simulate.radiance.integrator.auxiliary_layers import AuxiliaryLayers, truth
from simulate.radiance.integrator.integrator_settings import LIMITS, IntegratorSettings, Run, one_by_one
from simulate.radiance.integrator.irradiance_cache import IrradianceCache, build_irradiance_cache
from simulate.radiance.integrator.low_discrepancy import R2, fraction
from simulate.radiance.integrator.outgoing_radiance import Shared, radiance_along
from simulate.radiance.integrator.shading_points import ShadingPoints
from simulate.radiance.integrator.spectral_scene import SpectralScene
from simulate.radiance.integrator.subpixel_sources import add_small_sources

Array = NDArray[np.floating]


@dataclass(frozen=True)
class PixelBatch:
    """Pixels (indices of shape (pixel,)) with the same number of rays, spread over the pixel or not (`together`).

    `sky_control_fraction`, shape (pixel,), is that of `ShadingPoints`. Where surfaces meet, irradiance varies within a
    pixel: with `alone` its rays do not use the cache and gather more. Each `turn` has other rays.
    """

    pixels: NDArray[np.int64]
    rays: int
    sky_control_fraction: NDArray[np.float32]
    together: bool = False
    alone: bool = False
    turn: int = 0


def jobs(
    wanted: NDArray[np.int32],
    sky_control_fraction: NDArray[np.float32],
    alone: NDArray[np.bool_],
    gather_rays: int,
    turn: int,
) -> Iterator[PixelBatch]:
    """Yield batches of pixels with the same number of rays, in frame order, for maps of shape (row, col)."""
    flat = 2 * wanted.ravel() + alone.ravel()
    for kind in np.unique(flat):
        pixels, count = np.flatnonzero(flat == kind), int(kind) // 2
        if not count:
            continue
        batch = max(1, LIMITS.batch_rays // (count * max(gather_rays, 1)))
        for start in range(0, len(pixels), batch):
            part = pixels[start : start + batch]
            yield PixelBatch(part, count, sky_control_fraction.ravel()[part], alone=bool(kind % 2), turn=turn)


@dataclass(frozen=True, kw_only=True)
class PixelBatchRenderer:
    """Renders batches of pixels."""

    stage: SpectralScene
    view: Viewpoint
    effort: IntegratorSettings
    weight: NDArray[np.float32]
    gather_rays: int
    seed: int
    field: IrradianceCache | None = None

    @property
    def only_shadow(self) -> bool:
        """Whether only sky shadowing is computed, which is cheap without a cache."""
        return self.effort.max_bounces == 0 and self.stage.lighting.panels is None

    @property
    def gathers_alone(self) -> int:
        """Factor on the gather rays of pixels outside the cache."""
        return LIMITS.sky_shadow_ray_factor if self.only_shadow else LIMITS.uncached_ray_factor

    def render(self, job: PixelBatch) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the pixels' radiance, shape (pixel, band), and the variance of their signal, shape (pixel,)."""
        rng = np.random.default_rng([self.seed, job.rays, int(job.pixels[0]), job.alone, job.turn])
        count, columns = len(job.pixels), self.view.shape[1]
        apart = np.zeros(job.rays) if job.together else np.arange(job.rays)
        spread = fraction(rng.random((count, 1, 2)) + apart[:, None] * R2)
        row = (job.pixels[:, None] // columns + spread[..., 0]).ravel()
        col = (job.pixels[:, None] % columns + spread[..., 1]).ravel()
        origin, towards = self.view.rays(row, col)
        sky_control_fraction = np.repeat(job.sky_control_fraction, job.rays)
        share = None if self.field is None or job.alone else partial(_irradiance_from_cache, self.field, row, col)
        light = radiance_along(
            self.stage,
            origin,
            towards,
            self.effort,
            rng,
            gather_rays=self.gather_rays * (self.gathers_alone if job.alone else 1),
            sky_control_fraction=sky_control_fraction,
            share=share,
        ).total()
        each = (light @ self.weight).reshape(count, job.rays)
        return light.reshape(count, job.rays, -1).mean(axis=1), _variance_of_mean(each)


def _variance_of_mean(each: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the variance of the mean of signals (pixel, ray), from means of slices; nan for one ray."""
    count, rays = each.shape
    if rays < 2:
        return np.full(count, np.nan, np.float32)
    first = np.arange(min(rays, LIMITS.variance_slices)) * rays // min(rays, LIMITS.variance_slices)
    length = np.diff(first, append=rays)
    apart = np.add.reduceat(each, first, axis=1) / length - each.mean(axis=1, keepdims=True)
    return (length * apart**2).sum(axis=1) / ((len(first) - 1) * rays)


def _irradiance_from_cache(
    field: IrradianceCache, row: Array, col: Array, points: ShadingPoints, which: NDArray[np.int64]
) -> Shared:
    return field.at(points, row[which], col[which])


class Trials:
    """Traces pilot rays in batches, and measures the time."""

    def __init__(self, look: PixelBatchRenderer, sky_control_fraction: NDArray[np.float32]) -> None:
        self._look, self._known = look, sky_control_fraction.ravel()
        self._rays, self._seconds = 0, 0.0

    def __call__(self, pixels: NDArray[np.int64], rays: int, *, together: bool = False) -> tuple[Array, Array]:
        start = time.perf_counter()
        signal, single = np.empty(len(pixels)), np.empty(len(pixels))
        for first in range(0, len(pixels), LIMITS.batch_rays // rays):
            part = slice(first, first + LIMITS.batch_rays // rays)
            light, variance = self._look.render(PixelBatch(pixels[part], rays, self._known[pixels[part]], together))
            signal[part], single[part] = light @ self._look.weight, variance * rays
        self._rays += rays * len(pixels)
        self._seconds += time.perf_counter() - start
        return signal, single

    @property
    def seconds_a_ray(self) -> float:
        """Time of one camera ray with its gather rays, s; 0 before the first."""
        return self._seconds / max(self._rays, 1)


def sky_control_fraction(stage: SpectralScene, view: Viewpoint, seed: int) -> NDArray[np.float32]:
    """Return the unoccluded fraction of the hemisphere at the surfaces in view, averaged over a tile, shape (row, col).

    It is the control-variate fraction of the sky, estimated from a few points of each tile with independent random
    numbers.
    """
    rng = np.random.default_rng([seed, 1])
    tiles, columns, tracer = Tiles.of(view.shape, LIMITS.control_tile_px), view.shape[1], stage.surfaces.tracer
    pixel = tiles.some_pixels(LIMITS.control_pixels, rng)
    jitter = rng.random((2, len(pixel)))
    origin, towards = view.rays(pixel // columns + jitter[0], pixel % columns + jitter[1])
    hit = tracer.hits(origin, towards)
    met = hit.met
    points = stage.points(hit, origin, towards, met)
    hidden = np.zeros(len(pixel))
    for _ in range(LIMITS.control_rays):
        direction, _ = stage.bsdfs.sample(points, rng.random((len(met), 2)), rng)
        start = tracer.above(points.face, points.place_m, points.normal)
        hidden[met] += tracer.is_occluded(start, direction) / LIMITS.control_rays
    share = hidden.reshape(*tiles.count, LIMITS.control_pixels).mean(axis=-1)
    down, across = tiles.of_pixels
    return (1.0 - share)[down, across].astype(np.float32)


@dataclass(frozen=True, kw_only=True)
class Rendering:
    """A rendering with its error estimate.

    Parameters
    ----------
    cube
        Spectral radiance.
    signal, variance
        Sensor signal of each pixel, and its estimated variance from slices of the pixel's rays, shape (row, col): on
        average too large where objects meet; the variance of the irradiance cache is not included.
    rays
        Rays of each pixel, shape (row, col).
    truth
        Auxiliary layers.
    below_zero
        Number of pixels with negative radiance in some band, because of the control variate. They are set to zero.
    """

    cube: RadianceCube
    signal: NDArray[np.float32]
    variance: NDArray[np.float32]
    rays: NDArray[np.int32]
    truth: AuxiliaryLayers
    below_zero: int


def render_scene(
    stage: SpectralScene,
    view: Viewpoint,
    rays: SamplingSettings,
    effort: IntegratorSettings,
    *,
    weight: NDArray[np.floating],
    seed: int,
    run: Run = one_by_one,
    progress: Callable[[float], None] = lambda share: None,
    announce: Callable[[float], None] = lambda seconds: None,
) -> Rendering:
    """Render a scene.

    Parameters
    ----------
    stage
        The scene on its bands.
    view
        The camera.
    rays, effort
        Numbers of rays, and integrator settings.
    weight
        Signal of each band's radiance (`Eye.weight`), in which variances are stated, shape (band,).
    seed
        Seed; the rendering does not depend on the number of threads.
    run
        Runs jobs, see `workers`.
    progress
        Called with the fraction completed.
    announce
        Called with the expected time in one thread, s, from the time of the pilot.

    Notes
    -----
    Memory: two cubes and one batch of rays.
    """
    look = PixelBatchRenderer(
        stage=stage,
        view=view,
        effort=effort,
        weight=np.asarray(weight, np.float32),
        gather_rays=rays.gather_rays,
        seed=seed,
    )
    here = truth(stage, view)
    control = sky_control_fraction(stage, view, seed)
    if rays.cache_rays is not None and effort.gathers:
        look, rays = _sharing(look, rays, rays.cache_rays, control, run)
    tried = Trials(look, control)
    wanted = allocate_samples(here, rays, tried, seed)
    announce(tried.seconds_a_ray * float(wanted.sum()))
    alone = here.edges(shadows=False) & (look.field is not None and (rays.refine or look.only_shadow))
    seen, done = _Sum(view.shape, stage.bands), 0
    for turn in range(LIMITS.max_turns):
        batches = list(jobs(wanted, control, alone, rays.gather_rays, turn))
        total = done + int(wanted.sum())
        for job, found in zip(batches, run(look.render, batches), strict=True):
            seen.add(job, *found)
            done += len(job.pixels) * job.rays
            progress(done / total)
        wanted = further(here, rays, *map(seen.of, (seen.radiance @ look.weight, seen.variance, seen.rays)))
        if not wanted.any():
            break
    radiance = seen.radiance
    add_small_sources(stage, view, radiance)
    below_zero = int(np.count_nonzero((radiance < 0.0).any(axis=1)))
    signal = (radiance @ look.weight).reshape(view.shape)
    np.maximum(radiance, 0.0, out=radiance)
    cube = np.ascontiguousarray(radiance.T).reshape(stage.bands, *view.shape)
    return Rendering(
        cube=RadianceCube(wavelength_nm=stage.bsdfs.wavelength_nm, radiance=cube, averaged=True),
        signal=signal,
        variance=seen.of(seen.variance),
        rays=seen.of(seen.rays),
        truth=here,
        below_zero=below_zero,
    )


def _sharing(
    look: PixelBatchRenderer, rays: SamplingSettings, first: int, sky_control_fraction: NDArray[np.float32], run: Run
) -> tuple[PixelBatchRenderer, SamplingSettings]:
    """Build the irradiance cache, and leave the rest of the allowed variance to the camera rays."""
    fine = rays.refine and not look.only_shadow
    around = build_irradiance_cache(
        look.stage,
        look.view,
        look.effort,
        sky_control_fraction,
        rays=max(first // 2, 2) if fine else first,
        max_rays=rays.max_cache_rays,
        error_limit=_part(rays.error_limit, LIMITS.cache_variance_fraction),
        weight=look.weight,
        seed=look.seed,
        run=run,
        fine=fine,
    )
    return replace(look, field=around), replace(
        rays, error_limit=_part(rays.error_limit, 1.0 - LIMITS.cache_variance_fraction)
    )


def _part(error_limit: Callable[[Array], Array] | None, share: float) -> Callable[[Array], Array] | None:
    """Return a fraction of the allowed variance."""
    return None if error_limit is None else lambda signal: share * error_limit(signal)


class _Sum:
    """Accumulated mean radiance (pixel, band), variance of its signal, and rays (pixel,)."""

    def __init__(self, shape: tuple[int, int], bands: int) -> None:
        self._shape = shape
        self.radiance = np.zeros((shape[0] * shape[1], bands), np.float32)
        self.variance = np.full(shape[0] * shape[1], np.nan, np.float32)
        self.rays = np.zeros(shape[0] * shape[1], np.int32)

    def add(self, job: PixelBatch, light: NDArray[np.float32], variance: NDArray[np.float32]) -> None:
        """Add the rays of a batch: means and variances are weighted by rays."""
        pixels = job.pixels
        share = (job.rays / (self.rays[pixels] + job.rays)).astype(np.float32)
        before = np.where(share < 1.0, self.variance[pixels], 0.0)
        self.variance[pixels] = share**2 * variance + (1.0 - share) ** 2 * before
        self.radiance[pixels] += share[:, None] * (light - self.radiance[pixels])
        self.rays[pixels] += job.rays

    def of(self, values: NDArray) -> NDArray:
        """Return values of pixels (pixel,) as an image (row, col)."""
        return values.reshape(self._shape)
