"""Measurements with interval, status and provenance, their curves and posterior."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata import flags as vocabulary
from labdata.frames import read_only
from labdata.quantity import QUANTITIES

Status = Literal["ok", "suspect", "refused"]
Interval = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Posterior:
    """Draws of a posterior distribution with their convergence diagnostics.

    Parameters
    ----------
    names, units
        Name and unit of each parameter.
    draws
        Thinned draws, shape (draw, parameter), read-only.
    autocorrelation_time
        Integrated autocorrelation time of each parameter, steps, shape (parameter,).
    acceptance
        Mean acceptance fraction, dimensionless.
    r_hat
        Split R-hat over independent ensembles, shape (parameter,).
    effective_sample_size
        Effective number of independent draws of each parameter, shape (parameter,).
    sampler
        "emcee", "laplace" (curvature at the maximum) or "importance" (importance sampling).
        by their weight.
    seed
        Seed of the draws.
    flags
        Reasons to distrust it.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    draws: NDArray[np.float64]
    autocorrelation_time: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    acceptance: float | None = None
    r_hat: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    effective_sample_size: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    sampler: Literal["emcee", "laplace", "importance"] = "emcee"
    seed: int = 0
    flags: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        draws = np.asarray(self.draws, float)
        if draws.ndim != 2 or draws.shape[1] != len(self.names) or len(self.names) != len(self.units):
            raise ValueError(f"draws must be (draw, {len(self.names)}) with a unit each, got shape {draws.shape}")
        object.__setattr__(self, "draws", read_only(draws))
        object.__setattr__(self, "flags", vocabulary.ordered_flags(self.flags))

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """Draws of one parameter, shape (draw,)."""
        return self.draws[:, self.names.index(name)]


def intervals_of(draws: ArrayLike) -> tuple[float, Interval, Interval]:
    """Return the median and the equal-tailed 68 % and 95 % intervals of draws."""
    # np.quantile gives the same result in ten times the time for a few hundred draws.
    ordered = np.sort(np.asarray(draws, float), axis=None)
    if np.isnan(ordered[-1]):
        return np.nan, (np.nan, np.nan), (np.nan, np.nan)
    places = np.asarray(QUANTILES) * (ordered.size - 1)
    low95, low68, middle, high68, high95 = np.interp(places, np.arange(ordered.size), ordered)
    return float(middle), (float(low68), float(high68)), (float(low95), float(high95))


# Median and equal-tailed 68 % and 95 % intervals.
QUANTILES = (0.025, 0.16, 0.5, 0.84, 0.975)


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Provenance of a value, sufficient to reproduce it.

    Parameters
    ----------
    version
        Version of charact.
    seed
        Seed of every random step.
    settings
        Settings of the method, by name.
    inputs
        SHA-256 of each input file, by path as given; see `labdata.session`.
    """

    version: str
    seed: int | None = None
    settings: dict[str, Any] = field(default_factory=dict)
    inputs: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """One measured quantity; made by `make_measurement`, `measurement_from_draws` or `make_refusal`.

    Parameters
    ----------
    quantity, unit
        A name of `labdata.quantity.QUANTITIES` and one of its units.
    value, interval68, interval95
        Value and equal-tailed intervals; all None when refused.
    status
        "ok" (no flags), "suspect" (flagged) or "refused" (no value; see `reason`).
    method, seconds
        Name of the method and its run time without compilation, s.
    stack, region, frequency_cy_per_px, orientation_deg
        Where applicable: label of the stack; ROW, COL, HEIGHT, WIDTH in px; frequency of `mtf`; direction in degrees.
    posterior
        Posterior from which the intervals were computed, if any.
    """

    quantity: str
    unit: str
    value: float | None
    interval68: Interval | None
    interval95: Interval | None
    status: Status
    method: str
    seconds: float | None = None
    flags: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    reason: str | None = None
    stack: str | None = None
    region: tuple[int, int, int, int] | None = None
    frequency_cy_per_px: float | None = None
    orientation_deg: float | None = None
    posterior: Posterior | None = None
    provenance: Provenance | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "flags", vocabulary.ordered_flags(self.flags))
        known = QUANTITIES.get(self.quantity)
        if known is None or self.unit not in known.units:
            raise ValueError(f"no quantity {self.quantity!r} with the unit {self.unit!r} in labdata.quantity")
        if self.status == "refused" and (self.value is not None or not self.reason):
            raise ValueError(f"a refused {self.quantity} carries a reason and no value")
        if self.status != "refused" and (self.value is None or not np.isfinite(self.value)):
            raise ValueError(f"{self.quantity} must be a finite number, got {self.value}")
        if self.status != "refused" and (self.status == "ok") == bool(self.flags):
            raise ValueError(f"{self.quantity} is {self.status} with flags {self.flags}")

    def with_(self, *, findings: Iterable[vocabulary.Finding] = (), **changes: Any) -> "Measurement":
        """Return a copy with fields changed; flags and findings are added and change the status to suspect."""
        found = tuple(findings)
        flags = vocabulary.ordered_flags((*self.flags, *(each.flag for each in found), *changes.pop("flags", ())))
        if found:
            changes["notes"] = (*changes.get("notes", self.notes), *(each.note for each in found))
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


def measurement_from_draws(quantity: str, unit: str, draws: ArrayLike, *, method: str, **fields: Any) -> Measurement:
    """Return a measurement whose value is the median of draws and whose intervals are their quantiles."""
    value, interval68, interval95 = intervals_of(draws)
    return make_measurement(quantity, unit, value, interval68, interval95, method=method, **fields)


def measurement_from_sd(
    quantity: str, unit: str, value: float, sd: float, *, method: str, **fields: Any
) -> Measurement:
    """Return a measurement with Gaussian intervals of a standard deviation in the unit of the value."""
    half68, half95 = 0.994458 * sd, 1.959964 * sd
    return make_measurement(
        quantity,
        unit,
        value,
        (value - half68, value + half68),
        (value - half95, value + half95),
        method=method,
        **fields,
    )


def make_refusal(quantity: str, unit: str, reason: str, *, method: str, **fields: Any) -> Measurement:
    """Return a measurement without a value, with the reason for it."""
    return Measurement(
        quantity=quantity,
        unit=unit,
        value=None,
        interval68=None,
        interval95=None,
        status="refused",
        reason=reason,
        method=method,
        **fields,
    )


@dataclass(frozen=True, kw_only=True)
class Curve:
    """A quantity against spatial frequency with its pointwise intervals.

    Parameters
    ----------
    frequency_cy_per_px
        Increasing frequencies, shape (n,), cycles per pixel along the measured direction.
    value
        Values, shape (n,).
    interval68, interval95
        Lower and upper bounds, shape (2, n), or None.
    stack
        Label of the measured stack.
    draws
        Curves drawn from the posterior, shape (draw, n), for the correlation of errors between frequencies; None
        where there are none. Not written to files.
    """

    frequency_cy_per_px: NDArray[np.float64]
    value: NDArray[np.float64]
    interval68: NDArray[np.float64] | None = None
    interval95: NDArray[np.float64] | None = None
    stack: str | None = None
    draws: NDArray[np.float64] | None = None


@dataclass(frozen=True, kw_only=True)
class Result:
    """Result of one analysis.

    Parameters
    ----------
    measurements
        The quantities.
    curves
        Curves by name ("mtf", "mtf_vertical", ...). Curves of several stacks of a session have a
        suffix ":label".
    evidence
        Figure data by name: JSON-ready mappings of lists and numbers (profiles, fits, residuals).
    """

    measurements: tuple[Measurement, ...] = ()
    curves: dict[str, Curve] = field(default_factory=dict)
    evidence: dict[str, dict[str, Any]] = field(default_factory=dict)

    def __add__(self, other: "Result") -> "Result":
        return Result(
            measurements=self.measurements + other.measurements,
            curves={**self.curves, **other.curves},
            evidence={**self.evidence, **other.evidence},
        )

    def find(self, quantity: str, **where: Any) -> tuple[Measurement, ...]:
        """Return the measurements of a quantity whose fields equal those given."""
        return tuple(
            m
            for m in self.measurements
            if m.quantity == quantity and all(getattr(m, key) == value for key, value in where.items())
        )
