"""Final gather: sampling of the hemisphere at shading points.

The unoccluded sky irradiance is a control variate. A gather ray that meets nothing adds nothing, so that a point in the
open has no noise; a ray that meets an object adds the object's radiance and subtracts the sky behind it. Where little
of the sky is visible the fraction of the control variate is low, see `ShadingPoints`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.brdf.protocol import Lambert
from simulate.radiance.geometry.ray_tracer import NOTHING, Hits
from simulate.radiance.integrator import direct_lighting
from simulate.radiance.integrator.compiled_light_sources import disc_arrays, lamp_arrays, panel_arrays, sky_arrays
from simulate.radiance.integrator.environment_map import SkyImportance
from simulate.radiance.integrator.integrator_settings import LIMITS, IntegratorSettings
from simulate.radiance.integrator.panes import Passed, trace_through_panes
from simulate.radiance.integrator.path_tracer import LEAST_CHANCE, MOST_CHANCE, CompiledScene
from simulate.radiance.integrator.shading_points import BsdfSet, ShadingPoints
from simulate.radiance.integrator.shading_request import Further, ShadingRequest, bounce_order
from simulate.radiance.integrator.source_sampling_loops import sky_residual_irradiance
from simulate.radiance.integrator.spectral_scene import SpectralScene

Array = NDArray[np.floating]


@dataclass(frozen=True)
class Around:
    """Gather rays: their points, starts, directions, densities and factors, and their hits."""

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
        return self._of_glass(np.zeros(len(self.direction), np.bool_), lambda glass: np.ones_like(glass.is_reflected))

    @property
    def last_start_m(self) -> Array:
        """Starts of the last segments of rays."""
        return self._of_glass(self.start_m, lambda glass: glass.start_m)

    @property
    def last_direction(self) -> Array:
        """Directions of the last segments of rays."""
        return self._of_glass(self.direction, lambda glass: glass.direction)

    @property
    def earlier_length_m(self) -> Array:
        """Path length before the last segments, m."""
        return self._of_glass(np.zeros(len(self.direction)), lambda glass: glass.earlier_length_m)

    @property
    def is_reflected(self) -> NDArray[np.bool_]:
        """Whether panes reflected rays."""
        return self._of_glass(np.zeros(len(self.direction), np.bool_), lambda glass: glass.is_reflected)

    def weight(self, bsdfs: BsdfSet, which: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return BRDF times cosine over density and number of rays, of some rays, shape (ray, band)."""
        weight = bsdfs.value(self.many.some(which), self.direction[which])
        weight *= self.factor[which, None].astype(np.float32)
        return weight

    def there(self, stage: SpectralScene) -> ShadingPoints:
        """Return the shading points of rays that hit a surface."""
        return stage.points(
            self.hit, self.last_start_m, self.last_direction, self.met, self.many.sky_control_fraction[self.met]
        )

    def weaken(self, which: NDArray[np.int64], light: NDArray[np.float32]) -> None:
        """Attenuate the light of some rays (ray, band) by the panes that they met."""
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
    """Trace gather rays from points, half of those of glossy points by the specular lobe."""
    tracer, rays = stage.surfaces.tracer, asked.rays
    many = asked.points if rays == 1 else asked.points.some(np.repeat(np.arange(len(asked.points)), rays))
    direction, density = stage.bsdfs.sample(many, asked.stretches.pairs().reshape(-1, 2), asked.rng)
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


def add_sky(stage: SpectralScene, asked: ShadingRequest, around: Around) -> None:
    """Add the sky that gather rays meet, and subtract the occluded part of the control variate."""
    environment, sky_shadowing, sky_control_fraction = (
        stage.lighting.environment_map,
        asked.effort.sky_shadowing,
        np.repeat(asked.sky_control_fraction, asked.rays),
    )
    # Behind panes the control variate does not apply to the transmitted light.
    unknown = np.float32(1.0) - sky_control_fraction * ~(around.has_pane_hits & sky_shadowing)
    seen = np.flatnonzero(around.open & (unknown > 0.0))
    light = around.weight(stage.bsdfs, seen)
    light *= environment.radiance(around.last_direction[seen])
    light *= (unknown[seen] * _share(stage, asked, around, seen))[:, None]
    around.weaken(seen, light)
    asked.add_found("sky", seen, light)
    hides = (~around.open | around.has_pane_hits) & (around.factor > 0.0)
    behind = np.flatnonzero(hides & (sky_control_fraction > 0.0)) if sky_shadowing else around.met[:0]
    light = around.weight(stage.bsdfs, behind)
    light *= environment.radiance(around.direction[behind])
    light *= (-sky_control_fraction[behind] * _share(stage, asked, around, behind))[:, None]
    asked.add_found("hidden sky", behind, light)


def _share(
    stage: SpectralScene, asked: ShadingRequest, around: Around, which: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Balance-heuristic weight of gather rays against `add_bright_sky`, shape (ray,)."""
    bright = stage.bright_sky
    if bright is None:
        return np.ones(len(which), np.float32)
    own = asked.rays * around.density[which]
    return (own / (own + bright.density(around.direction[which]))).astype(np.float32)


def add_bright_sky(stage: SpectralScene, asked: ShadingRequest) -> None:
    """Add the importance-sampled part of the sky, one ray from each point (balance heuristic, Veach 1995).

    Visible and occluded directions count as for gather rays: 1 minus, or minus, the control-variate fraction.
    """
    bright, points, sky_shadowing, sky_control_fraction = (
        stage.bright_sky,
        asked.points,
        asked.effort.sky_shadowing,
        asked.sky_control_fraction,
    )
    if bright is None:
        return
    asks = (sky_control_fraction < 1.0) | sky_shadowing
    towards = bright.draw(len(points), asked.rng)
    cosine = np.einsum("ij,ij->i", points.normal, towards)
    which = np.flatnonzero(asks & (cosine > 0.0))
    some, towards = points.some(which), towards[which]
    hidden = direct_lighting.is_occluded(points, which, towards, stage.surfaces.tracer, None)
    counts = (
        (1.0 - sky_control_fraction[which] - hidden)
        if sky_shadowing
        else np.where(hidden, 0.0, 1.0 - sky_control_fraction[which])
    )
    density = asked.rays * stage.bsdfs.density(some, towards) + bright.density(towards)
    light = stage.bsdfs.value(some, towards)
    light *= (counts * cosine[which] / density).astype(np.float32)[:, None]
    light *= stage.lighting.environment_map.radiance(towards)
    for name, these in (("sky", ~hidden), ("hidden sky", hidden)):
        asked.add(name, which[these], light[these])


def add_by_batches(stage: SpectralScene, asked: ShadingRequest, further: Further) -> None:
    """Add indirect light on any surface, in batches of rays."""
    around = sent(stage, asked)
    if not stage.lighting.environment_map.dark:
        add_sky(stage, asked, around)
        add_bright_sky(stage, asked)
    met, glows = around.met, stage.lighting.panels is not None
    if not len(met) or not (asked.reflections or glows):
        return
    there = around.there(stage)
    weight = around.weight(stage.bsdfs, met)
    around.weaken(met, weight)
    if glows:
        _add_glow(stage, asked, there, around, weight)
    if asked.reflections:
        _add_bounced(asked, there, met, weight, further)


def _add_glow(
    stage: SpectralScene, asked: ShadingRequest, there: ShadingPoints, around: Around, weight: NDArray[np.float32]
) -> None:
    panels, (glows, glow) = stage.lighting.panels, stage.emission(there)
    if panels is None or not len(glows):
        return
    ray = around.met[glows]
    leaving = np.einsum("ij,ij->i", there.normal[glows], -around.last_direction[ray])
    way = around.hit.range_m[ray] + around.earlier_length_m[ray]
    share = direct_lighting.gather_mis_weight(panels, there.face[glows], way, leaving, around.density[ray], asked.rays)
    # Only gather rays sample light reflected by panes.
    share = np.where(around.is_reflected[ray], 1.0, share)
    asked.add_found("glow", ray, glow * share.astype(np.float32)[:, None] * weight[glows])


def _add_bounced(
    asked: ShadingRequest, there: ShadingPoints, met: NDArray[np.int64], weight: NDArray[np.float32], further: Further
) -> None:
    roulette_depth = asked.effort.roulette_depth
    if roulette_depth is not None and asked.depth >= roulette_depth:
        chance = np.clip(weight.mean(axis=1) * asked.rays, LEAST_CHANCE, MOST_CHANCE)
        stays = np.flatnonzero(asked.rng.random(len(met)) < chance)
        there, met, weight = there.some(stays), met[stays], weight[stays] / chance[stays, None]
    if not len(met):
        return
    for name, light in further(there, asked.depth + 1).found.items():
        order, source = bounce_order(name)
        light *= weight
        asked.add_found(f"bounce {order + 1} of {source}", met, light)


def add_by_paths(stage: SpectralScene, asked: ShadingRequest, further: Further) -> None:
    """Add indirect light on diffuse points by the compiled path tracer, which defers what is not diffuse."""
    points, effort, light = asked.points, asked.effort, stage.lighting
    last = not asked.reflections and light.panels is None
    if last and (not effort.sky_shadowing or light.environment_map.dark):
        return
    # Low-discrepancy rays of neighbouring points sample the sky well enough where only its shadowing is computed.
    bright = None if asked.even is not None and last else stage.bright_sky
    even = asked.stretches
    if bright is None and last:
        found = sky_residual_irradiance(points, even, light.environment_map, stage.surfaces.tracer)
        asked.parts.add("sky", asked.rows, found * stage.bsdfs.diffuse_brdf(points))
        return
    if bright is not None:
        add_bright_sky(stage, asked)
    found, back = plain(stage, effort, bright).irradiance(
        points,
        even,
        sky_control_fraction=asked.sky_control_fraction,
        sky_shadowing=effort.sky_shadowing,
        depth=asked.depth,
        max_bounces=effort.max_bounces,
        roulette_depth=effort.roulette_depth,
        asked_lamps=LIMITS.max_sampled_lamps,
        seed=int(asked.rng.integers(1 << 63)),
    )
    for behind in np.unique(back.depth).tolist():
        these = np.flatnonzero(back.depth == behind)
        owner = back.owner[these]
        there = stage.bsdfs.points(
            stage.surfaces,
            back.face[these],
            back.place_m[these],
            back.direction[these],
            points.sky_control_fraction[owner],
        )
        np.add.at(found, owner, further(there, behind).total() * back.weight[these])
    asked.parts.add("around", asked.rows, found * stage.bsdfs.diffuse_brdf(points))


def plain(stage: SpectralScene, effort: IntegratorSettings, bright: SkyImportance | None) -> CompiledScene:
    """Return the scene in the form of the compiled loops."""
    light = stage.lighting
    shine = np.array([lamp.name not in effort.neglected for lamp in light.lamps], np.bool_)
    return CompiledScene(
        tracer=stage.surfaces.tracer,
        material_of=stage.surfaces.material_of,
        rho_by_pi=stage.bsdfs.rho_by_pi,
        is_diffuse=np.array([isinstance(brdf, Lambert) for brdf in stage.bsdfs.brdfs]),
        sky=sky_arrays(light.environment_map, bright),
        discs=disc_arrays(effort.active_lights(light.discs), stage.bands),
        lamps=lamp_arrays(effort.active_lights(light.lamps), stage.bands),
        panels=panel_arrays(light.panels, stage.bands),
        beams=stage.beams.arrays(light.lamps, shine),
    )
