"""Infrared image of a scene: enough rays, terms left out, and auxiliary layers."""

import os
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from simulate.arrays import Array
from simulate.effect_selection import OptionalEffect, select_effects
from simulate.radiance.geometry.viewpoint import Viewpoint
from simulate.radiance.integrator.auxiliary_layers import AuxiliaryLayers, layers_of
from simulate.radiance.integrator.integrator_settings import workers
from simulate.radiance.integrator.sampling import SequenceSlice
from simulate.radiance.outdoor.scene import OutdoorScene
from simulate.thermal.air import modtran_air
from simulate.thermal.infrared_picture import InfraredPicture, notes_beyond_laws
from simulate.thermal.infrared_sky import notes_on_sky, sky_of
from simulate.thermal.infrared_surfaces import infrared_surfaces
from simulate.thermal.infrared_tracer import (
    AIR,
    BETWEEN,
    GLASS,
    MORE,
    SUN,
    InfraredTracer,
    TracedPixels,
)
from simulate.thermal.temperatures import Temperatures
from simulate.thermal.thresholds import INFRARED

BINS, FINER = "transmittance by bins, not one of the band", "bins finer than these"
INSIDE = "sky and sun on it through the glass"


def infrared_radiance(
    temperatures: Temperatures,
    scene: OutdoorScene,
    viewpoint: Viewpoint,
    *,
    band_um: tuple[float, float],
    netd_k: float,
    tolerance: float | None = INFRARED.tolerance,
    seed: int = 0,
    progress: Callable[[float], None] = lambda fraction: None,
) -> InfraredPicture:
    """Return the infrared radiance of a scene as a camera would see it without lens, blur and
    noise.

    Parameters
    ----------
    temperatures
        Surface temperatures of the scene (`temperatures_of`), shared by all views of it.
    scene
        The scene.
    viewpoint
        Pose and pixels.
    band_um
        Ends of the band, um; all bins that it overlaps are computed in full.
    netd_k
        Noise-equivalent temperature difference of one pixel of the view, K, by which rays are
        chosen.
    tolerance
        What terms left out may change together, as a fraction of that; None: no term is left out.
    seed
        Seed of the rays.
    progress
        Called with the fraction done.

    Raises
    ------
    BadInput
        If the band is not within 3 to 5 or 7.5 to 14 um.

    Notes
    -----
    A surface sends out (1 - a) B(T) + a L, with its albedo a towards the viewer (Kirchhoff's law
    for the same BRDF) and the mean radiance L of what it sees: by the cosine law of diffuse
    surfaces, by rays drawn from the BRDF of others. Those rays see the sky by its direction and
    facets of the scene with all their own reflections, taken as diffuse. In surroundings of one
    temperature every pixel is a black body whatever its material, angle and range.

    Examples
    --------
    >>> picture = infrared_radiance(
    ...     temperatures, scene, viewpoint, band_um=(8, 12), netd_k=0.05
    ... )  # doctest: +SKIP
    """
    return _render(
        tracer_of(temperatures, scene, viewpoint, band_um=band_um, seed=seed),
        netd_k,
        tolerance,
        progress,
    )


def tracer_of(
    temperatures: Temperatures,
    scene: OutdoorScene,
    viewpoint: Viewpoint,
    *,
    band_um: tuple[float, float],
    seed: int,
) -> InfraredTracer:
    """Return the tracer of a view, with few rays and all terms."""
    state = scene.weather
    assert state is not None
    weather = temperatures.balance.weather
    sky = sky_of(band_um, weather, state)
    if state.atmosphere == "modtran5":
        sky = replace(sky, air=modtran_air(sky.air, scene, weather, viewpoint.position_m[2]))
    return InfraredTracer(
        temperatures=temperatures,
        surfaces=infrared_surfaces(temperatures, scene, sky.air, sky),
        air=sky.air,
        sky=sky,
        viewpoint=viewpoint,
        seed=seed,
        rays=INFRARED.min_rays,
        mirror_rays=INFRARED.min_mirror_rays,
    )


def _render(
    tracer: InfraredTracer,
    netd_k: float,
    tolerance: float | None,
    progress: Callable[[float], None],
) -> InfraredPicture:
    tracer, error_k, short = _enough_rays(tracer, netd_k)
    kept_effects, left_out = _effects(tracer, netd_k, tolerance)
    tracer = replace(tracer, without=frozenset(effect.name for effect in left_out))
    starts, parts = list(range(0, tracer.viewpoint.shape[0], INFRARED.rows)), []
    with workers(min(2, os.cpu_count() or 1)) as run:
        for part in run(tracer.rows, starts):
            parts.append(part)
            progress(len(parts) / len(starts))
        radiance, truth = (
            np.concatenate([part.radiance.astype(np.float32) for part in parts]),
            _truth(tracer, parts),
        )
        edges = np.flatnonzero(truth.edges(shadows=tracer.sky.sun is not None))
        batches = (
            np.array_split(edges, max(1, len(edges) // INFRARED.edge_batch)) if len(edges) else []
        )
        edge_error = np.zeros(len(radiance))
        for pixels, (mean, error) in zip(batches, run(tracer.mean_radiance, batches), strict=True):
            radiance[pixels], edge_error[pixels] = mean, error
    off_k = _root_mean_square(edge_error[edges]) * tracer.air.kelvin_per_radiance(
        tracer.air.temperature_k
    )
    return InfraredPicture(
        edges_um=tracer.air.edges_um,
        radiance=radiance.reshape(*tracer.viewpoint.shape, -1),
        truth=truth,
        error_k=error_k,
        rays=(tracer.rays, tracer.mirror_rays),
        effects=kept_effects,
        left_out=left_out,
        notes=(
            f"infrared radiance by {tracer.rays} rays of a pixel, {tracer.mirror_rays} of glossy "
            f"ones and metals: by chance surfaces are uncertain by {1e3 * error_k:.2g} mK, root "
            "mean square",
            *short,
            f"{100.0 * len(edges) / len(radiance):.2g} % of the pixels show where objects or "
            f"faces meet, each as the mean of {INFRARED.edge_parts**2} parts: uncertain by "
            f"{1e3 * off_k:.2g} mK, root mean square",
            *notes_beyond_laws(
                tracer.air, tracer.temperatures.balance.weather.sun[-1], tracer.viewpoint, truth
            ),
            *tracer.air.notes,
            *notes_on_sky(tracer.air),
            *tracer.temperatures.balance.weather.notes,
        ),
    )


def _pilot(tracer: InfraredTracer, number: int) -> TracedPixels:
    """See random pixels, the same ones in each turn, by different rays."""
    rng = np.random.default_rng([tracer.seed, INFRARED.pilot_pixels])
    row, col = (
        rng.integers(0, side, INFRARED.pilot_pixels) + 0.5 for side in tracer.viewpoint.shape
    )
    rng_rays = np.random.default_rng([tracer.seed, INFRARED.pilot_pixels, number])
    return tracer.see(row, col, SequenceSlice.random(len(row), tracer.rays, rng_rays), rng_rays)


def _enough_rays(
    tracer: InfraredTracer, netd_k: float
) -> tuple[InfraredTracer, float, tuple[str, ...]]:
    """Double the rays until two independent views of some pixels agree; return also the error, K,
    and a note on it.
    """
    limit, per_radiance = (
        INFRARED.error_share * netd_k,
        tracer.air.kelvin_per_radiance(tracer.air.temperature_k),
    )
    while True:
        first, second = _pilot(tracer, 1), _pilot(tracer, 2)
        differences_k = (first.radiance - second.radiance).sum(axis=1) * per_radiance / np.sqrt(2.0)
        surface = np.isfinite(first.kelvin)
        errors = [
            _root_mean_square(differences_k[pixels])
            for pixels in (surface & ~first.glossy, first.glossy)
        ]
        next_tracer = replace(
            tracer,
            rays=min(2 * tracer.rays, INFRARED.max_rays) if errors[0] > limit else tracer.rays,
            mirror_rays=min(2 * tracer.mirror_rays, INFRARED.max_mirror_rays)
            if errors[1] > limit
            else tracer.mirror_rays,
        )
        if (next_tracer.rays, next_tracer.mirror_rays) == (tracer.rays, tracer.mirror_rays):
            break
        tracer = next_tracer
    notes = tuple(
        f"{name} are uncertain by {1e3 * error:.2g} mK by chance, more than "
        f"{INFRARED.error_share:g} of the imager's {1e3 * netd_k:.3g} mK: there are at most "
        f"{max_rays} rays of a pixel"
        for name, error, max_rays in zip(
            ("diffuse surfaces", "glossy surfaces and metals"),
            errors,
            (INFRARED.max_rays, INFRARED.max_mirror_rays),
            strict=True,
        )
        if error > limit
    )
    return tracer, _root_mean_square(differences_k[surface]), notes


def _root_mean_square(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else 0.0


def _effects(
    tracer: InfraredTracer, netd_k: float, tolerance: float | None
) -> tuple[tuple[OptionalEffect, ...], tuple[OptionalEffect, ...]]:
    """Return the terms kept and left out by what they change at some pixels, mK."""
    per_radiance = 1e3 * tracer.air.kelvin_per_radiance(tracer.air.temperature_k)
    full = _pilot(tracer, 1)

    def change(radiance: Array) -> float:
        return float(np.abs(full.radiance.sum(axis=1) - radiance.sum(axis=1)).max() * per_radiance)

    optional = [
        OptionalEffect(
            name=name,
            influence=change(_pilot(replace(tracer, without=frozenset({name})), 1).radiance),
        )
        for name in (AIR, MORE, SUN, BETWEEN)
    ]
    plan = select_effects(optional, 1e3 * (tolerance or 0.0) * netd_k)
    surface_pixels = full.surface_pixels
    black, bare = (
        tracer.air.black_body(full.kelvin[surface_pixels]),
        _pilot(replace(tracer, without=frozenset({AIR})), 1),
    )
    transmittance = tracer.air.transmittance(full.range_m[surface_pixels])
    ground = tracer.air.black_body(tracer.air.temperature_k)
    mean = (transmittance * ground).sum(axis=1, keepdims=True) / ground.sum()
    one_bin = np.array(full.radiance)
    one_bin[surface_pixels] = mean * bare.radiance[surface_pixels] + (1.0 - mean) * ground
    # Panes are few pixels, which random ones may miss.
    no_glass = (
        _pilot(replace(tracer, without=frozenset({GLASS})), 1)
        if tracer.surfaces.clear.any()
        else full
    )
    neglected_always = [
        OptionalEffect(name=GLASS, influence=change(no_glass.radiance)),
        OptionalEffect(name=BINS, influence=change(one_bin)),
        OptionalEffect(
            name="reflected sky and surfaces",
            influence=float(
                np.abs((bare.radiance[surface_pixels] - black).sum(axis=1)).max(initial=0.0)
                * per_radiance
            ),
        ),
    ]
    metals = bool((full.albedo > 0.5).any())
    finer = OptionalEffect(
        name=FINER, influence=INFRARED.finer_bins_metal_mk if metals else INFRARED.finer_bins_mk
    )
    lit_interiors = tracer.surfaces.change_by_lit_interiors(tracer.sky, ground) * per_radiance
    return (*plan.kept, *neglected_always), (
        *plan.left_out,
        finer,
        OptionalEffect(name=INSIDE, influence=lit_interiors),
    )


def _truth(tracer: InfraredTracer, parts: list[TracedPixels]) -> AuxiliaryLayers:
    """Return the auxiliary layers of rows of pixels."""
    starts = np.cumsum([0, *(len(part.radiance) for part in parts)])
    has_sun = tracer.sky.sun is not None
    return layers_of(
        tracer.temperatures.balance.facets.surfaces,
        tracer.viewpoint.shape,
        np.concatenate(
            [start + part.surface_pixels for start, part in zip(starts, parts, strict=False)]
        ),
        np.concatenate([part.points.face for part in parts]),
        normal=np.concatenate([part.points.normal for part in parts]),
        shadow=np.concatenate([part.shadow & has_sun for part in parts]),
        range_m=np.concatenate([part.range_m for part in parts]),
        temperature_k=np.concatenate([part.kelvin for part in parts]),
        sources=("sun",) if has_sun else (),
    )
