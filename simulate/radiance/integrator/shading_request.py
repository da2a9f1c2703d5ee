"""Places whose light is asked for, how it is to be found, and where it is added up."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.integrator.integrator_settings import IntegratorSettings
from simulate.radiance.integrator.low_discrepancy import SequenceSlice
from simulate.radiance.integrator.shading_points import ShadingPoints


class RadianceComponents:
    """Light at places (place, band), in parts by name, or all in one where nobody asks.

    Parameters
    ----------
    shape
        Places and bands.
    split
        Whether parts are kept apart.
    """

    def __init__(self, shape: tuple[int, int], *, split: bool = False) -> None:
        self.shape, self.split = shape, split
        self.found: dict[str, NDArray[np.float32]] = {}

    def add(self, name: str, which: NDArray[np.int64], light: NDArray[np.float32]) -> None:
        """Add light to a part at some places, each named once."""
        if not len(which):
            return
        key = name if self.split else ""
        if key not in self.found:
            self.found[key] = np.zeros(self.shape, np.float32)
        if len(which) == self.shape[0]:
            self.found[key] += light
        else:
            self.found[key][which] += light

    def total(self) -> NDArray[np.float32]:
        """Return all parts together."""
        return sum(self.found.values(), start=np.zeros(self.shape, np.float32))


def bounce_order(name: str) -> tuple[int, str]:
    """Return how often the light of a part (`leaving.leaving`) was reflected elsewhere, and what it comes from."""
    if not name.startswith("bounce "):
        return 0, name
    order, source = name.removeprefix("bounce ").split(" of ", 1)
    return int(order), source


def sum_by_point(
    light: NDArray[np.float32], which: NDArray[np.int64], rows: NDArray[np.int64], rays: int
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Add up the light of some rays at their points, which come one after the other: rows of points and light."""
    owner = which // rays
    first = np.flatnonzero(np.diff(owner, prepend=-1))
    if len(first) == len(which):
        return rows[owner], light
    return rows[owner[first]], np.add.reduceat(light, first, axis=0)


# The light that leaves places which rays met so many bounces before the surface that the eye sees.
Further = Callable[[ShadingPoints, int], RadianceComponents]


@dataclass(frozen=True, kw_only=True)
class ShadingRequest:
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

    points: ShadingPoints
    parts: RadianceComponents
    rows: NDArray[np.int64]
    effort: IntegratorSettings
    rng: np.random.Generator
    rays: int
    depth: int = 0
    even: SequenceSlice | None = None

    @property
    def reflections(self) -> bool:
        """Whether light is asked for that something else reflects on its way to the points."""
        return self.depth < self.effort.bounces

    @property
    def stretches(self) -> SequenceSlice:
        """The even numbers, drawn where none are given."""
        return SequenceSlice.drawn(len(self.points), self.rays, self.rng) if self.even is None else self.even

    @cached_property
    def known(self) -> NDArray[np.float32]:
        """Share of the sky that points take as known: none where they are not matt, all where nothing may hide it."""
        return self.points.known * self.points.matt if self.effort.hidden_sky else self.points.matt.astype(np.float32)

    def some(self, which: NDArray[np.int64]) -> "ShadingRequest":
        """Return some of the places."""
        even = None if self.even is None else self.even.some(which)
        return replace(self, points=self.points.some(which), rows=self.rows[which], even=even)

    def add(self, name: str, which: NDArray[np.int64], light: NDArray[np.float32]) -> None:
        """Add light to a part at some of the points, each named once."""
        self.parts.add(name, self.rows[which], light)

    def add_found(self, name: str, ray: NDArray[np.int64], light: NDArray[np.float32]) -> None:
        """Add what some rays found to a part: numbers of rays, of which those of a point follow each other."""
        self.parts.add(name, *sum_by_point(light, ray, self.rows, self.rays))
