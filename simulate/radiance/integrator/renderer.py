"""The picture of a scene in spectral radiance: rays where they are needed, an estimate of its own error for each pixel.

A first look along the middle of each pixel finds what is where (`truth`); a trial finds how much single rays differ and
decides how many rays a pixel gets (`allotment`). The picture is made of rays drawn afresh. What they themselves differ
measures the error; where it is more than was to be, pixels get further rays, turn by turn.
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
from simulate.radiance.integrator.integrator_settings import IntegratorSettings, Run, one_by_one
from simulate.radiance.integrator.irradiance_cache import IrradianceCache, build_irradiance_cache
from simulate.radiance.integrator.low_discrepancy import R2, fraction
from simulate.radiance.integrator.outgoing_radiance import Shared, radiance_along
from simulate.radiance.integrator.shading_points import ShadingPoints
from simulate.radiance.integrator.spectral_scene import SpectralScene
from simulate.radiance.integrator.subpixel_sources import add_small_sources

Array = NDArray[np.floating]
# Rays that are followed at once, gathering counted.
BATCH = 48_000
# Pixels that share nothing gather by so many times as many rays: more where only the sky's shadow is to be found.
ALONE, ALONE_IN_SHADOW = 2, 8
# Stretches of a pixel's rays whose means are compared: each is spread over the pixel as evenly as all of them.
STRETCHES = 8


@dataclass(frozen=True)
class PixelBatch:
    """Some pixels (numbers in the picture, shape (pixel,)) that get as many rays each, spread over them or not.

    Where `known` (pixel,) is 1 the open sky's light is taken as known, see `ShadingPoints`. Where surfaces meet, light from
    around changes within a pixel: `alone`, its rays share none of it and gather more. Each `turn` has other rays.
    """

    pixels: NDArray[np.int64]
    rays: int
    known: NDArray[np.float32]
    together: bool = False
    alone: bool = False
    turn: int = 0


def jobs(
    wanted: NDArray[np.int32], known: NDArray[np.float32], alone: NDArray[np.bool_], gathered: int, turn: int
) -> Iterator[PixelBatch]:
    """Yield the pixels in batches of as many rays each, in the order of the picture, for maps of shape (row, col)."""
    flat = 2 * wanted.ravel() + alone.ravel()
    for kind in np.unique(flat):
        pixels, count = np.flatnonzero(flat == kind), int(kind) // 2
        if not count:
            continue
        batch = max(1, BATCH // (count * max(gathered, 1)))
        for start in range(0, len(pixels), batch):
            part = pixels[start : start + batch]
            yield PixelBatch(part, count, known.ravel()[part], alone=bool(kind % 2), turn=turn)


@dataclass(frozen=True, kw_only=True)
class PixelBatchRenderer:
    """All that a part of the picture is made from."""

    stage: SpectralScene
    view: Viewpoint
    effort: IntegratorSettings
    weight: NDArray[np.float32]
    gathered: int
    seed: int
    field: IrradianceCache | None = None

    @property
    def only_shadow(self) -> bool:
        """Whether of all around only what hides the sky is to be found, which takes so little that none need share."""
        return self.effort.bounces == 0 and self.stage.lighting.panels is None

    @property
    def gathers_alone(self) -> int:
        """By how many times as many rays pixels gather that share none."""
        return ALONE_IN_SHADOW if self.only_shadow else ALONE

    def seen(self, job: PixelBatch) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the pixels' radiance, shape (pixel, band), and the variance of their signal, shape (pixel,)."""
        rng = np.random.default_rng([self.seed, job.rays, int(job.pixels[0]), job.alone, job.turn])
        count, columns = len(job.pixels), self.view.shape[1]
        apart = np.zeros(job.rays) if job.together else np.arange(job.rays)
        spread = fraction(rng.random((count, 1, 2)) + apart[:, None] * R2)
        row = (job.pixels[:, None] // columns + spread[..., 0]).ravel()
        col = (job.pixels[:, None] % columns + spread[..., 1]).ravel()
        origin, towards = self.view.rays(row, col)
        known = np.repeat(job.known, job.rays)
        share = None if self.field is None or job.alone else partial(_irradiance_from_cache, self.field, row, col)
        light = radiance_along(
            self.stage,
            origin,
            towards,
            self.effort,
            rng,
            gathered=self.gathered * (self.gathers_alone if job.alone else 1),
            known=known,
            share=share,
        ).total()
        each = (light @ self.weight).reshape(count, job.rays)
        return light.reshape(count, job.rays, -1).mean(axis=1), _variance_of_mean(each)


def _variance_of_mean(each: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the variance of the mean of signals (pixel, ray), by means of stretches of them; nan for one ray."""
    count, rays = each.shape
    if rays < 2:
        return np.full(count, np.nan, np.float32)
    first = np.arange(min(rays, STRETCHES)) * rays // min(rays, STRETCHES)
    length = np.diff(first, append=rays)
    apart = np.add.reduceat(each, first, axis=1) / length - each.mean(axis=1, keepdims=True)
    return (length * apart**2).sum(axis=1) / ((len(first) - 1) * rays)


def _irradiance_from_cache(
    field: IrradianceCache, row: Array, col: Array, points: ShadingPoints, which: NDArray[np.int64]
) -> Shared:
    return field.at(points, row[which], col[which])


class Trials:
    """Follows pixels for trials, a batch at a time, and takes its own time."""

    def __init__(self, look: PixelBatchRenderer, known: NDArray[np.float32]) -> None:
        self._look, self._known = look, known.ravel()
        self._rays, self._seconds = 0, 0.0

    def __call__(self, pixels: NDArray[np.int64], rays: int, *, together: bool = False) -> tuple[Array, Array]:
        start = time.perf_counter()
        signal, single = np.empty(len(pixels)), np.empty(len(pixels))
        for first in range(0, len(pixels), BATCH // rays):
            part = slice(first, first + BATCH // rays)
            light, variance = self._look.seen(PixelBatch(pixels[part], rays, self._known[pixels[part]], together))
            signal[part], single[part] = light @ self._look.weight, variance * rays
        self._rays += rays * len(pixels)
        self._seconds += time.perf_counter() - start
        return signal, single

    @property
    def seconds_a_ray(self) -> float:
        """Time of one ray with all that it gathers, s; 0 before any was followed."""
        return self._seconds / max(self._rays, 1)


# Side of a tile, px; pixels of each by which it is tried how open the sky is, and rays of each of these.
TILE, TRIED, TRIES = 4, 2, 4


def sky_control_fraction(stage: SpectralScene, view: Viewpoint, seed: int) -> NDArray[np.float32]:
    """Return the share of the hemisphere that is open before what pixels show, on average over a tile, (row, col).

    Tried by a few places of each tile, with random numbers of their own.
    """
    rng = np.random.default_rng([seed, 1])
    tiles, columns, tracer = Tiles.of(view.shape, TILE), view.shape[1], stage.surfaces.tracer
    pixel = tiles.some_pixels(TRIED, rng)
    jitter = rng.random((2, len(pixel)))
    origin, towards = view.rays(pixel // columns + jitter[0], pixel % columns + jitter[1])
    hit = tracer.hits(origin, towards)
    met = hit.met
    points = stage.points(hit, origin, towards, met)
    hidden = np.zeros(len(pixel))
    for _ in range(TRIES):
        direction, _ = stage.bsdfs.drawn(points, rng.random((len(met), 2)), rng)
        start = tracer.above(points.face, points.place_m, points.normal)
        hidden[met] += tracer.is_occluded(start, direction) / TRIES
    share = hidden.reshape(*tiles.count, TRIED).mean(axis=-1)
    down, across = tiles.of_pixels
    return (1.0 - share)[down, across].astype(np.float32)


# Share of the variance allowed that is left to light that pixels share: it costs most. The rest is for their own rays.
SHARED_CHANCE = 0.8
# Times that the error is measured at most.
TURNS = 12


@dataclass(frozen=True, kw_only=True)
class Rendering:
    """A picture and what is known of it.

    Parameters
    ----------
    cube
        Spectral radiance.
    signal, variance
        What the eye makes of each pixel, and how far chance may have moved that: an estimate of its variance from
        stretches of the pixel's own rays, on average too large where objects meet, shape (row, col); what pixels share
        (`build_irradiance_cache.Field.variance`) comes besides.
    rays
        Rays of each pixel, shape (row, col).
    truth
        What is where.
    below_zero
        Pixels that chance brought below zero in some band: rays take hidden sky away one by one. They count as dark.
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
    """Return the picture of a scene.

    Parameters
    ----------
    stage
        The scene on bands.
    view
        The camera.
    rays, effort
        How many rays, and how far light is followed.
    weight
        Signal of each band's radiance (`Eye.weight`), in which variances are stated, shape (band,).
    seed
        Seed: the picture follows from it, whatever runs it.
    run
        Does parts of the work, see `workers`.
    progress
        Told the share done.
    announce
        Told how long it will take in one process, s, by how long the trials took.

    Notes
    -----
    Memory is that of two cubes and of `look.BATCH` rays, whatever the number of rays.
    """
    look = PixelBatchRenderer(
        stage=stage,
        view=view,
        effort=effort,
        weight=np.asarray(weight, np.float32),
        gathered=rays.gathered,
        seed=seed,
    )
    here = truth(stage, view)
    known = sky_control_fraction(stage, view, seed)
    if rays.shared is not None and effort.gathers:
        look, rays = _sharing(look, rays, rays.shared, known, run)
    tried = Trials(look, known)
    wanted = allocate_samples(here, rays, tried, seed)
    announce(tried.seconds_a_ray * float(wanted.sum()))
    alone = here.edges(shadows=False) & (look.field is not None and (rays.fine or look.only_shadow))
    seen, done = _Sum(view.shape, stage.bands), 0
    for turn in range(TURNS):
        batches = list(jobs(wanted, known, alone, rays.gathered, turn))
        in_all = done + int(wanted.sum())
        for job, found in zip(batches, run(look.seen, batches), strict=True):
            seen.add(job, *found)
            done += len(job.pixels) * job.rays
            progress(done / in_all)
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
    look: PixelBatchRenderer, rays: SamplingSettings, first: int, known: NDArray[np.float32], run: Run
) -> tuple[PixelBatchRenderer, SamplingSettings]:
    """Have pixels share what they gather, by so many rays of a node at first; their own rays have the rest to err."""
    fine = rays.fine and not look.only_shadow
    around = build_irradiance_cache(
        look.stage,
        look.view,
        look.effort,
        known,
        rays=max(first // 2, 2) if fine else first,
        most=rays.shared_most,
        allowed=_part(rays.allowed, SHARED_CHANCE),
        weight=look.weight,
        seed=look.seed,
        run=run,
        fine=fine,
    )
    return replace(look, field=around), replace(rays, allowed=_part(rays.allowed, 1.0 - SHARED_CHANCE))


def _part(allowed: Callable[[Array], Array] | None, share: float) -> Callable[[Array], Array] | None:
    """A share of the variance allowed."""
    return None if allowed is None else lambda signal: share * allowed(signal)


class _Sum:
    """What turns have found so far: mean radiance (pixel, band), the variance of its signal, and rays (pixel,)."""

    def __init__(self, shape: tuple[int, int], bands: int) -> None:
        self._shape = shape
        self.radiance = np.zeros((shape[0] * shape[1], bands), np.float32)
        self.variance = np.full(shape[0] * shape[1], np.nan, np.float32)
        self.rays = np.zeros(shape[0] * shape[1], np.int32)

    def add(self, job: PixelBatch, light: NDArray[np.float32], variance: NDArray[np.float32]) -> None:
        """Add the rays of a job: means and their variances are weighed by rays."""
        pixels = job.pixels
        share = (job.rays / (self.rays[pixels] + job.rays)).astype(np.float32)
        before = np.where(share < 1.0, self.variance[pixels], 0.0)
        self.variance[pixels] = share**2 * variance + (1.0 - share) ** 2 * before
        self.radiance[pixels] += share[:, None] * (light - self.radiance[pixels])
        self.rays[pixels] += job.rays

    def of(self, values: NDArray) -> NDArray:
        """Return values of pixels (pixel,) as a picture."""
        return values.reshape(self._shape)
