"""Photometric files of lamps: IES LM-63 (.ies).

Read: editions of 1986, 1991, 1995, 2002 and 2019, photometry of type C, and no correction for tilt. The lamp shines
along its axis at vertical angle 0; horizontal angles grow from the plane C0 counterclockwise as seen from above a lamp
that shines down. Not read: types A and B, as floodlights and cars have, and corrections for tilt other than 1.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.radiance.lamps.distribution import MeasuredDistribution

# Most angles and bytes of a valid file.
MOST_ANGLES = 20_000
LARGEST_BYTES = 16_000_000
TYPE_C = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Photometry:
    """Photometry of a lamp from a file.

    Parameters
    ----------
    table
        Its intensities over direction.
    lumens
        Its luminous flux: the integral of the intensities with all factors of the file, lm.
    """

    table: MeasuredDistribution
    lumens: float


def read_ies(path: str | Path) -> Photometry:
    """Return the photometry of a file.

    Raises
    ------
    BadInput
        If the file cannot be read, breaks the form, or needs what is not read here.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError:
        raise BadInput(f"a lamp's photometry must be a readable file, got {path}") from None
    if len(data) > LARGEST_BYTES:
        raise BadInput(f"a lamp's photometry must not be larger than {LARGEST_BYTES} bytes, got {len(data)} in {path}")
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
        raise BadInput(f"a file must state lamps and their lumens, or -1, got {lamps:g} of {lumens_each:g} lm")
    polar = numbers.take("vertical angles", _count("vertical angles", polar_count))
    azimuth = numbers.take("horizontal angles", _count("horizontal angles", azimuth_count))
    candela = numbers.take("candela", polar.size * azimuth.size).reshape(azimuth.size, polar.size)
    numbers.end()
    around, intensities = _from_zero(azimuth, candela)
    table = MeasuredDistribution(polar_deg=polar, azimuth_deg=around, candela=intensities * multiplier * ballast)
    return Photometry(table=table, lumens=table.integral)


def _after_tilt(lines: list[str]) -> Iterator[str]:
    """Return the lines after the keywords; raise BadInput if there is a correction for tilt."""
    for number, line in enumerate(lines):
        said = line.strip()
        if said.upper().startswith("TILT"):
            what = said.partition("=")[2].strip().upper()
            if what == "NONE":
                return iter(lines[number + 1 :])
            if what == "INCLUDE":
                return _without_tilt(lines[number + 1 :])
            raise BadInput(f"TILT must be NONE or INCLUDE, got {said[:40]!r}")
    raise BadInput("a photometric file must have a line TILT=, got none")


def _without_tilt(lines: list[str]) -> Iterator[str]:
    numbers = _Numbers(iter(lines))
    _, count = numbers.take("geometry and number of tilts", 2)
    pairs = _count("tilts", count)
    numbers.take("angles of tilt", pairs)
    factors = numbers.take("factors of tilt", pairs)
    if (factors != 1.0).any():
        raise BadInput(
            f"a lamp's light must not depend on its tilt, got factors of {factors.min():g} to {factors.max():g}"
        )
    return numbers.lines


class _Numbers:
    """Reader of numbers that are separated by blanks or commas, over several lines."""

    def __init__(self, lines: Iterator[str]) -> None:
        self.lines = lines
        self._held: list[str] = []

    def take(self, what: str, count: int) -> NDArray[np.float64]:
        while len(self._held) < count:
            line = next(self.lines, None)
            if line is None:
                raise BadInput(f"a photometric file must hold {count} numbers for {what}, got {len(self._held)}")
            self._held += line.replace(",", " ").split()
        words, self._held = self._held[:count], self._held[count:]
        try:
            found = np.array([float(word) for word in words])
        except ValueError:
            raise BadInput(f"{what} must be numbers, got {' '.join(words)[:60]!r}") from None
        if not np.isfinite(found).all():
            raise BadInput(f"{what} must be finite, got {' '.join(words)[:60]!r}")
        return found

    def end(self) -> None:
        left = [*self._held, *(word for line in self.lines for word in line.split())]
        if left:
            raise BadInput(f"a photometric file must end after its candela, got {len(left)} more")


def _count(what: str, number: float) -> int:
    if not (1 <= number <= MOST_ANGLES and number == int(number)):
        raise BadInput(f"the number of {what} must be whole and within 1 to {MOST_ANGLES}, got {number:g}")
    return int(number)


def _from_zero(
    azimuth: NDArray[np.float64], candela: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return horizontal angles from 0: a lamp given from 90 to 270 deg is symmetric about that plane."""
    if (azimuth[0], azimuth[-1]) != (90.0, 270.0):
        return azimuth, candela
    mirrored = (180.0 - azimuth) % 360.0
    every = np.concatenate([azimuth, mirrored])
    angles, first = np.unique(every, return_index=True)
    rows = np.concatenate([candela, candela])[first]
    if angles[0] != 0.0:
        # Between the last angle and 360 + the first lies 0: by both, linearly.
        share = angles[0] / (360.0 - angles[-1] + angles[0])
        angles = np.concatenate([[0.0], angles])
        rows = np.concatenate([[(1.0 - share) * rows[0] + share * rows[-1]], rows])
    return np.append(angles, 360.0), np.concatenate([rows, rows[:1]])
