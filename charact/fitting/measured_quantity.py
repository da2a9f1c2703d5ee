"""Quantities of a session's result as observations: number, interval and prediction."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from charact.fitting.stack_levels import SessionStacks
from charact.observables import (
    Case,
    Estimates,
    Observable,
    Values,
    admissible_measurements,
    sd_of,
)
from labdata import Array, Measurement


@dataclass(frozen=True, kw_only=True)
class Measured:
    """A measurement beside the stacks of its session."""

    m: Measurement
    stacks: SessionStacks


@dataclass(frozen=True, kw_only=True)
class MeasuredQuantity(Observable[Measured]):
    """The admissible measurements of a quantity, each predicted by `number`.

    A mildly suspect measurement is used only if there is none with status ok; refused and otherwise
    flagged ones are excluded.
    """

    name: str
    order: int
    quantity: str
    number: Callable[[Values, Measured], Array]  # prediction, shape (n,)
    unit: str | None = None
    # The observed number is (factor x measured number)^power
    factor: float = 1.0
    power: int = 1
    tube: bool | None = None
    unless: tuple[str, ...] = ()
    depends: tuple[str, ...] = ()
    paths: Callable[[SessionStacks], tuple[str, ...]] | None = None  # in place of `depends`
    relative_model_sd: float = 0.0
    model_sd: float = 0.0
    pattern_sd: Callable[[SessionStacks], float] = lambda stacks: 0.0  # further error, by camera
    is_bound: bool = False
    first: bool = False  # whether one measurement is enough
    where: Callable[[Measured], object] = lambda shown: True  # which measurements count
    shown_as: str = ""  # name in messages where it is not `name`

    def cases(self, stacks: SessionStacks) -> Iterator[Case[Measured]]:
        """Yield the measurements that count."""
        known = admissible_measurements(stacks.result, self.quantity, self.unit)
        for m in known[:1] if self.first else known:
            if self.where(shown := Measured(m=m, stacks=stacks)):
                scaled, sd = self.factor * (m.value or 0.0), self.factor * sd_of(m)
                sd *= self.power * scaled ** (self.power - 1)
                total_sd = float(np.hypot(sd, self.pattern_sd(stacks)))
                yield Case(
                    estimates=Estimates.of_number(scaled**self.power, total_sd),
                    of=shown,
                    label=self.shown_as.format(stack=m.stack),
                )

    def parameters(self, shown: Measured) -> tuple[str, ...]:
        return self.paths(shown.stacks) if self.paths else self.depends


def photon_transfer_of(stacks: SessionStacks, *columns: str) -> list[Array]:
    """Return columns of the measured photon transfer curve at the flats that were fitted, shape
    (flat,).
    """
    curve = stacks.result.evidence.get("photon-transfer", {})
    is_fitted = np.array(curve.get("fitted", ()), bool)
    return [np.array(curve.get(name, ()), float)[is_fitted] for name in columns]
