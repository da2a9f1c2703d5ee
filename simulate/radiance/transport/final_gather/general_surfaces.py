"""What places gather on surfaces that reflect in any way, and through panes: their rays in batches."""

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.transport import direct_lighting
from simulate.radiance.transport.final_gather.hemisphere_rays import Around, sent
from simulate.radiance.transport.final_gather.sky import add_bright_sky, add_sky
from simulate.radiance.transport.path_tracer import LEAST_CHANCE, MOST_CHANCE
from simulate.radiance.transport.radiance_components import bounce_order
from simulate.radiance.transport.shading_points import ShadingPoints
from simulate.radiance.transport.shading_request import Further, ShadingRequest
from simulate.radiance.transport.spectral_scene import SpectralScene


def add_by_batches(stage: SpectralScene, asked: ShadingRequest, further: Further) -> None:
    """Add what the hemisphere holds besides the open sky."""
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
    way = around.hit.range_m[ray] + around.gone_m[ray]
    share = direct_lighting.gather_mis_weight(panels, there.face[glows], way, leaving, around.density[ray], asked.rays)
    # What panes mirror is found by gathering alone.
    share = np.where(around.turned[ray], 1.0, share)
    asked.add_found("glow", ray, glow * share.astype(np.float32)[:, None] * weight[glows])


def _add_bounced(
    asked: ShadingRequest, there: ShadingPoints, met: NDArray[np.int64], weight: NDArray[np.float32], further: Further
) -> None:
    roulette_from = asked.effort.roulette_from
    if roulette_from is not None and asked.depth >= roulette_from:
        chance = np.clip(weight.mean(axis=1) * asked.rays, LEAST_CHANCE, MOST_CHANCE)
        stays = np.flatnonzero(asked.rng.random(len(met)) < chance)
        there, met, weight = there.some(stays), met[stays], weight[stays] / chance[stays, None]
    if not len(met):
        return
    for name, light in further(there, asked.depth + 1).found.items():
        order, source = bounce_order(name)
        light *= weight
        asked.add_found(f"bounce {order + 1} of {source}", met, light)
