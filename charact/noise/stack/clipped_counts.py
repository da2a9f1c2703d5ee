"""Pixels at the ends of the digitiser's codes, counted run by run."""

from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from labdata.importers.full_scale import ends_at

# So many values at the largest one, in a frame on average, are no chance.
PILED_UP = 8
SIGNIFICANT = 5.0


@dataclass(frozen=True, kw_only=True)
class ClippedCounts:
    """How many values lie at the ends of the codes.

    Parameters
    ----------
    values, frames
        Values counted, and frames that they are of.
    low, full
        Values at code 0, and at or above the highest code where it is stated.
    largest, held
        The largest value and how many hold it.
    next_largest, next_held
        The largest value below that and how many hold it; none where too few hold the largest to matter.
    """

    values: int
    frames: int
    low: int
    full: int
    largest: float
    held: int
    next_largest: float
    next_held: int

    @property
    def low_fraction(self) -> float:
        """Share of values at code 0."""
        return self.low / self.values

    @property
    def high_fraction(self) -> float:
        """Share at the highest code, or at the largest value where values pile up there: the camera stops there.

        The tail of a smooth distribution falls towards its largest value; codes need not be successive whole numbers.
        """
        likely = self.next_held + SIGNIFICANT * np.sqrt(self.next_held)
        piled = self.next_held and self.held >= max(PILED_UP * self.frames, 2 * PILED_UP) and self.held >= likely
        shown = float(self.largest).is_integer() and ends_at(int(self.largest), self.held)
        return max(self.full, self.held if piled or shown else 0) / self.values


def count_clipped(data: NDArray, full_scale_dn: float | None) -> ClippedCounts:
    """Count the values of some frames at the ends of the codes."""
    flat = data.reshape(-1)
    largest, held, next_largest, next_held = _top(flat)
    full = 0
    if full_scale_dn is not None and largest >= full_scale_dn:
        full = held if largest == full_scale_dn else int(np.count_nonzero(flat >= full_scale_dn))
    # Of values below 0 that is no end of the codes.
    low = int(np.count_nonzero(flat == 0)) if flat.min() == 0 else 0
    return ClippedCounts(values=flat.size, frames=len(data), low=low, full=full,
                 largest=float(largest), held=int(held), next_largest=float(next_largest),
                 next_held=int(next_held))  # fmt: skip


def sum_counts(parts: list[ClippedCounts]) -> ClippedCounts:
    """Return the counts of all parts."""
    return reduce(_sum, parts)


def _sum(one: ClippedCounts, two: ClippedCounts) -> ClippedCounts:
    tops = [(part.largest, part.held) for part in (one, two)]
    tops += [(part.next_largest, part.next_held) for part in (one, two)]
    held: dict[float, int] = {}
    for value, count in tops:
        held[value] = held.get(value, 0) + count
    first, second = sorted(held, reverse=True)[:2] if len(held) > 1 else (one.largest, one.largest)
    return ClippedCounts(values=one.values + two.values, frames=one.frames + two.frames, low=one.low + two.low,
                 full=one.full + two.full, largest=first, held=held[first], next_largest=second,
                 next_held=held[second] if second < first else 0)  # fmt: skip


def _top(flat: NDArray) -> tuple[float, int, float, int]:
    """The largest value and how many hold it, and where these are many, the same of the next largest."""
    largest = flat.max()
    held = int(np.count_nonzero(flat == largest))
    less = flat[flat < largest] if held >= 2 * PILED_UP else flat[:0]
    if not less.size:
        return largest, held, largest, 0
    following = less.max()
    return largest, held, following, int(np.count_nonzero(less == following))
