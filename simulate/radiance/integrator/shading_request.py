"""Shading requests: points, how their light is to be computed, and the radiance components it is added to."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.integrator.integrator_settings import IntegratorSettings
from simulate.radiance.integrator.low_discrepancy import SequenceSlice
from simulate.radiance.integrator.shading_points import ShadingPoints


class RadianceComponents:
    """Radiance (point, band) in components by name, or their sum if not split.

    Parameters
    ----------
    shape
        Points and bands.
    split
        Whether components are stored separately.
    """

    def __init__(self, shape: tuple[int, int], *, split: bool = False) -> None:
        self.shape, self.split = shape, split
        self.found: dict[str, NDArray[np.float32]] = {}

    def add(self, name: str, which: NDArray[np.int64], light: NDArray[np.float32]) -> None:
        """Add light to a component at some points, each named once."""
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
        """Return the sum of all components."""
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
    """Sum the light of consecutive rays at their points: rows of points, and light."""
    owner = which // rays
    first = np.flatnonzero(np.diff(owner, prepend=-1))
    if len(first) == len(which):
        return rows[owner], light
    return rows[owner[first]], np.add.reduceat(light, first, axis=0)


# Outgoing radiance of points at a given number of bounces from the surface that the camera sees.
Further = Callable[[ShadingPoints, int], RadianceComponents]


@dataclass(frozen=True, kw_only=True)
class ShadingRequest:
    """Points whose outgoing radiance is requested.

    Parameters
    ----------
    points
        Where.
    parts, rows
        Components that the light is added to, and the row of each point there, shape (point,).
    effort
        How far light is followed.
    rng
        Source of chance.
    rays
        Gather rays of each point.
    depth
        Bounces between the points and the surface that the camera sees.
    even
        Two quasi-random numbers for each ray, from which directions follow; None: drawn.
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
        """Whether indirect light (at least one reflection before the points) is included."""
        return self.depth < self.effort.max_bounces

    @property
    def stretches(self) -> SequenceSlice:
        """The quasi-random numbers, drawn where none are given."""
        return SequenceSlice.random(len(self.points), self.rays, self.rng) if self.even is None else self.even

    @cached_property
    def sky_control_fraction(self) -> NDArray[np.float32]:
        """Control-variate fraction of the sky: 0 where not diffuse, 1 where sky shadowing is off."""
        return (
            self.points.sky_control_fraction * self.points.is_diffuse
            if self.effort.sky_shadowing
            else self.points.is_diffuse.astype(np.float32)
        )

    def some(self, which: NDArray[np.int64]) -> "ShadingRequest":
        """Return the request for some of the points."""
        even = None if self.even is None else self.even.some(which)
        return replace(self, points=self.points.some(which), rows=self.rows[which], even=even)

    def add(self, name: str, which: NDArray[np.int64], light: NDArray[np.float32]) -> None:
        """Add light to a component at some of the points, each named once."""
        self.parts.add(name, self.rows[which], light)

    def add_found(self, name: str, ray: NDArray[np.int64], light: NDArray[np.float32]) -> None:
        """Add light of some rays to a component: ray numbers, in which the rays of a point are consecutive."""
        self.parts.add(name, *sum_by_point(light, ray, self.rows, self.rays))
