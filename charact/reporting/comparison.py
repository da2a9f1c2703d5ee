"""Comparison of two sessions, and verdicts on limits, as text of one screen."""

import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from charact.comparison import Comparison, Difference, LimitCheck, Outcome, load_check
from charact.comparison.conditions import ConditionPair
from charact.reporting.number_format import (
    MINUS,
    plus_minus,
    round_to_spread,
    short_text,
    value_text,
)
from charact.reporting.summary import LEADING, SERIES
from labdata.measurement import Measurement, make_measurement
from labdata.session import LoadedStackEntry, Session

ROWS, CONDITIONS, OUTCOMES = 20, 6, 36  # Most lines of a summary
NAME, COLUMNS = 33, 100  # Width of a name and of a row of a table
STATUS = {
    "pass": "ok",
    "fail": "refused",
    "undecided": "suspect",
}  # Colour of a verdict in the report


def comparison_text(
    comparison: Comparison,
    *,
    names: tuple[str, str],
    sessions: tuple[Session, Session],
    everything: bool = False,
    width: int = 100,
) -> str:
    """Return a comparison as text, without `everything` at most 40 lines.

    Parameters
    ----------
    comparison
        The comparison.
    names, sessions
        The two sessions as the user named them, and the sessions.
    everything
        Print all differences and conditions.
    width
        Columns of a line.
    """
    rows = list(_rows(comparison.differences, everything))
    hidden = [one for one in comparison.differences if all(one is not shown for _, shown in rows)]
    lines = [f"compare: {len(comparison.differences)} quantities with a value in both"]
    lines += [
        line
        for letter, name, one in zip("AB", names, sessions, strict=True)
        for line in _wrapped(f"{letter}  {_session_text(name, one)}", "   ", width, 1)
    ]
    lines += _condition_lines(comparison, everything, width)
    head = f"{'A':>12} {'B':>12} {'P(B better)':>11}   B {MINUS} A, ± is 95 %"
    lines.append(f"{'':<{NAME}} {head}")
    lines += [_line(name, one)[:COLUMNS] for name, one in rows]
    lines += _flag_lines([one for _, one in rows], width)
    lines += _footer(comparison, hidden, width)
    return "\n".join(lines)


def _footer(comparison: Comparison, hidden: Sequence[Difference], width: int) -> list[str]:
    """Return what is not shown, and the meaning of the table."""
    excluding = sum(one.excludes_zero for one in hidden)
    left = (
        [f"{len(hidden)} differences, {excluding} of them with zero outside the interval (--all)"]
        if hidden
        else []
    )
    left += [
        f"{count} values only in {side}"
        for side, count in zip("AB", comparison.unmatched, strict=True)
        if count
    ]
    lines = _wrapped(f"Not shown: {'; '.join(left)}", "    ", width, 2) if left else []
    excluding, total = (
        sum(one.excludes_zero for one in comparison.differences),
        len(comparison.differences),
    )
    meaning = (
        "( ): P(B > A), where no direction is better; !: suspect; (of N): the largest difference "
        f"of N. Zero lies outside the 95 % interval of {excluding} of {total}; for equal cameras "
        "about 5 %."
    )
    return lines + _wrapped(meaning, "    ", width, 3)


def _session_text(name: str, session: Session) -> str:
    counts = Counter(entry.kind for entry in session.stacks)
    stacks = ", ".join(f"{count} {kind}" for kind, count in counts.items())
    camera = session.camera
    return f"{name}: {'no sensor description' if camera is None else camera.name}; stacks: {stacks}"


def _condition_lines(comparison: Comparison, everything: bool, width: int) -> list[str]:
    """Return the conditions that differ side by side, equal pairs of values of several stacks in
    one line.
    """
    groups: dict[tuple[str, str, str, bool], list[ConditionPair]] = {}
    for pair in comparison.conditions:
        groups.setdefault(
            (pair.name, short_text(pair.a), short_text(pair.b), pair.unlike), []
        ).append(pair)
    matched = f"{comparison.stacks} matched stacks"
    if not groups:
        return [f"Conditions: alike in {matched}"]
    lines = [f"Conditions that differ ({matched}): A | B"]
    order = sorted(groups.items(), key=lambda item: not item[0][3])
    for (name, a, b, unlike), pairs in order if everything else order[:CONDITIONS]:
        labels = [pair.stack for pair in pairs if pair.stack is not None]
        where = f" of {', '.join(labels[:4])}" if labels else ""
        where += f" and {len(labels) - 4} more" if len(labels) > 4 else ""
        lines += _wrapped(
            f"  {name} {a} | {b}{where}{' (unlike)' if unlike else ''}", "    ", width, 1
        )
    if not everything and len(order) > CONDITIONS:
        lines.append(f"  and {len(order) - CONDITIONS} more (--all)")
    return lines


def _rows(differences: Sequence[Difference], everything: bool) -> Iterator[tuple[str, Difference]]:
    """Yield name and difference of each row: the leading quantities, of a series that with the
    largest difference.
    """
    groups: dict[tuple[str, str], list[Difference]] = {}
    for one in differences:
        groups.setdefault((one.a.quantity, one.a.unit), []).append(one)
    if everything:
        for own in groups.values():
            yield from ((_name(one.a, [other.a for other in own]), one) for one in own)
        return
    order = [quantity for quantities in LEADING.values() for quantity in quantities]
    keys = [key for key in groups if key[0] in order] or list(groups)
    keys.sort(key=lambda key: order.index(key[0]) if key[0] in order else len(order))
    shown = 0
    for key in keys:
        own = groups[key]
        rows = own if len(own) <= SERIES else [max(own, key=_distance)]
        for one in rows[: ROWS - shown]:
            more = f" (of {len(own)})" if len(rows) < len(own) else ""
            yield _name(one.a, [other.a for other in own]) + more, one
            shown += 1


def _distance(one: Difference) -> float:
    """Return the difference in half-widths of its 95 % interval; 0 without an interval."""
    if one.interval95 is None or one.interval95[0] == one.interval95[1]:
        return 0.0
    return 2.0 * abs(one.difference) / (one.interval95[1] - one.interval95[0])


def _name(m: Measurement | Outcome, among: Sequence[Measurement | Outcome]) -> str:
    """Return quantity, stack, frequency and direction, and the method if another has the same
    place.
    """

    def place(one: Measurement | Outcome) -> tuple[object, ...]:
        direction = None if one.orientation_deg is None else round(one.orientation_deg)
        return one.stack, direction, one.frequency_cy_per_px

    parts = [m.quantity]
    parts += [m.stack] if m.stack else []
    parts += [f"at {m.frequency_cy_per_px:.3g} cy/px"] if m.frequency_cy_per_px is not None else []
    if (
        m.orientation_deg is not None
        and len({one.orientation_deg for one in among if one.stack == m.stack}) > 1
    ):
        parts.append(f"{m.orientation_deg:.0f}°")
    if m.method and len({one.method for one in among if place(one) == place(m)}) > 1:
        parts.append(m.method)
    return " ".join(parts)


def _line(name: str, one: Difference) -> str:
    """Return name, both values, probability, a mark if suspect, and the difference with its
    unit.
    """
    values = f"{value_text(one.a):>12} {value_text(one.b):>12}"
    return (
        f"{_cut(name):<{NAME}} {values} {_probability(one):>11} {'!' if one.flags else ' '} "
        f"{_difference_text(one)}"
    )


def _difference_text(one: Difference) -> str:
    unit = "" if one.a.unit == "1" else f" {one.a.unit}"
    if one.interval95 is None:
        return f"{one.difference:+.3g}{unit}, no interval".replace("-", MINUS)
    up, down = one.interval95[1] - one.difference, one.difference - one.interval95[0]
    if abs(up - down) < 0.1 * (up + down):  # equal but for the scatter of the draws
        up = down = (up + down) / 2.0
    if one.difference == 0.0 and up == down:
        return f"0 ± {round_to_spread(up, up / 2.0)}{unit}"
    ends = one.difference - down, one.difference + up
    number = plus_minus(
        make_measurement(one.a.quantity, one.a.unit, one.difference, None, ends, method="")
    )
    sign = "+" if one.difference > 0.0 else ""
    return (f"({sign}{number[1:]}" if number.startswith("(") else f"{sign}{number}") + unit


def _probability(one: Difference) -> str:
    """Return the probability that B is better, in brackets that it is greater where no direction is
    better.
    """
    better = one.probability_better
    value = one.probability_greater if better is None else better
    if value is None:
        return "—"
    text = "< 0.001" if value < 0.001 else "> 0.999" if value > 0.999 else f"{value:.3f}"
    return text if better is not None else f"({text})"


def _flag_lines(shown: Iterable[Difference], width: int) -> list[str]:
    """Return one line for each flag with its quantities."""
    by_flag: dict[str, list[str]] = {}
    for one in shown:
        for flag in one.flags:
            by_flag.setdefault(flag, []).append(one.a.quantity)
    lines = []
    for flag, quantities in list(by_flag.items())[:5]:
        lines += _wrapped(f"! {flag}: {', '.join(dict.fromkeys(quantities))}", "    ", width, 1)
    return lines


def check_text(checked: LimitCheck, *, session: str, width: int = 100) -> str:
    """Return the verdicts as text of at most 40 lines of `width` columns, those that do not pass
    first.
    """
    counts = ", ".join(
        f"{len(checked.of(v))} {v}" for v in ("pass", "fail", "undecided") if checked.of(v)
    )
    lines = _wrapped(f"check of {session} against {checked.name}", "    ", width, 2)
    lines.append(f"Verdict: {checked.verdict} ({counts})")
    lines.append(f"{'':<10} {'':<{NAME}} {'limits':<22} value, 95 %")
    order = sorted(
        checked.outcomes, key=lambda one: ("fail", "undecided", "pass").index(one.verdict)
    )
    shown = 0
    for one in order:
        row = outcome_row(one, checked.outcomes)
        rows = [
            f"{one.verdict:<10} {_cut(row['name']):<{NAME}} {row['limits']:<22} {row['value']}"[
                :COLUMNS
            ]
        ]
        rows += _wrapped(f"           {one.reason}", "", width, 1) if one.reason else []
        if len(lines) + len(rows) > OUTCOMES:
            break
        lines, shown = lines + rows, shown + 1
    if shown < len(order):
        left = Counter(one.verdict for one in order[shown:])
        lines.append(
            f"Not shown: {', '.join(f'{count} {verdict}' for verdict, count in left.items())} "
            f"(--json)"
        )
    return "\n".join(lines)


def outcome_row(one: Outcome, among: Sequence[Outcome]) -> dict[str, str]:
    """Return name, limits, value, verdict and reason of an outcome as text."""
    unit = "" if one.unit == "1" else f" {one.unit}"
    ends = [None if end is None else short_text(float(end)) for end in (one.min, one.max)]
    limits = (
        f"{ends[0]} … {ends[1]}"
        if None not in ends
        else f"≥ {ends[0]}"
        if ends[1] is None
        else f"≤ {ends[1]}"
    )
    value = "—"
    if one.value is not None:
        of = make_measurement(one.quantity, one.unit, one.value, None, one.interval95, method="")
        value = plus_minus(of) + unit
    own = [other for other in among if (other.quantity, other.unit) == (one.quantity, one.unit)]
    return {
        "name": _name(one, own),
        "limits": limits + unit,
        "value": value,
        "verdict": one.verdict,
        "status": STATUS[one.verdict],
        "reason": one.reason,
    }


def limits_section(session: Session) -> dict[str, Any] | None:
    """Return what the report shows of the verdicts saved in a session; None without."""
    if any(isinstance(entry, LoadedStackEntry) for entry in session.stacks):
        return None
    if (found := load_check(session.folder)) is None:
        return None
    checked, current = found
    rows = [outcome_row(one, checked.outcomes) for one in checked.outcomes]
    return {"name": checked.name, "verdict": checked.verdict, "rows": rows, "current": current}


def _cut(name: str) -> str:
    return name if len(name) <= NAME else name[: NAME - 1] + "…"


def _wrapped(text: str, indent: str, width: int, most: int) -> list[str]:
    """Return text in lines of a width, cut after `most` of them with an ellipsis."""
    first = text[: len(text) - len(text.lstrip())]
    return textwrap.wrap(
        text.strip(),
        width,
        initial_indent=first,
        subsequent_indent=indent,
        max_lines=most,
        placeholder=" …",
    )
