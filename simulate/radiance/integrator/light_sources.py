"""Light sources on the bands of a rendering: sky, lamps, discs of sun and moon, and emitting
surfaces.

Each is an object, and for compiled loops a tuple of arrays.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from simulate.arrays import Array, Array32, Index
from simulate.radiance.geometry.embree import COMPILED, INLINED
from simulate.radiance.geometry.ray_tracer import normals
from simulate.radiance.geometry.surfaces import Surfaces
from simulate.radiance.integrator.environment_map import EnvironmentMap, SkyImportance
from simulate.radiance.integrator.sampling import draw_disc_point, set_direction, shading_frames
from simulate.radiance.lamps.distribution import POWER, Distribution

# Shadow rays end before their source, at this fraction of the distance.
SHORT = 1.0 - 1e-4


@dataclass(frozen=True, kw_only=True)
class LampLight:
    """A small spherical lamp with an intensity distribution."""

    name: str
    position_m: Array  # of its centre
    radius_m: float  # it sets the width of penumbrae
    spectrum: Array32  # radiant flux, shape (band,), W nm-1
    distribution: Distribution
    frame: Array  # axes of the distribution in scene coordinates, as rows, shape (3, 3)

    def per_sr(self, direction: Array) -> Array:
        """Return the fraction of its light per sr in unit directions (ray, 3) away from it, shape
        (ray,).
        """
        return self.distribution.per_sr(direction @ self.frame.T)


@dataclass(frozen=True, kw_only=True)
class DiscLight:
    """Sun or moon."""

    name: str
    direction: Array  # unit vector to its centre
    angular_radius_rad: float
    irradiance: Array32  # at normal incidence, shape (band,), W m-2 nm-1


@dataclass(frozen=True)
class Panels:
    """Emitting triangles, Lambertian on their outer side."""

    face: Index  # numbers of the triangles, shape (panel,)
    corners_m: Array  # shape (panel, 3, 3)
    normal: Array  # shape (panel, 3)
    spectra: Array32  # radiance of each kind of emitter, shape (kind, band), W m-2 sr-1 nm-1
    kind_of_face: Index  # of each triangle of the scene, -1 for none
    per_m2_of_face: Array  # sampling density on each triangle of the scene
    cumulative: Array  # cumulative probability of the panels, shape (panel,)

    @classmethod
    def of(cls, surfaces: Surfaces, kind_of_face: Index, spectra: Array32) -> "Panels | None":
        """Return the emitting triangles of surfaces, or None without any."""
        face = np.flatnonzero(kind_of_face >= 0)
        power = (
            surfaces.area_m2[face] * spectra.sum(axis=1)[kind_of_face[face]]
            if len(face)
            else np.zeros(0)
        )
        if not power.sum() > 0.0:
            return None
        probability = power / power.sum()
        per_m2, area, corners = (
            np.zeros(len(kind_of_face)),
            surfaces.area_m2[face],
            surfaces.mesh.corners_m[face],
        )
        per_m2[face] = np.divide(probability, area, out=np.zeros_like(area), where=area > 0.0)
        return cls(
            face, corners, normals(corners), spectra, kind_of_face, per_m2, np.cumsum(probability)
        )

    def draw(self, count: int, rng: np.random.Generator) -> tuple[Index, Array]:
        """Draw panels by power and a uniform point on each: indices (count,) and positions (count,
        3), m.
        """
        panel = np.minimum(
            np.searchsorted(self.cumulative, rng.random(count), side="right"), len(self.face) - 1
        )
        root, v = np.sqrt(rng.random(count))[:, None], rng.random(count)[:, None]
        a, b, c = (self.corners_m[panel, i] for i in range(3))
        return panel, (1.0 - root) * a + root * ((1.0 - v) * b + v * c)


@dataclass(frozen=True, kw_only=True)
class Lighting:
    """All light sources of a scene: the sky without discs, lamps, sun and moon, and emitting
    surfaces.
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
        """Names of lamps and discs, in the order of the bits of `AuxiliaryLayers.shadow`."""
        return tuple(light.name for light in (*self.discs, *self.lamps))


def disc_arrays(discs: tuple[DiscLight, ...], bands: int) -> tuple[NDArray, NDArray, NDArray]:
    """Return axes with z towards the centre (disc, 3, 3), cosines of radii (disc,) and irradiances
    (disc, band).
    """
    axes = np.array([shading_frames(disc.direction[None])[0] for disc in discs]).reshape(-1, 3, 3)
    limb_cosines = np.array([np.cos(disc.angular_radius_rad) for disc in discs])
    return (
        axes,
        limb_cosines,
        np.array([disc.irradiance for disc in discs], np.float32).reshape(-1, bands),
    )


def lamp_arrays(lamps: tuple[LampLight, ...], bands: int) -> tuple:
    """Return positions, radii, spectra and their sums, and the distributions' axes and concatenated
    tables.
    """
    tables = [lamp.distribution.encode() for lamp in lamps]
    table_starts = np.cumsum([0, *(len(table) for table in tables)])
    return (
        np.array([lamp.position_m for lamp in lamps], float).reshape(-1, 3),
        np.array([lamp.radius_m for lamp in lamps], float),
        np.array([lamp.spectrum for lamp in lamps], np.float32).reshape(-1, bands),
        np.array([float(lamp.spectrum.sum()) for lamp in lamps]),
        np.array([lamp.frame for lamp in lamps], float).reshape(-1, 3, 3),
        table_starts,
        np.concatenate([*tables, np.zeros(0)]),
    )


def panel_arrays(panels: Panels | None, bands: int) -> tuple:
    """Return the arrays of emitting triangles, see `Panels`; empty ones without any."""
    if panels is None:
        no_value, no_face = np.zeros(0), np.zeros(0, np.int64)
        return (
            no_value,
            no_face,
            np.zeros((0, 3, 3)),
            np.zeros((0, 3)),
            no_value,
            no_face,
            np.zeros((0, bands), np.float32),
        )
    sampling_arrays = (panels.cumulative, panels.face, panels.corners_m, panels.normal)
    return (*sampling_arrays, panels.per_m2_of_face, panels.kind_of_face, panels.spectra)


@numba.njit(**COMPILED)
def _cell(values: Any, value: float) -> Any:
    """Return the interval of ascending values that contains a value, and the relative position in
    it.
    """
    cell = min(max(np.searchsorted(values, value, side="right") - 1, 0), len(values) - 2)
    return cell, (value - values[cell]) / (values[cell + 1] - values[cell])


@numba.njit(**INLINED)
def lamp_pattern(pattern: Any, axes: Any, x: float, y: float, z: float) -> float:
    """Return the fraction of a lamp's light per sr in a unit direction away from it."""
    z_local = axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z
    if pattern[0] == POWER:
        return pattern[1] * max(z_local, 0.0) ** pattern[2] if pattern[2] > 0.0 else pattern[1]
    x_local = axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z
    y_local = axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z
    polar = np.rad2deg(np.arccos(min(max(z_local, -1.0), 1.0)))
    azimuth = np.rad2deg(np.arctan2(y_local, x_local)) % 360.0
    n_polars, n_azimuths = int(pattern[2]), int(pattern[3])
    polars, azimuths = pattern[4 : 4 + n_polars], pattern[4 + n_polars : 4 + n_polars + n_azimuths]
    candela = pattern[4 + n_polars + n_azimuths :]
    if polar < polars[0] or polar > polars[-1]:
        return 0.0
    last_azimuth = azimuths[-1]
    if last_azimuth <= 180.0 and azimuth > 180.0:
        azimuth = 360.0 - azimuth
    if last_azimuth <= 90.0 and azimuth > 90.0:
        azimuth = 180.0 - azimuth
    col, polar_fraction = _cell(polars, polar)
    row, azimuth_fraction = (0, 0.0) if n_azimuths == 1 else _cell(azimuths, azimuth)
    next_row = min(row + 1, n_azimuths - 1)
    row_candela = (
        candela[row * n_polars + col] * (1.0 - polar_fraction)
        + candela[row * n_polars + col + 1] * polar_fraction
    )
    next_row_candela = (
        candela[next_row * n_polars + col] * (1.0 - polar_fraction)
        + candela[next_row * n_polars + col + 1] * polar_fraction
    )
    return pattern[1] * (
        row_candela * (1.0 - azimuth_fraction) + next_row_candela * azimuth_fraction
    )


@numba.njit(**INLINED)
def lamp_factor(lamps: Any, lamp: int, position_m: Any, normal: Any) -> float:
    """Return the unoccluded irradiance of a lamp over its spectrum, as
    `direct_lighting.lamp_factor`.
    """
    position, _, _, _, axes, table_starts, tables = lamps
    x, y, z = (
        position[lamp, 0] - position_m[0],
        position[lamp, 1] - position_m[1],
        position[lamp, 2] - position_m[2],
    )
    square = x * x + y * y + z * z
    distance = np.sqrt(square)
    cosine = (x * normal[0] + y * normal[1] + z * normal[2]) / distance
    if not cosine > 0.0:
        return 0.0
    pattern = tables[table_starts[lamp] : table_starts[lamp + 1]]
    return (
        cosine
        * lamp_pattern(pattern, axes[lamp], -x / distance, -y / distance, -z / distance)
        / square
    )


@numba.njit(**INLINED)
def towards_lamp(lamps: Any, lamp: int, point: Any, state: Any, direction: Any) -> None:
    """Set the vector from a point to one drawn on a lamp."""
    position, radius, square = lamps[0][lamp], lamps[1][lamp], 0.0
    for axis in range(3):
        direction[axis] = position[axis] - point[axis]
        square += direction[axis] ** 2
    distance = np.sqrt(square)
    centre = (direction[0] / distance, direction[1] / distance, direction[2] / distance)
    square, cosine, sine = draw_disc_point(state)
    disc_radius = radius * np.sqrt(square)
    set_direction(centre, disc_radius * cosine, disc_radius * sine, distance, direction)
