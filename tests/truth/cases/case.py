"""A case of known truth, and the axes along which cases leave the scope of the methods."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from charact.method import Context, Method
from labdata import Result

# Axis: unit, positions, the first and last position inside the scope, and what a position changes
# of a scene.
Axes = Mapping[str, tuple[Any, ...]]


@dataclass(frozen=True, kw_only=True)
class Case:
    """One situation with known truth.

    Parameters
    ----------
    kind
        Kind of target: which methods it is given to.
    name
        What is special about it, in words.
    axis, position, unit
        The knob that was turned, how far, and its unit.
    quantity
        The quantity whose truth is known.
    truth
        Its true value; None where there is nothing to measure, so that any number given as ok is a
        lie.
    in_scope
        Whether every method must cope: inside the scope 95 % of the cases must be ok.
    seed
        Seed of the drawn frames.
    draw
        Maps a generator to the method's input: the stack or the session.
    arguments
        Further arguments of the method, such as the region.
    context
        Fields of `charact.method.Context` that the case sets.
    call
        Calls a method with what was drawn; None: `method.function(drawn, **arguments,
        context=context)`.
    score
        Makes the result from what the call returned, outside of the time; None: that is the result.
    """

    kind: str
    name: str
    axis: str
    position: float
    unit: str
    quantity: str
    truth: float | None
    in_scope: bool
    seed: int
    draw: Callable[[np.random.Generator], Any]
    arguments: Mapping[str, Any] = field(default_factory=dict)
    context: Mapping[str, Any] = field(default_factory=dict)
    call: Callable[[Method, Any, Context], Any] | None = None
    score: Callable[[Any], Result] | None = None

    def drawn(self) -> Any:
        """Draw the input from the seed."""
        return self.draw(np.random.default_rng(self.seed))


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

    def case(self, rng: np.random.Generator, **fields: Any) -> Case:
        """Return a case at this place, its seed drawn; `fields` are the case's other fields."""
        return Case(
            name=f"{self.axis} {self.position:g} {self.unit}".strip(),
            axis=self.axis,
            position=float(self.position),
            unit=self.unit,
            in_scope=self.in_scope,
            seed=int(rng.integers(1 << 31)),
            **fields,
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
            axis_position = AxisPosition(
                axis=axis, position=at, unit=unit, in_scope=first <= at <= last
            )
            out += [case_at(axis_position, repeat) for repeat in range(repeats)]
    return tuple(out)


def cases_in_scope(count: int, case_at: Callable[[AxisPosition, int], Case]) -> tuple[Case, ...]:
    """Return numbered cases that turn no knob; `case_at` makes one of a place and its number."""
    return tuple(
        case_at(AxisPosition(axis="in scope", position=number, unit="", in_scope=True), number)
        for number in range(count)
    )
