"""The picture of a scene in spectral radiance: rays where they are needed, an estimate of its own error for each pixel.

A first look along the middle of each pixel finds what is where (`truth`); a trial finds how much single rays differ and
decides how many rays a pixel gets (`allotment`). The picture is made of rays drawn afresh. What they themselves differ
measures the error; where it is more than was to be, pixels get further rays, turn by turn.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.cube import RadianceCube
from simulate.radiance.outdoor.viewpoint import Viewpoint
from simulate.radiance.transport.adaptive_sampling import SamplingSettings, allocate_samples, further
from simulate.radiance.transport.auxiliary_layers import AuxiliaryLayers, truth
from simulate.radiance.transport.integrator_settings import IntegratorSettings
from simulate.radiance.transport.irradiance_cache import build_irradiance_cache
from simulate.radiance.transport.pixel_batch import PixelBatch, PixelBatchRenderer, Trials, jobs
from simulate.radiance.transport.sky_control_variate import sky_control_fraction
from simulate.radiance.transport.spectral_scene import SpectralScene
from simulate.radiance.transport.subpixel_sources import add_small_sources
from simulate.radiance.transport.workers import Run, one_by_one

Array = NDArray[np.floating]
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
