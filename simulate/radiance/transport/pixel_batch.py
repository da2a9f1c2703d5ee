"""Some pixels of a picture followed at once: their radiance, and how far chance may have moved it."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.outdoor.viewpoint import Viewpoint
from simulate.radiance.transport.camera_ray_radiance import radiance_along
from simulate.radiance.transport.integrator_settings import IntegratorSettings
from simulate.radiance.transport.irradiance_cache import IrradianceCache
from simulate.radiance.transport.low_discrepancy import R2, fraction
from simulate.radiance.transport.outgoing_radiance import Shared
from simulate.radiance.transport.shading_points import ShadingPoints
from simulate.radiance.transport.spectral_scene import SpectralScene

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
