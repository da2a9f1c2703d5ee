"""Rays that gather light at places, and what they meet."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.ray_tracer import NOTHING, Hits
from simulate.radiance.transport.panes import Passed, trace_through_panes
from simulate.radiance.transport.shading_points import BsdfSet, ShadingPoints
from simulate.radiance.transport.shading_request import ShadingRequest
from simulate.radiance.transport.spectral_scene import SpectralScene

Array = NDArray[np.floating]


@dataclass(frozen=True)
class Around:
    """Rays that gather: their points, starts, directions, densities and factors, and what they meet."""

    many: ShadingPoints
    start_m: Array
    direction: Array
    density: Array
    factor: Array
    hit: Hits
    met: NDArray[np.int64]
    open: NDArray[np.bool_]
    glass: Passed | None = None

    @property
    def has_pane_hits(self) -> NDArray[np.bool_]:
        """Whether rays met panes."""
        return self._of_glass(np.zeros(len(self.direction), np.bool_), lambda glass: np.ones_like(glass.turned))

    @property
    def last_start_m(self) -> Array:
        """Where the last legs of rays begin."""
        return self._of_glass(self.start_m, lambda glass: glass.start_m)

    @property
    def last_direction(self) -> Array:
        """Directions of the last legs of rays."""
        return self._of_glass(self.direction, lambda glass: glass.direction)

    @property
    def gone_m(self) -> Array:
        """Ways before the last legs, m."""
        return self._of_glass(np.zeros(len(self.direction)), lambda glass: glass.gone_m)

    @property
    def turned(self) -> NDArray[np.bool_]:
        """Whether panes mirrored rays."""
        return self._of_glass(np.zeros(len(self.direction), np.bool_), lambda glass: glass.turned)

    def weight(self, coats: BsdfSet, which: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return BRDF times cosine over density and number of rays, of some rays, shape (ray, band)."""
        weight = coats.value(self.many.some(which), self.direction[which])
        weight *= self.factor[which, None].astype(np.float32)
        return weight

    def there(self, stage: SpectralScene) -> ShadingPoints:
        """Return what the rays that met something met."""
        return stage.points(self.hit, self.last_start_m, self.last_direction, self.met, self.many.known[self.met])

    def weaken(self, which: NDArray[np.int64], light: NDArray[np.float32]) -> None:
        """Weaken the light of some rays (ray, band) by the panes that they met."""
        if self.glass is not None:
            _, among, here = np.intersect1d(self.glass.which, which, assume_unique=True, return_indices=True)
            light[here] *= self.glass.weight[among]

    def _of_glass(self, plain: NDArray, own: Callable[[Passed], NDArray]) -> NDArray:
        if self.glass is None:
            return plain
        found = plain.copy()
        found[self.glass.which] = own(self.glass)
        return found


def sent(stage: SpectralScene, asked: ShadingRequest) -> Around:
    """Send rays from places as they reflect, half of those of a gloss by it, and find what they meet."""
    tracer, rays = stage.surfaces.tracer, asked.rays
    many = asked.points if rays == 1 else asked.points.some(np.repeat(np.arange(len(asked.points)), rays))
    direction, density = stage.bsdfs.drawn(many, asked.stretches.pairs().reshape(-1, 2), asked.rng)
    cosine = np.einsum("ij,ij->i", many.normal, direction)
    gives = (cosine > 0.0) & (density > 0.0)
    factor = np.divide(cosine, density * rays, out=np.zeros_like(cosine), where=gives)
    start = tracer.above(many.face, many.place_m, many.normal)
    hit = tracer.hits(start, direction)
    glass = None
    if stage.bsdfs.panes is not None:
        glass = trace_through_panes(stage.bsdfs.panes, tracer, start, direction, hit.range_m, asked.rng)
        hit.face[glass.which], hit.range_m[glass.which] = glass.face, glass.range_m
    missed = hit.face == NOTHING
    return Around(
        many,
        start,
        direction,
        density,
        factor,
        hit,
        np.flatnonzero(~missed & gives),
        missed & gives,
        glass,
    )
