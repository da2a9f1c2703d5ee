"""One class a statistic: what it is called, how frames show it, how a camera's description predicts
it.

Noise, fit and validation take the same statistics: noise prints them, the fit minimises their
misfit, the validation compares those of measured with those of simulated frames.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Generic, Literal, TypeVar

import numpy as np

from charact.frames.stack_statistics import StackStatistics
from charact.observables.frame_view import FrameView
from charact.observables.size import Size
from charact.observables.stack_level import StackLevel
from labdata import QUANTITIES, Array, Camera, Result
from labdata.quantity import Quantity

# Every parameter of a description by its path: n draws, or one value, shape (n,) or (1,)
Values = Mapping[str, Array]
Numbers = Mapping[str, float]


# A stack whose errors are known, as the fit and as the noise of a session read it
MeasuredStack = StackLevel | StackStatistics
S_co = TypeVar("S_co", bound=FrameView | MeasuredStack, covariant=True)
Shown = TypeVar("Shown")


@dataclass(frozen=True, kw_only=True)
class Stacks(Generic[S_co]):
    """Darks and flats of one camera, each flat with the dark from which its signal counts."""

    darks: tuple[S_co, ...]
    flats: tuple[S_co, ...] = ()
    references: tuple[S_co, ...] = ()  # the dark of each flat; empty: the first dark
    camera: Camera | None = None
    result: Result = field(default_factory=Result)  # what was measured before

    @property
    def dark(self) -> S_co:
        """The first dark."""
        return self.darks[0]

    @property
    def flat(self) -> S_co:
        """The last flat, which is the brightest."""
        return self.flats[-1]

    @property
    def pairs(self) -> Iterator[tuple[S_co, S_co]]:
        """Each flat with its dark."""
        return zip(self.flats, self.references or len(self.flats) * self.darks[:1], strict=True)

    @cached_property
    def signal_dn(self) -> Array:
        """Mean of each flat above its dark, shape (flat,), DN."""
        return np.array([flat.mean_dn - dark.mean_dn for flat, dark in self.pairs])

    def only(self, **stacks: Sequence[Any]) -> "Stacks[S_co]":
        """Return some of the stacks: `darks` or `flats`, of which each keeps its dark."""
        changes: dict[str, Any] = {name: tuple(chosen) for name, chosen in stacks.items()}
        if self.references and "flats" in changes:
            known = {flat.label: dark for flat, dark in self.pairs}
            changes["references"] = tuple(known[flat.label] for flat in changes["flats"])
        return replace(self, **changes)


@dataclass(frozen=True, kw_only=True)
class Estimates:
    """Measured numbers of a statistic and the covariance of their errors."""

    value: Array  # shape (k,)
    covariance: Array  # shape (k, k)

    @property
    def number(self) -> tuple[float, float]:
        """The first number and its standard error."""
        return float(self.value[0]), float(np.sqrt(self.covariance[0, 0]))

    @classmethod
    def of_number(cls, value: float, sd: float) -> "Estimates":
        """Return one number with its standard error."""
        return cls(value=np.array([value]), covariance=np.array([[sd**2]]))


@dataclass(frozen=True, kw_only=True)
class Ridge:
    """Surface on which a posterior is narrow: a number of many parameters that is known far better
    than any of them.

    In coordinates with the number itself in place of one parameter the surface is a plane.
    """

    carrier: str  # path of the parameter
    number: Callable[[Values], Array]  # values of shape (n,) each -> (n,)
    slope: float  # change of the number with the coordinate of the carrier, the same everywhere


@dataclass(frozen=True, kw_only=True)
class GivenOthers:
    """Parameter that numbers show as far as other parameters allow: they are linear in a function
    of it, by a slope that follows the others.

    Where the slope is small the posterior has the width of the prior, elsewhere that of the data: a
    funnel, which is even in units of the width given the others.
    """

    path: str  # of the parameter
    function: Callable[[Array], Array]
    # parameter at a value of the function and its standard deviation, also of a value beyond all
    inverse: Callable[[Array, Array], Array]


@dataclass(frozen=True, kw_only=True)
class Case(Generic[Shown]):
    """Numbers of a statistic that are fitted together, and what their prediction needs."""

    estimates: Estimates
    of: Shown
    label: str = ""  # name in messages, where it is not that of the statistic


@dataclass(frozen=True, kw_only=True)
class Printed:
    """How noise prints the first number of a statistic, of a dark or of a flat with its dark.

    `kind`: "noise" and "pattern" are variances in time and over pixels, printed as their root;
    "level" is that of a dark; "number" is none of these. Rounding and clipping have known effects
    on noise and level.
    """

    quantity: str
    kind: Literal["level", "noise", "number", "pattern"] = "number"
    unit: str = "DN"
    factor: float = 1.0  # to the unit
    with_flats: bool = False  # whether it is printed only where there are flats
    of_flat: bool = False
    per_electron: bool = False  # in electrons where the gain is known
    note: str = ""
    entry: Quantity | None = None  # in the catalogue, of a quantity that `labdata` does not list


class Observable(Generic[Shown]):
    """One statistic of the frames of a session.

    `name` is that of the statistic, and of its group in a validation. A statistic takes part in a
    fit if it depends on parameters, in a validation if it has a `title`; `cause` are the stages of
    the camera, or faults of the session, that move it; `matters` is the use for which a departure
    of it matters.
    """

    name: str
    order: int  # place in fit and reports
    title: str = ""
    cause: str = ""
    matters: str = ""
    # What the departure of a number is measured in, where that is the same for all
    size: Size | None = None
    # Least standard deviation of each number, for counts that all simulated sets have in common
    least_sd: float = 0.0
    # Whether all parts of the frame are compared, as faults may lie anywhere
    over_frame: bool = False
    # Whether the prediction is that of cameras with a tube, or without one; None: of both
    tube: bool | None = None
    # Names of statistics of the same parameters in whose absence alone this one is fitted
    unless: tuple[str, ...] = ()
    # Paths of the parameters that the prediction depends on
    depends: tuple[str, ...] = ()
    # The parameter that this statistic shows given the others
    given_others: GivenOthers | None = None
    # Those of which one must move the prediction by a standard error over its prior range
    moved_by: tuple[str, ...] = ()
    # Errors by which no camera follows the prediction: relative, and absolute
    relative_model_sd: float = 0.0
    model_sd: float = 0.0
    # Whether the numbers are lower bounds: a prediction beyond them agrees
    is_bound: bool = False
    printed: Printed | None = None

    def usable(self, stacks: Any) -> Any:
        """Return the stacks that show the statistic to a fit; None where there are none."""
        return stacks if stacks.darks and stacks.flats else None

    def cases(self, stacks: Any) -> Iterable["Case[Shown]"]:
        """Yield what stacks show of the statistic to a fit."""
        usable = self.usable(stacks)
        if usable is not None and self.parameters(usable):
            yield Case(estimates=self.measure(usable), of=usable)

    def measure(self, shown: Shown) -> Estimates:
        """Return the numbers that frames show, with the errors of measuring."""
        raise NotImplementedError

    def model_covariance(self, estimates: Estimates, shown: Shown) -> Array:
        """Return the covariance by which no camera follows the model, shape (k, k)."""
        return np.diag((self.relative_model_sd * estimates.value) ** 2 + self.model_sd**2)

    def predict(self, values: Values, shown: Shown) -> Array:
        """Return the numbers of cameras under the conditions of stacks, shape (n, k)."""
        return self.number(values, shown)[:, None]

    def number(self, values: Values, shown: Shown) -> Array:
        """Return the number of cameras, where it is one, shape (n,)."""
        raise NotImplementedError

    def parameters(self, shown: Shown) -> tuple[str, ...]:
        """Return the paths of the parameters that the prediction depends on."""
        return self.depends

    def ridge(self, shown: Shown) -> Ridge | None:
        """Return the number that is known far better than the parameters it depends on."""
        return None

    def numbers(self, stacks: Shown) -> Numbers:
        """Return the numbers that a validation compares, nearly Gaussian over simulated sets."""
        raise NotImplementedError

    def sizes(self, stacks: Shown) -> Mapping[str, Size]:
        """Return what departures of the numbers are measured in, by how their labels begin."""
        return {} if self.size is None else {"": self.size}


_KNOWN: list[Observable[Any]] = []
Statistic = TypeVar("Statistic", bound=Observable[Any])


def observable(statistic: type[Statistic]) -> type[Statistic]:
    """Add a statistic to those that noise, fit and validation loop over."""
    declare(statistic())
    return statistic


def declare(*statistics: Observable[Any]) -> None:
    """Add statistics that are values of a class to those that are looped over."""
    _KNOWN.extend(statistics)
    QUANTITIES.update(
        (statistic.printed.quantity, statistic.printed.entry)
        for statistic in statistics
        if statistic.printed is not None and statistic.printed.entry is not None
    )


def observables() -> tuple[Observable[Any], ...]:
    """Return every statistic in its order."""
    return tuple(sorted(_KNOWN, key=lambda statistic: statistic.order))


def columns(*numbers: Array) -> Array:
    """Return predictions of shape (n,) or (1,) each side by side, shape (n, k)."""
    return np.stack(np.broadcast_arrays(*numbers), axis=1)
