"""Infrared image of a scene: radiance in spectral bins by emission, traced reflection, air and
sky.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import NDArray

from simulate.effect_selection import OptionalEffect, select_effects
from simulate.radiance.brdf.protocol import Brdf
from simulate.radiance.geometry.embree import ROW
from simulate.radiance.geometry.viewpoint import Viewpoint
from simulate.radiance.integrator.auxiliary_layers import AuxiliaryLayers
from simulate.radiance.integrator.integrator_settings import workers
from simulate.radiance.integrator.sampling import (
    EvenNumbers,
    SequenceSlice,
    low_discrepancy_points,
    shading_frames,
)
from simulate.radiance.integrator.spectral_scene import ShadingPoints, within
from simulate.radiance.outdoor.scene import OutdoorScene
from simulate.thermal.air import InfraredAir, modtran_air
from simulate.thermal.exposure import Spots, Views, precise_view
from simulate.thermal.infrared_picture import InfraredPicture, notes_beyond_laws
from simulate.thermal.infrared_sky import Surroundings, notes_on_sky, sky_of
from simulate.thermal.infrared_surfaces import InfraredSurfaces, infrared_surfaces
from simulate.thermal.temperatures import Temperatures
from simulate.thermal.thresholds import INFRARED

Array = NDArray[np.floating]
Index = NDArray[np.int64]
AIR, MORE, SUN = "air on the path", "reflected light of surfaces that reflect", "sunlight reflected"
BINS, FINER, BETWEEN = (
    "transmittance by bins, not one of the band",
    "bins finer than these",
    "air between surfaces",
)
GLASS, INSIDE = "what lies behind clear glass", "sky and sun on it through the glass"


# Steps of an octave, and octaves from 1 m on, by which the air between surfaces is tabulated.
STEPS, OCTAVES = 8, 14


@dataclass(frozen=True, kw_only=True)
class _Seen:
    """Pixels: radiance (pixel, bin), temperature (pixel,), K, NaN for the sky, and those that meet
    a surface.
    """

    radiance: Array
    kelvin: Array
    glossy: NDArray[np.bool_]
    range_m: Array
    points: ShadingPoints
    met: Index
    shadow: NDArray[np.bool_]
    albedo: Array  # towards the viewer, mean over the bins, of those that meet a surface


@dataclass(frozen=True, kw_only=True)
class _Look:
    """What a picture is made of; `without` names the terms left out."""

    temperatures: Temperatures
    surfaces: InfraredSurfaces
    air: InfraredAir
    sky: Surroundings
    viewpoint: Viewpoint
    seed: int
    rays: int
    mirror_rays: int
    without: frozenset[str] = frozenset()

    def rows(self, start: int) -> _Seen:
        """Return the pixels of some rows."""
        stop = min(start + INFRARED.rows, self.viewpoint.shape[0])
        grid = np.meshgrid(
            np.arange(start, stop), np.arange(self.viewpoint.shape[1]), indexing="ij"
        )
        row, col = (axis.ravel() for axis in grid)
        sequence = low_discrepancy_points(row, col, self.rays, [self.seed, start])
        return self.see(row + 0.5, col + 0.5, sequence, np.random.default_rng([self.seed, start]))

    def mean_radiance(self, pixels: Index) -> tuple[Array, Array]:
        """Return the radiance of pixels (pixel,) as means over parts of each, (pixel, bin), and
        their error, (pixel,).

        Where an edge crosses side^2 parts in a grid, the area to one side of it errs by about
        side^-1.5.
        """
        side, rng = INFRARED.edge_parts, np.random.default_rng([self.seed, 3, int(pixels[0])])
        part = (np.indices((side, side)).reshape(2, -1, 1) + 0.5) / side
        row, col = (
            pixel_coordinate + at
            for pixel_coordinate, at in zip(
                np.divmod(pixels, self.viewpoint.shape[1]), part, strict=True
            )
        )
        sequence = SequenceSlice.random(row.size, max(self.rays // side, 1), rng)
        few = replace(self, mirror_rays=max(self.mirror_rays // side**2, 1))
        parts = few.see(row.ravel(), col.ravel(), sequence, rng).radiance.reshape(
            side**2, len(pixels), -1
        )
        return parts.mean(axis=0), parts.sum(axis=2).std(axis=0) / side**1.5

    def see(
        self, row: Array, col: Array, sequence: SequenceSlice, rng: np.random.Generator
    ) -> _Seen:
        """Return points of the image, at coordinates (point,), by the rays of a sequence for
        each.
        """
        facets = self.temperatures.balance.facets
        tracer = facets.surfaces.tracer
        origin, towards = self.viewpoint.rays(row, col)
        hit = tracer.hits(origin, towards)
        met, radiance = hit.met, self.sky.radiance(towards)
        position_m = origin[met] + hit.range_m[met, None] * towards[met]
        points = self.surfaces.bsdfs.points(
            facets.surfaces, hit.face[met], position_m, towards[met]
        )
        spots = Spots.on(facets.surfaces, points.face, position_m)
        views = precise_view(facets.surfaces, spots, sequence.some(met))
        kelvin, incoming = (
            self.temperatures.spots_k(facets.of_faces(points.face), spots, views),
            self._diffuse(views),
        )
        start_m = tracer.above(points.face, position_m, points.normal)
        behind = np.flatnonzero(~points.on_outer_side)
        if len(behind):
            spots = Spots(start_m=start_m[behind], normal=points.normal[behind])
            incoming[behind] = self._diffuse(
                precise_view(facets.surfaces, spots, sequence.some(met[behind]))
            )
        albedo = np.pi * self.surfaces.bsdfs.diffuse_brdf(points)
        for which, brdf in points.glossy:
            outgoing = within(shading_frames(points.normal[which]), points.outgoing[which])
            albedo[which] = brdf.albedo(outgoing, self.air.centre_nm).T
            incoming[which] = self._mirrored(
                points.normal[which], outgoing, start_m[which], brdf, rng
            )
        leaving = (1.0 - albedo) * self.air.black_body(kelvin) + albedo * incoming
        clear, through = self._clear(
            points.material, np.einsum("ij,ij->i", points.normal, points.outgoing)
        )
        if len(clear):
            # No more than the pane does not reflect.
            through = np.minimum(through, 1.0 - albedo[clear])
            below_pane = tracer.above(points.face[clear], position_m[clear], -points.normal[clear])
            behind_it = self._along(below_pane, towards[met[clear]], INFRARED.panes - 1)
            leaving[clear] += through * (behind_it - self.air.black_body(kelvin[clear]))
        lit = self._lit(points, start_m)
        if len(lit) and SUN not in self.without:
            assert self.sky.sun is not None
            some = points.some(lit)
            cosine = some.normal @ self.sky.sun
            value = self.surfaces.bsdfs.value(
                some, np.broadcast_to(self.sky.sun, some.normal.shape)
            )
            leaving[lit] += value * cosine[:, None] * self.sky.sunlight
        radiance[met] = (
            leaving if AIR in self.without else self.air.after_path(leaving, hit.range_m[met])
        )
        image_points = _Seen(
            radiance=radiance,
            kelvin=np.full(len(row), np.nan),
            glossy=np.zeros(len(row), np.bool_),
            range_m=hit.range_m,
            points=points,
            met=met,
            shadow=np.ones(len(met), np.bool_),
            albedo=albedo.mean(axis=1),
        )
        image_points.kelvin[met], image_points.glossy[met], image_points.shadow[lit] = (
            kelvin,
            ~points.is_diffuse,
            False,
        )
        return image_points

    @property
    def of_facets(self) -> Array:
        """Radiance of facets as they are seen by reflection, shape (facet, bin)."""
        return self.surfaces.black if MORE in self.without else self.surfaces.facets

    def _diffuse(self, views: Views) -> Array:
        """Mean radiance that spots see by the cosine law, shape (spot, bin)."""
        spot, face, part, range_m = views.surfaces()
        of, ground = (
            self.temperatures.balance.facets.of_faces(face),
            self.air.black_body(self.air.temperature_k),
        )
        radiance = views.rings @ self.surfaces.rings + views.off_scene[:, None] * ground
        step = self._step_of(range_m)
        for number, light in enumerate(self.of_facets.T):
            ray = light[of]
            if BETWEEN not in self.without:
                ray = ground[number] + self._through[step, number] * (ray - ground[number])
            radiance[:, number] += np.bincount(spot, part * ray, len(radiance))
        return radiance

    @cached_property
    def _through(self) -> Array:
        """Transmittance of paths in steps of their logarithm, shape (step, bin)."""
        return self.air.transmittance(2.0 ** (np.arange(OCTAVES * STEPS + 1) / STEPS))

    @staticmethod
    def _step_of(range_m: Array) -> Index:
        """Row of `_through` of paths; shorter ones than a metre count as that long."""
        return np.rint(STEPS * np.log2(np.clip(range_m, 1.0, 2.0**OCTAVES))).astype(np.int64)

    def _mirrored(
        self, normal: Array, outgoing: Array, start_m: Array, brdf: Brdf, rng: np.random.Generator
    ) -> Array:
        """Mean radiance that points see, weighted by the BRDF, by rays drawn from it, shape (point,
        bin).

        The mean over the weights rather than their expectation: uniform surroundings give no noise.
        """
        radiance = np.empty((len(normal), len(self.air.low_um)))
        batch_points = max(1, INFRARED.batch_rays // self.mirror_rays)
        for first in range(0, len(normal), batch_points):
            part = slice(first, first + batch_points)
            count = len(normal[part])
            out = np.repeat(outgoing[part], self.mirror_rays, axis=0)
            numbers = cast(np.random.Generator, EvenNumbers(count, self.mirror_rays, rng))
            local, density = brdf.sample(out, numbers)
            weight = (
                brdf.value(local, out, self.air.centre_nm) * np.maximum(local[:, 2], 0.0) / density
            )
            frames = np.repeat(shading_frames(normal[part]), self.mirror_rays, axis=0)
            light = self._along(
                np.repeat(start_m[part], self.mirror_rays, axis=0),
                np.einsum("ij,ijk->ik", local, frames),
            )
            weight = weight.T.reshape(count, self.mirror_rays, -1)
            # A lobe of which all is below the surface is seen as it is drawn.
            weight += np.where(weight.sum(axis=1, keepdims=True) > 0.0, 0.0, 1.0)
            radiance[part] = np.average(light.reshape(weight.shape), axis=1, weights=weight)
        return radiance

    def _clear(self, material: Index, cosine: Array) -> tuple[Index, Array]:
        """Rays that see through panes, and the transmittance of each."""
        if GLASS in self.without:
            return np.zeros(0, np.int64), np.zeros((0, len(self.air.low_um)))
        return self.surfaces.through(material, cosine)

    def _along(self, start_m: Array, direction: Array, panes: int = INFRARED.panes) -> Array:
        """Radiance of sky and facets along rays, through some panes, shape (ray, bin)."""
        facets = self.temperatures.balance.facets
        tracer = facets.surfaces.tracer
        hit = tracer.hits(start_m, direction)
        radiance = self.sky.radiance(direction)
        face = hit.face[hit.met]
        light = self.of_facets[facets.of_faces(face)]
        if panes and self.surfaces.clear.any():
            facing, cosine = tracer.facing(face, direction[hit.met])
            clear, through = self._clear(facets.surfaces.material_of[face & ROW], cosine)
            if len(clear):
                rays = hit.met[clear]
                pane_position_m = start_m[rays] + hit.range_m[rays, None] * direction[rays]
                behind = self._along(
                    tracer.above(face[clear], pane_position_m, -facing[clear]),
                    direction[rays],
                    panes - 1,
                )
                light[clear] += through * (behind - light[clear])
        if BETWEEN not in self.without:
            ground = self.air.black_body(self.air.temperature_k)
            light = ground + self._through[self._step_of(hit.range_m[hit.met])] * (light - ground)
        radiance[hit.met] = light
        return radiance

    def _lit(self, points: ShadingPoints, start_m: Array) -> Index:
        """Points on which the sun shines."""
        if self.sky.sun is None:
            return np.zeros(0, np.int64)
        faces = np.flatnonzero(points.normal @ self.sky.sun > 0.0)
        way = np.broadcast_to(self.sky.sun, (len(faces), 3))
        return faces[
            ~self.temperatures.balance.facets.surfaces.tracer.is_occluded(start_m[faces], way)
        ]


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
        look_at(temperatures, scene, viewpoint, band_um=band_um, seed=seed),
        netd_k,
        tolerance,
        progress,
    )


def look_at(
    temperatures: Temperatures,
    scene: OutdoorScene,
    viewpoint: Viewpoint,
    *,
    band_um: tuple[float, float],
    seed: int,
) -> _Look:
    """Return what a picture is made of, with few rays and all terms."""
    state = scene.weather
    assert state is not None
    weather = temperatures.balance.weather
    sky = sky_of(band_um, weather, state)
    if state.atmosphere == "modtran5":
        sky = replace(sky, air=modtran_air(sky.air, scene, weather, viewpoint.position_m[2]))
    return _Look(
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
    look: _Look, netd_k: float, tolerance: float | None, progress: Callable[[float], None]
) -> InfraredPicture:
    look, error_k, short = _enough_rays(look, netd_k)
    kept_effects, left_out = _effects(look, netd_k, tolerance)
    look = replace(look, without=frozenset(effect.name for effect in left_out))
    starts, parts = list(range(0, look.viewpoint.shape[0], INFRARED.rows)), []
    with workers(min(2, os.cpu_count() or 1)) as run:
        for part in run(look.rows, starts):
            parts.append(part)
            progress(len(parts) / len(starts))
        radiance, truth = (
            np.concatenate([part.radiance.astype(np.float32) for part in parts]),
            _truth(look, parts),
        )
        edges = np.flatnonzero(truth.edges(shadows=look.sky.sun is not None))
        batches = (
            np.array_split(edges, max(1, len(edges) // INFRARED.edge_batch)) if len(edges) else []
        )
        off = np.zeros(len(radiance))
        for pixels, (mean, error) in zip(batches, run(look.mean_radiance, batches), strict=True):
            radiance[pixels], off[pixels] = mean, error
    off_k = _root_mean_square(off[edges]) * look.air.kelvin_per_radiance(look.air.temperature_k)
    return InfraredPicture(
        edges_um=look.air.edges_um,
        radiance=radiance.reshape(*look.viewpoint.shape, -1),
        truth=truth,
        error_k=error_k,
        rays=(look.rays, look.mirror_rays),
        effects=kept_effects,
        left_out=left_out,
        notes=(
            f"infrared radiance by {look.rays} rays of a pixel, {look.mirror_rays} of glossy ones "
            f"and metals: by chance surfaces are uncertain by {1e3 * error_k:.2g} mK, root mean "
            "square",
            *short,
            f"{100.0 * len(edges) / len(radiance):.2g} % of the pixels show where objects or "
            f"faces meet, each as the mean of {INFRARED.edge_parts**2} parts: uncertain by "
            f"{1e3 * off_k:.2g} mK, root mean square",
            *notes_beyond_laws(
                look.air, look.temperatures.balance.weather.sun[-1], look.viewpoint, truth
            ),
            *look.air.notes,
            *notes_on_sky(look.air),
            *look.temperatures.balance.weather.notes,
        ),
    )


def _pilot(look: _Look, turn: int) -> _Seen:
    """See random pixels, the same ones in each turn, by different rays."""
    rng = np.random.default_rng([look.seed, INFRARED.pilot_pixels])
    row, col = (rng.integers(0, side, INFRARED.pilot_pixels) + 0.5 for side in look.viewpoint.shape)
    other = np.random.default_rng([look.seed, INFRARED.pilot_pixels, turn])
    return look.see(row, col, SequenceSlice.random(len(row), look.rays, other), other)


def _enough_rays(look: _Look, netd_k: float) -> tuple[_Look, float, tuple[str, ...]]:
    """Double the rays until two independent views of some pixels agree; return also the error, K,
    and a note on it.
    """
    limit, per_radiance = (
        INFRARED.error_share * netd_k,
        look.air.kelvin_per_radiance(look.air.temperature_k),
    )
    while True:
        first, second = _pilot(look, 1), _pilot(look, 2)
        differences_k = (first.radiance - second.radiance).sum(axis=1) * per_radiance / np.sqrt(2.0)
        surface = np.isfinite(first.kelvin)
        errors = [
            _root_mean_square(differences_k[of]) for of in (surface & ~first.glossy, first.glossy)
        ]
        more = replace(
            look,
            rays=min(2 * look.rays, INFRARED.max_rays) if errors[0] > limit else look.rays,
            mirror_rays=min(2 * look.mirror_rays, INFRARED.max_mirror_rays)
            if errors[1] > limit
            else look.mirror_rays,
        )
        if (more.rays, more.mirror_rays) == (look.rays, look.mirror_rays):
            break
        look = more
    short = tuple(
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
    return look, _root_mean_square(differences_k[surface]), short


def _root_mean_square(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else 0.0


def _effects(
    look: _Look, netd_k: float, tolerance: float | None
) -> tuple[tuple[OptionalEffect, ...], tuple[OptionalEffect, ...]]:
    """Return the terms kept and left out by what they change at some pixels, mK."""
    per_radiance = 1e3 * look.air.kelvin_per_radiance(look.air.temperature_k)
    full = _pilot(look, 1)

    def change(radiance: Array) -> float:
        return float(np.abs(full.radiance.sum(axis=1) - radiance.sum(axis=1)).max() * per_radiance)

    optional = [
        OptionalEffect(
            name=name,
            influence=change(_pilot(replace(look, without=frozenset({name})), 1).radiance),
        )
        for name in (AIR, MORE, SUN, BETWEEN)
    ]
    plan = select_effects(optional, 1e3 * (tolerance or 0.0) * netd_k)
    met = full.met
    black, bare = (
        look.air.black_body(full.kelvin[met]),
        _pilot(replace(look, without=frozenset({AIR})), 1),
    )
    through = look.air.transmittance(full.range_m[met])
    ground = look.air.black_body(look.air.temperature_k)
    mean = (through * ground).sum(axis=1, keepdims=True) / ground.sum()
    one_bin = np.array(full.radiance)
    one_bin[met] = mean * bare.radiance[met] + (1.0 - mean) * ground
    # Panes are few pixels, which random ones may miss.
    no_glass = (
        _pilot(replace(look, without=frozenset({GLASS})), 1) if look.surfaces.clear.any() else full
    )
    always = [
        OptionalEffect(name=GLASS, influence=change(no_glass.radiance)),
        OptionalEffect(name=BINS, influence=change(one_bin)),
        OptionalEffect(
            name="reflected sky and surfaces",
            influence=float(
                np.abs((bare.radiance[met] - black).sum(axis=1)).max(initial=0.0) * per_radiance
            ),
        ),
    ]
    metals = bool((full.albedo > 0.5).any())
    finer = OptionalEffect(
        name=FINER, influence=INFRARED.finer_bins_metal_mk if metals else INFRARED.finer_bins_mk
    )
    lit_interiors = look.surfaces.change_by_lit_interiors(look.sky, ground) * per_radiance
    return (*plan.kept, *always), (
        *plan.left_out,
        finer,
        OptionalEffect(name=INSIDE, influence=lit_interiors),
    )


def _truth(look: _Look, parts: list[_Seen]) -> AuxiliaryLayers:
    """Return the auxiliary layers of rows of pixels."""
    surfaces, shape = look.temperatures.balance.facets.surfaces, look.viewpoint.shape
    count = shape[0] * shape[1]
    material, thing = np.full(count, -1, np.int16), np.full(count, -1, np.int32)
    normal, shadow = np.zeros((count, 3), np.float32), np.zeros(count, np.uint32)
    first = 0
    for part in parts:
        met, row = first + part.met, part.points.face & ROW
        material[met], thing[met] = surfaces.material_of[row], surfaces.object_of[row]
        normal[met], shadow[met] = (
            part.points.normal,
            part.shadow if look.sky.sun is not None else 0,
        )
        first += len(part.radiance)
    return AuxiliaryLayers(
        material=material.reshape(shape),
        object=thing.reshape(shape),
        range_m=np.concatenate([part.range_m for part in parts]).astype(np.float32).reshape(shape),
        normal=normal.reshape(*shape, 3),
        shadow=shadow.reshape(shape),
        temperature_k=np.concatenate([part.kelvin for part in parts])
        .astype(np.float32)
        .reshape(shape),
        materials=surfaces.materials,
        objects=surfaces.objects,
        sources=() if look.sky.sun is None else ("sun",),
    )
