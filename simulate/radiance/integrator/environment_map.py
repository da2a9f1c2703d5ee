"""Environment map of the sky, the unoccluded irradiance by normal, and importance sampling; also in
compiled loops.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from simulate.arrays import Array, Array32
from simulate.radiance.geometry.embree import INLINED
from simulate.radiance.integrator.integrator_settings import LIMITS
from simulate.radiance.integrator.sampling import fraction

# Cells of the radiance table, in height and azimuth; step between the normals of the irradiance
# table.
HEIGHTS, AZIMUTHS, NORMAL_STEP_DEG = 90, 120, 4.0


@dataclass(frozen=True)
class EnvironmentMap:
    """Radiance of the sky above the horizon; zero below it."""

    # By height from horizon to zenith and azimuth from east by north, both ends of each included,
    # shape (height, azimuth, band), W m-2 sr-1 nm-1; and without obstacles by the normal's angle
    # from the zenith and azimuth.
    radiance_table: Array32
    irradiance_table: Array32

    @property
    def is_dark(self) -> bool:
        """Whether it emits no light."""
        return not self.radiance_table.any()

    def radiance(self, direction: Array) -> Array32:
        """Return spectral radiance from unit directions (ray, 3), shape (ray, band)."""
        height = np.arcsin(np.clip(direction[:, 2], -1.0, 1.0)) / (0.5 * np.pi)
        radiance = _interpolate(
            self.radiance_table, np.maximum(height, 0.0), azimuth_turns(direction)
        )
        radiance[direction[:, 2] < 0.0] = 0.0
        return radiance

    def irradiance(self, normal: Array) -> Array32:
        """Return the unoccluded irradiance of surfaces with unit normals (point, 3), shape (point,
        band).
        """
        return _interpolate(
            self.irradiance_table,
            np.arccos(np.clip(normal[:, 2], -1.0, 1.0)) / np.pi,
            azimuth_turns(normal),
        )


def environment_map(sky: Callable[[Array], Array]) -> EnvironmentMap:
    """Return the map of a sky: a function of unit directions (n, 3), z up, that gives radiance
    (band, n).
    """
    height = np.linspace(0.0, 0.5 * np.pi, HEIGHTS + 1)
    azimuth = np.linspace(0.0, 2.0 * np.pi, AZIMUTHS + 1)
    table = np.asarray(sky(_directions(height, azimuth)), np.float32).T
    table = np.ascontiguousarray(table).reshape(HEIGHTS + 1, AZIMUTHS + 1, -1)
    return EnvironmentMap(table, _irradiance(table))


def sphere(light: Callable[[Array], Array]) -> EnvironmentMap:
    """Tabulate a function of unit directions (n, 3) over the full sphere, for
    `EnvironmentMap.irradiance`.
    """
    table = np.asarray(light(_directions(*_normals())), np.float32).T
    n_heights, n_azimuths = (len(axis) for axis in _normals())
    return EnvironmentMap(
        np.zeros((2, 2, table.shape[1]), np.float32),
        np.ascontiguousarray(table).reshape(n_heights, n_azimuths, -1),
    )


def black(bands: int) -> EnvironmentMap:
    """Return a sky without light."""
    return EnvironmentMap(np.zeros((2, 2, bands), np.float32), np.zeros((2, 2, bands), np.float32))


def _irradiance(table: Array32) -> Array32:
    """Integrate the radiance table over the hemisphere of each normal, in equal steps of the sine
    of the height.
    """
    bands = table.shape[2]
    if not table.any():
        return np.zeros((2, 2, bands), np.float32)
    rows, columns = HEIGHTS, AZIMUTHS
    sine = (np.arange(rows) + 0.5) / rows
    directions = _directions(np.arcsin(sine), 2.0 * np.pi * (np.arange(columns) + 0.5) / columns)
    sample_sr = 2.0 * np.pi / len(directions)
    radiance = (
        _interpolate(table, np.arcsin(directions[:, 2]) / (0.5 * np.pi), azimuth_turns(directions))
        * sample_sr
    )
    height, azimuth = _normals()
    normals = _directions(height, azimuth).astype(np.float32)
    transposed_directions = directions.T.astype(np.float32)
    integrals = [
        np.maximum(normal_part @ transposed_directions, 0.0) @ radiance
        for normal_part in np.array_split(normals, 16)
    ]
    return np.concatenate(integrals).reshape(len(height), len(azimuth), bands)


def _normals() -> tuple[Array, Array]:
    """Heights and azimuths of the irradiance table."""
    tilts, azimuths = round(180.0 / NORMAL_STEP_DEG) + 1, round(360.0 / NORMAL_STEP_DEG) + 1
    return 0.5 * np.pi - np.linspace(0.0, np.pi, tilts), np.linspace(0.0, 2.0 * np.pi, azimuths)


def _directions(height: Array, azimuth: Array) -> Array:
    height, azimuth = np.meshgrid(height, azimuth, indexing="ij")
    cosine = np.cos(height)
    return np.stack(
        [cosine * np.cos(azimuth), cosine * np.sin(azimuth), np.sin(height)], axis=-1
    ).reshape(-1, 3)


def azimuth_turns(direction: Array) -> Array:
    """Return the azimuth from east by north as a fraction of a turn, 0 to 1."""
    return fraction(np.arctan2(direction[:, 1], direction[:, 0]) / (2.0 * np.pi))


def _interpolate(table: Array32, height_fraction: Array, width_fraction: Array) -> Array32:
    """Interpolate a table (row, col, band) linearly at fractions of its height and width, shape
    (point, band).
    """
    rows, columns, bands = table.shape
    row, col = height_fraction * (rows - 1), width_fraction * (columns - 1)
    first_row, first_column = (
        np.minimum(row.astype(np.int64), rows - 2),
        np.minimum(col.astype(np.int64), columns - 2),
    )
    row_fraction, column_fraction = (
        (position - cell).astype(np.float32)[:, None]
        for position, cell in ((row, first_row), (col, first_column))
    )
    cells, first_cell = table.reshape(-1, bands), first_row * columns + first_column
    upper = cells[first_cell]
    upper += column_fraction * (cells[first_cell + 1] - upper)
    lower = cells[first_cell + columns]
    lower += column_fraction * (cells[first_cell + columns + 1] - lower)
    lower -= upper
    lower *= row_fraction
    upper += lower
    return upper


@dataclass(frozen=True)
class SkyImportance:
    """Sampling probabilities of the cells of the environment map, by their light."""

    cumulative: Array  # height by height, shape (cell,)
    per_sr: Array  # shape (height, azimuth), sr-1

    @classmethod
    def of(cls, environment: EnvironmentMap) -> "SkyImportance | None":
        """Return the sampling probabilities of a sky, or None where it is too uniform to gain from
        them.
        """
        if environment.is_dark:
            return None
        corners = environment.radiance_table.sum(axis=2, dtype=np.float64)
        mean = 0.25 * (corners[:-1, :-1] + corners[1:, :-1] + corners[:-1, 1:] + corners[1:, 1:])
        sine = np.sin(np.linspace(0.0, 0.5 * np.pi, len(mean) + 1))
        cell_sr = np.broadcast_to(np.diff(sine)[:, None] * 2.0 * np.pi / mean.shape[1], mean.shape)
        light = mean * cell_sr
        if 2.0 * np.pi * (mean * light).sum() < LIMITS.min_sky_contrast * light.sum() ** 2:
            return None
        probability = light / light.sum()
        return cls(np.cumsum(probability.ravel()), probability / cell_sr)

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Draw unit directions, uniform over the solid angle of each cell, shape (count, 3)."""
        n_heights, n_azimuths = self.per_sr.shape
        cell = np.minimum(
            np.searchsorted(self.cumulative, rng.random(count), side="right"), self.per_sr.size - 1
        )
        sine = np.sin(np.linspace(0.0, 0.5 * np.pi, n_heights + 1))
        row, col = np.divmod(cell, n_azimuths)
        z = sine[row] + rng.random(count) * (sine[row + 1] - sine[row])
        azimuth = 2.0 * np.pi * (col + rng.random(count)) / n_azimuths
        cosine = np.sqrt(np.maximum(1.0 - z**2, 0.0))
        return np.column_stack([cosine * np.cos(azimuth), cosine * np.sin(azimuth), z])

    def density(self, direction: Array) -> Array:
        """Return the density of `draw` in unit directions (ray, 3), sr-1, zero below the
        horizon.
        """
        n_heights, n_azimuths = self.per_sr.shape
        row = np.arcsin(np.clip(direction[:, 2], 0.0, 1.0)) / (0.5 * np.pi) * n_heights
        col = azimuth_turns(direction) * n_azimuths
        cell = (
            np.minimum(row.astype(np.int64), n_heights - 1),
            np.minimum(col.astype(np.int64), n_azimuths - 1),
        )
        return np.where(direction[:, 2] >= 0.0, self.per_sr[cell], 0.0)


def sky_arrays(environment: EnvironmentMap, importance: SkyImportance | None) -> tuple:
    """Return tables, whether there is light, probabilities (empty without importance sampling) and
    sines of heights.
    """
    cumulative, per_sr = (
        (np.zeros(0), np.zeros((0, 0)))
        if importance is None
        else (importance.cumulative, importance.per_sr)
    )
    sines = np.sin(np.linspace(0.0, 0.5 * np.pi, len(per_sr) + 1))
    return (
        environment.radiance_table,
        environment.irradiance_table,
        not environment.is_dark,
        cumulative,
        per_sr,
        sines,
    )


@numba.njit(**INLINED)
def sky_light(
    table: Any, x: float, y: float, z: float, fraction: float, weight: Any, total: Any
) -> None:
    """Add a fraction of the radiance from a unit direction above the horizon, weighted by band."""
    _add(table, np.arcsin(min(z, 1.0)) / (0.5 * np.pi), x, y, fraction, weight, total)


@numba.njit(**INLINED)
def sky_irradiance(
    table: Any, x: float, y: float, z: float, fraction: float, weight: Any, total: Any
) -> None:
    """Add a fraction of the unoccluded sky irradiance of a surface with a unit normal, weighted by
    band.
    """
    _add(table, np.arccos(min(max(z, -1.0), 1.0)) / np.pi, x, y, fraction, weight, total)


@numba.njit(**INLINED)
def _add(
    table: Any, height_fraction: float, x: float, y: float, fraction: float, weight: Any, total: Any
) -> None:
    """Add the interpolated value of a table at a fraction of its height and the azimuth of a
    direction.
    """
    rows, columns, bands = table.shape
    row, col = height_fraction * (rows - 1), np.arctan2(y, x) / (2.0 * np.pi)
    col = (col - np.floor(col)) * (columns - 1)
    first_row, first_column = min(int(row), rows - 2), min(int(col), columns - 2)
    row_fraction, column_fraction = row - first_row, col - first_column
    for band in range(bands):
        upper = (
            table[first_row, first_column, band] * (1.0 - column_fraction)
            + table[first_row, first_column + 1, band] * column_fraction
        )
        lower = (
            table[first_row + 1, first_column, band] * (1.0 - column_fraction)
            + table[first_row + 1, first_column + 1, band] * column_fraction
        )
        total[band] += (
            fraction * weight[band] * (upper * (1.0 - row_fraction) + lower * row_fraction)
        )


@numba.njit(**INLINED)
def sky_density(per_sr: Any, x: float, y: float, z: float) -> float:
    """Return the density with which `draw_sky_direction` draws a unit direction above the
    horizon, sr-1; zero without any.
    """
    n_heights, n_azimuths = per_sr.shape
    if n_heights == 0:
        return 0.0
    col = np.arctan2(y, x) / (2.0 * np.pi)
    row = min(int(np.arcsin(min(z, 1.0)) / (0.5 * np.pi) * n_heights), n_heights - 1)
    return per_sr[row, min(int((col - np.floor(col)) * n_azimuths), n_azimuths - 1)]


@numba.njit(**INLINED)
def draw_sky_direction(
    cumulative: Any, sines: Any, a: float, b: float, c: float, direction: Any
) -> None:
    """Set a direction drawn by the brightness of the sky, from three uniform numbers."""
    n_azimuths = len(cumulative) // (len(sines) - 1)
    cell = min(np.searchsorted(cumulative, a, side="right"), len(cumulative) - 1)
    row, col = cell // n_azimuths, cell % n_azimuths
    direction[2] = sines[row] + b * (sines[row + 1] - sines[row])
    azimuth, cosine = (
        2.0 * np.pi * (col + c) / n_azimuths,
        np.sqrt(max(1.0 - direction[2] ** 2, 0.0)),
    )
    direction[0], direction[1] = cosine * np.cos(azimuth), cosine * np.sin(azimuth)
