"""The radiance along rays of the eye: sky, glow and surfaces that they meet, by way of panes and through air."""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.ray_tracer import NOTHING
from simulate.radiance.transport.integrator_settings import IntegratorSettings
from simulate.radiance.transport.outgoing_radiance import Shared, outgoing_radiance
from simulate.radiance.transport.panes import MOST, SPLIT, Met, Panes, choose_mirror_rays, reflect_direction
from simulate.radiance.transport.radiance_components import RadianceComponents
from simulate.radiance.transport.shading_points import ShadingPoints
from simulate.radiance.transport.spectral_scene import SpectralScene

Array = NDArray[np.floating]
# What points share of all that they gather, by the numbers of the rays that met them.
Sharing = Callable[[ShadingPoints, NDArray[np.int64]], Shared]


def radiance_along(
    stage: SpectralScene,
    origin: Array,
    towards: Array,
    effort: IntegratorSettings,
    rng: np.random.Generator,
    *,
    gathered: int,
    known: NDArray[np.float32] | None = None,
    split: bool = False,
    share: Sharing | None = None,
    behind: int = 0,
) -> RadianceComponents:
    """Return the radiance along rays of unit direction (ray, 3), in parts of shape (ray, band), as `outgoing_radiance.leaving`.

    Besides the sources, parts are "in view": sky and glow that the ray meets, and "air": what air adds on the way, less
    what it takes of all the rest. Points of rays (their numbers) may `share` what they gather, see `outgoing_radiance.leaving`.
    Rays that meet a pane go on both ways, through and mirrored; `behind` a few panes they take one by chance.
    """
    hit = stage.surfaces.tracer.hits(origin, towards)
    parts = RadianceComponents((len(towards), stage.bands), split=split)
    here = np.ones(len(towards), np.bool_)
    if stage.bsdfs.panes is not None:
        glass = stage.bsdfs.panes.met(origin, towards, hit.range_m)
        here[glass.which] = False
        for which, start, ways, left, straight in _ways_on(stage.bsdfs.panes, glass, towards, behind, rng):
            seen = None if known is None else known[which]
            sharing = _of_some(share, which) if straight else None
            onwards = radiance_along(
                stage, start, ways, effort, rng,
                gathered=gathered, known=seen, split=split, share=sharing, behind=behind + 1,
            )  # fmt: skip
            for name, light in onwards.found.items():
                parts.add(name, which, light * left)
        if stage.air.absorbs and "air" not in effort.left_out:
            _through_air(stage, parts, glass.range_m, towards[glass.which], glass.which)
    met = np.flatnonzero(here & (hit.face != NOTHING))
    away = np.flatnonzero(here & (hit.face == NOTHING))
    parts.add("in view", away, stage.lighting.environment_map.radiance(towards[away]))
    points = stage.points(hit, origin, towards, met, None if known is None else known[met])
    glows, glow = stage.emission(points)
    parts.add("in view", met[glows], glow)
    shared = None if share is None else share(points, met)
    outgoing_radiance(stage, points, effort, rng, rays=gathered, into=(parts, met), shared=shared)
    if stage.air.absorbs and "air" not in effort.left_out:
        _through_air(stage, parts, hit.range_m[met], towards[met], met)
    return parts


def _of_some(share: Sharing | None, which: NDArray[np.int64]) -> Sharing | None:
    """Share as all rays do, for some of them."""
    return None if share is None else lambda points, numbers: share(points, which[numbers])


def _ways_on(
    panes: Panes, glass: Met, towards: Array, behind: int, rng: np.random.Generator
) -> Iterator[tuple[NDArray[np.int64], Array, Array, NDArray[np.float32], bool]]:
    """Yield ways on from panes: numbers of rays, starts, directions, shares of the light, and whether straight on."""
    if not len(glass.which) or behind >= MOST:
        return
    ahead = towards[glass.which]
    by_chance = choose_mirror_rays(glass, rng) if behind >= SPLIT else None
    for turns, start, ways, left in (
        (False, panes.beyond(glass), ahead, glass.through),
        (True, panes.before(glass), reflect_direction(ahead, glass.normal), glass.mirrored),
    ):
        rows = np.arange(len(ahead)) if by_chance is None else np.flatnonzero(by_chance[0] == turns)
        if len(rows):
            share = left[rows] if by_chance is None else by_chance[1][rows]
            yield glass.which[rows], start[rows], ways[rows], share, not turns


def _through_air(
    stage: SpectralScene, parts: RadianceComponents, range_m: Array, towards: Array, met: NDArray[np.int64]
) -> None:
    """Add what the air adds on the way, and take what it takes of all the rest."""
    parts.add("air", met, stage.air.change_of(parts.total()[met], range_m, towards))
