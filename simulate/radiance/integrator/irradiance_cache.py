"""What matt surfaces gather, shared between the pixels of a picture instead of sought anew by every ray.

Light from all around changes slowly along a surface. It is gathered at nodes, one for four pixels or, finely, one for
each and from places all over it, by two halves of rays that know nothing of each other, less what an open sky would
give, which is known exactly. Each half is evened out by planes fitted to windows; the window of a node is the one whose
fit of either half best foretells the other half nearby. So contact shadows keep their shape, wide walls lose their
noise, and what is still missed is known: where it is more than allowed, more rays are sent, as many as their spread
asks for. What windows that follow the noise lose of the whole is put back evenly.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import gcd

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.geometry.viewpoint import Viewpoint
from simulate.radiance.integrator.cache_smoothing import Nodes, all_alike
from simulate.radiance.integrator.integrator_settings import IntegratorSettings, Run
from simulate.radiance.integrator.low_discrepancy import R2, SequenceSlice, fraction, low_discrepancy_points
from simulate.radiance.integrator.outgoing_radiance import lamp_and_disc_radiance, surroundings_radiance
from simulate.radiance.integrator.shading_points import ShadingPoints
from simulate.radiance.integrator.spectral_scene import SpectralScene

Array = NDArray[np.floating]
# Pixels between nodes; and where each pixel is one, places of it that rays are sent from at least, and rays of each at
# most: what a pixel sees in shadow's edge is known no better than by so many places.
STEP, PLACES, RAYS_A_PLACE = 2, 4, 8
# Halves of the windows that are tried, nodes.
WIDTHS = (0, 1, 2, 4, 8)
# Nodes on either side over which a window's success is judged, and what single rays may find where none did so far.
JUDGED, PROMISED = 2, 8
# Nodes send rays in so many turns at most, and in each so many times as many as they have sent.
TURNS, GROWTH = 6, 8
# Rays that are followed at once.
BATCH = 64_000


@dataclass(frozen=True, kw_only=True)
class IrradianceCache:
    """Light that matt surfaces in a picture get from around, lamps and discs left out.

    Parameters
    ----------
    stage
        The scene.
    nodes
        Where it is known.
    change
        What surroundings change of the irradiance of an open sky, shape (row, col, band), W m-2 nm-1.
    variance
        Estimated square of the error of its signal, for a surface that reflects all light, shape (row, col).
    rays
        Rays that each node sent, shape (row, col).
    fine
        Whether each pixel is a node.
    """

    stage: SpectralScene
    nodes: Nodes
    change: NDArray[np.float32]
    variance: NDArray[np.float64]
    rays: NDArray[np.int64]
    fine: bool = False

    def at(self, points: ShadingPoints, row: Array, col: Array) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Return which points can share, and the irradiance that they get, shape (sharing point, band).

        Parameters
        ----------
        points
            Places that rays meet.
        row, col
            Coordinates of those rays in the picture, shape (point,), whole numbers at the corners of pixels.
        """
        at = (np.floor(row), np.floor(col)) if self.fine else (row / STEP - 0.5, col / STEP - 0.5)
        light, has = self.nodes.between(self.change, *at, points.place_m, points.normal)
        shares = np.flatnonzero(has & points.matt)
        light = light[shares]
        if not self.stage.lighting.environment_map.dark:
            light += self.stage.lighting.environment_map.irradiance(points.normal[shares])
        return shares, light


def build_irradiance_cache(
    stage: SpectralScene,
    view: Viewpoint,
    effort: IntegratorSettings,
    known: Array,
    *,
    rays: int,
    most: int,
    allowed: Callable[[Array], Array] | None,
    weight: Array,
    seed: int,
    run: Run,
    fine: bool = False,
) -> IrradianceCache:
    """Return the light that the surfaces of a picture gather.

    Parameters
    ----------
    stage, view, effort
        The scene, the camera, and how far light is followed.
    known
        Share of the open sky that is taken as known, see `ShadingPoints.known`, shape (row, col).
    rays, most
        Rays of each node at first, and at most.
    allowed
        Variance that a pixel's signal may have, by its signal: over the nodes, variances over this are 1 in the mean.
        None: no node gets more rays.
    weight
        Signal of each band's radiance, shape (band,).
    seed, run
        Seed, and what does parts of the work.
    fine
        Whether each pixel is a node, which sends its rays from places all over the pixel: for shadows narrower than
        two pixels.
    """
    step = 1 if fine else STEP
    seen = _trace_nodes(stage, view, known, step)
    white = seen.points.whitened()
    places = _Places(stage, view, seen, white, fine)
    grid = Nodes.of(seen.row, seen.col, seen.shape, white.place_m, white.normal, white.face)
    budget = None if allowed is None else _Budget.of(stage, seen.points, effort, allowed, weight)
    light = np.zeros((2, len(white), stage.bands), np.float32)
    sent, half, turn = np.zeros(len(white), np.int64), np.full(len(white), max(rays // 2, 1)), 0
    while True:
        for part in (0, 1):
            for many in np.unique(half[half > 0]).tolist():
                which, seeds = np.flatnonzero(half == many), [[seed, kind, turn, part, many] for kind in (5, 6)]
                even = low_discrepancy_points(seen.row[which], seen.col[which], many, seeds[0])
                found = _gather(stage, places, which, effort, even, seeds[1], run)
                share = (many / (sent[which] + many)).astype(np.float32)[:, None]
                light[part, which] += share * (found - light[part, which])
        sent += half
        signals = np.stack([grid.spread(part @ weight) for part in light], axis=2).astype(np.float64)
        width, variance, smooth = _windows(grid, signals, run)
        turn += 1
        if budget is None or turn == TURNS:
            break
        excess = budget.excess(smooth[seen.row, seen.col], variance[seen.row, seen.col])
        half = _further(grid, excess, sent, most // 2)
        if not half.any():
            break
    change = _smooth(grid, grid.spread(light.mean(axis=0)), width, run)
    return IrradianceCache(
        stage=stage, nodes=grid, change=change, variance=variance, rays=grid.spread(2 * sent), fine=fine
    )


@dataclass(frozen=True)
class _NodePoints:
    """Points on matt surfaces, and the rows and columns of the nodes that see them."""

    points: ShadingPoints
    row: NDArray[np.int64]
    col: NDArray[np.int64]
    shape: tuple[int, int]


def _trace_nodes(stage: SpectralScene, view: Viewpoint, known: Array, step: int) -> _NodePoints:
    """Look along the middles of nodes."""
    shape = (-(-view.shape[0] // step), -(-view.shape[1] // step))
    row, col = (axis.ravel() for axis in np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"))
    origin, towards = view.rays(step * (row + 0.5), step * (col + 0.5))
    hit = stage.surfaces.tracer.hits(origin, towards)
    met = hit.met
    share = known[np.minimum(step * row[met], view.shape[0] - 1), np.minimum(step * col[met], view.shape[1] - 1)]
    points = stage.points(hit, origin, towards, met, share)
    kept = np.flatnonzero(points.matt)
    return _NodePoints(points.some(kept), row[met[kept]], col[met[kept]], shape)


@dataclass(frozen=True)
class _Places:
    """Where nodes, given by their numbers, send rays from: their middles or, finely, places all over their pixels."""

    stage: SpectralScene
    view: Viewpoint
    seen: _NodePoints
    white: ShadingPoints
    fine: bool

    def each(self, rays: int) -> int:
        """How many places so many rays of a node come from."""
        return gcd(rays, max(PLACES, rays // RAYS_A_PLACE)) if self.fine else 1

    def of(self, nodes: NDArray[np.int64], each: int, rng: np.random.Generator) -> ShadingPoints:
        """Return so many places of some nodes, one node after the other; the middle where another surface is met."""
        start = rng.random((2, len(nodes), 1))
        nodes = np.repeat(nodes, each)
        middle = self.white.some(nodes)
        if not self.fine:
            return middle
        at = fraction(start + R2[:, None, None] * np.arange(each)).reshape(2, -1)
        origin, towards = self.view.rays(self.seen.row[nodes] + at[0], self.seen.col[nodes] + at[1])
        hit = self.stage.surfaces.tracer.hits(origin, towards)
        met = hit.met
        place = origin[met] + hit.range_m[met, None] * towards[met]
        face = hit.face[met]
        normal, _ = self.stage.surfaces.tracer.facing(face, towards[met])
        same = all_alike(middle.place_m[met], middle.normal[met], place, normal)
        for values, found in ((middle.place_m, place), (middle.face, face), (middle.normal, normal)):
            values[met[same]] = found[same]
        return middle


@dataclass(frozen=True)
class _Budget:
    """How far the signal of nodes may err: their own reflectance and direct light decide."""

    allowed: Callable[[Array], Array]
    reflected: Array
    besides: Array

    @classmethod
    def of(
        cls,
        stage: SpectralScene,
        points: ShadingPoints,
        effort: IntegratorSettings,
        allowed: Callable[[Array], Array],
        weight: Array,
    ) -> "_Budget":
        # Of light as white as the weights, as the field's errors are stated.
        reflected = stage.bsdfs.matt(points) @ weight / max(float(weight.sum()), 1e-30)
        sky = (
            0.0
            if stage.lighting.environment_map.dark
            else stage.lighting.environment_map.irradiance(points.normal) @ weight
        )
        direct = lamp_and_disc_radiance(stage, points, effort, np.random.default_rng(0)).total() @ weight
        return cls(allowed, reflected, direct + reflected * sky)

    def excess(self, change: Array, variance: Array) -> Array:
        """Return the variances of nodes over what is allowed, for changes of their irradiance's signal."""
        signal = np.maximum(self.besides + self.reflected * change, 0.0)
        spread, limit = self.reflected**2 * variance, self.allowed(signal)
        # What came out dark and is allowed nothing asks for nothing: no rays would do.
        return np.divide(spread, limit, out=np.zeros_like(spread), where=limit > 0.0)


def _further(grid: Nodes, excess: Array, sent: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """How many rays more each node sends, a power of two or none.

    Parameters
    ----------
    grid
        The nodes.
    excess
        Variance of each node over what is allowed, shape (node,).
    sent, most
        Rays that it has sent, shape (node,), and may send in all.

    Notes
    -----
    n as the root of the variance v of single rays brings the mean of v/n to 1 by the fewest rays (Neyman, 1934). What a
    few rays tell of v is not trusted for more than `GROWTH` times as many. What the most rays could not mend, as where
    light comes by way of a place that a lamp almost touches, is not made up for by others. A node whose rays met
    nothing rare expects what nodes around it expect on average.
    """
    # Sums that run along the picture leave a hair below zero where nothing varies.
    single = np.clip(excess * sent, 0.0, most)
    single = np.maximum(single, grid.near(grid.spread(single), PROMISED)[grid.row, grid.col])
    if not sent.size or (single / sent).mean() <= 1.0:
        return np.zeros_like(sent)
    wanted = np.minimum(np.sqrt(single) * np.sqrt(single).mean(), np.minimum(GROWTH * sent, most))
    more = wanted - sent
    step = 2 ** np.round(np.log2(np.maximum(more, 1.0))).astype(np.int64)
    return np.where(more >= 0.5 * sent, np.where(sent + step > most, step // 2, step), 0)


def _gather(
    stage: SpectralScene,
    start_from: _Places,
    nodes: NDArray[np.int64],
    effort: IntegratorSettings,
    even: SequenceSlice,
    seed: list[int],
    run: Run,
) -> NDArray[np.float32]:
    """Gather at nodes: what surroundings change of an open sky's irradiance, shape (node, band)."""
    sky, places = stage.lighting.environment_map, start_from.each(even.rays)

    def gather_part(start: int) -> NDArray[np.float32]:
        part = np.arange(start, min(start + count, len(nodes)))
        rng = np.random.default_rng([*seed, start])
        here, shared = start_from.of(nodes[part], places, rng), even.some(part).divide(places)
        light = surroundings_radiance(stage, here, effort, rng, rays=shared.rays, even=shared).total()
        light *= np.float32(np.pi)
        if not sky.dark:
            light -= sky.irradiance(here.normal)
        return light.reshape(len(part), places, -1).mean(axis=1)

    count = max(1, BATCH // even.rays)
    found = list(run(gather_part, list(range(0, len(nodes), count))))
    return np.concatenate(found) if found else np.zeros((0, stage.bands), np.float32)


def _smooth(grid: Nodes, values: NDArray[np.float32], width: NDArray[np.int64], run: Run) -> NDArray[np.float32]:
    """Return values of nodes evened out over their windows, and what that loses of the whole put back evenly.

    Notes
    -----
    Windows chosen by noisy values keep away from what only few rays find: it would count for too few nodes. The mean of
    what is lost, over windows that no noise chose, is as noisy as the widest fit and knows no such choice (twicing,
    Tukey 1977).
    """
    evened = grid.fitted(values, width, run).astype(np.float32)
    evened += grid.fitted(values - evened, np.full(width.shape, WIDTHS[-1]), run)
    return evened


def _windows(
    grid: Nodes, signals: NDArray[np.float64], run: Run
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Choose each node's window by how well either half foretells the other; the square of what is missed; the fit.

    Notes
    -----
    (A - B)^2 / 2 is the variance of a half; a fit of A misses B by its own error and by B's noise. Both halves together
    have half of the noise, which is most of what is missed; never less than the noise that so many nodes leave.
    """
    noise = grid.near(0.5 * (signals[..., 0] - signals[..., 1]) ** 2, JUDGED)
    best, width, fit = np.full(noise.shape, np.inf), np.zeros(noise.shape, np.int64), np.zeros(noise.shape)
    for half_width in WIDTHS:
        smooth = grid.fitted(signals, np.full(noise.shape, half_width), run) if half_width else signals
        missed = grid.near(0.5 * ((smooth - signals[..., ::-1]) ** 2).sum(axis=-1), JUDGED) - noise
        better = missed < best
        best[better], width[better], fit[better] = missed[better], half_width, smooth[better].mean(axis=-1)
    return width, 0.5 * np.maximum(best, noise / (2.0 * width + 1.0) ** 2), fit
