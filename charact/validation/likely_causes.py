"""Likely causes of a validation that fails: numbers that one fault of camera or grabber moves, and
the way they go.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.findings import (
    AVERAGED,
    COARSE,
    CURVED,
    LAGGING,
    LENS_OFF_AXIS,
    OFF_AXIS,
    SHARPENED,
    UNSTEADY,
    Cause,
)
from charact.validation.thresholds import VALIDATION
from charact.verdict import Finding

Array = NDArray[np.float64]
# Half of a two-sided 95 % interval of a Gaussian, standard deviations.
HALF95_SD = 1.96


@dataclass(frozen=True, kw_only=True)
class Statistic:
    """One comparison of measured with simulated frames.

    Parameters
    ----------
    name, title, note
        Short name, description, and note for the reader.
    distance
        Distance of the measured value from the simulated ones, about 1 if they agree.
    p_value, level
        Probability of a distance at least as large if the camera is right, and that below which it
        fails, corrected for several comparisons; dimensionless.
    least_p
        Least p-value that the number of repetitions can give.
    labels, measured, low95, high95
        Names of the numbers, measured values, and predicted 95 % intervals.
    worst, cause
        Number that deviates most, and stages or faults that move the numbers of this statistic.
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
    note: str = ""
    least_p: float = 0.0
    worst: str = ""
    cause: str = ""

    @property
    def passed(self) -> bool:
        """Whether the measured frames look like the simulated ones in this respect."""
        return self.p_value >= self.level

    @property
    def p_text(self) -> str:
        """The p-value, or "< least" where no repetition was as distant."""
        return (
            f"< {self.least_p:.2g}"
            if self.p_value <= self.least_p * 1.0001
            else f"{self.p_value:.2g}"
        )


@dataclass(frozen=True, kw_only=True)
class Signature:
    """Effect of a fault on the numbers of one statistic.

    `flag`: key of `labdata.flags.FLAGS`; `statistic`, `numbers`: the statistic and how the labels
    of its numbers begin; `shows`: which of them show it, by their deviation in standard deviations
    and their value.
    """

    flag: str
    statistic: str
    numbers: str
    shows: Callable[[Array, Array], NDArray[np.bool_]]
    cause: Cause


def _limit() -> float:
    """Return the deviation of a single number that is no chance, standard deviations: two-sided, of
    few sets.
    """
    from scipy.stats import t

    return float(t.isf(VALIDATION.level / 2.0, VALIDATION.draws - 1))


def _above(z: Array, value: Array) -> NDArray[np.bool_]:
    return z > _limit()


def _positive(z: Array, value: Array) -> NDArray[np.bool_]:
    """Whether a correlation is above its prediction and no anticorrelation, which the mean of few
    frames leaves.
    """
    return _above(z, value) & (value > 0.0)


def _below(z: Array, value: Array) -> NDArray[np.bool_]:
    return z < -_limit()


def _either(z: Array, value: Array) -> NDArray[np.bool_]:
    return np.abs(z) > _limit()


def _constant(z: Array, value: Array) -> NDArray[np.bool_]:
    """Whether a bit of a digitiser is always 0 or always 1."""
    return _either(z, value) & ((value <= 0.0) | (value >= 1.0))


# From the most special to the most general: one of the first also moves numbers of the last.
SIGNATURES = (
    Signature(
        flag="quantised",
        statistic="histogram",
        numbers="share of ones of bit",
        shows=_constant,
        cause=COARSE,
    ),
    Signature(
        flag="processed",
        statistic="time",
        numbers="correlation of dark frames of",
        shows=_positive,
        cause=AVERAGED,
    ),
    Signature(flag="drift", statistic="time", numbers="drift of", shows=_either, cause=UNSTEADY),
    Signature(
        flag="processed",
        statistic="autocorrelation",
        numbers="correlation at",
        shows=_below,
        cause=SHARPENED,
    ),
    Signature(
        flag="correlated-noise",
        statistic="field",
        numbers="correlation at",
        shows=_above,
        cause=OFF_AXIS,
    ),
    Signature(
        flag="model-misfit",
        statistic="edge",
        numbers="step over 0.5 to 1.5 px of the edge, ends",
        shows=_below,
        cause=LENS_OFF_AXIS,
    ),
    Signature(flag="nonlinear", statistic="linearity", numbers="", shows=_either, cause=CURVED),
    Signature(
        flag="lag",
        statistic="time",
        numbers="correlation of frames of",
        shows=_above,
        cause=LAGGING,
    ),
)


def likely_causes(statistics: Iterable[Statistic]) -> tuple[Finding, ...]:
    """Return the faults whose signatures failing statistics show, the likeliest first; empty where
    none fails.

    Notes
    -----
    That a statistic fails is decided by its p-value alone. Of its numbers, one belongs to a
    signature if it deviates the signature's way by more than Student's quantile of
    `VALIDATION.level` for the simulated sets.
    """
    failing = {statistic.name: statistic for statistic in statistics if not statistic.passed}
    numbers = {
        signature: _number_of(signature, failing[signature.statistic])
        for signature in SIGNATURES
        if signature.statistic in failing
    }
    return tuple(
        signature.cause.finding(signature.flag, number)
        for signature, number in numbers.items()
        if number is not None
    )


def _number_of(signature: Signature, statistic: Statistic) -> str | None:
    """Return the number that shows a signature most, with its prediction, in words; None where none
    does.
    """
    rows = [
        index for index, label in enumerate(statistic.labels) if label.startswith(signature.numbers)
    ]
    if not rows or statistic.worst == "not measurable":
        return None
    measured, low, high = (
        np.array(getattr(statistic, name))[rows] for name in ("measured", "low95", "high95")
    )
    z = (measured - 0.5 * (low + high)) / ((high - low) / (2.0 * HALF95_SD))
    shown = signature.shows(z, measured)
    if not shown.any():
        return None
    at = int(np.argmax(np.where(shown, np.abs(z), -1.0)))
    return (
        f"{statistic.labels[rows[at]]} is {measured[at]:.3g}, not {low[at]:.3g} to {high[at]:.3g}"
    )
