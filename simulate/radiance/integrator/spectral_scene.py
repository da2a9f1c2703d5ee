"""A scene on the bands of a rendering: surfaces, BSDFs, panes of glass, light sources and air; its
shading points.

Panes have a ray tracer of their own, so that scenes without panes lose no time. A pane has no
thickness: transmitted rays are not displaced. Two panes closer to each other than the clearance of
rays (`CLEARANCE_M`) count as one.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from simulate.arrays import Array, Array32, Index, Mask
from simulate.radiance.brdf.protocol import Brdf, Lambert
from simulate.radiance.geometry.embree import ROW
from simulate.radiance.geometry.ray_tracer import NOTHING, Hits, RayTracer
from simulate.radiance.geometry.surfaces import Surfaces
from simulate.radiance.integrator import environment_map
from simulate.radiance.integrator.environment_map import SkyImportance
from simulate.radiance.integrator.integrator_settings import LIMITS
from simulate.radiance.integrator.light_sources import Lighting
from simulate.radiance.integrator.light_tracing import LightTracingSettings
from simulate.radiance.integrator.sampling import cosine_lobe, shading_frames
from simulate.radiance.materials import pane_fractions

if TYPE_CHECKING:
    from simulate.radiance.atmosphere import Atmosphere


class PaneHits(NamedTuple):
    """Rays that meet a pane, shape (meeting ray, ...)."""

    rays: Index  # numbers of the rays
    range_m: Array
    position_m: Array
    normal: Array  # on the side of the ray's origin
    face: Index
    reflectance: Array32  # shape (meeting ray, band)
    transmittance: Array32


@dataclass(frozen=True, kw_only=True)
class Panes:
    """All panes of a scene, on bands."""

    tracer: RayTracer
    kind_of_face: Index  # kind of glass of each triangle
    transmittance: Array  # of each kind at normal incidence, shape (kind, band)
    refractive_index: tuple[float, ...]  # of each kind

    def hits(self, origin_m: Array, direction: Array, max_range_m: Array) -> PaneHits:
        """Return the rays of unit direction (ray, 3) that meet a pane within a distance (ray,),
        m.
        """
        hit = self.tracer.hits(origin_m, direction)
        rays = np.flatnonzero((hit.face != NOTHING) & (hit.range_m < max_range_m))
        face, range_m, hit_direction = hit.face[rays], hit.range_m[rays], direction[rays]
        normal, cosine = self.tracer.sided_normals(face, hit_direction)
        reflectance = np.zeros((len(face), self.transmittance.shape[1]), np.float32)
        transmittance = np.zeros_like(reflectance)
        for kind, index in enumerate(self.refractive_index):
            rows = np.flatnonzero(self.kind_of_face[face] == kind)
            reflectance[rows], transmittance[rows] = pane_fractions(
                cosine[rows], self.transmittance[kind], index
            )
        position = origin_m[rays] + range_m[:, None] * hit_direction
        return PaneHits(rays, range_m, position, normal, face, reflectance, transmittance)

    def start(self, hits: PaneHits, is_reflected: Mask | bool = False) -> Array:
        """Return starts of transmitted or reflected rays, shape (meeting ray, 3), m."""
        side = np.where(
            np.broadcast_to(is_reflected, hits.rays.shape)[:, None], hits.normal, -hits.normal
        )
        return self.tracer.ray_starts(hits.face, hits.position_m, side)

    def transmittance_along(
        self, start_m: Array, vector: Array, length_limit: float | None
    ) -> tuple[Index, Array32]:
        """Return indices of rays that meet panes, and their transmittances (ray, band).

        Rays have a length of `length_limit` times that of their vectors (ray, 3), or none.
        """
        length = np.linalg.norm(vector, axis=1)
        direction = vector / np.maximum(length, 1e-300)[:, None]
        remaining_m = (
            np.full(len(vector), np.inf) if length_limit is None else length_limit * length
        )
        transmittance = np.ones((len(vector), self.transmittance.shape[1]), np.float32)
        rays, start = np.arange(len(vector)), np.asarray(start_m, float)
        meets_pane = np.zeros(len(vector), bool)
        for _ in range(LIMITS.max_panes):
            hits = self.hits(start, direction[rays], remaining_m[rays])
            rays = rays[hits.rays]
            if not len(rays):
                break
            transmittance[rays] *= hits.transmittance
            meets_pane[rays], start = True, self.start(hits)
            remaining_m[rays] -= hits.range_m
        transmittance[rays] = 0.0
        return np.flatnonzero(meets_pane), transmittance[meets_pane]


class Segments(NamedTuple):
    """Last segments of rays that panes reflect or transmit at random, shape (ray, ...)."""

    start_m: Array
    direction: Array
    hit: Hits  # opaque surface that the segment hits
    preceding_m: Array  # path length before the segment
    meets_pane: Mask  # whether the ray met a pane
    is_reflected: Mask  # whether a pane reflected it
    weight: (
        Array32  # fraction of the light over the probability of the path, shape (ray, band or 1)
    )


def trace_segments(
    tracer: RayTracer,
    panes: Panes | None,
    start_m: Array,
    direction: Array,
    rng: np.random.Generator,
) -> Segments:
    """Follow rays of unit direction (ray, 3) to the opaque surface."""
    hit, ray_count = tracer.hits(start_m, direction), len(start_m)
    meets_pane, is_reflected = np.zeros((2, ray_count), bool)
    preceding, weight = np.zeros(ray_count), np.ones((ray_count, 1), np.float32)
    if panes is None:
        return Segments(start_m, direction, hit, preceding, meets_pane, is_reflected, weight)
    start, direction, face, range_m = np.array(start_m), np.array(direction), hit.face, hit.range_m
    weight, rays = weight.repeat(panes.transmittance.shape[1], axis=1), np.arange(ray_count)
    for _ in range(LIMITS.max_panes):
        hits = panes.hits(start[rays], direction[rays], range_m[rays])
        rays = rays[hits.rays]
        if not len(rays):
            break
        reflectance, transmittance = hits.reflectance.mean(axis=1), hits.transmittance.mean(axis=1)
        probability = reflectance / np.maximum(reflectance + transmittance, 1e-30)
        picks_reflection = rng.random(len(rays)) < probability
        weight[rays] *= np.where(picks_reflection[:, None], hits.reflectance, hits.transmittance)
        weight[rays] /= np.where(picks_reflection, probability, 1.0 - probability)[:, None].astype(
            np.float32
        )
        start[rays] = panes.start(hits, picks_reflection)
        direction[rays] = np.where(
            picks_reflection[:, None],
            reflect_direction(direction[rays], hits.normal),
            direction[rays],
        )
        preceding[rays] += hits.range_m
        meets_pane[rays], is_reflected[rays] = True, is_reflected[rays] | picks_reflection
        next_hit = tracer.hits(start[rays], direction[rays])
        face[rays], range_m[rays] = next_hit.face, next_hit.range_m
    weight[rays] = 0.0
    segment_hit = Hits(face, range_m)
    return Segments(start, direction, segment_hit, preceding, meets_pane, is_reflected, weight)


def reflect_direction(direction: Array, normal: Array) -> Array:
    """Return directions (ray, 3) reflected by planes of unit normals (ray, 3)."""
    return direction - 2.0 * np.einsum("ij,ij->i", direction, normal)[:, None] * normal


# Number of an additional, perfectly reflecting material.
WHITE = -1


@dataclass(frozen=True)
class ShadingPoints:
    """Points on surfaces at which radiance is computed, shape (point, ...)."""

    position_m: Array
    face: Index
    normal: Array  # on the side of the viewer
    outgoing: Array  # unit direction to the viewer
    on_outer_side: Mask  # whether the viewer sees the outer side of the triangle
    material: Index
    glossy: tuple[
        tuple[Index, Brdf], ...
    ]  # points of each surface that is not diffuse, and its BRDF
    # Fraction of the unoccluded sky irradiance of diffuse points that serves as control variate;
    # the rest is gathered. Any fraction independent of the samples gives the same mean: 1 has no
    # noise in the open, 0 has least where little sky is visible.
    sky_control_fraction: Array32

    def __len__(self) -> int:
        return len(self.face)

    @property
    def is_diffuse(self) -> Mask:
        """Whether each point is on a diffuse surface, shape (point,)."""
        is_diffuse = np.ones(len(self), np.bool_)
        for rows, _ in self.glossy:
            is_diffuse[rows] = False
        return is_diffuse

    def on_white_surface(self) -> "ShadingPoints":
        """Return the same points on a perfectly reflecting diffuse surface."""
        return replace(self, material=np.full(len(self), WHITE), glossy=())

    def select(self, indices: Index) -> "ShadingPoints":
        """Return a selection of the points, with repetition."""
        glossy = []
        for rows, brdf in self.glossy:
            is_glossy = np.zeros(len(self), bool)
            is_glossy[rows] = True
            glossy_rows = np.flatnonzero(is_glossy[indices])
            glossy += [(glossy_rows, brdf)] if len(glossy_rows) else []
        arrays = {name: values[indices] for name, values in vars(self).items() if name != "glossy"}
        return ShadingPoints(glossy=tuple(glossy), **arrays)


@dataclass(frozen=True)
class BsdfSet:
    """BRDFs of the materials, on bands (band,), nm, and panes of glass."""

    wavelength_nm: Array
    brdfs: tuple[Brdf, ...]  # one for each material of the surfaces
    rho_by_pi: Array32  # of the diffuse ones, and last of `WHITE`, shape (material + 1, band), sr-1
    panes: Panes | None = None

    @classmethod
    def of(cls, brdfs: tuple[Brdf, ...], wavelength_nm: Array) -> "BsdfSet":
        """Return materials on bands."""
        table = np.zeros((len(brdfs) + 1, len(wavelength_nm)), np.float32)
        table[WHITE] = 1.0 / np.pi
        for row, brdf in zip(table[:WHITE], brdfs, strict=True):
            if isinstance(brdf, Lambert):
                row[:] = brdf.reflectance.at(wavelength_nm) / np.pi
        return cls(wavelength_nm, brdfs, table)

    def points(
        self,
        surfaces: Surfaces,
        face: Index,
        position_m: Array,
        direction: Array,
        control: Array32 | None = None,
    ) -> ShadingPoints:
        """Return shading points for rays of unit direction (ray, 3) that hit triangles (ray,) at
        positions (ray, 3), m.

        `control` is the control-variate fraction of the sky; None: 1.
        """
        normal = surfaces.tracer.normals(face)
        on_outer_side = np.einsum("ij,ij->i", normal, direction) < 0.0
        material = surfaces.material_of[face & ROW]
        glossy = tuple(
            (np.flatnonzero(material == number), brdf)
            for number, brdf in enumerate(self.brdfs)
            if not isinstance(brdf, Lambert) and (material == number).any()
        )
        viewer_normal = np.where(on_outer_side[:, None], normal, -normal)
        control = np.ones(len(face), np.float32) if control is None else control
        return ShadingPoints(
            position_m, face, viewer_normal, -direction, on_outer_side, material, glossy, control
        )

    def diffuse_brdf(self, points: ShadingPoints) -> Array32:
        """Return rho / pi of diffuse points and zero for others, shape (point, band), sr-1."""
        return self.rho_by_pi[points.material]

    def value(self, points: ShadingPoints, incoming: Array) -> Array32:
        """Return the BRDF of points for unit directions to the light above them, shape (point,
        band), sr-1.
        """
        brdf_values = self.diffuse_brdf(points)
        for rows, brdf in points.glossy:
            to_light, to_viewer = _to_light_and_viewer(points, rows, incoming)
            brdf_values[rows] = brdf.value(to_light, to_viewer, self.wavelength_nm).T
        return brdf_values

    def sample(
        self, points: ShadingPoints, pairs: Array, rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """Draw gather directions and their density, sr-1: by the cosine law from pairs of uniform
        numbers (point, 2).

        Half of those of glossy points are by the specular lobe.
        """
        frame, local = shading_frames(points.normal), cosine_lobe(pairs)
        for rows, brdf in points.glossy:
            lobe_rows = rows[rng.random(len(rows)) < 0.5]
            to_viewer = local_direction(frame[lobe_rows], points.outgoing[lobe_rows])
            local[lobe_rows] = brdf.sample(to_viewer, rng)[0]
        direction = np.einsum("ij,ijk->ik", local, frame)
        return direction, self.density(points, direction)

    def density(self, points: ShadingPoints, direction: Array) -> Array:
        """Return the density of `sample` in unit directions (point, 3), sr-1, shape (point,)."""
        densities = np.maximum(np.einsum("ij,ij->i", points.normal, direction), 0.0) / np.pi
        for rows, brdf in points.glossy:
            directions = _to_light_and_viewer(points, rows, direction)
            densities[rows] = 0.5 * (densities[rows] + brdf.pdf(*directions))
        return densities


def local_direction(frame: Array, direction: Array) -> Array:
    """Return directions (point, 3) in the axes of frames (point, 3, 3)."""
    return np.einsum("ijk,ik->ij", frame, direction)


def _to_light_and_viewer(points: ShadingPoints, rows: Index, incoming: Array) -> list[Array]:
    """Return the directions to light and viewer of some points, in the frames of their normals."""
    frame = shading_frames(points.normal[rows])
    return [local_direction(frame, direction[rows]) for direction in (incoming, points.outgoing)]


# Gas transmittance is tabulated at ranges of 2^(n / NODES) m from 1 m; shorter paths lose nothing
# to gases.
NODES, OCTAVES = 16, 20


@dataclass(frozen=True)
class Air:
    """Air of a scene, on bands."""

    # by haze and molecules, shape (band,); None: no air
    extinction_per_m: Array32 | None = None
    # over paths of 2^(n / `NODES`) m, shape (length, band)
    gas_transmittance: Array32 | None = None
    # radiance of an infinite path; None for unlit air
    infinite_path: environment_map.EnvironmentMap | None = None

    @classmethod
    def of(cls, atmosphere: "Atmosphere", wavelength_nm: Array) -> "Air":
        """Tabulate an atmosphere on bands (band,), nm."""
        lengths = 2.0 ** (np.arange(NODES * OCTAVES + 1) / NODES)
        light = atmosphere.light
        return cls(
            atmosphere.extinction_per_m(wavelength_nm).astype(np.float32),
            np.ascontiguousarray(
                atmosphere.gas_transmittance(lengths, wavelength_nm).T, np.float32
            ),
            None
            if light is None
            else environment_map.sphere(
                lambda direction: light.air_radiance(direction, wavelength_nm)
            ),
        )

    @property
    def is_present(self) -> bool:
        """Whether there is air."""
        return self.extinction_per_m is not None

    def transmittance(self, range_m: Array) -> Array32:
        """Return the transmittance of paths of given lengths (ray,), m, shape (ray, band)."""
        return self._particle_transmittance(range_m) * self._gas_transmittance(range_m)

    def change_of(self, light: Array32, range_m: Array, direction: Array) -> Array32:
        """Return the change of light (ray, band) along paths in unit directions (ray, 3): path
        radiance minus losses.

        The path radiance is J (1 - T of haze and molecules) (T of gases over half the path), see
        `Atmosphere.path_radiance`.
        """
        particle_transmittance = self._particle_transmittance(range_m)
        change = (
            particle_transmittance * self._gas_transmittance(range_m) - np.float32(1.0)
        ) * light
        if self.infinite_path is not None:
            change += (
                (1.0 - particle_transmittance)
                * self.infinite_path.irradiance(direction)
                * self._gas_transmittance(0.5 * range_m)
            )
        return change

    def _particle_transmittance(self, range_m: Array) -> Array32:
        assert self.extinction_per_m is not None
        return np.exp(np.asarray(-range_m, np.float32)[:, None] * self.extinction_per_m)

    def _gas_transmittance(self, range_m: Array) -> Array32:
        """Interpolate the gas transmittance in the logarithm of the length, shape (ray, band)."""
        table = self.gas_transmittance
        assert table is not None
        node_position = np.clip(NODES * np.log2(np.maximum(range_m, 1.0)), 0.0, len(table) - 1.0)
        lower_node = np.minimum(node_position.astype(np.int64), len(table) - 2)
        node_fraction = (node_position - lower_node).astype(np.float32)[:, None]
        return np.asarray(
            table[lower_node] + node_fraction * (table[lower_node + 1] - table[lower_node]),
            np.float32,
        )


@dataclass(frozen=True, kw_only=True)
class SpectralScene:
    """A scene on the bands of a rendering."""

    surfaces: Surfaces
    bsdfs: BsdfSet
    lighting: Lighting
    air: Air

    @property
    def bands(self) -> int:
        """Number of bands."""
        return len(self.bsdfs.wavelength_nm)

    @cached_property
    def beams(self) -> LightTracingSettings:
        """Sampling of lamp directions by intensity."""
        return LightTracingSettings.of(self.lighting.lamps, self.surfaces.tracer)

    @property
    def bright_sky(self) -> SkyImportance | None:
        """Importance sampling of the sky; None with panes, which next-event estimation does not
        handle.
        """
        return self.lighting.bright_sky if self.bsdfs.panes is None else None

    def points(
        self,
        hit: Hits,
        origin_m: Array,
        direction: Array,
        rays: Index,
        control: Array32 | None = None,
    ) -> ShadingPoints:
        """Return the shading points of some of the rays of unit direction (ray, 3), which hit a
        surface.
        """
        position_m = origin_m[rays] + hit.range_m[rays, None] * direction[rays]
        return self.bsdfs.points(
            self.surfaces, hit.face[rays], position_m, direction[rays], control
        )

    def emission(self, points: ShadingPoints) -> tuple[Index, Array32]:
        """Return the indices of emitting points and their emitted radiance, shape (emitting point,
        band).
        """
        panels = self.lighting.panels
        if panels is None:
            return np.zeros(0, np.int64), np.zeros((0, self.bands), np.float32)
        kind = panels.kind_of_face[points.face & ROW]
        emitters = np.flatnonzero((kind >= 0) & points.on_outer_side)
        return emitters, panels.spectra[kind[emitters]]
