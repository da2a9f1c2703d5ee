"""Shading points, and the BSDFs of their materials."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.brdf.protocol import Brdf, Lambert
from simulate.radiance.geometry.embree import ROW
from simulate.radiance.geometry.surfaces import Surfaces
from simulate.radiance.integrator.panes import Panes

Array = NDArray[np.floating]
# Number of an additional, perfectly reflecting material.
WHITE = -1


@dataclass(frozen=True)
class ShadingPoints:
    """Points on surfaces at which radiance is computed.

    Parameters
    ----------
    place_m
        Position, shape (point, 3), m.
    face
        Triangle, shape (point,).
    normal
        Unit normal on the side of the viewer, shape (point, 3).
    outgoing
        Unit direction to the viewer, shape (point, 3).
    outside
        Whether the viewer sees the outer side of the triangle, shape (point,).
    material
        Number of its material, shape (point,).
    glossy
        Points of each surface that is not diffuse, and its BRDF.
    sky_control_fraction
        Fraction of the unoccluded sky irradiance of diffuse points that serves as control variate; the rest is
        gathered, shape (point,). Any fraction independent of the samples gives the same mean: 1 has no noise in the
        open, 0 has least where little sky is visible.
    """

    place_m: Array
    face: NDArray[np.int64]
    normal: Array
    outgoing: Array
    outside: NDArray[np.bool_]
    material: NDArray[np.int64]
    glossy: tuple[tuple[NDArray[np.int64], Brdf], ...]
    sky_control_fraction: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.face)

    @property
    def is_diffuse(self) -> NDArray[np.bool_]:
        """Whether each point is on a diffuse surface, shape (point,)."""
        found = np.ones(len(self), np.bool_)
        for which, _ in self.glossy:
            found[which] = False
        return found

    def on_white_surface(self) -> "ShadingPoints":
        """Return the same points on a perfectly reflecting diffuse surface."""
        return replace(self, material=np.full(len(self), WHITE), glossy=())

    def some(self, which: NDArray[np.int64]) -> "ShadingPoints":
        """Return a selection of the points, with repetition."""
        glossy = []
        for of, brdf in self.glossy:
            shines = np.zeros(len(self), bool)
            shines[of] = True
            found = np.flatnonzero(shines[which])
            glossy += [(found, brdf)] if len(found) else []
        return ShadingPoints(
            self.place_m[which],
            self.face[which],
            self.normal[which],
            self.outgoing[which],
            self.outside[which],
            self.material[which],
            tuple(glossy),
            self.sky_control_fraction[which],
        )


@dataclass(frozen=True)
class BsdfSet:
    """BRDFs of the materials, on bands.

    Parameters
    ----------
    wavelength_nm
        Bands, shape (band,), nm.
    brdfs
        One for each material of the surfaces.
    rho_by_pi
        rho / pi of the diffuse ones, and last of `WHITE`, shape (material + 1, band), sr-1.
    panes
        Panes of glass; None without any.
    """

    wavelength_nm: NDArray[np.float64]
    brdfs: tuple[Brdf, ...]
    rho_by_pi: NDArray[np.float32]
    panes: Panes | None = None

    @classmethod
    def of(cls, brdfs: tuple[Brdf, ...], wavelength_nm: NDArray[np.float64]) -> "BsdfSet":
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
        face: NDArray[np.int64],
        place_m: Array,
        direction: Array,
        sky_control_fraction: NDArray[np.float32] | None = None,
    ) -> ShadingPoints:
        """Return shading points for rays of unit direction (ray, 3) that hit triangles (ray,) at positions (ray, 3), m.

        `sky_control_fraction` is the control-variate fraction of the sky; None: 1.
        """
        normal = surfaces.tracer.normals(face)
        outside = np.einsum("ij,ij->i", normal, direction) < 0.0
        material = surfaces.material_of[face & ROW]
        glossy = tuple(
            (np.flatnonzero(material == number), brdf)
            for number, brdf in enumerate(self.brdfs)
            if not isinstance(brdf, Lambert) and (material == number).any()
        )
        facing = np.where(outside[:, None], normal, -normal)
        sky_control_fraction = np.ones(len(face), np.float32) if sky_control_fraction is None else sky_control_fraction
        return ShadingPoints(place_m, face, facing, -direction, outside, material, glossy, sky_control_fraction)

    def diffuse_brdf(self, points: ShadingPoints) -> NDArray[np.float32]:
        """Return rho / pi of diffuse points and zero for others, shape (point, band), sr-1."""
        return self.rho_by_pi[points.material]

    def value(self, points: ShadingPoints, incoming: Array) -> NDArray[np.float32]:
        """Return the BRDF of points for unit directions to the light above them, shape (point, band), sr-1."""
        found = self.diffuse_brdf(points)
        for which, brdf in points.glossy:
            frame = shading_frames(points.normal[which])
            light, eye = within(frame, incoming[which]), within(frame, points.outgoing[which])
            found[which] = brdf.value(light, eye, self.wavelength_nm).T
        return found

    def sample(self, points: ShadingPoints, cosine: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw gather directions and their density, sr-1: by the cosine law, half of glossy ones by the specular lobe.

        Parameters
        ----------
        points
            Where.
        cosine
            Two uniform numbers in [0, 1) for each point, shape (point, 2), for the cosine law.
        rng
            Random generator for the specular lobe.
        """
        frame = shading_frames(points.normal)
        radius, turn = np.sqrt(cosine[:, 0]), 2.0 * np.pi * cosine[:, 1]
        local = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1.0 - cosine[:, 0])], axis=1)
        for which, brdf in points.glossy:
            by_gloss = which[rng.random(len(which)) < 0.5]
            local[by_gloss] = brdf.sample(within(frame[by_gloss], points.outgoing[by_gloss]), rng)[0]
        direction = np.einsum("ij,ijk->ik", local, frame)
        return direction, self.density(points, direction)

    def density(self, points: ShadingPoints, direction: Array) -> Array:
        """Return the density with which `drawn` gathers from unit directions (point, 3), sr-1, shape (point,)."""
        found = np.maximum(np.einsum("ij,ij->i", points.normal, direction), 0.0) / np.pi
        for which, brdf in points.glossy:
            frame = shading_frames(points.normal[which])
            light, eye = within(frame, direction[which]), within(frame, points.outgoing[which])
            found[which] = 0.5 * (found[which] + brdf.pdf(light, eye))
        return found


def shading_frames(normal: Array) -> NDArray[np.float64]:
    """Return axes (x, y, z) with z along unit normals, as rows: shape (point, 3, 3).

    Notes
    -----
    Duff et al., Building an Orthonormal Basis, Revisited, JCGT 6 (2017) 1: no branch, no loss near any pole.
    """
    x, y, z = normal[:, 0], normal[:, 1], normal[:, 2]
    sign = np.where(z >= 0.0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=1)
    second = np.stack([b, sign + y * y * a, -y], axis=1)
    return np.stack([first, second, normal], axis=1).astype(np.float64)


def within(frame: Array, direction: Array) -> NDArray[np.float64]:
    """Return directions (point, 3) in the axes of frames (point, 3, 3)."""
    return np.einsum("ijk,ik->ij", frame, direction)
