"""Places whose light is asked for, how it is to be found, and where it is added up."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.transport.effort import Effort
from simulate.radiance.transport.even import Even
from simulate.radiance.transport.parts import Parts, summed
from simulate.radiance.transport.points import Points

# The light that leaves places which rays met so many bounces before the surface that the eye sees.
Further = Callable[[Points, int], Parts]


@dataclass(frozen=True, kw_only=True)
class Asked:
    """Places whose light is asked for.

    Parameters
    ----------
    points
        Where.
    parts, rows
        What their light is added to, and the place there of each point, shape (point,).
    effort
        How far light is followed.
    rng
        Source of chance.
    rays
        Rays by which each point gathers.
    depth
        Bounces between the points and the surface that the eye sees.
    even
        Two even numbers for each ray, from which directions follow; None: drawn.
    """

    points: Points
    parts: Parts
    rows: NDArray[np.int64]
    effort: Effort
    rng: np.random.Generator
    rays: int
    depth: int = 0
    even: Even | None = None

    @property
    def reflections(self) -> bool:
        """Whether light is asked for that something else reflects on its way to the points."""
        return self.depth < self.effort.bounces

    @property
    def stretches(self) -> Even:
        """The even numbers, drawn where none are given."""
        return Even.drawn(len(self.points), self.rays, self.rng) if self.even is None else self.even

    @cached_property
    def known(self) -> NDArray[np.float32]:
        """Share of the sky that points take as known: none where they are not matt, all where nothing may hide it."""
        return self.points.known * self.points.matt if self.effort.hidden_sky else self.points.matt.astype(np.float32)

    def some(self, which: NDArray[np.int64]) -> "Asked":
        """Return some of the places."""
        even = None if self.even is None else self.even.some(which)
        return replace(self, points=self.points.some(which), rows=self.rows[which], even=even)

    def add(self, name: str, which: NDArray[np.int64], light: NDArray[np.float32]) -> None:
        """Add light to a part at some of the points, each named once."""
        self.parts.add(name, self.rows[which], light)

    def add_found(self, name: str, ray: NDArray[np.int64], light: NDArray[np.float32]) -> None:
        """Add what some rays found to a part: numbers of rays, of which those of a point follow each other."""
        self.parts.add(name, *summed(light, ray, self.rows, self.rays))
