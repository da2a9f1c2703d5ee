"""The radiance that leaves surfaces: direct light, the open sky, and what is gathered of the hemisphere around.

Gathering does not ask what the sky sends, for that is known without obstacles: it asks what obstacles change. A ray
that meets nothing adds nothing, so that a place in the open has its exact light with no noise; a ray that meets an
object adds what the object sends and takes away the sky behind it. Where little of the sky is open it is the other way
round, see `Points.known`. Surfaces that are not matt gather half of their rays by their gloss, and the sky by rays.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.trace import NOTHING
from simulate.radiance.transport import direct
from simulate.radiance.transport.air import Air
from simulate.radiance.transport.lights import Lighting
from simulate.radiance.transport.points import Coats, Points
from simulate.radiance.world.surfaces import Surfaces

Array = NDArray[np.floating]
# The golden and silver ratios' plane sequence fills a square evenly (Roberts' R2 sequence).
R2 = np.array([0.7548776662466927, 0.5698402909980532])
# More lamps than this are not all asked at places that an eye does not see: one is drawn.
ASKED_LAMPS = 2


@dataclass(frozen=True, kw_only=True)
class Effort:
    """How far light is followed.

    Parameters
    ----------
    bounces
        Reflections by other objects on the way from a source to the surface that the eye sees; what would need more is
        left out, so that the picture is never too bright.
    hidden_sky
        Whether objects hide the sky from surfaces; without, and without bounces, nothing is gathered.
    air_between
        Whether air weakens light between lamps and the surfaces that the eye sees.
    left_out
        Names of lamps and discs without influence.
    roulette_from
        From this bounce on a path goes on with a chance only, and counts for more; None: never.
    """

    bounces: int = 1
    hidden_sky: bool = True
    air_between: bool = True
    left_out: frozenset[str] = frozenset()
    roulette_from: int | None = None

    @property
    def gathers(self) -> bool:
        """Whether anything is gathered at all."""
        return self.hidden_sky or self.bounces > 0


class Parts:
    """Light in parts by name, or all in one where nobody asks."""

    def __init__(self, *, split: bool) -> None:
        self.split = split
        self.found: dict[str, NDArray[np.float32]] = {}

    def add(self, name: str, light: NDArray[np.float32]) -> None:
        """Add light (point, band) to a part; the array is taken over."""
        key = name if self.split else ""
        if key in self.found:
            self.found[key] += light
        else:
            self.found[key] = light

    def total(self) -> NDArray[np.float32]:
        """Return all parts together."""
        return sum(self.found.values())  # pyright: ignore[reportReturnType]


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A scene on bands, ready for light.

    Parameters
    ----------
    surfaces, coats
        Surfaces and how they reflect.
    lighting
        What lights them.
    air
        What air does on the way.
    """

    surfaces: Surfaces
    coats: Coats
    lighting: Lighting
    air: Air

    def leaving(
        self,
        points: Points,
        effort: Effort,
        rng: np.random.Generator,
        *,
        rays: int,
        split: bool = False,
        depth: int = 0,
    ) -> Parts:
        """Return the radiance that points send to the eye by reflection, in parts of shape (point, band).

        Parameters
        ----------
        points
            Where.
        effort
            How far light is followed.
        rng
            Source of chance.
        rays
            Rays by which each point gathers.
        split
            Whether sources and bounces are kept apart: parts are sources by name, "glow" of panels, "sky", "hidden sky"
            (what objects take of it, never positive) and "bounce 1", 2, ... by number of reflections elsewhere.
        depth
            Bounces between the points and the surface that the eye sees.
        """
        parts = Parts(split=split)
        self._add_direct(parts, points, effort, rng, rays if effort.gathers else 0, depth)
        if not self.lighting.dome.dark:
            light = points.matt * self.lighting.dome.irradiance(points.normal)
            parts.add("sky", light * points.known[:, None] if effort.hidden_sky else light)
        if effort.gathers:
            self._add_gathered(parts, points, effort, rng, rays, depth)
        return parts

    def emitted(self, points: Points) -> NDArray[np.float32]:
        """Return the radiance of the points' own glow towards the eye, shape (point, band)."""
        found = np.zeros_like(points.matt)
        if self.lighting.panels is not None:
            kind = self.lighting.panels.kind_of_face[points.face]
            glows = (kind >= 0) & points.outside
            found[glows] = self.lighting.panels.spectra[kind[glows]]
        return found

    def _add_direct(
        self, parts: Parts, points: Points, effort: Effort, rng: np.random.Generator, rays: int, depth: int
    ) -> None:
        coats, tracer, light = self.coats, self.surfaces.tracer, self.lighting
        through = self.air.through if effort.air_between and self.air.absorbs and depth == 0 else None
        for disc in light.discs:
            if disc.name not in effort.left_out:
                parts.add(disc.name, direct.from_disc(points, disc, coats, tracer, rng))
        lamps = tuple(lamp for lamp in light.lamps if lamp.name not in effort.left_out)
        if depth > 0 and len(lamps) > ASKED_LAMPS:
            parts.add("lamps", direct.from_one_lamp(points, lamps, coats, tracer, rng, through))
        else:
            for lamp in lamps:
                parts.add(lamp.name, direct.from_lamp(points, lamp, coats, tracer, rng, through))
        if light.panels is not None:
            parts.add("glow", direct.from_panels(points, light.panels, coats, tracer, rng, through, rays))

    def _add_gathered(
        self, parts: Parts, points: Points, effort: Effort, rng: np.random.Generator, rays: int, depth: int
    ) -> None:
        """Add what the hemisphere holds besides the open sky."""
        count, dome = len(points), self.lighting.dome
        many = points if rays == 1 else direct.subset(points, np.repeat(np.arange(count), rays))
        even = (rng.random((count, 1, 2)) + np.arange(rays)[:, None] * R2) % 1.0
        direction, density = self.coats.drawn(many, even.reshape(-1, 2), rng)
        cosine = np.einsum("ij,ij->i", many.normal, direction)
        gives = (cosine > 0.0) & (density > 0.0)
        factor = np.divide(cosine, density * rays, out=np.zeros_like(cosine), where=gives)
        weight = self.coats.value(many, direction) * factor.astype(np.float32)[:, None]
        start = self.surfaces.tracer.above(many.face, many.place_m, many.normal)
        hit = self.surfaces.tracer.hits(start, direction)
        met = np.flatnonzero((hit.face != NOTHING) & gives)
        if not dome.dark:
            known = _known_of(many) if effort.hidden_sky else np.ones(len(many), np.float32)
            seen = np.flatnonzero((hit.face == NOTHING) & (known < 1.0) & gives)
            sky = weight[seen] * dome.radiance(direction[seen]) * (1.0 - known[seen, None])
            parts.add("sky", _summed(sky, seen, count, rays))
            behind = met[known[met] > 0.0] if effort.hidden_sky else met[:0]
            sky = weight[behind] * dome.radiance(direction[behind]) * -known[behind, None]
            parts.add("hidden sky", _summed(sky, behind, count, rays))
        if len(met):
            there = self._met(many, start, direction, hit.face, hit.range_m, met)
            self._add_glow(parts, there, met, direction, density, hit.range_m, weight, count, rays)
            if depth < effort.bounces:
                self._add_bounced(parts, there, met, weight, effort, rng, count, rays, depth)

    def _met(
        self, many: Points, start: Array, direction: Array, face: NDArray[np.int64], range_m: Array, met: Array
    ) -> Points:
        place = start[met] + range_m[met, None] * direction[met]
        return self.coats.points(self.surfaces, face[met], place, direction[met], many.known[met])

    def _add_glow(
        self,
        parts: Parts,
        there: Points,
        met: NDArray[np.int64],
        direction: Array,
        density: Array,
        range_m: Array,
        weight: NDArray[np.float32],
        count: int,
        rays: int,
    ) -> None:
        panels = self.lighting.panels
        if panels is None:
            return
        leaving = np.einsum("ij,ij->i", there.normal, -direction[met])
        share = direct.found_by_gathering(panels, there.face, range_m[met], leaving, density[met], rays)
        glow = self.emitted(there) * share.astype(np.float32)[:, None] * weight[met]
        parts.add("glow", _summed(glow, met, count, rays))

    def _add_bounced(
        self,
        parts: Parts,
        there: Points,
        met: NDArray[np.int64],
        weight: NDArray[np.float32],
        effort: Effort,
        rng: np.random.Generator,
        count: int,
        rays: int,
        depth: int,
    ) -> None:
        weight = weight[met]
        if effort.roulette_from is not None and depth >= effort.roulette_from:
            chance = np.clip(weight.mean(axis=1) * rays, 0.05, 0.95)
            stays = np.flatnonzero(rng.random(len(met)) < chance)
            there, met, weight = direct.subset(there, stays), met[stays], weight[stays] / chance[stays, None]
        if not len(met):
            return
        further = self.leaving(there, effort, rng, rays=1, split=parts.split, depth=depth + 1)
        for name, light in further.found.items():
            order = int(name.split()[1]) if name.startswith("bounce ") else 0
            parts.add(f"bounce {order + 1}", _summed(light * weight, met, count, rays))


def _known_of(points: Points) -> NDArray[np.float32]:
    """Share of the sky that points take as known: none where they are not matt."""
    known = points.known.copy()
    for which, _ in points.glossy:
        known[which] = 0.0
    return known


def _summed(light: NDArray[np.float32], which: NDArray[np.int64], count: int, rays: int) -> NDArray[np.float32]:
    """Add up the light of some rays at their points: rays come point by point, shape (point, band)."""
    total = np.zeros((count, light.shape[1]), np.float32)
    if rays == 1:
        total[which] = light
        return total
    if len(which):
        owner = which // rays
        first = np.flatnonzero(np.diff(owner, prepend=-1))
        total[owner[first]] = np.add.reduceat(light, first, axis=0)
    return total
