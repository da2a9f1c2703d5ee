"""Counts of clipped pixel values."""

from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from charact.noise.thresholds import STACK
from labdata.importers.full_scale import ends_at


@dataclass(frozen=True, kw_only=True)
class ClippedCounts:
    """Number of values at 0 DN and at full scale.

    Parameters
    ----------
    values, frames
        Counted values and frames.
    low, full
        Values at 0 DN, and at or above full scale if stated.
    largest, held
        The largest value and its count.
    next_largest, next_held
        The next largest value and its count; 0 if the largest is rare.
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
        """Fraction of values at 0 DN."""
        return self.low / self.values

    @property
    def high_fraction(self) -> float:
        """Fraction at full scale, or at the largest value if values accumulate there.

        A smooth distribution falls towards its largest value; grey values need not be consecutive integers.
        """
        likely = self.next_held + STACK.accumulated_sd * np.sqrt(self.next_held)
        piled = (
            self.next_held
            and self.held >= max(STACK.accumulated * self.frames, 2 * STACK.accumulated)
            and self.held >= likely
        )
        shown = float(self.largest).is_integer() and ends_at(int(self.largest), self.held)
        return max(self.full, self.held if piled or shown else 0) / self.values


def count_clipped(data: NDArray, full_scale_dn: float | None) -> ClippedCounts:
    """Count the clipped values of frames."""
    flat = data.reshape(-1)
    largest, held, next_largest, next_held = _top(flat)
    full = 0
    if full_scale_dn is not None and largest >= full_scale_dn:
        full = held if largest == full_scale_dn else int(np.count_nonzero(flat >= full_scale_dn))
    # With negative values, 0 is not the lower limit.
    low = int(np.count_nonzero(flat == 0)) if flat.min() == 0 else 0
    return ClippedCounts(values=flat.size, frames=len(data), low=low, full=full,
                 largest=float(largest), held=int(held), next_largest=float(next_largest),
                 next_held=int(next_held))  # fmt: skip


def sum_counts(parts: list[ClippedCounts]) -> ClippedCounts:
    """Return the sum of the counts."""
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
    """Return the largest value and its count, and if it is frequent the next largest."""
    largest = flat.max()
    held = int(np.count_nonzero(flat == largest))
    less = flat[flat < largest] if held >= 2 * STACK.accumulated else flat[:0]
    if not less.size:
        return largest, held, largest, 0
    following = less.max()
    return largest, held, following, int(np.count_nonzero(less == following))
