"""Light sources as plain arrays for compiled loops: sky by direction, intensity distributions of lamps."""

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from simulate.radiance.geometry.embree import COMPILED, INLINED
from simulate.radiance.integrator.environment_map import EnvironmentMap, SkyImportance
from simulate.radiance.integrator.light_sources import DiscLight, LampLight, Panels
from simulate.radiance.integrator.path_states import in_disc, set_direction
from simulate.radiance.integrator.shading_points import shading_frames
from simulate.radiance.lamps.distribution import Cosine, Distribution, Isotropic, MeasuredDistribution, SpotBeam

# Arrays of the sky: radiance and irradiance tables, whether there is any light, cumulative probabilities and densities
# of the importance sampling, and the sines of the heights.
Sky = tuple[NDArray, NDArray, bool, NDArray, NDArray, NDArray]


def sky_arrays(environment: EnvironmentMap, bright: SkyImportance | None) -> Sky:
    """Return the sky for compiled loops; empty probabilities where it is not importance-sampled."""
    cumulated, per_sr = (np.zeros(0), np.zeros((0, 0))) if bright is None else (bright.cumulated, bright.per_sr)
    sines = np.sin(np.linspace(0.0, 0.5 * np.pi, len(per_sr) + 1))
    return environment.radiance_table, environment.irradiance_table, not environment.dark, cumulated, per_sr, sines


def disc_arrays(discs: tuple[DiscLight, ...], bands: int) -> tuple[NDArray, NDArray, NDArray]:
    """Return axes with z towards the centre (disc, 3, 3), cosines of radii (disc,) and irradiances (disc, band)."""
    axes = np.array([shading_frames(disc.direction[None])[0] for disc in discs]).reshape(-1, 3, 3)
    least = np.array([np.cos(disc.angular_radius_rad) for disc in discs])
    return axes, least, np.array([disc.irradiance for disc in discs], np.float32).reshape(-1, bands)


def lamp_arrays(lamps: tuple[LampLight, ...], bands: int) -> tuple:
    """Return positions, radii, spectra and their sums, and the distributions' axes and concatenated tables."""
    tables = [_pattern(lamp.pattern.distribution) for lamp in lamps]
    ends = np.cumsum([0, *(len(table) for table in tables)])
    return (
        np.array([lamp.position_m for lamp in lamps], float).reshape(-1, 3),
        np.array([lamp.radius_m for lamp in lamps], float),
        np.array([lamp.spectrum for lamp in lamps], np.float32).reshape(-1, bands),
        np.array([float(lamp.spectrum.sum()) for lamp in lamps]),
        np.array([lamp.pattern.frame for lamp in lamps], float).reshape(-1, 3, 3),
        ends,
        np.concatenate([*tables, np.zeros(0)]),
    )


def panel_arrays(panels: Panels | None, bands: int) -> tuple:
    """Return the arrays of emitting triangles, see `Panels`; empty ones without any."""
    if panels is None:
        nothing, no_face = np.zeros(0), np.zeros(0, np.int64)
        return (
            nothing,
            no_face,
            np.zeros((0, 3, 3)),
            np.zeros((0, 3)),
            nothing,
            no_face,
            np.zeros((0, bands), np.float32),
        )
    return (
        panels.cumulated,
        panels.face,
        panels.corners_m,
        panels.normal,
        panels.per_m2_of_face,
        panels.kind_of_face,
        panels.spectra,
    )


EVERYWHERE, POWER, MEASURED = 0.0, 1.0, 2.0
# Shadow rays end before their source, at this fraction of the distance.
SHORT = 1.0 - 1e-4


def _pattern(distribution: Distribution) -> NDArray[np.float64]:
    """Encode a distribution: its kind, then factor and power, or sizes, angles and intensities of a table."""
    match distribution:
        case Isotropic():
            return np.array([EVERYWHERE, 0.25 / np.pi])
        case Cosine():
            return np.array([POWER, 1.0 / np.pi, 1.0])
        case SpotBeam():
            return np.array([POWER, (distribution.power + 1.0) / (2.0 * np.pi), distribution.power])
        case MeasuredDistribution():
            polar, azimuth, candela = distribution.polar_deg, distribution.azimuth_deg, distribution.candela
            head = [MEASURED, 1.0 / distribution.integral, float(len(polar)), float(len(azimuth))]
            return np.concatenate([head, polar, azimuth, candela.ravel()])
    raise TypeError(f"no compiled loop knows {type(distribution).__name__}")


@numba.njit(**INLINED)
def lamp_factor(lamps: Any, lamp: int, place: Any, normal: Any) -> float:
    """Return the unoccluded irradiance of a lamp over its spectrum, as `direct.lamp_factor`."""
    position, _, _, _, axes, ends, tables = lamps
    x, y, z = (position[lamp, 0] - place[0], position[lamp, 1] - place[1], position[lamp, 2] - place[2])
    square = x * x + y * y + z * z
    distance = np.sqrt(square)
    cosine = (x * normal[0] + y * normal[1] + z * normal[2]) / distance
    if not cosine > 0.0:
        return 0.0
    pattern = tables[ends[lamp] : ends[lamp + 1]]
    return cosine * lamp_pattern(pattern, axes[lamp], -x / distance, -y / distance, -z / distance) / square


@numba.njit(**INLINED)
def towards_lamp(lamps: Any, lamp: int, place: Any, state: Any, way: Any) -> None:
    """Set the vector from a point to one drawn on a lamp."""
    position, radius, square = lamps[0][lamp], lamps[1][lamp], 0.0
    for axis in range(3):
        way[axis] = position[axis] - place[axis]
        square += way[axis] ** 2
    distance = np.sqrt(square)
    middle = (way[0] / distance, way[1] / distance, way[2] / distance)
    square, along, across = in_disc(state)
    off = radius * np.sqrt(square)
    set_direction(middle, off * along, off * across, distance, way)


@numba.njit(**INLINED)
def lamp_pattern(pattern: Any, axes: Any, x: float, y: float, z: float) -> float:
    """Return the fraction of a lamp's light per sr in a unit direction away from it."""
    up = axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z
    if pattern[0] == EVERYWHERE:
        return pattern[1]
    if pattern[0] == POWER:
        return pattern[1] * up ** pattern[2] if up > 0.0 else 0.0
    first = axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z
    second = axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z
    polar = np.rad2deg(np.arccos(min(max(up, -1.0), 1.0)))
    azimuth = np.rad2deg(np.arctan2(second, first)) % 360.0
    heights, around = int(pattern[2]), int(pattern[3])
    polars, azimuths = pattern[4 : 4 + heights], pattern[4 + heights : 4 + heights + around]
    candela = pattern[4 + heights + around :]
    if polar < polars[0] or polar > polars[-1]:
        return 0.0
    last = azimuths[-1]
    if last <= 180.0 and azimuth > 180.0:
        azimuth = 360.0 - azimuth
    if last <= 90.0 and azimuth > 90.0:
        azimuth = 180.0 - azimuth
    col, along = _cell(polars, polar)
    row, across = (0, 0.0) if around == 1 else _cell(azimuths, azimuth)
    following = min(row + 1, around - 1)
    near = candela[row * heights + col] * (1.0 - along) + candela[row * heights + col + 1] * along
    far = candela[following * heights + col] * (1.0 - along) + candela[following * heights + col + 1] * along
    return pattern[1] * (near * (1.0 - across) + far * across)


@numba.njit(**COMPILED)
def _cell(values: Any, value: float) -> Any:
    """Return the interval of ascending values that contains a value, and the relative position in it."""
    at = min(max(np.searchsorted(values, value, side="right") - 1, 0), len(values) - 2)
    return at, (value - values[at]) / (values[at + 1] - values[at])


@numba.njit(**INLINED)
def sky_light(table: Any, x: float, y: float, z: float, share: float, weight: Any, found: Any) -> None:
    """Add a fraction of the radiance from a unit direction above the horizon, weighted by band."""
    _add(table, np.arcsin(min(z, 1.0)) / (0.5 * np.pi), x, y, share, weight, found)


@numba.njit(**INLINED)
def sky_irradiance(table: Any, x: float, y: float, z: float, share: float, weight: Any, found: Any) -> None:
    """Add a fraction of the unoccluded sky irradiance of a surface with a unit normal, weighted by band."""
    _add(table, np.arccos(min(max(z, -1.0), 1.0)) / np.pi, x, y, share, weight, found)


@numba.njit(**INLINED)
def _add(table: Any, down: float, x: float, y: float, share: float, weight: Any, found: Any) -> None:
    """Add the interpolated value of a table at a fraction of its height and the azimuth of a direction."""
    rows, columns, bands = table.shape
    row, col = down * (rows - 1), np.arctan2(y, x) / (2.0 * np.pi)
    col = (col - np.floor(col)) * (columns - 1)
    top, left = min(int(row), rows - 2), min(int(col), columns - 2)
    below, right = row - top, col - left
    for band in range(bands):
        upper = table[top, left, band] * (1.0 - right) + table[top, left + 1, band] * right
        lower = table[top + 1, left, band] * (1.0 - right) + table[top + 1, left + 1, band] * right
        found[band] += share * weight[band] * (upper * (1.0 - below) + lower * below)


@numba.njit(**INLINED)
def bright_density(per_sr: Any, x: float, y: float, z: float) -> float:
    """Return the density with which `bright_way` draws a unit direction above the horizon, sr-1; zero without any."""
    heights, around = per_sr.shape
    if heights == 0:
        return 0.0
    col = np.arctan2(y, x) / (2.0 * np.pi)
    row = min(int(np.arcsin(min(z, 1.0)) / (0.5 * np.pi) * heights), heights - 1)
    return per_sr[row, min(int((col - np.floor(col)) * around), around - 1)]


@numba.njit(**INLINED)
def bright_way(cumulated: Any, sines: Any, a: float, b: float, c: float, way: Any) -> None:
    """Set a direction drawn by the brightness of the sky, from three uniform numbers."""
    around = len(cumulated) // (len(sines) - 1)
    cell = min(np.searchsorted(cumulated, a, side="right"), len(cumulated) - 1)
    row, col = cell // around, cell % around
    way[2] = sines[row] + b * (sines[row + 1] - sines[row])
    turn, flat = 2.0 * np.pi * (col + c) / around, np.sqrt(max(1.0 - way[2] ** 2, 0.0))
    way[0], way[1] = flat * np.cos(turn), flat * np.sin(turn)
