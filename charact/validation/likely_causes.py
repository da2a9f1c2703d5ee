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
from charact.validation.statistic import Statistic
from charact.validation.thresholds import VALIDATION
from charact.verdict import Finding

Array = NDArray[np.float64]
# Half of a two-sided 95 % interval of a Gaussian, standard deviations.
HALF95_SD = 1.96


@dataclass(frozen=True, kw_only=True)
class Signature:
    """Effect of a fault on the numbers of one statistic.

    `flag`: key of `labdata.flags.FLAGS`; `statistic`, `numbers`: the statistic and how the labels
    of its numbers begin; `way`: 1 or -1 where they deviate upwards or downwards, 0 either way;
    `only`: which values show it.
    """

    flag: str
    statistic: str
    numbers: str
    way: float = 0.0
    only: Callable[[Array], NDArray[np.bool_]] = np.isfinite
    cause: Cause


# From the most special to the most general: one of the first also moves numbers of the last.
SIGNATURES = (
    Signature(
        flag="quantised",
        statistic="histogram",
        numbers="share of ones of bit",
        # A bit of a digitiser is always 0 or always 1.
        only=lambda ones: (ones <= 0.0) | (ones >= 1.0),
        cause=COARSE,
    ),
    Signature(
        flag="processed",
        statistic="time",
        numbers="correlation of dark frames of",
        way=1.0,
        # The mean of few frames leaves an anticorrelation.
        only=lambda correlation: correlation > 0.0,
        cause=AVERAGED,
    ),
    Signature(flag="drift", statistic="time", numbers="drift of", cause=UNSTEADY),
    Signature(
        flag="processed",
        statistic="autocorrelation",
        numbers="correlation at",
        way=-1.0,
        cause=SHARPENED,
    ),
    Signature(
        flag="correlated-noise",
        statistic="field",
        numbers="correlation at",
        way=1.0,
        cause=OFF_AXIS,
    ),
    Signature(
        flag="model-misfit",
        statistic="edge",
        numbers="step over 0.5 to 1.5 px of the edge, ends",
        way=-1.0,
        cause=LENS_OFF_AXIS,
    ),
    Signature(flag="nonlinear", statistic="linearity", numbers="", cause=CURVED),
    Signature(
        flag="lag",
        statistic="time",
        numbers="correlation of frames of",
        way=1.0,
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
    from scipy.stats import t

    rows = [
        index for index, label in enumerate(statistic.labels) if label.startswith(signature.numbers)
    ]
    if not rows or statistic.p_value == 0.0:
        return None
    measured, low, high = (
        np.array(getattr(statistic, name))[rows] for name in ("measured", "low95", "high95")
    )
    z = (measured - 0.5 * (low + high)) / ((high - low) / (2.0 * HALF95_SD))
    deviation = z * signature.way if signature.way else np.abs(z)
    # No chance of a single number, two-sided, of few sets.
    limit = t.isf(VALIDATION.level / 2.0, VALIDATION.draws - 1)
    shown = np.where((deviation > limit) & signature.only(measured), deviation, 0.0)
    at = int(np.argmax(shown))
    if shown[at] == 0.0:
        return None
    return (
        f"{statistic.labels[rows[at]]} is {measured[at]:.3g}, not {low[at]:.3g} to {high[at]:.3g}"
    )
