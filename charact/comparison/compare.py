"""Differences between two sets of measurements, by draws from their intervals.

Measurements of one quantity and unit are matched by stack, direction and frequency. Each side is
described by its intervals alone, and the two sides are independent.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from charact.comparison.conditions import ConditionPair, condition_pairs, pair_stacks, require_alike
from charact.comparison.thresholds import LIMITS
from labdata import QUANTITIES, BadInput, Session, order_flags
from labdata.measurement import Interval, Measurement, Result, intervals_of
from labdata.short_repr import short_repr

# Label of a stack that the other session does not have, and quantities that grow with the exposure
# of the darks, which have no difference where those differ.
UNPAIRED, OF_EXPOSURE = "\0", ("dark_signal",)
# Standard scores of the upper limits of the 68 % and 95 % intervals, and one beyond all draws.
SCORES, FARTHEST = (0.994458, 1.959964), 10.0


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Difference B - A of one quantity."""

    a: Measurement  #: The measurement of the first result
    b: Measurement  #: The measurement of the second result
    difference: float  #: Value of B minus value of A, unit of both
    #: Equal-tailed interval of the difference; None if a side has no interval
    interval68: Interval | None
    #: Equal-tailed interval of the difference; None if a side has no interval
    interval95: Interval | None
    #: Probability that B is greater than A; None if a side has no interval
    probability_greater: float | None
    flags: tuple[str, ...] = ()  #: Flags of either side, and "unlike-conditions"

    @property
    def status(self) -> Literal["ok", "suspect"]:
        """Return "suspect" if either side is suspect or the conditions are unlike."""
        return "suspect" if self.flags else "ok"

    @property
    def probability_better(self) -> float | None:
        """Return the probability that B is better; None for a quantity without a better
        direction.
        """
        better = QUANTITIES[self.a.quantity].better
        if self.probability_greater is None or better == "higher":
            return self.probability_greater
        return 1.0 - self.probability_greater if better == "lower" else None

    @property
    def excludes_zero(self) -> bool:
        """Return whether the 95 % interval of the difference excludes zero."""
        return self.interval95 is not None and not self.interval95[0] <= 0.0 <= self.interval95[1]


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Comparison of two sessions."""

    differences: tuple[Difference, ...]  #: Quantities with a value in both
    conditions: tuple[ConditionPair, ...] = ()  #: Properties in which the sessions differ
    stacks: int = 0  #: Number of stacks in both sessions
    unmatched: tuple[int, int] = (0, 0)  #: Number of values in A only and in B only

    __repr__ = short_repr

    def find(self, quantity: str, stack: str | None = None) -> tuple[Difference, ...]:
        """Return the differences of a quantity, of one stack if given."""
        return tuple(
            difference
            for difference in self.differences
            if difference.a.quantity == quantity and stack in (None, difference.a.stack)
        )


def compare(
    a: Result,
    b: Result,
    *,
    sessions: tuple[Session, Session] | None = None,
    anyway: bool = False,
    rng: np.random.Generator,
) -> Comparison:
    r"""Return the difference B - A of every quantity with a value in both results.

    Parameters
    ----------
    a, b
        The results.
    sessions
        Their sessions, whose conditions are compared; None: the conditions are unknown.
    anyway
        Compare unlike sessions, with the flag "unlike-conditions".
    rng
        Generator of the draws.

    Raises
    ------
    BadInput
        If the sessions are unlike, have no stack in common, or there is no quantity with a value in
        both.

    Notes
    -----
    Each side is drawn by its quantile function: piecewise linear in the standard score through the
    value and the limits of the 68 and 95 % intervals, and linear beyond. This is a normal
    distribution for a Gaussian measurement, a split normal for an asymmetric 95 % interval alone,
    and always reproduces the given intervals. Errors that both sessions have in common, such as
    that of one light meter, are counted twice: the interval is then too wide.

    Examples
    --------
    >>> import numpy as np
    >>> from labdata.measurement import Result, measurement_from_sd
    >>> a, b = (
    ...     Result(
    ...         measurements=(
    ...             measurement_from_sd("mtf50", "cy/px", value, 0.003, method="edge-forward"),
    ...         )
    ...     )
    ...     for value in (0.200, 0.220)
    ... )
    >>> found = compare(a, b, rng=np.random.default_rng(1)).differences[0]
    >>> print(f"{found.difference:.3f}, better with probability {found.probability_better:.2f}")
    0.020, better with probability 1.00
    """
    conditions, stacks, labels = (), (), dict[str, str]()
    unlike = set[str | None]()
    if sessions is not None:
        if not anyway:
            require_alike(*sessions)
        conditions, stacks = condition_pairs(*sessions), pair_stacks(*sessions)
        labels = dict.fromkeys((entry.label for entry in sessions[1].stacks), UNPAIRED)
        labels |= {stack_b.label: stack_a.label for stack_a, stack_b in stacks}
        unlike = {pair.stack for pair in conditions if pair.unlike}
    matched = pair_measurements(a, b, labels)
    if not matched:
        raise BadInput(
            "two results must have a quantity with a value in both to be compared, got none"
        )
    darks = all(session.of_kind("dark") for session in sessions or ())
    if darks and not any(stack_a.kind == "dark" for stack_a, _ in stacks):
        matched = tuple(pair for pair in matched if pair[0].quantity not in OF_EXPOSURE)
    valued = [sum(m.value is not None for m in result.measurements) for result in (a, b)]
    return Comparison(
        differences=tuple(_difference(*pair, unlike, rng) for pair in matched),
        conditions=conditions,
        stacks=len(stacks),
        unmatched=(valued[0] - len(matched), valued[1] - len(matched)),
    )


def pair_measurements(
    a: Result, b: Result, labels: Mapping[str, str] | None = None
) -> tuple[tuple[Measurement, Measurement], ...]:
    """Return the measurements with values that measure the same thing in two results, in the order
    of the first; `labels`: label in A of each stack of B.

    Quantity, unit, stack and amplifier are equal, frequency and direction agree within `LIMITS`,
    and regions overlap. Of several possible partners the same method comes first, then the nearest
    direction and frequency.
    """
    groups: dict[tuple[object, ...], list[tuple[int, Measurement]]] = {}
    for index, m in enumerate(b.measurements):
        if m.value is not None:
            of = m.stack if m.stack is None else (labels or {}).get(m.stack, m.stack)
            groups.setdefault((m.quantity, m.unit, of, m.amplifier), []).append((index, m))
    possible = [
        (_unlikeness(measurement, partner), i, j)
        for i, measurement in enumerate(a.measurements)
        if measurement.value is not None
        for j, partner in groups.get(
            (measurement.quantity, measurement.unit, measurement.stack, measurement.amplifier), ()
        )
        if _same_place(measurement, partner)
    ]
    partners: dict[int, int] = {}
    for _, i, j in sorted(possible):
        if i not in partners and j not in partners.values():
            partners[i] = j
    return tuple((a.measurements[i], b.measurements[j]) for i, j in sorted(partners.items()))


def _same_place(a: Measurement, b: Measurement) -> bool:
    return (
        same_frequency(a.frequency_cy_per_px, b.frequency_cy_per_px)
        and (
            a.orientation_deg is None
            or b.orientation_deg is None
            or turn_deg(a.orientation_deg, b.orientation_deg) <= LIMITS.direction_deg
        )
        and (a.region is None or b.region is None or _overlap(a.region, b.region))
    )


def same_frequency(a: float | None, b: float | None) -> bool:
    """Return whether two frequencies agree within the tolerance; both None agree."""
    if a is None or b is None:
        return a is b
    return abs(a - b) <= LIMITS.relative_frequency * max(abs(a), abs(b))


def turn_deg(a: float, b: float) -> float:
    """Return the angle between two directions, 0 to 90 degrees."""
    return abs((a - b + 90.0) % 180.0 - 90.0)


def _overlap(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> bool:
    return all(max(a[i], b[i]) < min(a[i] + a[i + 2], b[i] + b[i + 2]) for i in (0, 1))


def _unlikeness(a: Measurement, b: Measurement) -> tuple[bool, float, float, float]:
    """Return the order of preference of a partner: method, direction, frequency, position."""
    frequency = abs((a.frequency_cy_per_px or 0.0) - (b.frequency_cy_per_px or 0.0))
    turned = turn_deg(a.orientation_deg or 0.0, b.orientation_deg or 0.0)
    return a.method != b.method, turned, frequency, _apart_px(a, b)


def _apart_px(a: Measurement, b: Measurement) -> float:
    """Return the distance between the centres of two regions along rows and columns, px."""
    if a.region is None or b.region is None:
        return 0.0
    (row, col, height, width), (other_row, other_col, other_height, other_width) = (
        a.region,
        b.region,
    )
    return abs(row - other_row + 0.5 * (height - other_height)) + abs(
        col - other_col + 0.5 * (width - other_width)
    )


def _difference(
    a: Measurement, b: Measurement, unlike: set[str | None], rng: np.random.Generator
) -> Difference:
    assert a.value is not None and b.value is not None
    # Quantities of the session depend on all its stacks.
    doubtful = bool(unlike) if a.stack is None else None in unlike or a.stack in unlike
    flags = order_flags((*a.flags, *b.flags, *(["unlike-conditions"] if doubtful else [])))
    draws_a, draws_b = draws_of(a, rng=rng), draws_of(b, rng=rng)
    interval68 = interval95 = probability = None
    if draws_a is not None and draws_b is not None:
        _, interval68, interval95 = intervals_of(draws_b - draws_a)
        probability = float(np.mean(draws_b > draws_a) + 0.5 * np.mean(draws_b == draws_a))
    return Difference(
        a=a,
        b=b,
        difference=b.value - a.value,
        interval68=interval68,
        interval95=interval95,
        probability_greater=probability,
        flags=flags,
    )


def draws_of(
    m: Measurement, *, count: int = LIMITS.draws, rng: np.random.Generator
) -> NDArray[np.float64] | None:
    """Return draws of a measurement by its intervals, shape (count,); None without a value or an
    interval.

    Examples
    --------
    >>> import numpy as np
    >>> from labdata.measurement import make_measurement
    >>> gain = make_measurement(
    ...     "photoelectron_gain", "DN/pe", 3.1, None, (2.3, 5.2), method="covariance-sum"
    ... )
    >>> draws = draws_of(gain, count=200_000, rng=np.random.default_rng(1))
    >>> low, high = np.quantile(draws, [0.025, 0.975])
    >>> print(f"{low:.1f} {high:.1f}")
    2.3 5.2
    """
    known = [
        (score, ends)
        for score, ends in zip(SCORES, (m.interval68, m.interval95), strict=True)
        if ends is not None
    ]
    if m.value is None or not known:
        return None
    lower = _arm([(score, m.value - low) for score, (low, _) in known])
    upper = _arm([(score, high - m.value) for score, (_, high) in known])
    scores = np.concatenate([-lower[0][::-1], [0.0], upper[0]])
    values = m.value + np.concatenate([-lower[1][::-1], [0.0], upper[1]])
    return np.interp(rng.standard_normal(count), scores, values)


def _arm(known: list[tuple[float, float]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return standard scores and distances from the value on one side, extended linearly to
    `FARTHEST`.
    """
    scores, lengths = [0.0], [0.0]
    for score, length in known:
        scores.append(score)
        # A value may lie outside its interval by rounding, and intervals may be nested the wrong
        # way.
        lengths.append(max(length, lengths[-1]))
    slope = (lengths[-1] - lengths[-2]) / (scores[-1] - scores[-2])
    scores.append(FARTHEST)
    lengths.append(lengths[-1] + slope * (FARTHEST - scores[-2]))
    return np.array(scores[1:]), np.array(lengths[1:])


def comparison_json(comparison: Comparison) -> dict[str, Any]:
    """Return a comparison as JSON-ready mappings: the differences, and the conditions that
    differ.
    """
    return {
        "differences": [_document(difference) for difference in comparison.differences],
        "conditions": [vars(pair) for pair in comparison.conditions],
    }


def _document(difference: Difference) -> dict[str, Any]:
    applying = ("stack", "region", "frequency_cy_per_px", "orientation_deg", "amplifier")
    better = difference.probability_better
    return {
        "quantity": difference.a.quantity,
        "unit": difference.a.unit,
        **{name: value for name in applying if (value := getattr(difference.a, name)) is not None},
        "a": difference.a.value,
        "b": difference.b.value,
        **{
            name: getattr(difference, name)
            for name in ("difference", "interval68", "interval95", "probability_greater")
        },
        **({} if better is None else {"probability_better": better}),
        "status": difference.status,
        "flags": list(difference.flags),
    }
