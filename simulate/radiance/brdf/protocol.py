"""Bidirectional reflectance distribution functions: protocol, Lambert's law, measured tables, and
sampling.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol
from zipfile import BadZipFile

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata.errors import BadInput
from labdata.file_io import require_regular
from labdata.frames import read_only
from simulate.arrays import Array


class Brdf(Protocol):
    """Bidirectional reflectance distribution function of a surface that is the same in all
    azimuths.

    Notes
    -----
    f(i, o) = f(o, i), and int f cos(i) di <= 1 for every o. A direction at or below the surface
    gives zero.
    """

    def value(self, incoming: Array, outgoing: Array, wavelength_nm: ArrayLike) -> Array:
        """Return f for directions (ray, 3) to light and viewer at wavelengths (band,), sr-1, shape
        (band, ray).
        """
        ...

    def sample(self, outgoing: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw a direction to the light for each direction (ray, 3) to the viewer; return them, and
        densities as `pdf`.

        Some may lie below the surface, where `value` is zero.
        """
        ...

    def pdf(self, incoming: Array, outgoing: Array) -> Array:
        """Return the probability density of `sample`, sr-1, shape (ray,)."""
        ...

    def albedo(self, outgoing: Array, wavelength_nm: ArrayLike) -> Array:
        """Return the fraction of a uniform sky's light that goes to the viewer, int f cos(i) di,
        shape (band, ray).
        """
        ...


@dataclass(frozen=True, kw_only=True)
class Reflectance:
    """Fraction of light over wavelength, linear between the given values and constant outside."""

    wavelength_nm: tuple[float, ...] = (550.0,)  # wavelengths, ascending, nm; one makes a grey
    fraction: tuple[float, ...] = (0.0,)  # fraction at each, 0 to 1, dimensionless

    def __post_init__(self) -> None:
        if not self.wavelength_nm or len(self.wavelength_nm) != len(self.fraction):
            raise BadInput(
                f"a reflectance must have one fraction per wavelength, got "
                f"{len(self.wavelength_nm)} wavelengths and {len(self.fraction)} fractions"
            )
        if any(b <= a for a, b in zip(self.wavelength_nm, self.wavelength_nm[1:], strict=False)):
            raise BadInput(f"a material's wavelengths must ascend, got {list(self.wavelength_nm)}")
        for fraction in self.fraction:
            if not 0.0 <= fraction <= 1.0:
                raise BadInput(f"a fraction of light must lie in [0, 1], got {fraction:g}")

    def at(self, wavelength_nm: ArrayLike) -> Array:
        """Return the fraction at wavelengths, dimensionless, shape (band,)."""
        return np.interp(
            np.atleast_1d(np.asarray(wavelength_nm, float)), self.wavelength_nm, self.fraction
        )


def grey(reflectance: float) -> Reflectance:
    """Return the same reflectance at all wavelengths."""
    return Reflectance(fraction=(reflectance,))


def both_above(incoming: Array, outgoing: Array) -> Array:
    """Return 1 where both directions lie above the surface and 0 elsewhere, shape (ray,)."""
    return ((incoming[:, 2] > 0.0) & (outgoing[:, 2] > 0.0)).astype(float)


def cosine_directions(count: int, rng: np.random.Generator) -> Array:
    """Draw directions with density cos/pi, shape (count, 3)."""
    square, azimuth = rng.random(count), 2.0 * np.pi * rng.random(count)
    radius = np.sqrt(square)
    return np.column_stack(
        [radius * np.cos(azimuth), radius * np.sin(azimuth), np.sqrt(1.0 - square)]
    )


def cosine_density(incoming: Array) -> Array:
    """Return cos/pi, sr-1, zero below the surface, shape (ray,)."""
    return np.maximum(incoming[:, 2], 0.0) / np.pi


def directions_at_cosine(cosine: Array) -> Array:
    """Return unit vectors (x, 0, z) with z given, shape (ray, 3)."""
    sine = np.sqrt(np.maximum(1.0 - np.square(cosine), 0.0))
    return np.asarray(np.column_stack([sine, np.zeros_like(sine), cosine]), float)


class CosineSampled:
    """Sampling by the cosine law, for BRDFs without a lobe."""

    def sample(self, outgoing: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        direction = cosine_directions(len(outgoing), rng)
        return direction, cosine_density(direction)

    def pdf(self, incoming: Array, outgoing: Array) -> Array:
        """Return cos(i) / pi."""
        return cosine_density(incoming)


@dataclass(frozen=True, kw_only=True)
class Lambert(CosineSampled):
    """Lambert's law, f = rho / pi."""

    reflectance: Reflectance

    def value(self, incoming: Array, outgoing: Array, wavelength_nm: ArrayLike) -> Array:
        return self.reflectance.at(wavelength_nm)[:, None] / np.pi * both_above(incoming, outgoing)

    def albedo(self, outgoing: Array, wavelength_nm: ArrayLike) -> Array:
        """Return rho, shape (band, ray)."""
        return self.reflectance.at(wavelength_nm)[:, None] * np.ones(len(outgoing))


# Largest deviation from f(i, o) = f(o, i), as a fraction of the largest value.
ASYMMETRY = 0.05
# Largest excess of the albedo over 1, for rounding of measured values.
EXCESS = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredTable(CosineSampled):
    """An isotropic BRDF, linear between the table's angles and wavelengths.

    Raises
    ------
    BadInput
        If the table is not reciprocal within 5 % of its largest value, depends as much on azimuth
        along the normal, or gives off more light than arrives.

    Notes
    -----
    The mean of f(i, o) and f(o, i) is kept, and along the normal the mean over azimuths, which has
    no meaning there.
    """

    wavelength_nm: Array  # wavelengths, ascending, shape (band,), nm; constant outside
    # Angles of light and viewer from the normal, ascending from 0 to 90, shape (polar,), degrees.
    polar_deg: Array
    # Azimuth between light and viewer, ascending from 0 (both on one side) to 180 (specular side),
    # degrees.
    azimuth_deg: Array
    table: Array  # f, sr-1, shape (band, polar of light, polar of eye, azimuth)
    _albedo: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        axes = [
            np.asarray(axis, float)
            for axis in (self.wavelength_nm, self.polar_deg, self.azimuth_deg)
        ]
        wavelength, polar, azimuth = axes
        table = np.asarray(self.table, float)
        if table.shape != (wavelength.size, polar.size, polar.size, azimuth.size):
            raise BadInput(
                "a measured BRDF must have the shape (band, polar, polar, azimuth) = "
                f"{(wavelength.size, polar.size, polar.size, azimuth.size)}, got {table.shape}"
            )
        for name, axis in zip(("wavelength_nm", "polar_deg", "azimuth_deg"), axes, strict=True):
            if not (np.diff(axis) > 0.0).all():
                raise BadInput(f"{name} of a measured BRDF must ascend")
        if polar[0] != 0.0 or polar[-1] != 90.0 or azimuth[0] != 0.0 or azimuth[-1] != 180.0:
            raise BadInput(
                "polar_deg must run from 0 to 90 and azimuth_deg from 0 to 180, got "
                f"{polar[0]:g} to {polar[-1]:g} and {azimuth[0]:g} to {azimuth[-1]:g}"
            )
        if not np.isfinite(table).all() or table.min() < 0.0:
            raise BadInput("a measured BRDF must be finite and not negative")
        exchanged = table.transpose(0, 2, 1, 3)
        asymmetry = float(np.abs(table - exchanged).max())
        if asymmetry > ASYMMETRY * table.max():
            raise BadInput(
                f"a BRDF must be the same with light and eye exchanged, got a difference of "
                f"{asymmetry:g} sr-1"
            )
        upright = np.concatenate([table[:, 0], table[:, :, 0]], axis=1)
        azimuth_range = float(np.ptp(upright, axis=2).max())
        if azimuth_range > ASYMMETRY * table.max():
            raise BadInput(
                f"a BRDF must not depend on the azimuth of the normal, got a difference of "
                f"{azimuth_range:g} sr-1"
            )
        table = 0.5 * (table + exchanged)
        table[:, 0] = table[:, 0].mean(axis=-1, keepdims=True)
        table[:, :, 0] = table[:, :, 0].mean(axis=-1, keepdims=True)
        arrays = (wavelength, polar, azimuth, table)
        for name, values in zip(
            ("wavelength_nm", "polar_deg", "azimuth_deg", "table"), arrays, strict=True
        ):
            object.__setattr__(self, name, read_only(values))
        object.__setattr__(self, "_albedo", read_only(self._albedos()))
        highest = float(self._albedo.max())
        if highest > 1.0 + EXCESS:
            raise BadInput(
                f"a BRDF must not give off more light than arrives, got {highest:g} of it"
            )

    def value(self, incoming: Array, outgoing: Array, wavelength_nm: ArrayLike) -> Array:
        return self._linear(self._bands(wavelength_nm), incoming, outgoing) * both_above(
            incoming, outgoing
        )

    def albedo(self, outgoing: Array, wavelength_nm: ArrayLike) -> Array:
        column, fraction = _interval(self.polar_deg, _polar_deg(outgoing))
        table = self._at_wavelengths(self._albedo, wavelength_nm)
        return table[:, column] * (1.0 - fraction) + table[:, column + 1] * fraction

    def _bands(self, wavelength_nm: ArrayLike) -> Array:
        """Return the table at wavelengths."""
        return self._at_wavelengths(self.table, wavelength_nm)

    def _at_wavelengths(self, values: Array, wavelength_nm: ArrayLike) -> Array:
        clipped_nm = np.clip(
            np.atleast_1d(np.asarray(wavelength_nm, float)),
            self.wavelength_nm[0],
            self.wavelength_nm[-1],
        )
        if self.wavelength_nm.size == 1:
            return np.repeat(np.asarray(values, float), clipped_nm.size, axis=0)
        band, fraction = _interval(self.wavelength_nm, clipped_nm)
        fraction = fraction.reshape(-1, *[1] * (values.ndim - 1))
        return values[band] * (1.0 - fraction) + values[band + 1] * fraction

    def _linear(self, table: Array, incoming: Array, outgoing: Array) -> Array:
        """Return the table's bands at directions: linear in both polar angles and in azimuth, shape
        (band, ray).
        """
        cells = [
            _interval(self.polar_deg, _polar_deg(incoming)),
            _interval(self.polar_deg, _polar_deg(outgoing)),
            _interval(self.azimuth_deg, _azimuth_between_deg(incoming, outgoing)),
        ]
        total = np.zeros((len(table), len(incoming)))
        for corner in np.ndindex(2, 2, 2):
            weight = np.ones(len(incoming))
            for (_, fraction), is_upper in zip(cells, corner, strict=True):
                weight = weight * (fraction if is_upper else 1.0 - fraction)
            index = [cell + is_upper for (cell, _), is_upper in zip(cells, corner, strict=True)]
            total += weight * table[:, index[0], index[1], index[2]]
        return total

    def _albedos(self) -> Array:
        """Return the albedo towards each polar angle of the table, shape (band, polar).

        It is linear in between, as f is; rings of light are summed by Gauss-Legendre between the
        table's angles.
        """
        azimuth_integral = 2.0 * np.asarray(
            np.trapezoid(self.table, np.deg2rad(self.azimuth_deg), axis=3)
        )
        node, weight = np.polynomial.legendre.leggauss(8)
        edges = np.deg2rad(self.polar_deg)
        half = 0.5 * np.diff(edges)
        total = np.zeros((len(self.table), edges.size))
        for cosine, node_weight in zip(node, weight, strict=True):
            angle = edges[:-1] + half * (cosine + 1.0)
            rise = 0.5 * (cosine + 1.0)
            ring = node_weight * half * np.sin(angle) * np.cos(angle)
            light = azimuth_integral[:, :-1] * (1.0 - rise) + azimuth_integral[:, 1:] * rise
            total += np.einsum("bpo,p->bo", light, ring)
        return total


def _interval(axis: Array, value: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the interval of an ascending axis that each value lies in, and how far along."""
    index = np.clip(np.searchsorted(axis, value, side="right") - 1, 0, axis.size - 2)
    fraction = (value - axis[index]) / (axis[index + 1] - axis[index])
    return index, np.clip(fraction, 0.0, 1.0)


def _polar_deg(direction: Array) -> Array:
    return np.rad2deg(np.arctan2(np.hypot(direction[:, 0], direction[:, 1]), direction[:, 2]))


def _azimuth_between_deg(incoming: Array, outgoing: Array) -> Array:
    sine = incoming[:, 0] * outgoing[:, 1] - incoming[:, 1] * outgoing[:, 0]
    cosine = incoming[:, 0] * outgoing[:, 0] + incoming[:, 1] * outgoing[:, 1]
    return np.rad2deg(np.arctan2(np.abs(sine), cosine))


ARRAYS = ("wavelength_nm", "polar_deg", "azimuth_deg", "table")


def read_measured(path: Path) -> MeasuredTable:
    """Return the BRDF of an .npz file with the arrays of
    `simulate.radiance.brdf.protocol.MeasuredTable`.

    Raises BadInput if the file cannot be read, lacks an array, or the table is not a BRDF.
    """
    require_regular(path, "a measured BRDF")
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: np.asarray(file[name], float) for name in ARRAYS if name in file}
    except (OSError, ValueError, EOFError, AttributeError, BadZipFile):
        raise BadInput(f"a measured BRDF must be a readable .npz file, got {path}") from None
    missing = [name for name in ARRAYS if name not in arrays]
    if missing:
        raise BadInput(
            f"a measured BRDF must hold {', '.join(ARRAYS)}, got no {missing[0]} in {path.name}"
        )
    try:
        return MeasuredTable(**arrays)
    except BadInput as error:
        raise BadInput(f"{error}, in {path.name}") from None
