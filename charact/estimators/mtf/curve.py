"""MTF curves and crossing frequencies from posterior draws."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from charact.verdict import Finding, widen_curve
from labdata import Array
from labdata.measurement import (
    QUANTILES,
    Curve,
    Measurement,
    Posterior,
    make_refusal,
    measurement_from_draws,
)

# From frequencies, cy/px, and an MTF, shape (f,), to the MTF without an effect.
Undo = Callable[[Array, Array], Array]
# Frequencies of a reported curve, and the finer grid for crossing frequencies, cy/px.
REPORTED = np.linspace(0.0, 0.5, 101)
FINE = np.concatenate([[1e-6], np.geomspace(0.003, 1.5, 230)])
# Frequencies at which the MTF is reported as a quantity of its own, cy/px.
PINNED = (0.1, 0.2, 0.3)
LEVELS = {"mtf50": 0.5, "mtf10": 0.1}


@dataclass(frozen=True, kw_only=True)
class CurveFinding:
    """A finding of a target, before it is one of a quantity.

    Parameters
    ----------
    flag, effect, sign
        As of `Finding`.
    undo
        From frequencies, cy/px, and the MTF, shape (f,), to the MTF without the largest effect;
        None: the effect is unbounded.
    """

    flag: str
    effect: str
    undo: Undo | None = None
    sign: int = 0

    def of_number(
        self, measurement: Measurement, frequency: Array, modulus: Array, remedy: str
    ) -> Finding:
        """Return the finding of MTF50, MTF10 or an MTF; `modulus`: the MTF at frequencies."""
        bound = None
        if self.undo is not None and measurement.value is not None:
            both = np.stack([modulus, self.undo(frequency, modulus)])
            level, at = LEVELS.get(measurement.quantity), measurement.frequency_cy_per_px or 0.0
            before, after = (
                [np.interp(at, frequency, line) for line in both]
                if level is None
                else crossing_frequency(frequency, both, level)
            )
            change = measurement.value * abs(after / max(before, 1e-12) - 1.0)
            bound = float(change) if np.isfinite(change) else None
        return Finding(
            flag=self.flag, effect=self.effect, remedy=remedy, bound=bound, sign=self.sign
        )


def stretched(fraction: float) -> Undo:
    """Return what makes an MTF one whose frequencies are higher by a fraction."""
    return lambda frequency, modulus: np.interp(frequency / (1.0 + fraction), frequency, modulus)


def widen_by(
    findings: Iterable[CurveFinding], curve: Curve, frequency: Array, modulus: Array
) -> Curve:
    """Return a curve whose intervals and draws hold the bounded effects, as its numbers do;
    `modulus`: the MTF at frequencies, shape (f,).
    """
    bounds = [
        (finding.sign, np.minimum(np.abs(finding.undo(frequency, modulus) - modulus), 1.0))
        for finding in findings
        if finding.undo is not None
    ]
    sides = [
        np.interp(
            curve.frequency_cy_per_px,
            frequency,
            sum((bound for of, bound in bounds if of != sign), np.zeros_like(modulus)),
        )
        for sign in (-1, 1)
    ]
    return widen_curve(curve, *sides) if bounds else curve


def curve_of(frequency: Array, draws: Array) -> Curve:
    """Return median and pointwise credible intervals of drawn curves, shape (draw, frequency)."""
    low95, low68, centre, high68, high95 = quantiles(draws, QUANTILES)
    return Curve(
        frequency_cy_per_px=frequency,
        value=centre,
        interval68=np.stack([low68, high68]),
        interval95=np.stack([low95, high95]),
        draws=draws,
    )


def quantiles(draws: Array, shares: tuple[float, ...]) -> Array:
    """Return quantiles of draws (draw, ...), shape (quantile, ...); equal to `numpy.quantile`, with
    a single sort.
    """
    ordered = np.sort(np.ascontiguousarray(draws.T)).T
    position = np.asarray(shares) * (len(draws) - 1)
    low = np.minimum(position.astype(int), max(len(draws) - 2, 0))
    fraction = (position - low).reshape(-1, *[1] * (draws.ndim - 1))
    return ordered[low] + fraction * (ordered[np.minimum(low + 1, len(draws) - 1)] - ordered[low])


def crossing_frequency(frequency: Array, curves: Array, level: float) -> Array:
    """Return the lowest frequency at which each curve falls to a level, NaN where it does not.

    Parameters
    ----------
    frequency
        Shape (f,).
    curves
        Shape (n, f).
    """
    is_low = curves < level
    first = np.argmax(is_low, axis=1)
    crosses = is_low.any(axis=1) & (first > 0)
    index = np.where(crosses, first, 1)
    rows = np.arange(len(curves))
    high, low = curves[rows, index - 1], curves[rows, index]
    fraction = (high - level) / np.where(high > low, high - low, 1.0)
    crossing = frequency[index - 1] + fraction * (frequency[index] - frequency[index - 1])
    return np.where(crosses, crossing, np.nan)


def mtf_measurements(
    mtf: Callable[[Array], Array],
    common: dict[str, Any],
    *,
    posterior: Posterior,
    doubt: Callable[[Array], Array] | None = None,
    finish: Callable[[Measurement, Array], Measurement] | None = None,
    names: tuple[str, ...] = ("mtf50", "mtf10", "mtf"),
) -> tuple[list[Measurement], Curve, Array]:
    """Return MTF50, MTF10 and the MTF at pinned frequencies, its curve, and the draws of MTF50.

    Parameters
    ----------
    mtf
        From frequencies, cy/px, to drawn MTFs, shape (f,) -> (draw, f).
    common
        Fields that all measurements share.
    posterior
        Recorded with the crossing frequencies.
    doubt
        Relative standard uncertainty of what is known of the transfer, shape (f,) -> (f,); None:
        exact.
    finish
        Changes a measurement according to its draws, before the doubt widens it.
    names
        Which of the quantities are returned.
    """
    every = 6
    coarse_at = np.append(FINE[:-1:every], FINE[-1])
    draws = mtf(np.concatenate([coarse_at, PINNED, np.maximum(REPORTED, 1e-6)]))
    coarse, pinned, reported = np.split(
        draws, [coarse_at.size, coarse_at.size + len(PINNED)], axis=1
    )

    def crossings(level: float) -> Array:
        """Return where each draw falls to a level, NaN where it never does: finely where the coarse
        ones do.
        """
        is_low = coarse < level
        falls = is_low.any(axis=1)
        first = np.argmax(is_low[falls], axis=1)
        if not first.size:
            return np.full(len(coarse), np.nan)
        bracket = FINE[max(first.min() - 1, 0) * every : first.max() * every + 1]
        return np.where(falls, crossing_frequency(bracket, mtf(bracket), level), np.nan)

    halves = crossings(LEVELS["mtf50"])

    measurements: list[Measurement] = []
    for name in names:
        if name in LEVELS:
            draws_of_level = halves if name == "mtf50" else crossings(LEVELS[name])
            pairs = [
                (
                    _crossing_measurement(name, draws_of_level, posterior, common),
                    draws_of_level[np.isfinite(draws_of_level)],
                )
            ]
        else:
            pairs = [
                (measurement_from_draws(name, "1", at, frequency_cy_per_px=float(f), **common), at)
                for f, at in zip(PINNED, pinned.T, strict=True)
            ]
        finished = [
            measurement if finish is None else finish(measurement, drawn)
            for measurement, drawn in pairs
        ]
        measurements += [
            flag_filter_uncertainty(
                measurement, doubt, lambda level: float(np.nanmedian(crossings(level)))
            )
            for measurement in finished
        ]
    return measurements, curve_of(REPORTED, reported), halves


def crossing_measurement(
    quantity: str, curves: Array, posterior: Posterior, common: dict[str, Any]
) -> Measurement:
    """Return MTF50 or MTF10 of drawn curves at `FINE`; refused where over 2 % of them do not fall
    to the level.
    """
    return _crossing_measurement(
        quantity, crossing_frequency(FINE, curves, LEVELS[quantity]), posterior, common
    )


def _crossing_measurement(
    quantity: str, draws: Array, posterior: Posterior, common: dict[str, Any]
) -> Measurement:
    lost = float(np.mean(~np.isfinite(draws)))
    if lost > 0.02:
        level = LEVELS[quantity]
        reason = (
            f"the MTF must fall to {level:g} below {FINE[-1]:.1f} cy/px; {100 * lost:.0f} % "
            f"of its draws do not"
        )
        return make_refusal(quantity, "cy/px", reason, **common)
    return measurement_from_draws(
        quantity, "cy/px", draws[np.isfinite(draws)], posterior=posterior, **common
    )


def flag_filter_uncertainty(
    measurement: Measurement,
    doubt: Callable[[Array], Array] | None,
    crossing: Callable[[float], float],
) -> Measurement:
    """Return a measurement whose intervals include the systematic uncertainty of the known
    transfer.

    Parameters
    ----------
    measurement
        An MTF at a frequency, MTF50 or MTF10; other quantities are returned unchanged.
    doubt
        Relative standard uncertainty of the known transfer at frequencies, cy/px, shape (f,) ->
        (f,); None: exact.
    crossing
        From a level to the frequency at which the measured MTF falls to it, cy/px.
    """
    if (
        doubt is None
        or measurement.value is None
        or measurement.interval68 is None
        or measurement.quantity not in (*LEVELS, "mtf")
    ):
        return measurement
    frequency = (
        measurement.value
        if measurement.frequency_cy_per_px is None
        else measurement.frequency_cy_per_px
    )
    fraction = float(doubt(np.array([frequency]))[0])
    if fraction == 0.0:
        return measurement
    level = LEVELS.get(measurement.quantity)
    shift = (
        fraction * measurement.value
        if level is None
        else crossing(level * np.exp(-fraction)) - measurement.value
    )
    return measurement.with_(
        interval68=_widen(measurement.value, measurement.interval68, 0.994458 * shift),
        interval95=_widen(measurement.value, measurement.interval95, 1.959964 * shift),
    )


def _widen(
    value: float, interval: tuple[float, float] | None, by: float
) -> tuple[float, float] | None:
    if interval is None:
        return None
    low, high = interval
    return max(value - float(np.hypot(value - low, by)), 0.0), value + float(
        np.hypot(high - value, by)
    )
