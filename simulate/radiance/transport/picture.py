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
from simulate.radiance.trace import NOTHING
from simulate.radiance.transport.allotment import Rays, allotted, further
from simulate.radiance.transport.effort import Effort
from simulate.radiance.transport.even import R2, fraction
from simulate.radiance.transport.field import Field, field
from simulate.radiance.transport.leaving import leaving
from simulate.radiance.transport.panes import MOST, SPLIT, Met, Panes, chosen, mirrored
from simulate.radiance.transport.parts import Parts
from simulate.radiance.transport.points import Points
from simulate.radiance.transport.small_sources import add_small_sources
from simulate.radiance.transport.stage import Stage
from simulate.radiance.transport.truth import Truth, truth
from simulate.radiance.transport.workers import Run, one_by_one
from simulate.radiance.world.viewpoint import Viewpoint

Array = NDArray[np.floating]
# Points that share what they gather, and the irradiance that they get, see `leaving`.
Shared = tuple[NDArray[np.int64], NDArray[np.float32]]
Sharing = Callable[[Points, NDArray[np.int64]], Shared]
# Share of the variance allowed that is left to light that pixels share: it costs most. The rest is for their own rays.
SHARED_CHANCE = 0.8
# Rays that are followed at once, gathering counted.
BATCH = 48_000
# Pixels that share nothing gather by so many times as many rays: more where only the sky's shadow is to be found.
ALONE, ALONE_IN_SHADOW = 2, 8
# Pixels and rays by which it is tried how open the sky is, in each tile; of small pictures tiles have one pixel.
OPEN_TILE, OPEN_TILES, OPEN_TRIED, OPEN_TRIES = 4, 16, 2, 4
# Stretches of a pixel's rays whose means are compared: each is spread over the pixel as evenly as all of them.
STRETCHES = 8
# Times that the error is measured at most.
TURNS = 12


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A picture and what is known of it.

    Parameters
    ----------
    cube
        Spectral radiance.
    signal, variance
        What the eye makes of each pixel, and how far chance may have moved that: an estimate of its variance from
        stretches of the pixel's own rays, on average too large where objects meet, shape (row, col); what pixels share
        (`field.Field.variance`) comes besides.
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
    truth: Truth
    below_zero: int


@dataclass(frozen=True)
class Job:
    """Some pixels (numbers in the picture, shape (pixel,)) that get as many rays each, spread over them or not.

    Where `known` (pixel,) is 1 the open sky's light is taken as known, see `Points`. Where surfaces meet, light from
    around changes within a pixel: `alone`, its rays share none of it and gather more. Each `turn` has other rays.
    """

    pixels: NDArray[np.int64]
    rays: int
    known: NDArray[np.float32]
    together: bool = False
    alone: bool = False
    turn: int = 0


@dataclass(frozen=True, kw_only=True)
class Look:
    """All that a part of the picture is made from."""

    stage: Stage
    view: Viewpoint
    effort: Effort
    weight: NDArray[np.float32]
    gathered: int
    seed: int
    field: Field | None = None

    @property
    def only_shadow(self) -> bool:
        """Whether of all around only what hides the sky is to be found, which takes so little that none need share."""
        return self.effort.bounces == 0 and self.stage.lighting.panels is None

    @property
    def gathers_alone(self) -> int:
        """By how many times as many rays pixels gather that share none."""
        return ALONE_IN_SHADOW if self.only_shadow else ALONE

    def seen(self, job: Job) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the pixels' radiance, shape (pixel, band), and the variance of their signal, shape (pixel,)."""
        rng = np.random.default_rng([self.seed, job.rays, int(job.pixels[0]), job.alone, job.turn])
        count, columns = len(job.pixels), self.view.shape[1]
        apart = np.zeros(job.rays) if job.together else np.arange(job.rays)
        spread = fraction(rng.random((count, 1, 2)) + apart[:, None] * R2)
        row = (job.pixels[:, None] // columns + spread[..., 0]).ravel()
        col = (job.pixels[:, None] % columns + spread[..., 1]).ravel()
        origin, towards = self.view.rays(row, col)
        known = np.repeat(job.known, job.rays)
        share = None if self.field is None or job.alone else partial(_shared, self.field, row, col)
        light = along(
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


def _shared(field: Field, row: Array, col: Array, points: Points, which: NDArray[np.int64]) -> Shared:
    return field.at(points, row[which], col[which])


def along(
    stage: Stage,
    origin: Array,
    towards: Array,
    effort: Effort,
    rng: np.random.Generator,
    *,
    gathered: int,
    known: NDArray[np.float32] | None = None,
    split: bool = False,
    share: Sharing | None = None,
    behind: int = 0,
) -> Parts:
    """Return the radiance along rays of unit direction (ray, 3), in parts of shape (ray, band), as `leaving`.

    Besides the sources, parts are "in view": sky and glow that the ray meets, and "air": what air adds on the way, less
    what it takes of all the rest. Points of rays (their numbers) may `share` what they gather, see `leaving`.
    Rays that meet a pane go on both ways, through and mirrored; `behind` a few panes they take one by chance.
    """
    hit = stage.surfaces.tracer.hits(origin, towards)
    parts = Parts((len(towards), len(stage.coats.wavelength_nm)), split=split)
    here = np.ones(len(towards), np.bool_)
    if stage.coats.panes is not None:
        glass = stage.coats.panes.met(origin, towards, hit.range_m)
        here[glass.which] = False
        for which, start, ways, left, straight in _ways_on(stage.coats.panes, glass, towards, behind, rng):
            seen = None if known is None else known[which]
            sharing = _of_some(share, which) if straight else None
            onwards = along(
                stage, start, ways, effort, rng,
                gathered=gathered, known=seen, split=split, share=sharing, behind=behind + 1,
            )  # fmt: skip
            for name, light in onwards.found.items():
                parts.add(name, which, light * left)
        if stage.air.absorbs and "air" not in effort.left_out:
            _through_air(stage, parts, glass.range_m, towards[glass.which], glass.which)
    met = np.flatnonzero(here & (hit.face != NOTHING))
    away = np.flatnonzero(here & (hit.face == NOTHING))
    parts.add("in view", away, stage.lighting.dome.radiance(towards[away]))
    points = stage.points(hit, origin, towards, met, None if known is None else known[met])
    glows, glow = stage.emitted(points)
    parts.add("in view", met[glows], glow)
    shared = None if share is None else share(points, met)
    leaving(stage, points, effort, rng, rays=gathered, into=(parts, met), shared=shared)
    if stage.air.absorbs and "air" not in effort.left_out:
        _through_air(stage, parts, hit.range_m[met], towards[met], met)
    return parts


def _of_some(share: Sharing | None, which: NDArray[np.int64]) -> Sharing | None:
    """Share as all rays do, for some of them."""
    return None if share is None else lambda points, numbers: share(points, which[numbers])


def _ways_on(
    panes: Panes, glass: Met, towards: Array, behind: int, rng: np.random.Generator
) -> Iterator[tuple[NDArray[np.int64], Array, Array, NDArray[np.float32], bool]]:
    """Yield ways on from panes: numbers of rays, starts, directions, shares of the light, and whether straight on."""
    if not len(glass.which) or behind >= MOST:
        return
    ahead = towards[glass.which]
    by_chance = chosen(glass, rng) if behind >= SPLIT else None
    for turns, start, ways, left in (
        (False, panes.beyond(glass), ahead, glass.through),
        (True, panes.before(glass), mirrored(ahead, glass.normal), glass.mirrored),
    ):
        rows = np.arange(len(ahead)) if by_chance is None else np.flatnonzero(by_chance[0] == turns)
        if len(rows):
            share = left[rows] if by_chance is None else by_chance[1][rows]
            yield glass.which[rows], start[rows], ways[rows], share, not turns


def _through_air(stage: Stage, parts: Parts, range_m: Array, towards: Array, met: NDArray[np.int64]) -> None:
    """Add what the air adds on the way, and take what it takes of all the rest."""
    change = stage.air.through(range_m)
    change -= np.float32(1.0)
    change *= parts.total()[met]
    if stage.air.added is not None:
        change += stage.air.added(range_m, towards)
    parts.add("air", met, change)


def picture(
    stage: Stage,
    view: Viewpoint,
    rays: Rays,
    effort: Effort,
    *,
    weight: NDArray[np.floating],
    seed: int,
    run: Run = one_by_one,
    progress: Callable[[float], None] = lambda share: None,
    announce: Callable[[float], None] = lambda seconds: None,
) -> Picture:
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
    Memory is that of two cubes and of `BATCH` rays, whatever the number of rays.
    """
    look = Look(
        stage=stage,
        view=view,
        effort=effort,
        weight=np.asarray(weight, np.float32),
        gathered=rays.gathered,
        seed=seed,
    )
    here = truth(stage, view)
    known = sky_known(stage, view, seed)
    if rays.shared is not None and effort.gathers:
        fine = rays.fine and not look.only_shadow
        first = max(rays.shared // 2, 2) if fine else rays.shared
        sent = {"rays": first, "most": rays.shared_most, "allowed": _part(rays.allowed, SHARED_CHANCE)}
        around = field(stage, view, effort, known, **sent, weight=look.weight, seed=seed, run=run, fine=fine)
        look, rays = replace(look, field=around), replace(rays, allowed=_part(rays.allowed, 1.0 - SHARED_CHANCE))
    tried = _Tried(look, known)
    wanted = allotted(here, rays, tried, seed)
    announce(tried.seconds_a_ray * float(wanted.sum()))
    alone = here.edges(shadows=False) & (look.field is not None and (rays.fine or look.only_shadow))
    seen, done = _Sum(view.shape, len(look.weight)), 0
    for turn in range(TURNS):
        jobs = list(_jobs(wanted, known, alone, rays.gathered, turn))
        in_all = done + int(wanted.sum())
        for job, found in zip(jobs, run(look.seen, jobs), strict=True):
            seen.add(job, *found)
            done += len(job.pixels) * job.rays
            progress(done / in_all)
        wanted = further(here, rays, *map(seen.of, (seen.radiance @ look.weight, seen.variance, seen.rays)))
        if not wanted.any():
            break
    radiance, bands = seen.radiance, len(look.weight)
    add_small_sources(stage, view, radiance)
    below_zero = int(np.count_nonzero((radiance < 0.0).any(axis=1)))
    signal = (radiance @ look.weight).reshape(view.shape)
    np.maximum(radiance, 0.0, out=radiance)
    cube = np.ascontiguousarray(radiance.T).reshape(bands, *view.shape)
    return Picture(
        cube=RadianceCube(wavelength_nm=stage.coats.wavelength_nm, radiance=cube),
        signal=signal,
        variance=seen.of(seen.variance),
        rays=seen.of(seen.rays),
        truth=here,
        below_zero=below_zero,
    )


class _Sum:
    """What turns have found so far: mean radiance (pixel, band), the variance of its signal, and rays (pixel,)."""

    def __init__(self, shape: tuple[int, int], bands: int) -> None:
        self._shape = shape
        self.radiance = np.zeros((shape[0] * shape[1], bands), np.float32)
        self.variance = np.full(shape[0] * shape[1], np.nan, np.float32)
        self.rays = np.zeros(shape[0] * shape[1], np.int32)

    def add(self, job: Job, light: NDArray[np.float32], variance: NDArray[np.float32]) -> None:
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


def _part(allowed: Callable[[Array], Array] | None, share: float) -> Callable[[Array], Array] | None:
    """A share of the variance allowed."""
    return None if allowed is None else lambda signal: share * allowed(signal)


def sky_known(stage: Stage, view: Viewpoint, seed: int) -> NDArray[np.float32]:
    """Return the share of the hemisphere that is open before what pixels show, on average over a tile, (row, col).

    Tried by a few places of each tile, with random numbers of their own.
    """
    rng = np.random.default_rng([seed, 1])
    columns = view.shape[1]
    tile = int(np.clip(min(view.shape) // OPEN_TILES, 1, OPEN_TILE))
    pixel, tiles = _some_pixels(view.shape, tile, OPEN_TRIED, rng)
    jitter = rng.random((2, len(pixel)))
    origin, towards = view.rays(pixel // columns + jitter[0], pixel % columns + jitter[1])
    hit = stage.surfaces.tracer.hits(origin, towards)
    met = np.flatnonzero(hit.face != NOTHING)
    points = stage.points(hit, origin, towards, met)
    hidden = np.zeros(len(pixel))
    for _ in range(OPEN_TRIES):
        direction, _ = stage.coats.drawn(points, rng.random((len(met), 2)), rng)
        start = stage.surfaces.tracer.above(points.face, points.place_m, points.normal)
        hidden[met] += stage.surfaces.tracer.blocked(start, direction) / OPEN_TRIES
    share = hidden.reshape(*tiles, OPEN_TRIED).mean(axis=-1)
    return _of_tiles(1.0 - share, tile, view.shape).astype(np.float32)


class _Tried:
    """Follows pixels for trials, a batch at a time, and takes its own time."""

    def __init__(self, look: Look, known: NDArray[np.float32]) -> None:
        self._look, self._known = look, known.ravel()
        self._rays, self._seconds = 0, 0.0

    def __call__(self, pixels: NDArray[np.int64], rays: int, *, together: bool = False) -> tuple[Array, Array]:
        start = time.perf_counter()
        signal, single = np.empty(len(pixels)), np.empty(len(pixels))
        for first in range(0, len(pixels), BATCH // rays):
            part = slice(first, first + BATCH // rays)
            light, variance = self._look.seen(Job(pixels[part], rays, self._known[pixels[part]], together))
            signal[part], single[part] = light @ self._look.weight, variance * rays
        self._rays += rays * len(pixels)
        self._seconds += time.perf_counter() - start
        return signal, single

    @property
    def seconds_a_ray(self) -> float:
        """Time of one ray with all that it gathers, s; 0 before any was followed."""
        return self._seconds / max(self._rays, 1)


def _some_pixels(
    shape: tuple[int, int], tile: int, tried: int, rng: np.random.Generator
) -> tuple[NDArray[np.int64], tuple[int, int]]:
    """Numbers of a few pixels of each tile, tile by tile, and the numbers of tiles (down, across)."""
    tiles = (-(-shape[0] // tile), -(-shape[1] // tile))
    corner = np.stack(np.meshgrid(*(tile * np.arange(n) for n in tiles), indexing="ij"), axis=-1).reshape(-1, 1, 2)
    at = np.minimum(corner + rng.integers(0, tile, (len(corner), tried, 2)), np.array(shape) - 1)
    return (at[..., 0] * shape[1] + at[..., 1]).ravel(), tiles


def _of_tiles(values: NDArray, tile: int, shape: tuple[int, int]) -> NDArray:
    return values.repeat(tile, axis=0).repeat(tile, axis=1)[: shape[0], : shape[1]]


def _jobs(
    wanted: NDArray[np.int32], known: NDArray[np.float32], alone: NDArray[np.bool_], gathered: int, turn: int
) -> Iterator[Job]:
    """Cut the pixels into batches of as many rays each, in the order of the picture."""
    flat = 2 * wanted.ravel() + alone.ravel()
    for kind in np.unique(flat):
        pixels, count = np.flatnonzero(flat == kind), int(kind) // 2
        if not count:
            continue
        batch = max(1, BATCH // (count * max(gathered, 1)))
        for start in range(0, len(pixels), batch):
            part = pixels[start : start + batch]
            yield Job(part, count, known.ravel()[part], alone=bool(kind % 2), turn=turn)
