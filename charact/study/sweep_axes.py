"""The knobs that studies turn: how far, within what scope, and the cases that come of it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from charact.study.harness import Case

# Axis: unit, positions, and the first and last position inside the scope.
Axes = Mapping[str, tuple[str, tuple[float, ...], tuple[float, float]]]


@dataclass(frozen=True, kw_only=True)
class AxisPosition:
    """A position of one knob.

    `axis`, `position`, `unit`: the knob, how far it is turned, and its unit; `in_scope`: whether every method must cope
    with it.
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


def cases_along_axes(
    axes: Axes, chosen: Sequence[str], repeats: int, case_at: Callable[[AxisPosition, int], Case]
) -> tuple[Case, ...]:
    """Return the cases of all positions of some axes, drawn several times.

    `axes`, `chosen`: all axes, and the names of those that are turned; `repeats`: draws at each position; `case_at`:
    makes a case of a place and the number of the draw.
    """
    return tuple(case_at(place, repeat) for place in _places(axes, chosen) for repeat in range(repeats))


def cases_in_scope(count: int, case_at: Callable[[AxisPosition, int], Case]) -> tuple[Case, ...]:
    """Return numbered cases that turn no knob; `case_at` makes one of a place and its number."""
    return tuple(
        case_at(AxisPosition(axis="in scope", position=number, unit="", in_scope=True), number)
        for number in range(count)
    )


def _places(axes: Axes, chosen: Sequence[str]) -> list[AxisPosition]:
    return [
        AxisPosition(
            axis=axis, position=position, unit=axes[axis][0], in_scope=axes[axis][2][0] <= position <= axes[axis][2][1]
        )
        for axis in chosen
        for position in axes[axis][1]
    ]
