"""One comparison of measured with simulated frames: its chance, and the size of its departure."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from charact.observables.size import Size
from charact.validation.thresholds import VALIDATION

# Half of a two-sided 95 % interval of a Gaussian, standard deviations.
HALF95_SD = 1.96

# "agrees": chance explains the difference, and the tolerance could have been seen; "within": it is
# no chance, but smaller than the tolerance; "differs": beyond it; "unseen": predictions spread too
# far to tell.
Agreement = Literal["agrees", "within", "differs", "unseen"]


@dataclass(frozen=True, kw_only=True)
class Statistic:
    """One comparison of measured with simulated frames.

    Parameters
    ----------
    name, title
        Short name and description.
    distance
        Distance of the measured value from the simulated ones, about 1 if they agree.
    p_value, level
        Probability of a distance at least as large if the camera is right, and that below which it
        fails, corrected for several comparisons; dimensionless. The probability of a number that
        cannot be measured is 0.
    least_p
        Least p-value that the number of repetitions can give.
    labels, measured, low95, high95
        Names of the numbers, measured values, and predicted 95 % intervals.
    worst, part, cause, matters
        Number that deviates most, part of the frame that it is of, stages or faults that move the
        numbers of this statistic, and the use for which a departure matters.
    departure, departure95, departure_unit, tolerance
        Measured less predicted size of that number, its 95 % interval, their unit, and the largest
        departure that does not matter; None where no size is known.
    unseen, least_spread
        Numbers whose predictions spread further than the tolerance, and the least spread of a
        number, half of a 95 % interval, over its tolerance.
    """

    name: str
    title: str
    distance: float
    p_value: float
    level: float
    labels: tuple[str, ...] = ()
    measured: tuple[float, ...] = ()
    low95: tuple[float, ...] = ()
    high95: tuple[float, ...] = ()
    least_p: float = 0.0
    worst: str = ""
    part: str = ""
    cause: str = ""
    matters: str = ""
    departure: float | None = None
    departure95: tuple[float, float] | None = None
    departure_unit: str = ""
    tolerance: float | None = None
    unseen: tuple[str, ...] = ()
    least_spread: float | None = None

    @property
    def passed(self) -> bool:
        """Whether the measured frames look like the simulated ones in this respect."""
        return self.p_value >= self.level

    @property
    def verdict(self) -> Agreement:
        """What the departure means at its tolerance; without a size chance alone decides."""
        if self.departure is None or self.departure95 is None or self.tolerance is None:
            return "agrees" if self.passed else "differs"
        low, high = self.departure95
        if self.passed:
            spread = self.least_spread
            spread = (high - low) / 2.0 / self.tolerance if spread is None else spread
            return "agrees" if spread <= 1.0 else "unseen"
        if abs(self.departure) > self.tolerance:
            return "differs"
        return "within" if max(-low, high) <= self.tolerance else "unseen"

    @property
    def excess(self) -> float:
        """Departure over its tolerance; infinite where no size is known."""
        if self.departure is None or self.tolerance is None:
            return float("inf")
        return abs(self.departure) / self.tolerance

    def is_sure(self, draws: int) -> bool:
        """Return whether as many other simulated sets would hardly change the verdict.

        Notes
        -----
        The spread of n sets has a relative error of 1 / sqrt(2 (n - 1)), and p, which follows from
        it and from their mean, is known to a factor. Twice that error and the factor, to both
        sides, must leave the verdict; "agrees" and "within" are one.
        """
        if self.departure is None or self.departure95 is None:
            return True
        verdicts, shown = set[Agreement](), self.p_value > 1.0001 * self.least_p
        for sign in (-1.0, 1.0):
            width = 1.0 + sign * np.sqrt(2.0 / (draws - 1.0))
            low, high = (self.departure + width * (at - self.departure) for at in self.departure95)
            spread = self.least_spread and width * self.least_spread
            wider = replace(self, departure95=(low, high), least_spread=spread)
            factors = (1.0 / VALIDATION.unsure_p, VALIDATION.unsure_p) if shown else (1.0,)
            verdicts |= {replace(wider, p_value=self.p_value * by).verdict for by in factors}
        return len({"agrees" if verdict == "within" else verdict for verdict in verdicts}) == 1

    @property
    def p_text(self) -> str:
        """The p-value, or "< least" where no repetition was as distant."""
        return (
            f"< {self.least_p:.2g}"
            if self.p_value <= self.least_p * 1.0001
            else f"{self.p_value:.2g}"
        )


def with_departure(
    statistic: Statistic, scales: Mapping[str, tuple[Size, float]], draws: int
) -> Statistic:
    """Return a statistic with the size of its departure.

    Parameters
    ----------
    statistic
        Its numbers with their predictions.
    scales
        Size and tolerance of numbers by label.
    draws
        Number of simulated sets: mean and spread of the predictions are estimates.

    Notes
    -----
    The size is that of one number. Of a statistic that fails it is the largest over its tolerance
    among those that deviate by more than chance; of one that passes, or that fails by its numbers
    together, the most deviating one; of one whose predictions all spread further than the
    tolerance, that of the least spread. The 95 % interval is Student's.
    """
    from scipy.stats import t

    rows = [row for row, label in enumerate(statistic.labels) if label in scales]
    if not rows or statistic.p_value == 0.0:
        return statistic
    measured, low, high = (
        np.array(getattr(statistic, name))[rows] for name in ("measured", "low95", "high95")
    )
    predicted, sd = (low + high) / 2.0, (high - low) / (2.0 * HALF95_SD)
    z = np.abs(measured - predicted) / sd
    half = t.isf(0.025, draws - 1) * sd
    sizes, largest = zip(*(scales[statistic.labels[row]] for row in rows), strict=True)
    ends = np.stack([measured, measured - half, measured + half], axis=1)
    departures = np.array([s.departure(*p) for s, *p in zip(sizes, ends, predicted, strict=True)])
    tolerance = np.array(largest)
    spread = np.diff(departures[:, 1:]).ravel() / 2.0 / tolerance
    weight = np.where(spread <= 1.0, z, -spread)
    if not statistic.passed:
        chance = z <= t.isf(VALIDATION.level / 2.0, draws - 1)
        weight = z if chance.all() else np.where(chance, -1.0, np.abs(departures[:, 0]) / tolerance)
    weight[~np.isfinite(departures).all(axis=1)] = -np.inf
    at = int(np.argmax(weight))
    if not np.isfinite(weight[at]):
        return statistic
    departs = statistic.labels[rows[at]]
    return replace(
        statistic,
        worst=", ".join(filter(None, (departs, statistic.part))),
        departure=float(departures[at, 0]),
        departure95=(float(departures[at, 1]), float(departures[at, 2])),
        departure_unit=sizes[at].unit,
        tolerance=float(tolerance[at]),
        unseen=tuple(statistic.labels[rows[i]] for i in np.flatnonzero(spread > 1.0)),
        least_spread=float(spread[np.isfinite(weight)].min()),
    )
