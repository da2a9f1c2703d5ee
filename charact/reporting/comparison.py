"""Comparison of two sessions, and verdicts on limits, as text of one screen."""

import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from charact.comparison import Comparison, Difference, LimitCheck, Outcome, load_check
from charact.comparison.conditions import ConditionPair
from charact.reporting.summary import SERIES, sections_of_leading
from labdata import LoadedStackEntry, Measurement, Session, make_measurement
from labdata.number_format import (
    MINUS,
    plus_minus,
    round_to_spread,
    short_text,
    value_text,
)

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
    hidden = [
        difference
        for difference in comparison.differences
        if all(difference is not shown for _, shown in rows)
    ]
    lines = [f"compare: {len(comparison.differences)} quantities with a value in both"]
    lines += [
        line
        for letter, name, session in zip("AB", names, sessions, strict=True)
        for line in _wrapped(f"{letter}  {_session_text(name, session)}", "   ", width, 1)
    ]
    lines += _condition_lines(comparison, everything, width)
    head = f"{'A':>12} {'B':>12} {'P(B better)':>11}   B {MINUS} A, ± is 95 %"
    lines.append(f"{'':<{NAME}} {head}")
    lines += [_line(name, difference)[:COLUMNS] for name, difference in rows]
    lines += _flag_lines([difference for _, difference in rows], width)
    lines += _footer(comparison, hidden, width)
    return "\n".join(lines)


def _footer(comparison: Comparison, hidden: Sequence[Difference], width: int) -> list[str]:
    """Return what is not shown, and the meaning of the table."""
    excluding = sum(difference.excludes_zero for difference in hidden)
    omissions = (
        [f"{len(hidden)} differences, {excluding} with zero outside the interval (`everything`)"]
        if hidden
        else []
    )
    omissions += [
        f"{count} values only in {side}"
        for side, count in zip("AB", comparison.unmatched, strict=True)
        if count
    ]
    lines = _wrapped(f"Not shown: {'; '.join(omissions)}", "    ", width, 2) if omissions else []
    excluding, total = (
        sum(difference.excludes_zero for difference in comparison.differences),
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
        lines.append(f"  and {len(order) - CONDITIONS} more (`everything`)")
    return lines


def _rows(differences: Sequence[Difference], everything: bool) -> Iterator[tuple[str, Difference]]:
    """Yield name and difference of each row: the leading quantities, of a series that with the
    largest difference.
    """
    groups: dict[tuple[str, str], list[Difference]] = {}
    for difference in differences:
        groups.setdefault((difference.a.quantity, difference.a.unit), []).append(difference)
    if everything:
        for group in groups.values():
            yield from (
                (_name(difference.a, [other.a for other in group]), difference)
                for difference in group
            )
        return
    order = list(sections_of_leading())
    keys = [key for key in groups if key[0] in order] or list(groups)
    keys.sort(key=lambda key: order.index(key[0]) if key[0] in order else len(order))
    shown = 0
    for key in keys:
        group = groups[key]
        rows = group if len(group) <= SERIES else [max(group, key=_distance)]
        for difference in rows[: ROWS - shown]:
            more = f" (of {len(group)})" if len(rows) < len(group) else ""
            yield _name(difference.a, [other.a for other in group]) + more, difference
            shown += 1


def _distance(difference: Difference) -> float:
    """Return the difference in half-widths of its 95 % interval; 0 without an interval."""
    if difference.interval95 is None or difference.interval95[0] == difference.interval95[1]:
        return 0.0
    return 2.0 * abs(difference.difference) / (difference.interval95[1] - difference.interval95[0])


def _name(m: Measurement | Outcome, among: Sequence[Measurement | Outcome]) -> str:
    """Return quantity, stack, frequency and direction, and the method if another has the same
    place.
    """

    def place(estimate: Measurement | Outcome) -> tuple[object, ...]:
        direction = None if estimate.orientation_deg is None else round(estimate.orientation_deg)
        return estimate.stack, direction, estimate.frequency_cy_per_px

    parts = [m.quantity]
    parts += [m.stack] if m.stack else []
    parts += [f"amplifier {m.amplifier}"] if m.amplifier else []
    parts += [f"at {m.frequency_cy_per_px:.3g} cy/px"] if m.frequency_cy_per_px is not None else []
    if (
        m.orientation_deg is not None
        and len({estimate.orientation_deg for estimate in among if estimate.stack == m.stack}) > 1
    ):
        parts.append(f"{m.orientation_deg:.0f}°")
    if m.method and len({estimate.method for estimate in among if place(estimate) == place(m)}) > 1:
        parts.append(m.method)
    return " ".join(parts)


def _line(name: str, difference: Difference) -> str:
    """Return name, both values, probability, a mark if suspect, and the difference with its
    unit.
    """
    values = f"{value_text(difference.a):>12} {value_text(difference.b):>12}"
    mark = "!" if difference.flags else " "
    return (
        f"{_cut(name):<{NAME}} {values} {_probability(difference):>11} {mark} "
        f"{_difference_text(difference)}"
    )


def _difference_text(comparison: Difference) -> str:
    unit = "" if comparison.a.unit == "1" else f" {comparison.a.unit}"
    if comparison.interval95 is None:
        return f"{comparison.difference:+.3g}{unit}, no interval".replace("-", MINUS)
    up, down = (
        comparison.interval95[1] - comparison.difference,
        comparison.difference - comparison.interval95[0],
    )
    if abs(up - down) < 0.1 * (up + down):  # equal but for the scatter of the draws
        up = down = (up + down) / 2.0
    if comparison.difference == 0.0 and up == down:
        return f"0 ± {round_to_spread(up, up / 2.0)}{unit}"
    ends = comparison.difference - down, comparison.difference + up
    number = plus_minus(
        make_measurement(
            comparison.a.quantity, comparison.a.unit, comparison.difference, None, ends, method=""
        )
    )
    sign = "+" if comparison.difference > 0.0 else ""
    return (f"({sign}{number[1:]}" if number.startswith("(") else f"{sign}{number}") + unit


def _probability(difference: Difference) -> str:
    """Return the probability that B is better, in brackets that it is greater where no direction is
    better.
    """
    better = difference.probability_better
    value = difference.probability_greater if better is None else better
    if value is None:
        return "—"
    text = "< 0.001" if value < 0.001 else "> 0.999" if value > 0.999 else f"{value:.3f}"
    return text if better is not None else f"({text})"


def _flag_lines(shown: Iterable[Difference], width: int) -> list[str]:
    """Return one line for each flag with its quantities."""
    by_flag: dict[str, list[str]] = {}
    for difference in shown:
        for flag in difference.flags:
            by_flag.setdefault(flag, []).append(difference.a.quantity)
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
        checked.outcomes, key=lambda outcome: ("fail", "undecided", "pass").index(outcome.verdict)
    )
    shown = 0
    for outcome in order:
        row = outcome_row(outcome, checked.outcomes)
        rows = [
            f"{outcome.verdict:<10} {_cut(row['name']):<{NAME}} {row['limits']:<22} {row['value']}"[
                :COLUMNS
            ]
        ]
        rows += _wrapped(f"           {outcome.reason}", "", width, 1) if outcome.reason else []
        if len(lines) + len(rows) > OUTCOMES:
            break
        lines, shown = lines + rows, shown + 1
    if shown < len(order):
        remaining = Counter(outcome.verdict for outcome in order[shown:])
        lines.append(
            f"Not shown: {', '.join(f'{count} {verdict}' for verdict, count in remaining.items())} "
            f"(`as_json`)"
        )
    return "\n".join(lines)


def outcome_row(outcome: Outcome, among: Sequence[Outcome]) -> dict[str, str]:
    """Return name, limits, value, verdict and reason of an outcome as text."""
    unit = "" if outcome.unit == "1" else f" {outcome.unit}"
    ends = [None if end is None else short_text(float(end)) for end in (outcome.min, outcome.max)]
    limits = (
        f"{ends[0]} … {ends[1]}"
        if None not in ends
        else f"≥ {ends[0]}"
        if ends[1] is None
        else f"≤ {ends[1]}"
    )
    value = "—"
    if outcome.value is not None:
        of = make_measurement(
            outcome.quantity, outcome.unit, outcome.value, None, outcome.interval95, method=""
        )
        value = plus_minus(of) + unit
    same_quantity = [
        other for other in among if (other.quantity, other.unit) == (outcome.quantity, outcome.unit)
    ]
    return {
        "name": _name(outcome, same_quantity),
        "limits": limits + unit,
        "value": value,
        "verdict": outcome.verdict,
        "status": STATUS[outcome.verdict],
        "reason": outcome.reason,
    }


def limits_section(session: Session) -> dict[str, Any] | None:
    """Return what the report shows of the verdicts saved in a session; None without."""
    if any(isinstance(entry, LoadedStackEntry) for entry in session.stacks):
        return None
    if (stored := load_check(session.folder)) is None:
        return None
    checked, current = stored
    rows = [outcome_row(outcome, checked.outcomes) for outcome in checked.outcomes]
    return {"name": checked.name, "verdict": checked.verdict, "rows": rows, "current": current}


def _cut(name: str) -> str:
    return name if len(name) <= NAME else name[: NAME - 1] + "…"


def _wrapped(text: str, indent: str, width: int, max_lines: int) -> list[str]:
    """Return text in lines of a width, cut after `max_lines` of them with an ellipsis."""
    first = text[: len(text) - len(text.lstrip())]
    return textwrap.wrap(
        text.strip(),
        width,
        initial_indent=first,
        subsequent_indent=indent,
        max_lines=max_lines,
        placeholder=" …",
    )
