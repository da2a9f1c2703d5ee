"""The verdict on a measured number: the findings of the checks, and the one rule from them and the
interval to the status.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import fsum, isfinite

import numpy as np

from labdata import Array
from labdata.flags import order_flags
from labdata.measurement import Curve, Interval, Measurement, Status

GOLDEN_RATIO = 0.5 + 0.5 * 5.0**0.5
SETTLES, AT_MOST = "; what settles it: ", ": at most "


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What a check found in the data."""

    flag: str  #: A key of `labdata.flags.FLAGS`
    effect: str  #: What was seen, with quantity and unit: "3 of 2100 pixels were excluded"
    #: Setting, frames or description that removes it: "`black_dn`, or darks in the session"
    remedy: str
    #: Largest effect on the value, in the unit of the quantity (a relative one times the value).
    #: It comes from an equation or a study; None: unbounded, or contradicted by the data
    bound: float | None = None
    #: 1: the effect raises the value, so the truth is lower; -1: it lowers it; 0: either way
    sign: int = 0

    def __post_init__(self) -> None:
        order_flags((self.flag,))
        if self.bound is not None and not (isfinite(self.bound) and self.bound >= 0.0):
            raise ValueError(f"the bound of {self.flag} is finite and at least 0, got {self.bound}")
        if self.sign not in (-1, 0, 1):
            raise ValueError(f"the sign of {self.flag} is -1, 0 or 1, got {self.sign}")

    @property
    def note(self) -> str:
        """The finding as one line of text, without its bound."""
        return f"{self.flag}: {self.effect}{SETTLES}{self.remedy}"

    @property
    def beginnings(self) -> tuple[str, str]:
        """How a note on it begins, without and with its bound."""
        seen = f"{self.flag}: {self.effect}"
        return seen + SETTLES, seen + AT_MOST


def inherited(*measurements: Measurement) -> list[Finding]:
    """Return the findings on measurements that another one is computed from."""
    return [
        Finding(flag=flag, effect=f"of {m.quantity}", remedy="see its notes")
        for m in measurements
        for flag in m.flags
    ]


def judge(measurement: Measurement, findings: Iterable[Finding]) -> Measurement:
    """Return the measurement with the status that its findings give it, and a note on each.

    Parameters
    ----------
    measurement
        A number as estimated, or a refusal. One judged before keeps its flags and limits; findings
        that it was judged by are not counted again.
    findings
        All that the checks found; their order is that of the notes and has no other effect.

    Notes
    -----
    h = sum of the bounds that can move a limit; d = distance of the 95 % limit from the value. An
    unbounded finding makes the number suspect. Else it is ok: where h <= d the interval holds the
    effects; where h > d both limits of that side move outwards by h. Bounds add linearly, not in
    squares, as a bound is not a standard deviation. An effect that raises the value moves the lower
    limits, one that lowers it the upper ones. A number without an interval holds no effect: each
    bound above 0 makes it suspect. A refusal has no number to judge: it keeps all flags.
    """
    new = [
        finding
        for finding in dict.fromkeys(findings)
        if not any(note.startswith(finding.beginnings) for note in measurement.notes)
    ]
    if not new:
        return measurement
    value, interval95 = measurement.value, measurement.interval95
    if value is None or interval95 is None:
        flagged = [finding for finding in new if value is None or finding.bound != 0.0]
        return _with(measurement, flagged, tuple(finding.note for finding in new))
    # By how much each side moves: the lower by effects that raise the value.
    sums = [
        fsum(finding.bound for finding in new if finding.bound and finding.sign != sign)
        for sign in (-1, 1)
    ]
    distances = value - interval95[0], interval95[1] - value
    moves = [
        total if total > distance else 0.0 for total, distance in zip(sums, distances, strict=True)
    ]
    notes = tuple(_note(finding, measurement.unit, moves) for finding in new)
    judged = replace(
        measurement,
        interval68=measurement.interval68 and _wider(measurement.interval68, moves),
        interval95=_wider(interval95, moves),
    )
    return _with(judged, [finding for finding in new if finding.bound is None], notes)


def _wider(interval: Interval, moves: list[float]) -> Interval:
    """Return an interval whose lower and upper limit are moved outwards."""
    return interval[0] - moves[0], interval[1] + moves[1]


def widen_curve(curve: Curve, below: Array, above: Array) -> Curve:
    """Return a curve whose intervals and draws hold bounded effects, by the rule of `judge` at each
    frequency.

    Parameters
    ----------
    below, above
        Sums of the bounds that move the lower and the upper limits, shape (n,).

    Notes
    -----
    What combines curves takes their draws: those get one effect each, spread evenly over the bound
    (JCGM 100, 4.3.7), the same at all frequencies.
    """
    if curve.interval95 is None or curve.interval68 is None:
        return curve
    distances = np.abs(curve.interval95 - curve.value)
    moves = np.where(np.stack([below, above]) > distances, [below, above], 0.0)
    outwards, draws = np.array([[-1.0], [1.0]]) * moves, curve.draws
    if draws is not None and moves.any():
        # Multiples of the golden ratio are spread evenly, whatever the order of the draws.
        place = 2.0 * ((np.arange(1, len(draws) + 1) * GOLDEN_RATIO) % 1.0)[:, None] - 1.0
        draws = draws + np.where(place < 0.0, place * moves[0], place * moves[1])
    return replace(
        curve,
        interval68=curve.interval68 + outwards,
        interval95=curve.interval95 + outwards,
        draws=draws,
    )


def _note(finding: Finding, unit: str, moves: list[float]) -> str:
    """Return the note on a finding, a bound with what the interval makes of it."""
    if finding.bound is None:
        return finding.note
    size = f"{finding.bound:.2g} {unit}" if unit != "1" else f"{finding.bound:.2g}"
    way = {-1: " too low", 0: "", 1: " too high"}[finding.sign]
    widened = bool(finding.bound) and any(
        move for move, sign in zip(moves, (-1, 1), strict=True) if finding.sign != sign
    )
    held = "by which the interval is widened" if widened else "within the interval"
    return f"{finding.beginnings[1]}{size}{way}, {held}{SETTLES}{finding.remedy}"


def _with(measurement: Measurement, flagged: list[Finding], notes: tuple[str, ...]) -> Measurement:
    """Return a measurement with more flags and notes, and the status that its flags mean."""
    flags = order_flags((*measurement.flags, *(finding.flag for finding in flagged)))
    status: Status = "refused" if measurement.value is None else "suspect" if flags else "ok"
    return replace(measurement, flags=flags, status=status, notes=(*measurement.notes, *notes))
