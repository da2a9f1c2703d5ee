"""Infrared radiance of points of an image: emission, traced reflection, air and sky."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import numpy as np

from simulate.arrays import Array, Index, Mask
from simulate.radiance.brdf.protocol import Brdf
from simulate.radiance.geometry.embree import ROW
from simulate.radiance.geometry.viewpoint import Viewpoint
from simulate.radiance.integrator.sampling import (
    LowDiscrepancyNumbers,
    SequenceSlice,
    low_discrepancy_points,
    shading_frames,
)
from simulate.radiance.integrator.spectral_scene import ShadingPoints, local_direction
from simulate.thermal.air import InfraredAir
from simulate.thermal.exposure import Spots, Views, precise_view
from simulate.thermal.infrared_sky import Surroundings
from simulate.thermal.infrared_surfaces import InfraredSurfaces
from simulate.thermal.temperatures import Temperatures
from simulate.thermal.thresholds import INFRARED

# Terms that may be left out.
AIR, MORE, SUN = "air on the path", "reflected light of surfaces that reflect", "sunlight reflected"
BETWEEN, GLASS = "air between surfaces", "what lies behind clear glass"

# Steps of an octave, and octaves from 1 m on, by which the air between surfaces is tabulated.
STEPS, OCTAVES = 8, 14


@dataclass(frozen=True, kw_only=True)
class TracedPixels:
    """Pixels: radiance (pixel, bin), temperature (pixel,), K, NaN for the sky, and those that meet
    a surface.
    """

    radiance: Array
    kelvin: Array
    glossy: Mask
    range_m: Array
    points: ShadingPoints
    surface_pixels: Index
    shadow: Mask
    albedo: Array  # towards the viewer, mean over the bins, of those that meet a surface


@dataclass(frozen=True, kw_only=True)
class InfraredTracer:
    """Surfaces, air, sky and rays by which a viewpoint sees; `without` names the terms left out."""

    temperatures: Temperatures
    surfaces: InfraredSurfaces
    air: InfraredAir
    sky: Surroundings
    viewpoint: Viewpoint
    seed: int
    rays: int
    mirror_rays: int
    without: frozenset[str] = frozenset()

    def rows(self, start: int) -> TracedPixels:
        """Return the pixels of some rows."""
        stop = min(start + INFRARED.rows, self.viewpoint.shape[0])
        row, col = np.mgrid[start:stop, : self.viewpoint.shape[1]].reshape(2, -1)
        sequence = low_discrepancy_points(row, col, self.rays, [self.seed, start])
        return self.see(row + 0.5, col + 0.5, sequence, np.random.default_rng([self.seed, start]))

    def mean_radiance(self, pixels: Index) -> tuple[Array, Array]:
        """Return the radiance of pixels (pixel,) as means over parts of each, (pixel, bin), and
        their error, (pixel,).

        Where an edge crosses side^2 parts in a grid, the area to one side of it errs by about
        side^-1.5.
        """
        side, rng = INFRARED.edge_parts, np.random.default_rng([self.seed, 3, int(pixels[0])])
        offset = (np.indices((side, side)).reshape(2, -1, 1) + 0.5) / side
        row, col = (
            pixel_coordinate + axis_offset
            for pixel_coordinate, axis_offset in zip(
                np.divmod(pixels, self.viewpoint.shape[1]), offset, strict=True
            )
        )
        sequence = SequenceSlice.random(row.size, max(self.rays // side, 1), rng)
        tracer = replace(self, mirror_rays=max(self.mirror_rays // side**2, 1))
        parts = tracer.see(row.ravel(), col.ravel(), sequence, rng).radiance.reshape(
            side**2, len(pixels), -1
        )
        return parts.mean(axis=0), parts.sum(axis=2).std(axis=0) / side**1.5

    def see(
        self, row: Array, col: Array, sequence: SequenceSlice, rng: np.random.Generator
    ) -> TracedPixels:
        """Return points of the image, at coordinates (point,), by the rays of a sequence for
        each.
        """
        facets = self.temperatures.balance.facets
        tracer = facets.surfaces.tracer
        origin, direction = self.viewpoint.rays(row, col)
        hit = tracer.hits(origin, direction)
        rays, radiance = hit.rays, self.sky.radiance(direction)
        position_m = origin[rays] + hit.range_m[rays, None] * direction[rays]
        points = self.surfaces.bsdfs.points(
            facets.surfaces, hit.face[rays], position_m, direction[rays]
        )
        spots = Spots.on(facets.surfaces, points.face, position_m)
        views = precise_view(facets.surfaces, spots, sequence.select(rays))
        kelvin, incoming = (
            self.temperatures.spots_k(facets.of_faces(points.face), spots, views),
            self._diffuse(views),
        )
        start_m = tracer.ray_starts(points.face, position_m, points.normal)
        inner_points = np.flatnonzero(~points.on_outer_side)
        if len(inner_points):
            spots = Spots(start_m=start_m[inner_points], normal=points.normal[inner_points])
            incoming[inner_points] = self._diffuse(
                precise_view(facets.surfaces, spots, sequence.select(rays[inner_points]))
            )
        albedo = np.pi * self.surfaces.bsdfs.diffuse_brdf(points)
        for rows, brdf in points.glossy:
            outgoing = local_direction(shading_frames(points.normal[rows]), points.outgoing[rows])
            albedo[rows] = brdf.albedo(outgoing, self.air.centre_nm).T
            incoming[rows] = self._glossy_radiance(
                points.normal[rows], outgoing, start_m[rows], brdf, rng
            )
        radiosity = (1.0 - albedo) * self.air.black_body(kelvin) + albedo * incoming
        panes, transmittance = self._clear(
            points.material, np.einsum("ij,ij->i", points.normal, points.outgoing)
        )
        if len(panes):
            # No more than the pane does not reflect.
            transmittance = np.minimum(transmittance, 1.0 - albedo[panes])
            below_pane = tracer.ray_starts(
                points.face[panes], position_m[panes], -points.normal[panes]
            )
            behind_it = self._radiance_along(below_pane, direction[rays[panes]], INFRARED.panes - 1)
            radiosity[panes] += transmittance * (behind_it - self.air.black_body(kelvin[panes]))
        lit = self._lit(points, start_m)
        if len(lit) and SUN not in self.without:
            assert self.sky.sun is not None
            lit_points = points.select(lit)
            cosine = lit_points.normal @ self.sky.sun
            value = self.surfaces.bsdfs.value(
                lit_points, np.broadcast_to(self.sky.sun, lit_points.normal.shape)
            )
            radiosity[lit] += value * cosine[:, None] * self.sky.sunlight
        radiance[rays] = (
            radiosity if AIR in self.without else self.air.after_path(radiosity, hit.range_m[rays])
        )
        image_points = TracedPixels(
            radiance=radiance,
            kelvin=np.full(len(row), np.nan),
            glossy=np.zeros(len(row), np.bool_),
            range_m=hit.range_m,
            points=points,
            surface_pixels=rays,
            shadow=np.ones(len(rays), np.bool_),
            albedo=albedo.mean(axis=1),
        )
        image_points.kelvin[rays], image_points.glossy[rays], image_points.shadow[lit] = (
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
        spot, face, weight, range_m = views.surfaces()
        facet, ground = (
            self.temperatures.balance.facets.of_faces(face),
            self.air.black_body(self.air.temperature_k),
        )
        radiance = views.rings @ self.surfaces.rings + views.off_scene[:, None] * ground
        step = self._step_of(range_m)
        for number, light in enumerate(self.of_facets.T):
            ray = light[facet]
            if BETWEEN not in self.without:
                ray = ground[number] + self._transmittance_steps[step, number] * (
                    ray - ground[number]
                )
            radiance[:, number] += np.bincount(spot, weight * ray, len(radiance))
        return radiance

    @cached_property
    def _transmittance_steps(self) -> Array:
        """Transmittance of paths in steps of their logarithm, shape (step, bin)."""
        return self.air.transmittance(2.0 ** (np.arange(OCTAVES * STEPS + 1) / STEPS))

    @staticmethod
    def _step_of(range_m: Array) -> Index:
        """Row of `_transmittance_steps` of paths; shorter ones than a metre count as that long."""
        return np.rint(STEPS * np.log2(np.clip(range_m, 1.0, 2.0**OCTAVES))).astype(np.int64)

    def _glossy_radiance(
        self, normal: Array, outgoing: Array, start_m: Array, brdf: Brdf, rng: np.random.Generator
    ) -> Array:
        """Mean radiance that points see, weighted by the BRDF, by rays drawn from it, shape (point,
        bin).

        The mean over the weights rather than their expectation: uniform surroundings give no noise.
        """
        radiance = np.empty((len(normal), len(self.air.low_um)))
        batch_points = max(1, INFRARED.batch_rays // self.mirror_rays)
        for start in range(0, len(normal), batch_points):
            rows = slice(start, start + batch_points)
            count = len(normal[rows])
            to_viewer = np.repeat(outgoing[rows], self.mirror_rays, axis=0)
            numbers = cast(np.random.Generator, LowDiscrepancyNumbers(count, self.mirror_rays, rng))
            local, density = brdf.sample(to_viewer, numbers)
            weight = (
                brdf.value(local, to_viewer, self.air.centre_nm)
                * np.maximum(local[:, 2], 0.0)
                / density
            )
            frames = np.repeat(shading_frames(normal[rows]), self.mirror_rays, axis=0)
            light = self._radiance_along(
                np.repeat(start_m[rows], self.mirror_rays, axis=0),
                np.einsum("ij,ijk->ik", local, frames),
            )
            weight = weight.T.reshape(count, self.mirror_rays, -1)
            # A lobe of which all is below the surface is seen as it is drawn.
            weight += np.where(weight.sum(axis=1, keepdims=True) > 0.0, 0.0, 1.0)
            radiance[rows] = np.average(light.reshape(weight.shape), axis=1, weights=weight)
        return radiance

    def _clear(self, material: Index, cosine: Array) -> tuple[Index, Array]:
        """Rays that see through panes, and the transmittance of each."""
        if GLASS in self.without:
            return np.zeros(0, np.int64), np.zeros((0, len(self.air.low_um)))
        return self.surfaces.pane_transmittance(material, cosine)

    def _radiance_along(
        self, start_m: Array, direction: Array, panes: int = INFRARED.panes
    ) -> Array:
        """Radiance of sky and facets along rays, through some panes, shape (ray, bin)."""
        facets = self.temperatures.balance.facets
        tracer = facets.surfaces.tracer
        hit = tracer.hits(start_m, direction)
        radiance = self.sky.radiance(direction)
        face = hit.face[hit.rays]
        light = self.of_facets[facets.of_faces(face)]
        if panes and self.surfaces.clear.any():
            normal, cosine = tracer.sided_normals(face, direction[hit.rays])
            panes_hit, transmittance = self._clear(facets.surfaces.material_of[face & ROW], cosine)
            if len(panes_hit):
                rays = hit.rays[panes_hit]
                pane_position_m = start_m[rays] + hit.range_m[rays, None] * direction[rays]
                radiance_behind = self._radiance_along(
                    tracer.ray_starts(face[panes_hit], pane_position_m, -normal[panes_hit]),
                    direction[rays],
                    panes - 1,
                )
                light[panes_hit] += transmittance * (radiance_behind - light[panes_hit])
        if BETWEEN not in self.without:
            ground = self.air.black_body(self.air.temperature_k)
            light = ground + self._transmittance_steps[self._step_of(hit.range_m[hit.rays])] * (
                light - ground
            )
        radiance[hit.rays] = light
        return radiance

    def _lit(self, points: ShadingPoints, start_m: Array) -> Index:
        """Points on which the sun shines."""
        if self.sky.sun is None:
            return np.zeros(0, np.int64)
        faces = np.flatnonzero(points.normal @ self.sky.sun > 0.0)
        sun = np.broadcast_to(self.sky.sun, (len(faces), 3))
        return faces[
            ~self.temperatures.balance.facets.surfaces.tracer.is_occluded(start_m[faces], sun)
        ]
