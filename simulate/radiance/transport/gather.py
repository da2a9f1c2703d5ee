"""The radiance that leaves surfaces: direct light, the open sky, and what is gathered of the hemisphere around.

Gathering does not ask what the sky sends, for that is known without obstacles: it asks what obstacles change. A ray
that meets nothing adds nothing, so that a place in the open has its exact light with no noise; a ray that meets an
object adds what the object sends and takes away the sky behind it. Where little of the sky is open it is the other way
round, see `Points.known`. Surfaces that are not matt gather half of their rays by their gloss, and the sky by rays.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.brdf.lambert import Lambert
from simulate.radiance.trace import NOTHING
from simulate.radiance.transport import direct
from simulate.radiance.transport.air import Air
from simulate.radiance.transport.around import Around
from simulate.radiance.transport.bright_sky import BrightSky
from simulate.radiance.transport.compiled_lights import disc_arrays, lamp_arrays, panel_arrays, sky_arrays
from simulate.radiance.transport.effort import Effort
from simulate.radiance.transport.even import Even
from simulate.radiance.transport.lights import Lighting
from simulate.radiance.transport.lit_places import Beams
from simulate.radiance.transport.openness import sky_beyond_known
from simulate.radiance.transport.panes import passed
from simulate.radiance.transport.parts import Parts, bounced, summed
from simulate.radiance.transport.paths import Plain
from simulate.radiance.transport.points import Coats, Points
from simulate.radiance.world.surfaces import Surfaces

Array = NDArray[np.floating]
# More lamps than this are not all asked at places that an eye does not see: one is drawn.
ASKED_LAMPS = 2


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
        into: tuple[Parts, NDArray[np.int64]] | None = None,
        split: bool = False,
        depth: int = 0,
        shared: tuple[NDArray[np.int64], NDArray[np.float32]] | None = None,
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
        into
            Parts to add to, and the place there of each point; new ones if None.
        split
            Whether sources and bounces are kept apart: parts are sources by name, "glow" of panels, "sky", "hidden sky"
            (what objects take of it, never positive) and "bounce 1 of sun", "bounce 2 of sky" ... by number of
            reflections elsewhere and by source.
        depth
            Bounces between the points and the surface that the eye sees.
        shared
            Points whose irradiance by all but lamps and discs is known, and what it is, shape (sharing point, band):
            they gather nothing. Their part is "shared".
        """
        every = np.arange(len(points))
        parts, rows = into or (self._parts(points, split), every)
        self._add_direct(parts, rows, points, effort, rng, depth)
        if shared is not None:
            sharing, irradiance = shared
            parts.add("shared", rows[sharing], self.coats.matt(points)[sharing] * irradiance)
            alone = np.setdiff1d(every, sharing, assume_unique=True)
            points, rows = points.some(alone), rows[alone]
        if len(points):
            self._add_around(parts, rows, points, effort, rng, rays, depth)
        return parts

    def lit(self, points: Points, effort: Effort, rng: np.random.Generator) -> Parts:
        """Return what points send to the eye of lamps and discs alone, as `leaving`."""
        parts = self._parts(points, False)
        self._add_direct(parts, np.arange(len(points)), points, effort, rng, 0)
        return parts

    def around(
        self, points: Points, effort: Effort, rng: np.random.Generator, *, rays: int, even: Even | None = None
    ) -> Parts:
        """Return what points send to the eye of all but lamps and discs, as `leaving`.

        Parameters
        ----------
        points, effort, rng, rays
            As of `leaving`.
        even
            Two even numbers for each ray, from which directions follow; None: drawn.
        """
        parts = self._parts(points, False)
        self._add_around(parts, np.arange(len(points)), points, effort, rng, rays, 0, even)
        return parts

    def _parts(self, points: Points, split: bool) -> Parts:
        return Parts((len(points), len(self.coats.wavelength_nm)), split=split)

    def _add_around(
        self,
        parts: Parts,
        rows: NDArray[np.int64],
        points: Points,
        effort: Effort,
        rng: np.random.Generator,
        rays: int,
        depth: int,
        even: Even | None = None,
    ) -> None:
        """Add light of panels, of the sky and of what stands around."""
        # A gloss needs rays to find even the open sky.
        gathers = effort.gathers or bool(points.glossy)
        panels = self.lighting.panels
        if panels is not None:
            through, shared = self._between(effort, depth), rays if gathers else 0
            which, light = direct.from_panels(points, panels, self.coats, self.surfaces.tracer, rng, through, shared)
            parts.add("glow", rows[which], light)
        if not self.lighting.dome.dark:
            light = self.coats.matt(points)
            light *= self.lighting.dome.irradiance(points.normal)
            if effort.hidden_sky:
                light *= points.known[:, None]
            parts.add("sky", rows, light)
        if not gathers or self.surfaces.tracer.scene is None:
            return
        if parts.split or self.coats.panes is not None:
            self._add_gathered(parts, rows, points, effort, rng, rays, depth, even)
            return
        shines = np.zeros(len(points), np.bool_)
        for which, _ in points.glossy:
            shines[which] = True
        if shines.any():
            glossy, matt = np.flatnonzero(shines), np.flatnonzero(~shines)
            some = None if even is None else even.some(glossy)
            self._add_gathered(parts, rows[glossy], points.some(glossy), effort, rng, rays, depth, some)
            points, rows, even = points.some(matt), rows[matt], None if even is None else even.some(matt)
        if len(points):
            self._add_by_paths(parts, rows, points, effort, rng, rays, depth, even)

    def _add_by_paths(
        self,
        parts: Parts,
        rows: NDArray[np.int64],
        points: Points,
        effort: Effort,
        rng: np.random.Generator,
        rays: int,
        depth: int,
        even: Even | None,
    ) -> None:
        """Add what matt points gather, by compiled loops, which hand back what is not matt."""
        last = depth >= effort.bounces and self.lighting.panels is None
        if last and (not effort.hidden_sky or self.lighting.dome.dark):
            return
        # Rays of neighbours that are even together find the whole sky themselves where only its shadow counts.
        bright = None if even is not None and last else self._bright_sky
        even = Even.drawn(len(points), rays, rng) if even is None else even
        if bright is None and last:
            light = sky_beyond_known(points, even, self.lighting.dome, self.surfaces.tracer)
            parts.add("sky", rows, light * self.coats.matt(points))
            return
        if bright is not None:
            self._add_bright_sky(parts, rows, points, effort, rng, rays)
        light, back = self._plain(effort, bright).irradiance(
            points,
            even,
            known=_known_of(points, effort),
            hidden_sky=effort.hidden_sky,
            depth=depth,
            bounces=effort.bounces,
            roulette_from=effort.roulette_from,
            asked_lamps=ASKED_LAMPS,
            seed=int(rng.integers(1 << 63)),
        )
        for behind in np.unique(back.depth).tolist():
            these = np.flatnonzero(back.depth == behind)
            owner = back.owner[these]
            there = self.coats.points(
                self.surfaces, back.face[these], back.place_m[these], back.direction[these], points.known[owner]
            )
            further = self.leaving(there, effort, rng, rays=1, depth=behind).total()
            np.add.at(light, owner, further * back.weight[these])
        parts.add("around", rows, light * self.coats.matt(points))

    def _plain(self, effort: Effort, bright: BrightSky | None) -> Plain:
        """The scene as compiled loops need it."""
        bands, light = len(self.coats.wavelength_nm), self.lighting
        shine = np.array([lamp.name not in effort.left_out for lamp in light.lamps], np.bool_)
        return Plain(
            tracer=self.surfaces.tracer,
            material_of=self.surfaces.material_of,
            rho_by_pi=self.coats.rho_by_pi,
            matt=np.array([isinstance(brdf, Lambert) for brdf in self.coats.brdfs]),
            sky=sky_arrays(light.dome, bright),
            discs=disc_arrays(tuple(disc for disc in light.discs if disc.name not in effort.left_out), bands),
            lamps=lamp_arrays(tuple(lamp for lamp in light.lamps if lamp.name not in effort.left_out), bands),
            panels=panel_arrays(light.panels, bands),
            beams=self._beams.arrays(light.lamps, shine),
        )

    @cached_property
    def _beams(self) -> Beams:
        """How rays are drawn as lamps shine."""
        return Beams.of(self.lighting.lamps, self.surfaces.tracer)

    def _between(self, effort: Effort, depth: int) -> direct.Through | None:
        """What air takes between lamps and surfaces that the eye sees."""
        return self.air.through if effort.air_between and self.air.absorbs and depth == 0 else None

    def emitted(self, points: Points) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Return the points that glow and their own radiance towards the eye, shape (glowing point, band)."""
        panels = self.lighting.panels
        if panels is None:
            return np.zeros(0, np.int64), np.zeros((0, len(self.coats.wavelength_nm)), np.float32)
        kind = panels.kind_of_face[points.face]
        glows = np.flatnonzero((kind >= 0) & points.outside)
        return glows, panels.spectra[kind[glows]]

    def _add_direct(
        self,
        parts: Parts,
        rows: NDArray[np.int64],
        points: Points,
        effort: Effort,
        rng: np.random.Generator,
        depth: int,
    ) -> None:
        """Add light of lamps and discs."""
        coats, tracer, light = self.coats, self.surfaces.tracer, self.lighting
        through = self._between(effort, depth)

        def add(name: str, found: direct.Lit) -> None:
            parts.add(name, rows[found[0]], found[1])

        for disc in light.discs:
            if disc.name not in effort.left_out:
                add(disc.name, direct.from_disc(points, disc, coats, tracer, rng))
        lamps = tuple(lamp for lamp in light.lamps if lamp.name not in effort.left_out)
        if depth > 0 and len(lamps) > ASKED_LAMPS:
            for name, found in direct.from_one_lamp(points, lamps, coats, tracer, rng, through):
                add(name, found)
        else:
            for lamp in lamps:
                add(lamp.name, direct.from_lamp(points, lamp, coats, tracer, rng, through))

    def _add_gathered(
        self,
        parts: Parts,
        rows: NDArray[np.int64],
        points: Points,
        effort: Effort,
        rng: np.random.Generator,
        rays: int,
        depth: int,
        even: Even | None = None,
    ) -> None:
        """Add what the hemisphere holds besides the open sky."""
        around = self._gathering(points, rng, rays, even)
        if not self.lighting.dome.dark:
            self._add_sky(parts, rows, around, effort, rays)
            self._add_bright_sky(parts, rows, points, effort, rng, rays)
        if not len(around.met) or (depth >= effort.bounces and self.lighting.panels is None):
            return
        there = self._there(around)
        weight = self._weight(around, around.met)
        around.weaken(around.met, weight)
        if self.lighting.panels is not None:
            self._add_glow(parts, rows, there, around, weight, rays)
        if depth < effort.bounces:
            self._add_bounced(parts, rows, there, around.met, weight, effort, rng, rays, depth)

    @property
    def _bright_sky(self) -> BrightSky | None:
        """How bright sky is looked for by name; not through panes, which only gathering knows."""
        return self.lighting.bright_sky if self.coats.panes is None else None

    def _add_sky(self, parts: Parts, rows: NDArray[np.int64], around: "Around", effort: Effort, rays: int) -> None:
        """Add the sky that gathering meets, and take what objects hide of the sky that is known."""
        dome, known = self.lighting.dome, _known_of(around.many, effort)
        # Where panes are in the way, nothing is known of what comes by them, but all of the sky behind.
        unknown = np.float32(1.0) - known * ~(around.glazed & effort.hidden_sky)
        seen = np.flatnonzero(around.open & (unknown > 0.0))
        light = self._weight(around, seen)
        light *= dome.radiance(around.last_direction[seen])
        light *= (unknown[seen] * self._share_of_sky(around, seen, rays))[:, None]
        around.weaken(seen, light)
        parts.add("sky", *summed(light, seen, rows, rays))
        hides = (~around.open | around.glazed) & (around.factor > 0.0)
        behind = np.flatnonzero(hides & (known > 0.0)) if effort.hidden_sky else around.met[:0]
        light = self._weight(around, behind)
        light *= dome.radiance(around.direction[behind])
        light *= (-known[behind] * self._share_of_sky(around, behind, rays))[:, None]
        parts.add("hidden sky", *summed(light, behind, rows, rays))

    def _share_of_sky(self, around: "Around", which: NDArray[np.int64], rays: int) -> NDArray[np.float32]:
        """Return what gathering finds of the sky in its own directions, beside `_add_bright_sky`, shape (ray,)."""
        bright = self._bright_sky
        if bright is None:
            return np.ones(len(which), np.float32)
        own = rays * around.density[which]
        return (own / (own + bright.density(around.direction[which]))).astype(np.float32)

    def _add_bright_sky(
        self,
        parts: Parts,
        rows: NDArray[np.int64],
        points: Points,
        effort: Effort,
        rng: np.random.Generator,
        rays: int,
    ) -> None:
        """Add the share of the sky that is looked for by name, one ray from each point (balance heuristic, Veach 1995).

        What gathering counts of a free or a hidden direction counts here too: the unknown, or less the known.
        """
        bright = self._bright_sky
        if bright is None:
            return
        known = _known_of(points, effort)
        asks = (known < 1.0) | effort.hidden_sky
        towards = bright.draw(len(points), rng)
        cosine = np.einsum("ij,ij->i", points.normal, towards)
        which = np.flatnonzero(asks & (cosine > 0.0))
        some, towards = points.some(which), towards[which]
        hidden = direct.hidden(points, which, towards, self.surfaces.tracer, None)
        counts = (1.0 - known[which] - hidden) if effort.hidden_sky else np.where(hidden, 0.0, 1.0 - known[which])
        density = rays * self.coats.density(some, towards) + bright.density(towards)
        light = self.coats.value(some, towards)
        light *= (counts * cosine[which] / density).astype(np.float32)[:, None]
        light *= self.lighting.dome.radiance(towards)
        for name, these in (("sky", ~hidden), ("hidden sky", hidden)):
            parts.add(name, rows[which[these]], light[these])

    def _gathering(self, points: Points, rng: np.random.Generator, rays: int, even: Even | None) -> "Around":
        count = len(points)
        many = points if rays == 1 else points.some(np.repeat(np.arange(count), rays))
        if even is None:
            even = Even.drawn(count, rays, rng)
        direction, density = self.coats.drawn(many, even.pairs().reshape(-1, 2), rng)
        cosine = np.einsum("ij,ij->i", many.normal, direction)
        gives = (cosine > 0.0) & (density > 0.0)
        factor = np.divide(cosine, density * rays, out=np.zeros_like(cosine), where=gives)
        start = self.surfaces.tracer.above(many.face, many.place_m, many.normal)
        hit = self.surfaces.tracer.hits(start, direction)
        glass = None
        if self.coats.panes is not None:
            glass = passed(self.coats.panes, self.surfaces.tracer, start, direction, hit.range_m, rng)
            hit.face[glass.which], hit.range_m[glass.which] = glass.face, glass.range_m
        missed = hit.face == NOTHING
        return Around(
            many,
            start,
            direction,
            density,
            factor,
            hit.face,
            hit.range_m,
            np.flatnonzero(~missed & gives),
            missed & gives,
            glass,
        )

    def _weight(self, around: "Around", which: NDArray[np.int64]) -> NDArray[np.float32]:
        """BRDF times cosine over density and number of rays, of some rays, shape (ray, band)."""
        weight = self.coats.value(around.many.some(which), around.direction[which])
        weight *= around.factor[which, None].astype(np.float32)
        return weight

    def _there(self, around: "Around") -> Points:
        """What the rays that met something met."""
        met = around.met
        direction = around.last_direction[met]
        place = around.last_start_m[met] + around.range_m[met, None] * direction
        return self.coats.points(self.surfaces, around.face[met], place, direction, around.many.known[met])

    def _add_glow(
        self,
        parts: Parts,
        rows: NDArray[np.int64],
        there: Points,
        around: "Around",
        weight: NDArray[np.float32],
        rays: int,
    ) -> None:
        panels, (glows, glow) = self.lighting.panels, self.emitted(there)
        if panels is None or not len(glows):
            return
        ray = around.met[glows]
        leaving = np.einsum("ij,ij->i", there.normal[glows], -around.last_direction[ray])
        share = direct.found_by_gathering(
            panels, there.face[glows], around.range_m[ray] + around.gone_m[ray], leaving, around.density[ray], rays
        )
        # What panes mirror is found by gathering alone.
        share = np.where(around.turned[ray], 1.0, share)
        light = glow * share.astype(np.float32)[:, None] * weight[glows]
        parts.add("glow", *summed(light, ray, rows, rays))

    def _add_bounced(
        self,
        parts: Parts,
        rows: NDArray[np.int64],
        there: Points,
        met: NDArray[np.int64],
        weight: NDArray[np.float32],
        effort: Effort,
        rng: np.random.Generator,
        rays: int,
        depth: int,
    ) -> None:
        if effort.roulette_from is not None and depth >= effort.roulette_from:
            chance = np.clip(weight.mean(axis=1) * rays, 0.05, 0.95)
            stays = np.flatnonzero(rng.random(len(met)) < chance)
            there, met, weight = there.some(stays), met[stays], weight[stays] / chance[stays, None]
        if not len(met):
            return
        further = self.leaving(there, effort, rng, rays=1, split=parts.split, depth=depth + 1)
        for name, light in further.found.items():
            order, source = bounced(name)
            light *= weight
            parts.add(f"bounce {order + 1} of {source}", *summed(light, met, rows, rays))


def _known_of(points: Points, effort: Effort) -> NDArray[np.float32]:
    """Share of the sky that points take as known: none where they are not matt, all where nothing may hide it."""
    known = points.known.copy() if effort.hidden_sky else np.ones(len(points), np.float32)
    for which, _ in points.glossy:
        known[which] = 0.0
    return known
