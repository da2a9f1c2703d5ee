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
from numpy.typing import NDArray

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
from simulate.radiance.materials import pane_shares

if TYPE_CHECKING:
    from simulate.radiance.atmosphere import Atmosphere

Array = NDArray[np.floating]
Rows = NDArray[np.int64]


class Met(NamedTuple):
    """Rays that meet a pane, shape (meeting ray, ...)."""

    which: Rows  # numbers of the rays
    range_m: Array
    place_m: Array
    normal: Array  # on the side of the ray's origin
    face: Rows
    mirrored: NDArray[np.float32]  # reflected fraction, shape (meeting ray, band)
    through: NDArray[np.float32]  # transmitted fraction


@dataclass(frozen=True, kw_only=True)
class Panes:
    """All panes of a scene, on bands."""

    tracer: RayTracer
    kind_of_face: NDArray[np.int64]  # kind of glass of each triangle
    transmittance: Array  # of each kind at normal incidence, shape (kind, band)
    refractive_index: tuple[float, ...]  # of each kind

    def met(self, origin_m: Array, direction: Array, reach_m: Array) -> Met:
        """Return the rays of unit direction (ray, 3) that meet a pane within a distance (ray,),
        m.
        """
        hit = self.tracer.hits(origin_m, direction)
        which = np.flatnonzero((hit.face != NOTHING) & (hit.range_m < reach_m))
        face, range_m, along = hit.face[which], hit.range_m[which], direction[which]
        facing, cosine = self.tracer.facing(face, along)
        mirrored = np.zeros((len(face), self.transmittance.shape[1]), np.float32)
        through = np.zeros_like(mirrored)
        for number, index in enumerate(self.refractive_index):
            of = np.flatnonzero(self.kind_of_face[face] == number)
            mirrored[of], through[of] = pane_shares(cosine[of], self.transmittance[number], index)
        return Met(
            which,
            range_m,
            origin_m[which] + range_m[:, None] * along,
            facing,
            face,
            mirrored,
            through,
        )

    def start(self, met: Met, mirrored: NDArray[np.bool_] | bool = False) -> Array:
        """Return starts of transmitted or reflected rays, shape (meeting ray, 3), m."""
        side = np.where(
            np.broadcast_to(mirrored, met.which.shape)[:, None], met.normal, -met.normal
        )
        return self.tracer.above(met.face, met.place_m, side)

    def transmittance_along(
        self, start_m: Array, way: Array, length_limit: float | None
    ) -> tuple[Rows, NDArray[np.float32]]:
        """Return indices of rays that meet panes, and their transmittances (ray, band).

        Rays have a length of `length_limit` times that of their vectors `way` (ray, 3), or none.
        """
        length = np.linalg.norm(way, axis=1)
        ahead = way / np.maximum(length, 1e-300)[:, None]
        remaining_m = np.full(len(way), np.inf) if length_limit is None else length_limit * length
        transmittance = np.ones((len(way), self.transmittance.shape[1]), np.float32)
        rows, start, touched = (
            np.arange(len(way)),
            np.asarray(start_m, float),
            np.zeros(len(way), bool),
        )
        for _ in range(LIMITS.max_panes):
            met = self.met(start, ahead[rows], remaining_m[rows])
            rows = rows[met.which]
            if not len(rows):
                break
            transmittance[rows] *= met.through
            touched[rows], start = True, self.start(met)
            remaining_m[rows] -= met.range_m
        transmittance[rows] = 0.0
        return np.flatnonzero(touched), transmittance[touched]


class Segments(NamedTuple):
    """Last segments of rays that panes reflect or transmit at random, shape (ray, ...)."""

    start_m: Array
    direction: Array
    hit: Hits  # opaque surface that the segment hits
    earlier_m: Array  # path length before the segment
    crossed: NDArray[np.bool_]  # whether the ray met a pane
    mirrored: NDArray[np.bool_]  # whether a pane reflected it
    weight: NDArray[
        np.float32
    ]  # fraction of the light over the probability of the path, shape (ray, band or 1)


def trace_segments(
    tracer: RayTracer,
    panes: Panes | None,
    start_m: Array,
    direction: Array,
    rng: np.random.Generator,
) -> Segments:
    """Follow rays of unit direction (ray, 3) to the opaque surface."""
    hit, ray_count = tracer.hits(start_m, direction), len(start_m)
    no, plain = np.zeros(ray_count, bool), np.ones((ray_count, 1), np.float32)
    if panes is None:
        return Segments(start_m, direction, hit, np.zeros(ray_count), no, no, plain)
    start, ahead, face, range_m = np.array(start_m), np.array(direction), hit.face, hit.range_m
    earlier, crossed, mirrored = np.zeros(ray_count), no.copy(), no.copy()
    weight, rows = plain.repeat(panes.transmittance.shape[1], axis=1), np.arange(ray_count)
    for _ in range(LIMITS.max_panes):
        met = panes.met(start[rows], ahead[rows], range_m[rows])
        rows = rows[met.which]
        if not len(rows):
            break
        back, on = met.mirrored.mean(axis=1), met.through.mean(axis=1)
        chance = back / np.maximum(back + on, 1e-30)
        turns = rng.random(len(rows)) < chance
        weight[rows] *= np.where(turns[:, None], met.mirrored, met.through)
        weight[rows] /= np.where(turns, chance, 1.0 - chance)[:, None].astype(np.float32)
        start[rows] = panes.start(met, turns)
        ahead[rows] = np.where(
            turns[:, None], reflect_direction(ahead[rows], met.normal), ahead[rows]
        )
        earlier[rows] += met.range_m
        crossed[rows], mirrored[rows] = True, mirrored[rows] | turns
        onwards = tracer.hits(start[rows], ahead[rows])
        face[rows], range_m[rows] = onwards.face, onwards.range_m
    weight[rows] = 0.0
    return Segments(start, ahead, Hits(face, range_m), earlier, crossed, mirrored, weight)


def reflect_direction(direction: Array, normal: Array) -> Array:
    """Return directions (ray, 3) reflected by planes of unit normals (ray, 3)."""
    return direction - 2.0 * np.einsum("ij,ij->i", direction, normal)[:, None] * normal


# Number of an additional, perfectly reflecting material.
WHITE = -1


@dataclass(frozen=True)
class ShadingPoints:
    """Points on surfaces at which radiance is computed, shape (point, ...)."""

    place_m: Array
    face: Rows
    normal: Array  # on the side of the viewer
    outgoing: Array  # unit direction to the viewer
    on_outer_side: NDArray[np.bool_]  # whether the viewer sees the outer side of the triangle
    material: Rows
    glossy: tuple[
        tuple[Rows, Brdf], ...
    ]  # points of each surface that is not diffuse, and its BRDF
    # Fraction of the unoccluded sky irradiance of diffuse points that serves as control variate;
    # the rest is gathered. Any fraction independent of the samples gives the same mean: 1 has no
    # noise in the open, 0 has least where little sky is visible.
    sky_control_fraction: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.face)

    @property
    def is_diffuse(self) -> NDArray[np.bool_]:
        """Whether each point is on a diffuse surface, shape (point,)."""
        is_diffuse = np.ones(len(self), np.bool_)
        for which, _ in self.glossy:
            is_diffuse[which] = False
        return is_diffuse

    def on_white_surface(self) -> "ShadingPoints":
        """Return the same points on a perfectly reflecting diffuse surface."""
        return replace(self, material=np.full(len(self), WHITE), glossy=())

    def some(self, which: Rows) -> "ShadingPoints":
        """Return a selection of the points, with repetition."""
        glossy = []
        for of, brdf in self.glossy:
            shines = np.zeros(len(self), bool)
            shines[of] = True
            glossy_rows = np.flatnonzero(shines[which])
            glossy += [(glossy_rows, brdf)] if len(glossy_rows) else []
        arrays = {name: values[which] for name, values in vars(self).items() if name != "glossy"}
        return ShadingPoints(glossy=tuple(glossy), **arrays)


@dataclass(frozen=True)
class BsdfSet:
    """BRDFs of the materials, on bands (band,), nm, and panes of glass."""

    wavelength_nm: Array
    brdfs: tuple[Brdf, ...]  # one for each material of the surfaces
    rho_by_pi: NDArray[
        np.float32
    ]  # of the diffuse ones, and last of `WHITE`, shape (material + 1, band), sr-1
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
        face: Rows,
        place_m: Array,
        direction: Array,
        control: NDArray[np.float32] | None = None,
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
        facing = np.where(on_outer_side[:, None], normal, -normal)
        control = np.ones(len(face), np.float32) if control is None else control
        return ShadingPoints(
            place_m, face, facing, -direction, on_outer_side, material, glossy, control
        )

    def diffuse_brdf(self, points: ShadingPoints) -> NDArray[np.float32]:
        """Return rho / pi of diffuse points and zero for others, shape (point, band), sr-1."""
        return self.rho_by_pi[points.material]

    def value(self, points: ShadingPoints, incoming: Array) -> NDArray[np.float32]:
        """Return the BRDF of points for unit directions to the light above them, shape (point,
        band), sr-1.
        """
        brdf_values = self.diffuse_brdf(points)
        for which, brdf in points.glossy:
            frame = shading_frames(points.normal[which])
            light, eye = within(frame, incoming[which]), within(frame, points.outgoing[which])
            brdf_values[which] = brdf.value(light, eye, self.wavelength_nm).T
        return brdf_values

    def sample(
        self, points: ShadingPoints, pairs: Array, rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """Draw gather directions and their density, sr-1: by the cosine law from pairs of uniform
        numbers (point, 2).

        Half of those of glossy points are by the specular lobe.
        """
        frame, local = shading_frames(points.normal), cosine_lobe(pairs)
        for which, brdf in points.glossy:
            by_gloss = which[rng.random(len(which)) < 0.5]
            local[by_gloss] = brdf.sample(within(frame[by_gloss], points.outgoing[by_gloss]), rng)[
                0
            ]
        direction = np.einsum("ij,ijk->ik", local, frame)
        return direction, self.density(points, direction)

    def density(self, points: ShadingPoints, direction: Array) -> Array:
        """Return the density of `sample` in unit directions (point, 3), sr-1, shape (point,)."""
        densities = np.maximum(np.einsum("ij,ij->i", points.normal, direction), 0.0) / np.pi
        for which, brdf in points.glossy:
            frame = shading_frames(points.normal[which])
            light, eye = within(frame, direction[which]), within(frame, points.outgoing[which])
            densities[which] = 0.5 * (densities[which] + brdf.pdf(light, eye))
        return densities


def within(frame: Array, direction: Array) -> Array:
    """Return directions (point, 3) in the axes of frames (point, 3, 3)."""
    return np.einsum("ijk,ik->ij", frame, direction)


# Gas transmittance is tabulated at ranges of 2^(n / NODES) m from 1 m; shorter paths lose nothing
# to gases.
NODES, OCTAVES = 16, 20


@dataclass(frozen=True)
class Air:
    """Air of a scene, on bands."""

    # by haze and molecules, shape (band,); None: no air
    extinction_per_m: NDArray[np.float32] | None = None
    # over paths of 2^(n / `NODES`) m, shape (length, band)
    gas_transmittance: NDArray[np.float32] | None = None
    # radiance of an infinite path; None for unlit air
    endless: environment_map.EnvironmentMap | None = None

    @classmethod
    def of(cls, lit: "Atmosphere", wavelength_nm: Array) -> "Air":
        """Tabulate an atmosphere on bands (band,), nm."""
        lengths = 2.0 ** (np.arange(NODES * OCTAVES + 1) / NODES)
        light = lit.light
        return cls(
            lit.extinction_per_m(wavelength_nm).astype(np.float32),
            np.ascontiguousarray(lit.gas_transmittance(lengths, wavelength_nm).T, np.float32),
            None
            if light is None
            else environment_map.sphere(lambda way: light.air_radiance(way, wavelength_nm)),
        )

    @property
    def absorbs(self) -> bool:
        """Whether there is air."""
        return self.extinction_per_m is not None

    def through(self, range_m: Array) -> NDArray[np.float32]:
        """Return the transmittance of paths of given lengths (ray,), m, shape (ray, band)."""
        return self._particle_transmittance(range_m) * self._gas_transmittance(range_m)

    def change_of(
        self, light: NDArray[np.float32], range_m: Array, direction: Array
    ) -> NDArray[np.float32]:
        """Return the change of light (ray, band) along paths in unit directions (ray, 3): path
        radiance minus losses.

        The path radiance is J (1 - T of haze and molecules) (T of gases over half the path), see
        `Atmosphere.path_radiance`.
        """
        particle_transmittance = self._particle_transmittance(range_m)
        change = (
            particle_transmittance * self._gas_transmittance(range_m) - np.float32(1.0)
        ) * light
        if self.endless is not None:
            change += (
                (1.0 - particle_transmittance)
                * self.endless.irradiance(direction)
                * self._gas_transmittance(0.5 * range_m)
            )
        return change

    def _particle_transmittance(self, range_m: Array) -> NDArray[np.float32]:
        assert self.extinction_per_m is not None
        return np.exp(np.asarray(-range_m, np.float32)[:, None] * self.extinction_per_m)

    def _gas_transmittance(self, range_m: Array) -> NDArray[np.float32]:
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
        which: Rows,
        control: NDArray[np.float32] | None = None,
    ) -> ShadingPoints:
        """Return the shading points of some of the rays of unit direction (ray, 3), which hit a
        surface.
        """
        position_m = origin_m[which] + hit.range_m[which, None] * direction[which]
        return self.bsdfs.points(
            self.surfaces, hit.face[which], position_m, direction[which], control
        )

    def emission(self, points: ShadingPoints) -> tuple[Rows, NDArray[np.float32]]:
        """Return the indices of emitting points and their emitted radiance, shape (emitting point,
        band).
        """
        panels = self.lighting.panels
        if panels is None:
            return np.zeros(0, np.int64), np.zeros((0, self.bands), np.float32)
        kind = panels.kind_of_face[points.face & ROW]
        glows = np.flatnonzero((kind >= 0) & points.on_outer_side)
        return glows, panels.spectra[kind[glows]]
