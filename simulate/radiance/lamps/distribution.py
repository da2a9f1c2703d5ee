"""Lamps, their intensity distributions in the lamp's frame with the axis as z, and photometric
files (IES LM-63).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.file_io import require_regular
from labdata.frames import read_only
from simulate.arrays import Array
from simulate.radiance.spectrum import SourceSpectrum

# How compiled loops know a distribution: its kind, then factor and power, or sizes, angles and
# intensities of a table.
POWER, MEASURED = 1.0, 2.0


class Distribution(Protocol):
    """Fraction of a lamp's light per solid angle."""

    def per_sr(self, direction: Array) -> Array:
        """Return the fraction of the flux per sr in directions (ray, 3), shape (ray,); its integral
        is 1.
        """
        ...

    def encode(self) -> Array:
        """Return the numbers from which `light_sources.lamp_pattern` finds the same."""
        ...


@dataclass(frozen=True, kw_only=True)
class Isotropic:
    """The same in all directions."""

    def per_sr(self, direction: Array) -> Array:
        """Return 1/(4 pi), sr-1."""
        return np.full(len(direction), 0.25 / np.pi)

    def encode(self) -> Array:
        return np.array([POWER, 0.25 / np.pi, 0.0])


@dataclass(frozen=True, kw_only=True)
class Cosine:
    """A Lambertian emitter: the cosine of the angle from the axis."""

    def per_sr(self, direction: Array) -> Array:
        """Return cos/pi, sr-1, zero behind."""
        return np.maximum(direction[:, 2], 0.0) / np.pi

    def encode(self) -> Array:
        return np.array([POWER, 1.0 / np.pi, 1.0])


@dataclass(frozen=True, kw_only=True)
class SpotBeam:
    """A beam, cos^m of the angle from the axis; `half_angle_deg` is that at half intensity."""

    half_angle_deg: float

    def __post_init__(self) -> None:
        if not 0.1 <= self.half_angle_deg < 90.0:
            raise BadInput(f"half_angle_deg must lie in [0.1, 90), got {self.half_angle_deg:g}")

    @property
    def power(self) -> float:
        """m of cos^m, dimensionless."""
        return float(np.log(0.5) / np.log(np.cos(np.deg2rad(self.half_angle_deg))))

    def per_sr(self, direction: Array) -> Array:
        """Return (m + 1)/(2 pi) cos^m, sr-1, zero behind."""
        return (self.power + 1.0) / (2.0 * np.pi) * np.maximum(direction[:, 2], 0.0) ** self.power

    def encode(self) -> Array:
        return np.array([POWER, (self.power + 1.0) / (2.0 * np.pi), self.power])


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredDistribution:
    """Measured intensities, as in goniophotometer and IES files."""

    # Angles from the axis, ascending from 0 or more to at most 180, shape (polar,), degrees; dark
    # outside.
    polar_deg: Array
    # Angles around it from the frame's x towards its y, ascending from 0, shape (azimuth,),
    # degrees: one angle for a lamp that is the same all around, else up to 90 or 180 (mirrored) or
    # 360.
    azimuth_deg: Array
    candela: Array  # intensities in any unit, shape (azimuth, polar)

    def __post_init__(self) -> None:
        polar, azimuth = np.asarray(self.polar_deg, float), np.asarray(self.azimuth_deg, float)
        candela = np.asarray(self.candela, float)
        if candela.shape != (azimuth.size, polar.size):
            raise BadInput(
                f"candela must have the shape (azimuth, polar) = ({azimuth.size}, {polar.size}), "
                f"got {candela.shape}"
            )
        if (
            polar.size < 2
            or not (np.diff(polar) > 0.0).all()
            or polar[0] < 0.0
            or polar[-1] > 180.0
        ):
            raise BadInput("polar_deg must ascend within [0, 180] and have at least two angles")
        if (
            not (np.diff(azimuth) > 0.0).all()
            or azimuth[0] != 0.0
            or azimuth[-1] not in (0.0, 90.0, 180.0, 360.0)
        ):
            raise BadInput(
                f"azimuth_deg must ascend from 0 to 0, 90, 180 or 360, got {azimuth.tolist()}"
            )
        if not np.isfinite(candela).all() or candela.min() < 0.0 or not candela.max() > 0.0:
            raise BadInput("candela must be finite, not negative, and somewhere positive")
        for name, values in (("polar_deg", polar), ("azimuth_deg", azimuth), ("candela", candela)):
            object.__setattr__(self, name, read_only(values))

    def encode(self) -> Array:
        head = [
            MEASURED,
            1.0 / self.integral,
            float(self.polar_deg.size),
            float(self.azimuth_deg.size),
        ]
        return np.concatenate([head, self.polar_deg, self.azimuth_deg, self.candela.ravel()])

    def per_sr(self, direction: Array) -> Array:
        """Return the fraction of the flux per sr, linear in both angles between the table's."""
        polar = np.rad2deg(np.arccos(np.clip(direction[:, 2], -1.0, 1.0)))
        azimuth = np.rad2deg(np.arctan2(direction[:, 1], direction[:, 0])) % 360.0
        return self._candela(polar, azimuth) / self.integral

    def _candela(self, polar: Array, azimuth: Array) -> Array:
        column = np.clip(
            np.searchsorted(self.polar_deg, polar, side="right") - 1, 0, self.polar_deg.size - 2
        )
        polar_fraction = (polar - self.polar_deg[column]) / np.diff(self.polar_deg)[column]
        in_range = (polar >= self.polar_deg[0]) & (polar <= self.polar_deg[-1])
        row, row_fraction = self._row(azimuth)
        next_row = np.minimum(row + 1, self.azimuth_deg.size - 1)
        row_candela = (
            self.candela[row, column] * (1.0 - polar_fraction)
            + self.candela[row, column + 1] * polar_fraction
        )
        next_candela = (
            self.candela[next_row, column] * (1.0 - polar_fraction)
            + self.candela[next_row, column + 1] * polar_fraction
        )
        return np.where(
            in_range, row_candela * (1.0 - row_fraction) + next_candela * row_fraction, 0.0
        )

    def _row(self, azimuth: Array) -> tuple[NDArray[np.intp], Array]:
        last_azimuth = self.azimuth_deg[-1]
        if last_azimuth == 0.0:
            return np.zeros(azimuth.shape, np.intp), np.zeros(azimuth.shape)
        folded_azimuth = azimuth
        if last_azimuth <= 180.0:
            folded_azimuth = np.where(
                folded_azimuth > 180.0, 360.0 - folded_azimuth, folded_azimuth
            )
        if last_azimuth <= 90.0:
            folded_azimuth = np.where(folded_azimuth > 90.0, 180.0 - folded_azimuth, folded_azimuth)
        row = np.clip(
            np.searchsorted(self.azimuth_deg, folded_azimuth, side="right") - 1,
            0,
            self.azimuth_deg.size - 2,
        )
        return row, (folded_azimuth - self.azimuth_deg[row]) / np.diff(self.azimuth_deg)[row]

    @cached_property
    def integral(self) -> float:
        """Integral of the intensities over all directions, lumens where they are candela: exact in
        azimuth, by midpoints in the polar angle.
        """
        edges = np.linspace(self.polar_deg[0], self.polar_deg[-1], 3600)
        centre = 0.5 * (edges[1:] + edges[:-1])
        ring = np.cos(np.deg2rad(edges[:-1])) - np.cos(np.deg2rad(edges[1:]))
        if self.azimuth_deg.size == 1:
            mean_candela = self.candela[0]
        else:
            mean_candela = (
                np.trapezoid(self.candela, self.azimuth_deg, axis=0) / self.azimuth_deg[-1]
            )
        return float(2.0 * np.pi * np.sum(np.interp(centre, self.polar_deg, mean_candela) * ring))


# Beams by name, made from a scene's lamp (`LampPlacement`).
BEAMS: dict[str, Callable[[Any], Distribution]] = {
    "isotropic": lambda lamp: Isotropic(),
    "cosine": lambda lamp: Cosine(),
    "spot": lambda lamp: SpotBeam(half_angle_deg=lamp.half_angle_deg),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Lamp:
    """Radiant flux, W over wavelength, and intensity distribution of a lamp, without a position; z
    is its axis.
    """

    flux: SourceSpectrum
    distribution: Distribution = field(default_factory=Isotropic)


# Most angles and bytes of a valid file.
MOST_ANGLES = 20_000
LARGEST_BYTES = 16_000_000
TYPE_C = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Photometry:
    """Photometry of a lamp from a file."""

    table: MeasuredDistribution  # its intensities over direction
    # its luminous flux: the integral of the intensities with all factors of the file, lm
    lumens: float


def read_ies(path: str | Path) -> Photometry:
    """Return the photometry of a file.

    Read: IES LM-63 editions of 1986, 1991, 1995, 2002 and 2019, photometry of type C, and no
    correction for tilt. The lamp shines along its axis at vertical angle 0; horizontal angles grow
    from the plane C0 counterclockwise as seen from above a lamp that shines down. Not read: types A
    and B, as floodlights and cars have, and tilt factors but 1.

    Raises BadInput if the file cannot be read, breaks the form, or needs what is not read here.
    """
    path = Path(path)
    require_regular(path, "a lamp's photometry")
    try:
        data = path.read_bytes()
    except OSError:
        raise BadInput(f"a lamp's photometry must be a readable file, got {path}") from None
    if len(data) > LARGEST_BYTES:
        raise BadInput(
            f"a lamp's photometry must not be larger than {LARGEST_BYTES} bytes, got {len(data)} "
            f"in {path}"
        )
    try:
        return parse_photometry(data.decode("latin-1"))
    except BadInput as error:
        raise BadInput(f"{error}, in {path.name}") from None


def parse_photometry(text: str) -> Photometry:
    """Return the photometry of a file's text."""
    numbers = _Numbers(_after_tilt(text.splitlines()))
    lamps, lumens_each, multiplier, polar_count, azimuth_count, kind, unit = numbers.take("head", 7)
    numbers.take("sizes of the luminous opening", 3)
    ballast, _, _ = numbers.take("ballast factor, future use and watts", 3)
    if kind != TYPE_C:
        raise BadInput(f"photometry must be of type C (1), got {kind:g}")
    if unit not in (1.0, 2.0):
        raise BadInput(f"the unit of sizes must be 1 (feet) or 2 (metres), got {unit:g}")
    for name, value in (("candela multiplier", multiplier), ("ballast factor", ballast)):
        if not value > 0.0:
            raise BadInput(f"the {name} must be positive, got {value:g}")
    if lamps < 1.0 or (lumens_each < 0.0 and lumens_each != -1.0):
        raise BadInput(
            f"a file must state lamps and their lumens, or -1, got {lamps:g} of {lumens_each:g} lm"
        )
    polar = numbers.take("vertical angles", _count("vertical angles", polar_count))
    azimuth = numbers.take("horizontal angles", _count("horizontal angles", azimuth_count))
    candela = numbers.take("candela", polar.size * azimuth.size).reshape(azimuth.size, polar.size)
    numbers.end()
    azimuths, intensities = _from_zero(azimuth, candela)
    table = MeasuredDistribution(
        polar_deg=polar, azimuth_deg=azimuths, candela=intensities * multiplier * ballast
    )
    return Photometry(table=table, lumens=table.integral)


def _after_tilt(lines: list[str]) -> Iterator[str]:
    """Return the lines after the keywords; raise BadInput if there is a correction for tilt."""
    for number, line in enumerate(lines):
        text = line.strip()
        if text.upper().startswith("TILT"):
            tilt = text.partition("=")[2].strip().upper()
            if tilt == "NONE":
                return iter(lines[number + 1 :])
            if tilt == "INCLUDE":
                return _without_tilt(lines[number + 1 :])
            raise BadInput(f"TILT must be NONE or INCLUDE, got {text[:40]!r}")
    raise BadInput("a photometric file must have a line TILT=, got none")


def _without_tilt(lines: list[str]) -> Iterator[str]:
    numbers = _Numbers(iter(lines))
    _, count = numbers.take("geometry and number of tilts", 2)
    pairs = _count("tilts", count)
    numbers.take("angles of tilt", pairs)
    factors = numbers.take("factors of tilt", pairs)
    if (factors != 1.0).any():
        raise BadInput(
            f"a lamp's light must not depend on its tilt, got factors of {factors.min():g} to "
            f"{factors.max():g}"
        )
    return numbers.lines


class _Numbers:
    """Reader of numbers that are separated by blanks or commas, over several lines."""

    def __init__(self, lines: Iterator[str]) -> None:
        self.lines = lines
        self._held: list[str] = []

    def take(self, quantity: str, count: int) -> Array:
        while len(self._held) < count:
            line = next(self.lines, None)
            if line is None:
                raise BadInput(
                    f"a photometric file must hold {count} numbers for {quantity}, got "
                    f"{len(self._held)}"
                )
            self._held += line.replace(",", " ").split()
        words, self._held = self._held[:count], self._held[count:]
        try:
            numbers = np.array([float(word) for word in words])
        except ValueError:
            raise BadInput(f"{quantity} must be numbers, got {' '.join(words)[:60]!r}") from None
        if not np.isfinite(numbers).all():
            raise BadInput(f"{quantity} must be finite, got {' '.join(words)[:60]!r}")
        return numbers

    def end(self) -> None:
        remaining_words = [*self._held, *(word for line in self.lines for word in line.split())]
        if remaining_words:
            raise BadInput(
                f"a photometric file must end after its candela, got {len(remaining_words)} more"
            )


def _count(quantity: str, number: float) -> int:
    if not (1 <= number <= MOST_ANGLES and number == int(number)):
        raise BadInput(
            f"the number of {quantity} must be whole and within 1 to {MOST_ANGLES}, got {number:g}"
        )
    return int(number)


def _from_zero(azimuth: Array, candela: Array) -> tuple[Array, Array]:
    """Return horizontal angles from 0: a lamp given from 90 to 270 deg is symmetric about that
    plane.
    """
    if (azimuth[0], azimuth[-1]) != (90.0, 270.0):
        return azimuth, candela
    mirror_azimuth = (180.0 - azimuth) % 360.0
    all_azimuths = np.concatenate([azimuth, mirror_azimuth])
    angles, indices = np.unique(all_azimuths, return_index=True)
    rows = np.concatenate([candela, candela])[indices]
    if angles[0] != 0.0:
        # Between the last angle and 360 + the first lies 0: by both, linearly.
        last_weight = angles[0] / (360.0 - angles[-1] + angles[0])
        angles = np.concatenate([[0.0], angles])
        rows = np.concatenate([[(1.0 - last_weight) * rows[0] + last_weight * rows[-1]], rows])
    return np.append(angles, 360.0), np.concatenate([rows, rows[:1]])
