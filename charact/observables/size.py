"""Size of a departure: how a number of a statistic becomes percent of noise or of level, MTF or DN.

    size = f (g(y) - g(m)) / h(m)

y: measured; m: predicted; g: what the number is a scale of, such as the noise of its logarithm; h:
what the difference is over; f: 100 of percent.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from labdata import Array
from labdata.errors import check

Scale = Callable[[Array], Array]

Unit = Literal[
    "DN",
    "of MTF",
    "% of noise",
    "% of level",
    "% of the step",
    "% of values",
    "% of events",
    "% of their height",
    "% of the parameter",
]


def _as_it_is(number: Array) -> Array:
    return number


@dataclass(frozen=True, kw_only=True)
class Size:
    """What makes a size of a number: g and h of the equation, both rising, and the unit."""

    unit: Unit
    of: Scale = _as_it_is
    over: Scale = np.ones_like
    factor: float = 100.0

    def departure(self, measured: Array, predicted: float) -> Array:
        """Return the size of measured numbers less a predicted one."""
        centre = np.array(predicted)
        return self.factor * (self.of(measured) - self.of(centre)) / self.over(centre)

    def about(self, predicted: float) -> "Size":
        """Return the size of differences of the number, near a predicted one."""
        return Size(
            unit=self.unit, of=lambda step: self.departure(predicted + step, predicted), factor=1.0
        )


def relative(unit: Unit, of: Scale = _as_it_is) -> Size:
    """Return the relative size of what a number is a scale of."""
    return Size(unit=unit, of=of, over=of)


def part_of_noise(part: float) -> Size:
    """Return the size of the cube root of a variance, in percent of the noise of a pixel.

    `part`: the variance whose cube root is 1, over that of a pixel.
    """
    return Size(unit="% of noise", of=lambda root: np.sqrt(part * np.maximum(root, 0.0) ** 3))


# Of the logarithm of a variance, of a variance, and of the logarithm of a level.
LN_VARIANCE = relative("% of noise", lambda logarithm: np.exp(logarithm / 2.0))
VARIANCE = relative("% of noise", lambda variance: np.sqrt(np.maximum(variance, 1e-12)))
LN_LEVEL = relative("% of level", np.exp)
# Of a correlation r: noise at a frequency f has the power 1 + 2 r cos(2 pi f), and so changes by r.
CORRELATION = Size(unit="% of noise")


@dataclass(frozen=True, kw_only=True)
class Tolerance:
    """One [[tolerance]] of a limits file: the departure of a validation that does not matter."""

    unit: Unit  #: Unit of the departure
    max: float  #: Largest departure that does not matter, in that unit
    #: Name of the statistic, such as fixed-pattern; default: all of the unit
    statistic: str | None = None

    def __post_init__(self) -> None:
        check(self, of=" of a tolerance", positive="max")


def tolerance_of(statistic: str, unit: Unit, tolerances: tuple[Tolerance, ...]) -> float | None:
    """Return the last tolerance of a statistic and unit; None where none is stated."""
    known = [
        tolerance.max
        for tolerance in tolerances
        if tolerance.unit == unit and tolerance.statistic in (None, statistic)
    ]
    return known[-1] if known else None


def size_of(label: str, sizes: Mapping[str, Size]) -> Size | None:
    """Return the size of a number by its label, else by how that begins."""
    starts = (size for start, size in sizes.items() if label.startswith(start))
    return sizes.get(label) or next(starts, None)
