"""What matt places gather, by compiled loops (`paths`), which hand back what is not matt."""

import numpy as np

from simulate.radiance.brdf.lambert import Lambert
from simulate.radiance.transport.asked import Asked, Further
from simulate.radiance.transport.bright_sky import BrightSky
from simulate.radiance.transport.compiled_lights import disc_arrays, lamp_arrays, panel_arrays, sky_arrays
from simulate.radiance.transport.effort import ASKED_LAMPS, Effort
from simulate.radiance.transport.gather.sky import add_bright_sky
from simulate.radiance.transport.openness import sky_beyond_known
from simulate.radiance.transport.paths import Plain
from simulate.radiance.transport.stage import Stage


def add_by_paths(stage: Stage, asked: Asked, further: Further) -> None:
    """Add what matt points gather."""
    points, effort, light = asked.points, asked.effort, stage.lighting
    last = not asked.reflections and light.panels is None
    if last and (not effort.hidden_sky or light.dome.dark):
        return
    # Rays of neighbours that are even together find the whole sky themselves where only its shadow counts.
    bright = None if asked.even is not None and last else stage.bright_sky
    even = asked.stretches
    if bright is None and last:
        found = sky_beyond_known(points, even, light.dome, stage.surfaces.tracer)
        asked.parts.add("sky", asked.rows, found * stage.coats.matt(points))
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
        there = stage.coats.points(
            stage.surfaces, back.face[these], back.place_m[these], back.direction[these], points.known[owner]
        )
        np.add.at(found, owner, further(there, behind).total() * back.weight[these])
    asked.parts.add("around", asked.rows, found * stage.coats.matt(points))


def plain(stage: Stage, effort: Effort, bright: BrightSky | None) -> Plain:
    """Return the scene as compiled loops need it."""
    light = stage.lighting
    shine = np.array([lamp.name not in effort.left_out for lamp in light.lamps], np.bool_)
    return Plain(
        tracer=stage.surfaces.tracer,
        material_of=stage.surfaces.material_of,
        rho_by_pi=stage.coats.rho_by_pi,
        matt=np.array([isinstance(brdf, Lambert) for brdf in stage.coats.brdfs]),
        sky=sky_arrays(light.dome, bright),
        discs=disc_arrays(effort.kept(light.discs), stage.bands),
        lamps=lamp_arrays(effort.kept(light.lamps), stage.bands),
        panels=panel_arrays(light.panels, stage.bands),
        beams=stage.beams.arrays(light.lamps, shine),
    )
