"""Cores of a blur along one direction, each with its equation, and on which targets they are tried.

A new form is a class here and its place in `ON_EDGES`, `ON_BARS` and `ON_POINTS`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from math import exp, log

import numpy as np

from charact.transfer.form import LN2, MIN_LN, BarForm, Core, Parameter
from charact.transfer.pupil import (
    AREA,
    OBSCURATION,
    SQUARED_WAVES,
    pupil,
    pupil_table,
    pupils_from_table,
)
from charact.transfer.spreads import cubic_weights
from charact.transfer.stages import clear_pupil
from charact.transfer.tables import ln_bessel_transfer, moffat_grid, moffat_table
from labdata import Array

# Frequencies over the cut-off at which a pupil is integrated: 16 in each period of a defocus of
# 1.5 waves, within 2e-4.
PUPIL_NODES = np.linspace(0.0, 1.0, 97)
# Values of a hole or a defocus between which a transfer is cubic, within 2e-4.
PLACES = 129
# Half frequency of a clear pupil in focus over its cut-off: acos v - v sqrt(1 - v^2) = pi / 4.
AIRY_HALF = 0.40397275


def _ln_parameter(
    name: str, low: float, high: float, median: float, sd: float, start: float
) -> Parameter:
    """Return ln of a positive parameter with its bounds, median and start, and the sd of ln."""
    low, high, median, start = (log(value) for value in (low, high, median, start))
    return Parameter(name=name, unit="1", low=low, high=high, mean=median, sd=sd, start=start)


# No second parameter of bars: fixed at 0.
NONE = Parameter(name="none", unit="1", low=-1.0, high=1.0, sd=1e-3, start=0.0)
# Exponent of exp(-ln 2 (f/f2)^n): tubes about 1.1 to 1.7, a Gaussian 2, and what aberrations may
# make of it.
EXPONENT = Parameter(name="exponent", unit="1", low=0.6, high=4.0, mean=1.6, sd=0.6, start=1.5)


class Exponential(Core):
    """exp(-ln 2 (f/f2)^n), the form of image tubes (Johnson, Proc. SPIE 1979)."""

    name, shape = "exponential", (EXPONENT,)
    fixed: float | None = None  # n where it is no parameter

    def ln_scaled(self, ln_ratio: Array, attenuation: float, shape: Sequence[float]) -> Array:
        """As of `Core`, in closed form: -A (f/f0)^n."""
        return -attenuation * np.exp((self.fixed or shape[0]) * ln_ratio)

    def terms(self, theta: Array, frequency: Array) -> Iterator[Array]:
        """As of `Core`."""
        ratio, exponent = np.log(frequency) - theta[:, :1], self.fixed or theta[:, 1:]
        fall = np.maximum(-LN2 * np.exp(exponent * ratio), MIN_LN)
        yield (value := np.exp(fall))
        slope = np.where(fall > MIN_LN, value * fall, 0.0)
        yield -exponent * slope
        if not self.fixed:
            yield slope * ratio


class Gaussian(Exponential):
    """exp(-ln 2 (f/f2)^2), a Gaussian spread of variance ln 2 / (2 pi^2 f2^2)."""

    name, shape, fixed = "gaussian", (), 2.0


class Kolmogorov(Exponential):
    """exp(-ln 2 (f/f2)^(5/3)), a long exposure through turbulent air (Fried 1966, J. Opt. Soc. Am.
    56, 1372).
    """

    name, shape, fixed = "kolmogorov", (), 5.0 / 3.0


class Moffat(Core):
    """2^(2-b)/Gamma(b-1) x^(b-1) K_(b-1)(x), x = 2 pi a f, of the spread (1 + r^2/a^2)^-b.

    Its wings are a power law: b = 3/2 is a Lorentzian whose transfer is exp(-x), infinity a
    Gaussian (Moffat 1969, Astron. Astrophys. 3, 455).
    """

    name = "moffat"
    shape = (Parameter(name="moffat_exponent", unit="1", low=1.2, high=8.0, start=2.5),)

    def attenuation(self, x: Array, shape: Sequence[float]) -> Array:
        """As of `Core`, x as in the equation."""
        return -ln_bessel_transfer(np.maximum(x, 1e-5), shape[0] - 1.0)

    def terms(self, theta: Array, frequency: Array) -> Iterator[Array]:
        """As of `Core`."""
        ratio = np.log(np.maximum(frequency, 1e-12)) - theta[:, :1]
        ln, rise, by_exponent = moffat_grid(
            ratio, np.ascontiguousarray(theta[:, 1]), moffat_table()
        )
        yield (value := np.exp(np.maximum(ln, MIN_LN)))
        yield -value * rise
        yield value * by_exponent


class ClearPupil(Core):
    """2/pi (acos v - v sqrt(1 - v^2)), v = f over the cut-off, a round pupil in focus (Goodman,
    Fourier Optics, 6.3).
    """

    name = "airy"

    def attenuation(self, x: Array, shape: Sequence[float]) -> Array:
        """As of `Core`, x = v."""
        return -np.log(np.maximum(clear_pupil(x), np.exp(MIN_LN)))

    def terms(self, theta: Array, frequency: Array) -> Iterator[Array]:
        """As of `Core`."""
        v = np.minimum(AIRY_HALF * frequency / np.exp(theta[:, :1]), 1.0)
        yield clear_pupil(v)
        yield v * np.sqrt(1.0 - v**2) * (4.0 / np.pi)


class TabulatedPupil(Core):
    """A pupil with a hole and out of focus, from a table scaled by its half frequency: `pupil`."""

    name = "pupil"
    shape = (
        Parameter(name="obscured_area", unit="1", low=AREA[0], high=AREA[1], start=0.05),
        Parameter(
            name="squared_defocus",
            unit="waves^2",
            low=SQUARED_WAVES[0],
            high=SQUARED_WAVES[1],
            start=0.05,
        ),
    )

    def terms(self, theta: Array, frequency: Array) -> Iterator[Array]:
        """As of `Core`."""
        half, area, squared = np.ascontiguousarray(theta.T)
        yield from pupils_from_table(
            np.ascontiguousarray(frequency, float), np.exp(half), area, squared, pupil_table()
        )


# Square of the obscuration, and of the defocus, waves^2, in which a transfer is linear; the prior
# of the latter is half-normal.
HOLE = Parameter(name="obscuration_square", unit="1", low=0.0, high=OBSCURATION[1] ** 2, start=0.08)
DEFOCUS = Parameter(name="defocus_square", unit="waves^2", low=0.0, high=2.25, sd=0.5, start=0.05)


class ExactPupil(Core):
    """A round pupil with a hole, out of focus, or both, by integration: `pupil`.

    Scaled by the half frequency of a clear pupil in focus with the same cut-off. It is integrated
    at `PUPIL_NODES`, once for each hole and defocus, or at `PLACES` values of one of them, and
    interpolated by cubic polynomials.
    """

    def __init__(self, name: str, *shape: Parameter) -> None:
        self.name, self.shape = name, shape

    @cached_property
    def _table(self) -> tuple[Array, Array]:
        """Values of a single parameter, and transfers there at `PUPIL_NODES`."""
        places = np.linspace(self.shape[0].low, self.shape[0].high, PLACES)
        return places, self._at_nodes(places[:, None])

    def _at_nodes(self, shapes: Array) -> Array:
        free = dict(zip(self.shape, np.sqrt(np.maximum(shapes, 0.0)).T, strict=True))
        hole, defocus = (free.get(part, np.zeros(len(shapes))) for part in (HOLE, DEFOCUS))
        return pupil(PUPIL_NODES, 1.0, hole, defocus)

    def terms(self, theta: Array, frequency: Array) -> Iterator[Array]:
        """As of `Core`."""
        shapes, index = np.unique(theta[:, 1:], axis=0, return_inverse=True)
        if len(self.shape) > 1:
            table = self._at_nodes(shapes)
        else:
            places, transfers = self._table
            first, weight = cubic_weights(places, shapes[:, 0])
            table = np.einsum("nk,nkf->nf", weight, transfers[first])
        ratio = AIRY_HALF * np.broadcast_to(frequency, (len(theta), np.shape(frequency)[-1]))
        ratio = np.minimum(ratio / np.exp(theta[:, :1]), 1.0)
        nodes, weights = cubic_weights(PUPIL_NODES, ratio)
        row = index.reshape(-1, 1)
        yield np.sum(
            [weights[..., node] * table[row, nodes[..., node]] for node in range(4)], axis=0
        )
        yield from self.differences(theta, frequency)

    def attenuation(self, x: Array, shape: Sequence[float]) -> Array:
        """As of `Core`, x = f over the cut-off, up to the first zero of the transfer."""
        free = dict(zip(self.shape, np.sqrt(np.maximum(shape, 0.0)), strict=True))
        hole, defocus = (float(free.get(part, 0.0)) for part in (HOLE, DEFOCUS))
        transfer = np.interp(x, PUPIL_NODES, _pupil_at_nodes(hole, defocus))
        return -np.log(np.maximum(transfer, np.exp(MIN_LN)))


@lru_cache(maxsize=16)
def _pupil_at_nodes(hole: float, defocus: float) -> Array:
    return pupil(PUPIL_NODES, 1.0, hole, defocus)[0]


class TwoGaussians(Core):
    """(1 - q) exp(-x^2) + q exp(-(k x)^2), a Gaussian and a fraction q of the light in one k times
    as wide.
    """

    name = "two gaussians"
    shape = (
        Parameter(name="wide_fraction", unit="1", low=0.0, high=0.6, mean=0.1, sd=0.2, start=0.1),
        _ln_parameter("ln_wider", 1.3, 20.0, 3.0, 0.5, 3.0),
    )

    def attenuation(self, x: Array, shape: Sequence[float]) -> Array:
        """As of `Core`, x as in the equation."""
        square, (fraction, ln_wider) = x**2, shape
        wider_part = self.wider_part(np.exp(2.0 * ln_wider) * square)
        narrow_part = np.exp(-np.minimum(square, -MIN_LN))
        transfer = (1.0 - fraction) * narrow_part + fraction * wider_part
        return -np.log(np.maximum(transfer, np.exp(MIN_LN)))

    def wider_part(self, square: Array) -> Array:
        """Return the transfer of the wider part at squared frequencies (k x)^2."""
        return np.exp(-np.minimum(square, -MIN_LN))


class GaussianInWings(TwoGaussians):
    """(1 - q) exp(-x^2) + q (1 + (k x)^2)^(-3/2), a Gaussian and a fraction q of the light in a
    scatter tail exp(-r/t) with k = sqrt(2) t/s.
    """

    name = "gaussian in wings"

    def wider_part(self, square: Array) -> Array:
        """As of `TwoGaussians`."""
        return (1.0 + square) ** -1.5


GAUSSIAN, EXPONENTIAL, MOFFAT, AIRY = Gaussian(), Exponential(), Moffat(), ClearPupil()
# Cores of blur models along one direction; every edge is fitted with those of `ON_EDGES`, in order.
CORES: dict[str, Core] = {
    core.name: core for core in (GAUSSIAN, EXPONENTIAL, MOFFAT, AIRY, TabulatedPupil())
}
ON_EDGES = ("gaussian", "exponential", "moffat", "airy")

# Cores that points of any camera are fitted with, and their prior odds; variants of one kind share
# them.
ON_POINTS: dict[str, tuple[Core, float]] = {
    "gaussian": (GAUSSIAN, 1.0),
    "kolmogorov": (Kolmogorov(), 0.5),
    "exponential": (EXPONENTIAL, 0.5),
    "moffat": (MOFFAT, 0.5),
    "airy": (AIRY, 0.5),
    "hole": (ExactPupil("hole", HOLE), 0.25),
    "defocus": (ExactPupil("defocus", DEFOCUS), 0.25),
    "pupil": (ExactPupil("pupil", HOLE, DEFOCUS), 0.25),
}
# Forms that bars are fitted with; the preferred one, which approximates almost any blur to first
# order, comes first.
ON_BARS = (
    BarForm(
        name="a tube",
        core=EXPONENTIAL,
        first=_ln_parameter("ln_exponent", 0.6, 4.0, 1.5, 0.8, 1.6),
        second=replace(NONE, low=0.0),
        shape=lambda ln_exponent, _: (exp(ln_exponent),),
        gaussian_share=lambda _, fraction: fraction,
    ),
    BarForm(
        name="a tube and a lens",
        core=EXPONENTIAL,
        first=_ln_parameter("ln_exponent", 0.6, 4.0, 1.5, 0.8, 1.4),
        second=Parameter(
            name="gaussian_share", unit="1", low=0.0, high=1.0, mean=0.2, sd=0.25, start=0.2
        ),
        shape=lambda ln_exponent, _: (exp(ln_exponent),),
        gaussian_share=lambda _, fraction: fraction,
    ),
    BarForm(
        name="a lens",
        core=ExactPupil("defocus", DEFOCUS),
        first=Parameter(
            name="gaussian_share", unit="1", low=0.0, high=0.95, mean=0.2, sd=0.4, start=0.1
        ),
        second=DEFOCUS,
        shape=lambda _, defocus_square: (defocus_square,),
        gaussian_share=lambda fraction, _: fraction,
    ),
    BarForm(
        name="a Moffat",
        core=MOFFAT,
        first=_ln_parameter("ln_order", 0.2, 15.0, 2.5, 0.7, 2.5),
        second=NONE,
        shape=lambda ln_order, _: (1.0 + exp(ln_order),),
    ),
    BarForm(
        name="two Gaussians",
        core=TwoGaussians(),
        first=TwoGaussians.shape[0],
        second=TwoGaussians.shape[1],
        shape=lambda fraction, ln_wider: (fraction, ln_wider),
    ),
    BarForm(
        name="a Gaussian in wings",
        core=GaussianInWings(),
        first=TwoGaussians.shape[0],
        second=TwoGaussians.shape[1],
        shape=lambda fraction, ln_wider: (fraction, ln_wider),
    ),
)
