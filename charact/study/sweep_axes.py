"""The knobs that studies turn: how far, within what scope, and the cases that come of it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from charact.study.harness import Case

# Axis: unit, positions, the first and last position inside the scope, and what a position changes
# of a scene.
Axes = Mapping[str, tuple[Any, ...]]


@dataclass(frozen=True, kw_only=True)
class AxisPosition:
    """A position of one knob.

    `axis`, `position`, `unit`: the knob, how far it is turned, and its unit; `in_scope`: whether
    every method must cope with it.
    """

    axis: str
    position: float
    unit: str
    in_scope: bool

    def case(self, rng: np.random.Generator, **given: Any) -> Case:
        """Return a case at this place, its seed drawn; `given` are the case's other fields."""
        return Case(
            name=f"{self.axis} {self.position:g} {self.unit}".strip(),
            axis=self.axis,
            position=float(self.position),
            unit=self.unit,
            in_scope=self.in_scope,
            seed=int(rng.integers(1 << 31)),
            **given,
        )


def scene_at(axes: Axes, at: AxisPosition, base: Any) -> Any:
    """Return a scene at a position of an axis, all other knobs as they are."""
    return replace(base, **axes[at.axis][3](at.position, base))


def cases_along_axes(
    axes: Axes, chosen: Sequence[str], repeats: int, case_at: Callable[[AxisPosition, int], Case]
) -> tuple[Case, ...]:
    """Return the cases of all positions of the chosen axes, drawn several times.

    `case_at` makes a case of a place and the number of the draw.
    """
    out = []
    for axis in chosen:
        unit, positions, (first, last), *_ = axes[axis]
        for at in positions:
            place = AxisPosition(axis=axis, position=at, unit=unit, in_scope=first <= at <= last)
            out += [case_at(place, repeat) for repeat in range(repeats)]
    return tuple(out)


def cases_in_scope(count: int, case_at: Callable[[AxisPosition, int], Case]) -> tuple[Case, ...]:
    """Return numbered cases that turn no knob; `case_at` makes one of a place and its number."""
    return tuple(
        case_at(AxisPosition(axis="in scope", position=number, unit="", in_scope=True), number)
        for number in range(count)
    )
