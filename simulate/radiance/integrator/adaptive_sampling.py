"""Adaptive sampling: allocates camera rays per pixel so that the Monte Carlo error stays within its limit.

A pilot run estimates the variance of single rays in a few pixels of each tile, separately for edges of objects and
shadows; the pixels of the same object nearby use that estimate. The pilot's rays do not enter the rendering, because
sampling that depends on its own samples is biased. Where the measured variance exceeds the estimate, more rays follow.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.integrator.auxiliary_layers import AuxiliaryLayers
from simulate.radiance.integrator.integrator_settings import LIMITS


@dataclass(frozen=True)
class Tiles:
    """Tiles of a frame; those at its lower and right border may be smaller.

    Parameters
    ----------
    shape
        Pixels, (row, col).
    side
        Side of a tile, px.
    """

    shape: tuple[int, int]
    side: int

    @classmethod
    def of(cls, shape: tuple[int, int], side: int) -> "Tiles":
        """Return tiles of a side, px, or smaller ones in a small frame."""
        return cls(shape, int(np.clip(min(shape) // LIMITS.min_tiles, 1, side)))

    @property
    def count(self) -> tuple[int, int]:
        """Number of tiles, (down, across)."""
        return -(-self.shape[0] // self.side), -(-self.shape[1] // self.side)

    @property
    def of_pixels(self) -> NDArray[np.int64]:
        """Tile indices of all pixels, (down, across), shape (2, row, col)."""
        return np.indices(self.shape) // self.side

    def holding(self, pixel: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the tile indices of some pixels, (down, across), each of shape (pixel,)."""
        return pixel // self.shape[1] // self.side, pixel % self.shape[1] // self.side

    def some_pixels(self, many: int, rng: np.random.Generator) -> NDArray[np.int64]:
        """Draw the indices of `many` pixels of each tile, tile by tile."""
        down, across = self.count
        corner = self.side * np.indices((down, across)).reshape(2, -1, 1)
        at = corner + np.moveaxis(rng.integers(0, self.side, (down * across, many, 2)), -1, 0)
        row, col = (np.minimum(axis, length - 1) for axis, length in zip(at, self.shape, strict=True))
        return (row * self.shape[1] + col).ravel()

    def one_of_each(self, pixel: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the first of the given pixels in each tile."""
        down, across = self.holding(pixel)
        return pixel[np.unique(down * self.count[1] + across, return_index=True)[1]]


def with_neighbours(grid: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the sum of each tile (kind, down, across) and the eight around it."""
    wide = np.pad(grid, ((0, 0), (1, 1), (1, 1)))
    down = wide[:, :-2] + wide[:, 1:-1] + wide[:, 2:]
    return down[:, :, :-2] + down[:, :, 1:-1] + down[:, :, 2:]


Array = NDArray[np.floating]
# Objects beyond this number use the pilot rays of another object.
OBJECTS = 255
# Kind of the pilot rays at edges that go to the same point of the pixel; other edge rays are kind 0.
TOGETHER = OBJECTS + 1


@dataclass(frozen=True, kw_only=True)
class SamplingSettings:
    """Number of rays per pixel.

    Parameters
    ----------
    min_rays, edge, max_rays
        Fewest rays of a pixel, of a pixel where objects or shadows meet, and most rays of any pixel.
    total_rays
        Most rays of all pixels together, apart from the fewest of each; None: no limit.
    gather_rays
        Final-gather rays of each point that a camera ray hits.
    cache_rays, max_cache_rays
        First and most gather rays of each node of the irradiance cache; None: no cache, every ray gathers for itself,
        which is slower and makes no smoothness assumption.
    refine
        Whether the cache has one node per pixel instead of one per four, and pixels in which surfaces meet gather for
        themselves: for shadows narrower than two pixels, in twice the time. No effect where only sky shadowing is
        computed.
    error_limit
        Allowed Monte Carlo variance of a pixel's signal, as a function of the signal: the mean of variance over limit
        is 1 over the rendering. None: rays do not depend on variance.
    """

    min_rays: int = 2
    edge: int = 8
    max_rays: int = 32
    total_rays: int | None = None
    gather_rays: int = 2
    cache_rays: int | None = 8
    max_cache_rays: int = 512
    refine: bool = False
    error_limit: Callable[[Array], Array] | None = None


class PilotRenderer(Protocol):
    """Traces a few rays in some pixels."""

    def __call__(self, pixels: NDArray[np.int64], rays: int, *, together: bool = False) -> tuple[Array, Array]:
        """Return signals and the variances of single rays, each of shape (pixel,).

        Rays are spread over the pixel, or all go to the same point of it (`together`).
        """
        ...


def allocate_samples(
    here: AuxiliaryLayers, rays: SamplingSettings, trial: PilotRenderer, seed: int
) -> NDArray[np.int32]:
    """Return the rays of each pixel, shape (row, col).

    Notes
    -----
    With the variance v of single rays over its limit, n = c v^(1/2) rays minimise the mean of v/n for a given total
    (Neyman, 1934); c is the smallest that makes the mean 1 without a limit of rays. At edges, w is the variance of
    rays to the same point, which falls as elsewhere; the rest falls as (v - w) n^(-3/2) for evenly spread rays,
    because the edge crosses few of their cells: n = (3/2 c^2 (v - w))^(2/5) if that is more.
    """
    edges = here.edges()
    least = np.where(edges, max(rays.edge, rays.min_rays), rays.min_rays)
    least = np.minimum(least, rays.max_rays)
    if rays.error_limit is None:
        return least.astype(np.int32)
    tried = _Tried(here, edges, rays.error_limit)
    rng, tiles = np.random.default_rng([seed, 0]), Tiles.of(edges.shape, LIMITS.pilot_tile_px)
    edge = np.flatnonzero(edges)
    for round_number in range(1, LIMITS.max_pilot_rounds + 1):
        at_edges = np.concatenate([tiles.one_of_each(rng.permutation(edge)) for _ in range(LIMITS.pilot_edge_pixels)])
        pixel = np.concatenate([tiles.some_pixels(LIMITS.pilot_pixels, rng), at_edges])
        tried.add(pixel, *trial(pixel, LIMITS.pilot_rays))
        tried.add(at_edges, *trial(at_edges, LIMITS.pilot_rays, together=True), together=True)
        wanted = _distribute_rays(*tried.variances(), least, rays)
        if round_number * LIMITS.pilot_rays * len(pixel) >= max(
            LIMITS.pilot_fraction * wanted.sum(), LIMITS.min_pilot_rays
        ):
            break
    return wanted


def further(
    here: AuxiliaryLayers, rays: SamplingSettings, signal: Array, variance: Array, sent: NDArray[np.int32]
) -> NDArray[np.int32]:
    """Return the additional rays of each pixel by its measured error; zero where none are needed.

    Parameters
    ----------
    here, rays
        Auxiliary layers, and limits.
    signal, variance, sent
        Signals, the variances of their means (nan for a single ray), and rays so far, shape (row, col).

    Notes
    -----
    Variances of single rays are pooled over nearby pixels of the same object, edges separately, so that no pixel stops
    because its own rays missed a bright source. Rays grow at most `LIMITS.max_ray_growth`-fold, because the variance of
    a few rays is a poor estimate where bright rays are rare.
    """
    if rays.error_limit is None or not np.isfinite(variance).all():
        return np.zeros_like(sent)
    limit = rays.error_limit(np.maximum(signal, 0.0))
    excess = np.divide(variance, limit, out=np.zeros(limit.shape), where=(variance > 0.0) & (limit > 0.0))
    if excess.mean() <= 1.0:
        return np.zeros_like(sent)
    pooled = _Tried(here, here.edges(), lambda signal: np.ones(signal.shape))
    pooled.add(np.arange(sent.size), signal.ravel(), (excess * sent.astype(float)).ravel(), weight=sent.ravel())
    wanted = _distribute_rays(pooled.variance(), np.zeros(sent.shape), sent, rays)
    more = (np.minimum(wanted, np.minimum(LIMITS.max_ray_growth * sent, rays.max_rays)) - sent).astype(float)
    # A single additional ray would give no variance.
    return np.where(more * LIMITS.min_growth_divisor >= sent, _steps(more, np.full_like(sent, 2), rays.max_rays), 0)


def _distribute_rays(
    plain: Array, edge: Array, least: NDArray[np.integer], limits: SamplingSettings
) -> NDArray[np.int32]:
    """Fewest rays whose mean variance is 1, from single-ray variances in plain pixels and at edges.

    The excess of pixels at their limit of rays is not compensated by other pixels.
    """

    def rays(scale: float) -> Array:
        return np.maximum(np.maximum(scale * np.sqrt(plain), (1.5 * scale**2 * edge) ** 0.4), least)

    low, high = 0.0, max(1.0, 2.0 * float(np.sqrt(plain + edge).mean()))
    for _ in range(20):
        middle = 0.5 * (low + high)
        each = rays(middle)
        enough = np.mean(plain / each + edge / each**1.5) <= 1.0
        enough |= limits.total_rays is not None and np.minimum(each, limits.max_rays).sum() >= limits.total_rays
        low, high = (low, middle) if enough else (middle, high)
    return _steps(rays(high), least, limits.max_rays)


def _steps(rays: Array, least: NDArray[np.integer], max_rays: int) -> NDArray[np.int32]:
    """Round numbers of rays to the nearest step, between the least and the most."""
    step = np.round(LIMITS.ray_steps_per_doubling * np.log2(np.maximum(rays, 1.0)))
    return np.clip(np.round(2.0 ** (step / LIMITS.ray_steps_per_doubling)), least, max_rays).astype(np.int32)


class _Tried:
    """Pilot variances by kind (object, or edge) and tile, pooled with the eight tiles around.

    Parameters
    ----------
    here, edges
        Auxiliary layers, and edge pixels.
    error_limit
        Allowed variance as a function of the signal.
    """

    def __init__(self, here: AuxiliaryLayers, edges: NDArray[np.bool_], error_limit: Callable[[Array], Array]) -> None:
        self._object = 1 + (here.object + 1) % OBJECTS
        self._kind = np.where(edges, 0, self._object)
        self._edges, self._allowed = edges, error_limit
        self._tiles = Tiles.of(edges.shape, LIMITS.pilot_tile_px)
        # Number of pilot pixels, sums of their signals and of their variances.
        self._sums = np.zeros((3, OBJECTS + 2, *self._tiles.count))

    def add(
        self,
        pixel: NDArray[np.int64],
        signal: Array,
        single: Array,
        *,
        together: bool = False,
        weight: NDArray[np.integer] | None = None,
    ) -> None:
        """Add pilot results of pixels (pixel,), weighted; `together`: edge pixels whose rays went to one point."""
        kind = np.full(len(pixel), TOGETHER) if together else self._kind.ravel()[pixel]
        place = (kind, *self._tiles.holding(pixel))
        counts = np.ones(len(pixel)) if weight is None else weight
        for sums, values in zip(self._sums, (1.0, np.maximum(signal, 0.0), single), strict=True):
            np.add.at(sums, place, counts * values)

    def variance(self) -> Array:
        """Return single-ray variances over their limit, of each pixel's kind, shape (row, col)."""
        down, across = self._tiles.of_pixels
        return self._shares()[self._kind, down, across]

    def variances(self) -> tuple[Array, Array]:
        """Return single-ray variances over their limit, in plain pixels and at edges, shape (row, col)."""
        share = self._shares()
        down, across = self._tiles.of_pixels
        at_edge, together = share[0, down, across], share[TOGETHER, down, across]
        plain = np.where(self._edges, together, share[self._object, down, across])
        return plain, np.where(self._edges, LIMITS.edge_variance_factor * np.maximum(at_edge - together, 0.0), 0.0)

    def _shares(self) -> Array:
        """Return single-ray variances over their limit, by kind and tile."""
        count, signal, variance = (with_neighbours(sums) for sums in self._sums)
        # A kind without pilot pixels nearby takes the mean of all kinds there, else that of the whole frame.
        of_all = count.sum(axis=0) > 0.5
        mean, spread = (
            np.where(
                count > 0.5,
                total / np.maximum(count, 1.0),
                np.where(of_all, total.sum(axis=0) / np.maximum(count.sum(axis=0), 1.0), total.sum() / count.sum()),
            )
            for total in (signal, variance)
        )
        # Where the limit is zero, as in the dark, no number of rays reaches it: none are requested.
        limit = self._allowed(mean)
        return np.divide(spread, limit, out=np.zeros_like(spread), where=limit > 0.0)
