"""Measurements with interval, status and provenance, their curves and posterior."""

from dataclasses import dataclass, field, replace
from textwrap import shorten
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata import flags as vocabulary
from labdata.frames import read_only
from labdata.number_format import plus_minus
from labdata.quantity import QUANTITIES
from labdata.short_repr import WIDTH, short_repr

Status = Literal["ok", "suspect", "refused"]
Interval = tuple[float, float]
# Why there is no number: the attempt failed, frames or a description are missing, or the camera or
# frames have no such quantity
Refusal = Literal["failed", "missing", "not-applicable"]


@dataclass(frozen=True, kw_only=True)
class Posterior:
    """Draws of a posterior distribution with their convergence diagnostics."""

    names: tuple[str, ...]  #: Name and unit of each parameter
    units: tuple[str, ...]  #: Name and unit of each parameter
    draws: NDArray[np.float64]  #: Thinned draws, shape (draw, parameter), read-only
    #: Integrated autocorrelation time of each parameter, steps, shape (parameter,)
    autocorrelation_time: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    acceptance: float | None = None  #: Mean acceptance fraction, dimensionless
    #: Split R-hat over independent ensembles, shape (parameter,)
    r_hat: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    #: Effective number of independent draws of each parameter, shape (parameter,)
    effective_sample_size: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    #: "emcee", "laplace" (curvature at the maximum), "importance" (importance sampling) or "slice"
    sampler: Literal["emcee", "laplace", "importance", "slice"] = "emcee"
    seed: int = 0  #: Seed of the draws
    flags: tuple[str, ...] = ()  #: Reasons to distrust it

    __repr__ = short_repr

    def __post_init__(self) -> None:
        draws = np.asarray(self.draws, float)
        if (
            draws.ndim != 2
            or draws.shape[1] != len(self.names)
            or len(self.names) != len(self.units)
        ):
            raise ValueError(
                f"draws must be (draw, {len(self.names)}) with a unit each, got shape {draws.shape}"
            )
        object.__setattr__(self, "draws", read_only(draws))
        object.__setattr__(self, "flags", vocabulary.order_flags(self.flags))

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """Draws of one parameter, shape (draw,)."""
        return self.draws[:, self.names.index(name)]


def intervals_of(draws: ArrayLike) -> tuple[float, Interval, Interval]:
    """Return the median and the equal-tailed 68 % and 95 % intervals of draws."""
    # np.quantile gives the same result in ten times the time for a few hundred draws.
    ordered = np.sort(np.asarray(draws, float), axis=None)
    if np.isnan(ordered[-1]):
        return np.nan, (np.nan, np.nan), (np.nan, np.nan)
    ranks = np.asarray(QUANTILES) * (ordered.size - 1)
    low95, low68, middle, high68, high95 = np.interp(ranks, np.arange(ordered.size), ordered)
    return float(middle), (float(low68), float(high68)), (float(low95), float(high95))


# Median and equal-tailed 68 % and 95 % intervals.
QUANTILES = (0.025, 0.16, 0.5, 0.84, 0.975)


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Provenance of a value, sufficient to reproduce it."""

    version: str  #: Version of charact
    seed: int | None = None  #: Seed of every random step
    settings: dict[str, Any] = field(default_factory=dict)  #: Settings of the method, by name
    #: SHA-256 of each input file, by path as given; see `labdata.session`
    inputs: dict[str, str] = field(default_factory=dict)

    __repr__ = short_repr


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """One measured quantity; made by `make_measurement`, `measurement_from_draws` or
    `make_refusal`.
    """

    quantity: str  #: A name of `labdata.quantity.QUANTITIES` and one of its units
    unit: str  #: A name of `labdata.quantity.QUANTITIES` and one of its units
    value: float | None  #: Value and equal-tailed intervals; all None when refused
    interval68: Interval | None  #: Value and equal-tailed intervals; all None when refused
    interval95: Interval | None  #: Value and equal-tailed intervals; all None when refused
    status: Status  #: "ok" (no flags), "suspect" (flagged) or "refused" (no value; see `reason`)
    method: str  #: Name of the method and its run time without compilation, s
    seconds: float | None = None  #: Name of the method and its run time without compilation, s
    flags: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    reason: str | None = None
    refusal: Refusal = "failed"  #: Of a refused measurement, its kind
    #: Where applicable: label of the stack; ROW, COL, HEIGHT, WIDTH in px; frequency of `mtf`;
    #: direction in degrees
    stack: str | None = None
    region: tuple[int, int, int, int] | None = None
    frequency_cy_per_px: float | None = None
    orientation_deg: float | None = None
    amplifier: int | None = None  #: Number of the amplifier, from 1 by rows; None: the chip
    posterior: Posterior | None = None  #: Posterior from which the intervals were computed, if any
    provenance: Provenance | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "flags", vocabulary.order_flags(self.flags))
        known = QUANTITIES.get(self.quantity)
        if known is None or self.unit not in known.units:
            raise ValueError(
                f"no quantity {self.quantity!r} with the unit {self.unit!r} in labdata.quantity"
            )
        if self.status == "refused" and (self.value is not None or not self.reason):
            raise ValueError(f"a refused {self.quantity} carries a reason and no value")
        if self.status != "refused" and (self.value is None or not np.isfinite(self.value)):
            raise ValueError(f"{self.quantity} must be a finite number, got {self.value}")
        if self.status != "refused" and (self.status == "ok") == bool(self.flags):
            raise ValueError(f"{self.quantity} is {self.status} with flags {self.flags}")

    def __repr__(self) -> str:

        where = (
            "" if self.frequency_cy_per_px is None else f" at {self.frequency_cy_per_px:.4g} cy/px"
        )
        if self.value is None:
            return shorten(
                f"{self.quantity}{where} refused: {self.reason}", WIDTH, placeholder=" …"
            )
        unit = "" if self.unit == "1" else f" {self.unit}"
        verdict = ": ".join((self.status, *filter(None, (", ".join(self.flags),))))
        return f"{self.quantity}{where} = {plus_minus(self)}{unit}, {verdict}"

    def with_(self, **changes: Any) -> "Measurement":
        """Return a copy with fields changed; flags are added and change the status to suspect."""
        flags = vocabulary.order_flags((*self.flags, *changes.pop("flags", ())))
        status = self.status if self.status == "refused" else ("suspect" if flags else "ok")
        return replace(self, flags=flags, status=status, **changes)


def make_measurement(
    quantity: str,
    unit: str,
    value: float,
    interval68: Interval | None,
    interval95: Interval | None,
    *,
    method: str,
    flags: tuple[str, ...] = (),
    **fields: Any,
) -> Measurement:
    """Return a measurement with a value: ok without flags, suspect with flags."""
    return Measurement(
        quantity=quantity,
        unit=unit,
        value=float(value),
        interval68=interval68,
        interval95=interval95,
        status="suspect" if flags else "ok",
        method=method,
        flags=flags,
        **fields,
    )


def measurement_from_draws(
    quantity: str, unit: str, draws: ArrayLike, *, method: str, **fields: Any
) -> Measurement:
    """Return a measurement whose value is the median of draws and whose intervals are their
    quantiles.
    """
    value, interval68, interval95 = intervals_of(draws)
    return make_measurement(quantity, unit, value, interval68, interval95, method=method, **fields)


def measurement_from_sd(
    quantity: str, unit: str, value: float, sd: float, *, method: str, **fields: Any
) -> Measurement:
    """Return a measurement with Gaussian intervals of a standard deviation in the unit of the
    value.
    """
    half68, half95 = 0.994458 * sd, 1.959964 * sd
    interval68, interval95 = (value - half68, value + half68), (value - half95, value + half95)
    return make_measurement(quantity, unit, value, interval68, interval95, method=method, **fields)


def make_refusal(
    quantity: str, unit: str, reason: str, *, method: str, **fields: Any
) -> Measurement:
    """Return a measurement without a value, with the reason for it."""
    given = {"value": None, "interval68": None, "interval95": None, "status": "refused", **fields}
    return Measurement(quantity=quantity, unit=unit, reason=reason, method=method, **given)


@dataclass(frozen=True, kw_only=True)
class Curve:
    """A quantity against spatial frequency with its pointwise intervals."""

    #: Increasing frequencies, shape (n,), cycles per pixel along the measured direction
    frequency_cy_per_px: NDArray[np.float64]
    value: NDArray[np.float64]  #: Values, shape (n,)
    interval68: NDArray[np.float64] | None = None  #: Lower and upper bounds, shape (2, n), or None
    interval95: NDArray[np.float64] | None = None  #: Lower and upper bounds, shape (2, n), or None
    stack: str | None = None  #: Label of the measured stack
    #: Curves drawn from the posterior, shape (draw, n), for the correlation of errors between
    #: frequencies; None where there are none. Not written to files
    draws: NDArray[np.float64] | None = None

    __repr__ = short_repr


@dataclass(frozen=True, kw_only=True)
class Result:
    """Result of one analysis."""

    measurements: tuple[Measurement, ...] = ()  #: The quantities
    #: Curves by name ("mtf", "mtf_vertical", ...). Curves of several stacks of a session have a
    #: suffix ":label"
    curves: dict[str, Curve] = field(default_factory=dict)
    #: Figure data by name: JSON-ready mappings of lists and numbers (profiles, fits, residuals)
    evidence: dict[str, dict[str, Any]] = field(default_factory=dict)

    __repr__ = short_repr

    def __add__(self, other: "Result") -> "Result":
        return Result(
            measurements=self.measurements + other.measurements,
            curves={**self.curves, **other.curves},
            evidence={**self.evidence, **other.evidence},
        )

    def find(self, quantity: str, **where: Any) -> tuple[Measurement, ...]:
        """Return the measurements of a quantity whose fields equal those given; without an
        `amplifier` those of the chip, if there are any.
        """
        found = tuple(
            m
            for m in self.measurements
            if m.quantity == quantity
            and all(getattr(m, key) == value for key, value in where.items())
        )
        of_chip = tuple(m for m in found if m.amplifier is None)
        return found if "amplifier" in where else of_chip or found
