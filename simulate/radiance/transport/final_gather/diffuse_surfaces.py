"""What matt places gather, by compiled loops (`paths`), which hand back what is not matt."""

import numpy as np

from simulate.radiance.brdf.lambert import Lambert
from simulate.radiance.transport.compiled_light_sources import disc_arrays, lamp_arrays, panel_arrays, sky_arrays
from simulate.radiance.transport.final_gather.sky import add_bright_sky
from simulate.radiance.transport.integrator_settings import ASKED_LAMPS, IntegratorSettings
from simulate.radiance.transport.path_tracer import CompiledScene
from simulate.radiance.transport.shading_request import Further, ShadingRequest
from simulate.radiance.transport.sky_importance_sampling import SkyImportance
from simulate.radiance.transport.sky_shadow_rays import sky_residual_irradiance
from simulate.radiance.transport.spectral_scene import SpectralScene


def add_by_paths(stage: SpectralScene, asked: ShadingRequest, further: Further) -> None:
    """Add what matt points gather."""
    points, effort, light = asked.points, asked.effort, stage.lighting
    last = not asked.reflections and light.panels is None
    if last and (not effort.hidden_sky or light.environment_map.dark):
        return
    # Rays of neighbours that are even together find the whole sky themselves where only its shadow counts.
    bright = None if asked.even is not None and last else stage.bright_sky
    even = asked.stretches
    if bright is None and last:
        found = sky_residual_irradiance(points, even, light.environment_map, stage.surfaces.tracer)
        asked.parts.add("sky", asked.rows, found * stage.bsdfs.matt(points))
        return
    if bright is not None:
        add_bright_sky(stage, asked)
    found, back = plain(stage, effort, bright).irradiance(
        points,
        even,
        known=asked.known,
        hidden_sky=effort.hidden_sky,
        depth=asked.depth,
        bounces=effort.bounces,
        roulette_from=effort.roulette_from,
        asked_lamps=ASKED_LAMPS,
        seed=int(asked.rng.integers(1 << 63)),
    )
    for behind in np.unique(back.depth).tolist():
        these = np.flatnonzero(back.depth == behind)
        owner = back.owner[these]
        there = stage.bsdfs.points(
            stage.surfaces, back.face[these], back.place_m[these], back.direction[these], points.known[owner]
        )
        np.add.at(found, owner, further(there, behind).total() * back.weight[these])
    asked.parts.add("around", asked.rows, found * stage.bsdfs.matt(points))


def plain(stage: SpectralScene, effort: IntegratorSettings, bright: SkyImportance | None) -> CompiledScene:
    """Return the scene as compiled loops need it."""
    light = stage.lighting
    shine = np.array([lamp.name not in effort.left_out for lamp in light.lamps], np.bool_)
    return CompiledScene(
        tracer=stage.surfaces.tracer,
        material_of=stage.surfaces.material_of,
        rho_by_pi=stage.bsdfs.rho_by_pi,
        matt=np.array([isinstance(brdf, Lambert) for brdf in stage.bsdfs.brdfs]),
        sky=sky_arrays(light.environment_map, bright),
        discs=disc_arrays(effort.kept(light.discs), stage.bands),
        lamps=lamp_arrays(effort.kept(light.lamps), stage.bands),
        panels=panel_arrays(light.panels, stage.bands),
        beams=stage.beams.arrays(light.lamps, shine),
    )
