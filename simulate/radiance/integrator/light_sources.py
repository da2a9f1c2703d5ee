"""Light sources on the bands of a rendering: sky, lamps, discs of sun and moon, and emitting surfaces."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.geometry.ray_tracer import normals
from simulate.radiance.geometry.surfaces import Surfaces
from simulate.radiance.integrator.environment_map import EnvironmentMap, SkyImportance
from simulate.radiance.lamps.distribution import Distribution

Array = NDArray[np.floating]


@dataclass(frozen=True)
class LampPattern:
    """Intensity distribution of a lamp in the scene.

    Parameters
    ----------
    distribution
        Fraction of its light per solid angle, in the lamp's frame.
    frame
        Axes of that frame in scene coordinates, as rows, shape (3, 3).
    """

    distribution: Distribution
    frame: NDArray[np.float64]

    def __call__(self, direction: Array) -> Array:
        """Return the fraction per sr in unit directions (ray, 3) away from the lamp, shape (ray,)."""
        return self.distribution.per_sr(direction @ self.frame.T)


@dataclass(frozen=True, kw_only=True)
class LampLight:
    """A small spherical lamp with an intensity distribution.

    Parameters
    ----------
    name
        Its name.
    position_m
        Its centre, shape (3,), m.
    radius_m
        Radius of the sphere, m; it sets the width of penumbrae.
    spectrum
        Radiant flux, shape (band,), W nm-1.
    pattern
        Its intensity distribution.
    """

    name: str
    position_m: NDArray[np.float64]
    radius_m: float
    spectrum: NDArray[np.float32]
    pattern: LampPattern


@dataclass(frozen=True, kw_only=True)
class DiscLight:
    """Sun or moon.

    Parameters
    ----------
    name
        "sun" or "moon".
    direction
        Unit direction to its centre, shape (3,).
    angular_radius_rad
        Radius, rad.
    irradiance
        Irradiance at normal incidence, shape (band,), W m-2 nm-1.
    """

    name: str
    direction: NDArray[np.float64]
    angular_radius_rad: float
    irradiance: NDArray[np.float32]


@dataclass(frozen=True)
class Panels:
    """Emitting triangles, Lambertian on their outer side.

    Parameters
    ----------
    face
        Numbers of the triangles, shape (panel,).
    corners_m, normal
        Their corners, shape (panel, 3, 3), m, and unit normals, shape (panel, 3).
    spectra
        Radiance of each kind of emitter, shape (kind, band), W m-2 sr-1 nm-1.
    kind_of_face
        Kind of emitter of each triangle of the scene, -1 for none, shape (face,).
    per_m2_of_face
        Sampling density on each triangle of the scene, shape (face,), m-2.
    cumulated
        Cumulative probability of the panels, shape (panel,).
    """

    face: NDArray[np.int64]
    corners_m: NDArray[np.float64]
    normal: NDArray[np.float64]
    spectra: NDArray[np.float32]
    kind_of_face: NDArray[np.int64]
    per_m2_of_face: NDArray[np.float64]
    cumulated: NDArray[np.float64]

    def draw(self, count: int, rng: np.random.Generator) -> tuple[NDArray[np.int64], Array]:
        """Draw panels by power and a uniform point on each: indices (count,) and positions (count, 3), m."""
        panel = np.minimum(np.searchsorted(self.cumulated, rng.random(count), side="right"), len(self.face) - 1)
        root, v = np.sqrt(rng.random(count))[:, None], rng.random(count)[:, None]
        a, b, c = (self.corners_m[panel, i] for i in range(3))
        return panel, (1.0 - root) * a + root * ((1.0 - v) * b + v * c)


@dataclass(frozen=True, kw_only=True)
class Lighting:
    """All light sources of a scene.

    Parameters
    ----------
    environment_map
        The sky without discs.
    lamps, discs
        Lamps; sun and moon.
    panels
        Emitting surfaces, or None.
    """

    environment_map: EnvironmentMap
    lamps: tuple[LampLight, ...] = ()
    discs: tuple[DiscLight, ...] = ()
    panels: Panels | None = None

    @cached_property
    def bright_sky(self) -> SkyImportance | None:
        """Importance sampling of the sky; None where it is nearly uniform."""
        return SkyImportance.of(self.environment_map)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of lamps and discs, in the order of the bits of `truth.Truth.shadow`."""
        return tuple(light.name for light in (*self.discs, *self.lamps))


def panels_of(surfaces: Surfaces, kind_of_face: NDArray[np.int64], spectra: NDArray[np.float32]) -> Panels | None:
    """Return the emitting triangles of surfaces, or None without any.

    Parameters
    ----------
    surfaces
        All surfaces.
    kind_of_face
        Kind of emitter of each triangle, -1 for none, shape (face,).
    spectra
        Radiance of each kind, shape (kind, band), W m-2 sr-1 nm-1.
    """
    face = np.flatnonzero(kind_of_face >= 0)
    power = surfaces.area_m2[face] * spectra.sum(axis=1)[kind_of_face[face]] if len(face) else np.zeros(0)
    if not power.sum() > 0.0:
        return None
    chance = power / power.sum()
    per_m2 = np.zeros(len(kind_of_face))
    area = surfaces.area_m2[face]
    per_m2[face] = np.divide(chance, area, out=np.zeros_like(area), where=area > 0.0)
    corners = surfaces.mesh.corners_m[face]
    return Panels(face, corners, normals(corners), spectra, kind_of_face, per_m2, np.cumsum(chance))
