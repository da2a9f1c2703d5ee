"""How many rays each pixel gets: as few as keep chance, over the whole picture, within what is allowed.

Some pixels of each tile are tried, edges of objects and shadows apart from the rest. What single rays differ there
counts for the pixels of the same object around. The rays of the trial enter no picture: choosing where to look closely
would else bend what is seen. Where the picture's own rays then differ more than was foreseen, further ones follow.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.integrator.auxiliary_layers import AuxiliaryLayers

# Tiles along the shorter side of a small picture, whose pixels have less in common.
FEWEST = 16


@dataclass(frozen=True)
class Tiles:
    """Tiles of a picture; those at its lower and right border may be cut.

    Parameters
    ----------
    shape
        Pixels of the picture, (row, col).
    side
        Side of a tile, px.
    """

    shape: tuple[int, int]
    side: int

    @classmethod
    def of(cls, shape: tuple[int, int], side: int) -> "Tiles":
        """Return tiles of a side, px, or smaller ones where the picture is small."""
        return cls(shape, int(np.clip(min(shape) // FEWEST, 1, side)))

    @property
    def count(self) -> tuple[int, int]:
        """How many there are, (down, across)."""
        return -(-self.shape[0] // self.side), -(-self.shape[1] // self.side)

    @property
    def of_pixels(self) -> NDArray[np.int64]:
        """Where the tiles of all pixels are, (down, across), shape (2, row, col)."""
        return np.indices(self.shape) // self.side

    def holding(self, pixel: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return where the tiles of some pixels are, (down, across), each of shape (pixel,)."""
        return pixel // self.shape[1] // self.side, pixel % self.shape[1] // self.side

    def some_pixels(self, many: int, rng: np.random.Generator) -> NDArray[np.int64]:
        """Draw numbers of so many pixels of each tile, tile by tile."""
        down, across = self.count
        corner = self.side * np.indices((down, across)).reshape(2, -1, 1)
        at = corner + np.moveaxis(rng.integers(0, self.side, (down * across, many, 2)), -1, 0)
        row, col = (np.minimum(axis, length - 1) for axis, length in zip(at, self.shape, strict=True))
        return (row * self.shape[1] + col).ravel()

    def one_of_each(self, pixel: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return of some pixels the first in each tile."""
        down, across = self.holding(pixel)
        return pixel[np.unique(down * self.count[1] + across, return_index=True)[1]]


def with_neighbours(grid: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the sum of each tile (kind, down, across) and the eight around it."""
    wide = np.pad(grid, ((0, 0), (1, 1), (1, 1)))
    down = wide[:, :-2] + wide[:, 1:-1] + wide[:, 2:]
    return down[:, :, :-2] + down[:, :, 1:-1] + down[:, :, 2:]


Array = NDArray[np.floating]
# Side of a tile, px; pixels of each that are tried, those at edges that are tried besides, and rays of each.
TILE, TRIED, TRIED_EDGES, TRIES = 8, 4, 2, 2
# A trial costs so large a share of the rays that it asks for, in so many rounds at most: rare bright rays hide long.
TRIAL_SHARE, ROUNDS = 0.1, 1024
# However few rays a small picture asks for: a bright thing that one gathering ray in a hundred meets must be met.
FEWEST_TRIALS = 4096
# Variance that n rays leave at an edge over v n^(-3/2): 1.3 where a straight line crosses a pixel, more where several
# edges meet and where trials missed one; measured in the scenes of `benchmarks.radiance`.
LINE = 2.0
# Objects beyond so many share their trials with others.
OBJECTS = 255
# Kind of the trials at edges whose rays go to the same place; without that, edges are kind 0.
TOGETHER = OBJECTS + 1
# By how many times the rays of a pixel may grow at once; and the part of those sent that is worth sending at least.
GROWTH, LEAST_GROWTH = 4, 8
# Numbers of rays are steps of a factor of 2^(1/2), so that pixels of a kind can be followed together.
STEPS_PER_DOUBLING = 2


@dataclass(frozen=True, kw_only=True)
class SamplingSettings:
    """How many rays pixels get.

    Parameters
    ----------
    fewest, edge, most
        Rays of any pixel at least, of one where objects or shadows meet, and of any pixel at most.
    in_all
        Rays of all pixels together at most, beyond the fewest of each; None: no limit.
    gathered
        Rays by which each place that they hit gathers its hemisphere.
    shared, shared_most
        Rays by which places on matt surfaces gather for all pixels around, at first and at most, see `field`; None:
        every ray gathers for itself, which is slower and supposes nothing.
    fine
        Whether each pixel has such a place, instead of one for four, and pixels in which surfaces meet gather for
        themselves: for shadows narrower than two pixels, in twice the time. No difference where only the sky's shadow
        is to be found.
    allowed
        Variance that pixels may have by chance, by their signal: over the picture, variances over this are 1 in the
        mean. None: no pixel gets more for its variance.
    """

    fewest: int = 2
    edge: int = 8
    most: int = 32
    in_all: int | None = None
    gathered: int = 2
    shared: int | None = 8
    shared_most: int = 512
    fine: bool = False
    allowed: Callable[[Array], Array] | None = None


class PilotRenderer(Protocol):
    """Follows some pixels by a few rays each."""

    def __call__(self, pixels: NDArray[np.int64], rays: int, *, together: bool = False) -> tuple[Array, Array]:
        """Return signals and the variances of single rays, each of shape (pixel,).

        Rays are spread over the pixel, or all go to the same place of it.
        """
        ...


def allocate_samples(
    here: AuxiliaryLayers, rays: SamplingSettings, trial: PilotRenderer, seed: int
) -> NDArray[np.int32]:
    """Return the rays of each pixel, shape (row, col).

    Notes
    -----
    With a variance v of single rays, in units of what is allowed, n = c v^(1/2) rays give the least mean of v/n for
    their number (Neyman, 1934); c is the least that brings it to 1, were there no limit of rays. At edges a part w of
    the variance is that of rays to the same place, which is divided as elsewhere; of the rest n rays spread evenly
    leave about (v - w) n^(-3/2), as the line crosses few of their cells: n = (3/2 c^2 (v - w))^(2/5) if that is more.
    """
    edges = here.edges()
    least = np.where(edges, max(rays.edge, rays.fewest), rays.fewest)
    least = np.minimum(least, rays.most)
    if rays.allowed is None:
        return least.astype(np.int32)
    tried = _Tried(here, edges, rays.allowed)
    rng, tiles = np.random.default_rng([seed, 0]), Tiles.of(edges.shape, TILE)
    edge = np.flatnonzero(edges)
    for round_number in range(1, ROUNDS + 1):
        at_edges = np.concatenate([tiles.one_of_each(rng.permutation(edge)) for _ in range(TRIED_EDGES)])
        pixel = np.concatenate([tiles.some_pixels(TRIED, rng), at_edges])
        tried.add(pixel, *trial(pixel, TRIES))
        tried.add(at_edges, *trial(at_edges, TRIES, together=True), together=True)
        wanted = _distribute_rays(*tried.variances(), least, rays)
        if round_number * TRIES * len(pixel) >= max(TRIAL_SHARE * wanted.sum(), FEWEST_TRIALS):
            break
    return wanted


def further(
    here: AuxiliaryLayers, rays: SamplingSettings, signal: Array, variance: Array, sent: NDArray[np.int32]
) -> NDArray[np.int32]:
    """Return the rays that each pixel needs besides those that it has sent, by the error measured; zeros: none.

    Parameters
    ----------
    here, rays
        What is where, and limits.
    signal, variance, sent
        Signals, the variances of their means, nan where one ray says nothing of it, and rays so far, shape (row, col).

    Notes
    -----
    Variances of single rays are pooled over the pixels of the same object around, edges apart, so that no pixel alone
    stops because its own rays missed what is bright. Rays grow `GROWTH`-fold at most, as rare bright rays make the
    spread of few of them a poor estimate.
    """
    if rays.allowed is None or not np.isfinite(variance).all():
        return np.zeros_like(sent)
    limit = rays.allowed(np.maximum(signal, 0.0))
    excess = np.divide(variance, limit, out=np.zeros(limit.shape), where=(variance > 0.0) & (limit > 0.0))
    if excess.mean() <= 1.0:
        return np.zeros_like(sent)
    pooled = _Tried(here, here.edges(), lambda signal: np.ones(signal.shape))
    pooled.add(np.arange(sent.size), signal.ravel(), (excess * sent.astype(float)).ravel(), weight=sent.ravel())
    wanted = _distribute_rays(pooled.variance(), np.zeros(sent.shape), sent, rays)
    more = (np.minimum(wanted, np.minimum(GROWTH * sent, rays.most)) - sent).astype(float)
    # One ray alone would not know its error.
    return np.where(more * LEAST_GROWTH >= sent, _steps(more, np.full_like(sent, 2), rays.most), 0)


def _distribute_rays(
    plain: Array, edge: Array, least: NDArray[np.integer], limits: SamplingSettings
) -> NDArray[np.int32]:
    """Rays by variances of single ones in plain places and at edges: the fewest whose mean variance is 1.

    What pixels at the limit lack is not made up for by others: these could not, however many they got.
    """

    def rays(scale: float) -> Array:
        return np.maximum(np.maximum(scale * np.sqrt(plain), (1.5 * scale**2 * edge) ** 0.4), least)

    low, high = 0.0, max(1.0, 2.0 * float(np.sqrt(plain + edge).mean()))
    for _ in range(20):
        middle = 0.5 * (low + high)
        each = rays(middle)
        enough = np.mean(plain / each + edge / each**1.5) <= 1.0
        enough |= limits.in_all is not None and np.minimum(each, limits.most).sum() >= limits.in_all
        low, high = (low, middle) if enough else (middle, high)
    return _steps(rays(high), least, limits.most)


def _steps(rays: Array, least: NDArray[np.integer], most: int) -> NDArray[np.int32]:
    """The nearest number of rays that is a step, between the least and the most."""
    step = np.round(STEPS_PER_DOUBLING * np.log2(np.maximum(rays, 1.0)))
    return np.clip(np.round(2.0 ** (step / STEPS_PER_DOUBLING)), least, most).astype(np.int32)


class _Tried:
    """What trials found, by kind of place: objects, and edges as a kind of their own; by tile, and the eight around it.

    Parameters
    ----------
    here, edges
        What is where, and what is an edge.
    allowed
        Variance allowed, by signal.
    """

    def __init__(self, here: AuxiliaryLayers, edges: NDArray[np.bool_], allowed: Callable[[Array], Array]) -> None:
        self._object = 1 + (here.object + 1) % OBJECTS
        self._kind = np.where(edges, 0, self._object)
        self._edges, self._allowed = edges, allowed
        self._tiles = Tiles.of(edges.shape, TILE)
        # Number of trials, sums of their signals and of their variances.
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
        """Add trials of pixels (pixel,), of weights if not of 1, all at edges where their rays went to one place."""
        kind = np.full(len(pixel), TOGETHER) if together else self._kind.ravel()[pixel]
        place = (kind, *self._tiles.holding(pixel))
        counts = np.ones(len(pixel)) if weight is None else weight
        for sums, values in zip(self._sums, (1.0, np.maximum(signal, 0.0), single), strict=True):
            np.add.at(sums, place, counts * values)

    def variance(self) -> Array:
        """Return variances of single rays over what is allowed, of each pixel's own kind, shape (row, col)."""
        down, across = self._tiles.of_pixels
        return self._shares()[self._kind, down, across]

    def variances(self) -> tuple[Array, Array]:
        """Return variances of single rays over what is allowed, in plain places and at edges, shape (row, col)."""
        share = self._shares()
        down, across = self._tiles.of_pixels
        at_edge, together = share[0, down, across], share[TOGETHER, down, across]
        plain = np.where(self._edges, together, share[self._object, down, across])
        return plain, np.where(self._edges, LINE * np.maximum(at_edge - together, 0.0), 0.0)

    def _shares(self) -> Array:
        """Return variances of single rays over what is allowed, by kind and tile."""
        count, signal, variance = (with_neighbours(sums) for sums in self._sums)
        # Where a kind was not tried around: all kinds there; where nothing was, everything.
        of_all = count.sum(axis=0) > 0.5
        mean, spread = (
            np.where(
                count > 0.5,
                total / np.maximum(count, 1.0),
                np.where(of_all, total.sum(axis=0) / np.maximum(count.sum(axis=0), 1.0), total.sum() / count.sum()),
            )
            for total in (signal, variance)
        )
        # Where nothing is allowed, as in the dark, nothing is asked for: no rays would do.
        limit = self._allowed(mean)
        return np.divide(spread, limit, out=np.zeros_like(spread), where=limit > 0.0)
