"""Summary of a result as text: the leading quantities, their flags and what is missing, on one
screen.
"""

import re
import textwrap
from collections.abc import Callable, Iterable, Iterator
from itertools import groupby

from labdata import FLAGS, QUANTITIES, Measurement, Result
from labdata.number_format import plus_minus, plus_minus_of, round_to_spread, spread_of

Frequency = Callable[[float, Measurement | None], tuple[float, str]]

# Results with at most this many values are shown whole.
SHORT = 12
# Measurements of a quantity beyond this number are one line.
SERIES = 3
LINES = 40
# Lines of a summary by part; with two of the title and one of what is not shown these are 40.
ROW_LINES, FLAG_LINES, REASON_LINES, NOTE_LINES = 22, 6, 6, 3
BARS = "▁▂▃▄▅▆▇█"


def summary_of(
    result: Result, *, title: str, frequency: Frequency | None = None, width: int = 100
) -> str:
    """Return the summary of a result, at most 40 lines.

    Parameters
    ----------
    title
        What was measured, such as "mtf edge of chart.tif".
    frequency
        Conversion of cycles per pixel to the displayed unit and its name; None: cycles per pixel.
    width
        Columns of a line.
    """
    valued = [m for m in result.measurements if m.value is not None]
    refused = [m for m in result.measurements if m.value is None]
    lines = _wrap(_header(title, result), "", width, max_lines=2)
    rows, hidden = _rows(valued, frequency or in_cycles_per_pixel, width)
    for section, section_rows in groupby(rows, key=lambda row: row.section):
        lines += [section] * bool(section)
        lines += [line for row in section_rows for line in row.lines(width)]
    shown = [m for row in rows for m in row.measurements]
    lines += _flag_lines(valued, width)
    lines += _reason_lines([m for m in refused if m.refusal != "not-applicable"], width)
    lines += _note_lines(shown, width)
    doubtful = sum(m.status == "suspect" for m in hidden)
    of_them = f", {doubtful} of them suspect" if doubtful else ""
    omissions = {
        f"{len(hidden)} more values{of_them}": len(hidden),
        f"{(count := sum(m.refusal == 'not-applicable' for m in refused))} not applicable": count,
    }
    if further := [text for text, number in omissions.items() if number]:
        lines += _wrap(f"Not shown: {', '.join(further)} (`everything`)", "", width, max_lines=1)
    return "\n".join(lines)


def rows_of_file(name: str, result: Result, frequency: Frequency | None = None) -> Iterator[str]:
    """Yield one line for each target of one of several files: its leading quantity, ± 95 %, and its
    verdict.
    """
    by_region: dict[object, list[Measurement]] = {}
    for m in result.measurements:
        by_region.setdefault(m.region, []).append(m)
    for region, members in by_region.items():
        leading = next((m for m in members if m.quantity == "mtf50"), members[0])
        roi = (
            f" [{','.join(map(str, region))}]"
            if isinstance(region, tuple) and len(by_region) > 1
            else ""
        )
        number = (
            number_text(leading, frequency or in_cycles_per_pixel)
            if leading.value is not None
            else leading.reason or ""
        )
        yield f"{name + roi:<44} {leading.quantity} {number:<30} {verdict_of(leading)}".rstrip()


def in_cycles_per_pixel(
    frequency_cy_per_px: float, of: Measurement | None = None
) -> tuple[float, str]:
    """Return the frequency unchanged, with its unit."""
    return frequency_cy_per_px, "cy/px"


def _header(title: str, result: Result) -> str:
    """Return title and number of values by status."""
    counts = {
        status: sum(m.status == status for m in result.measurements)
        for status in ("ok", "suspect", "refused")
    }
    methods = list(dict.fromkeys(m.method for m in result.measurements))
    by = f" by {methods[0]}" if len(methods) == 1 else ""
    counted = ", ".join(f"{number} {status}" for status, number in counts.items() if number)
    return f"{title}{by}: {counted or 'nothing measured'} (± is 95 %)"


class Row:
    """One line of the summary: a measurement, or a series of one quantity."""

    def __init__(
        self, section: str, name: str, number: str, verdict: str, where: str, of: list[Measurement]
    ):
        self.section, self.name, self.number, self.verdict, self.where = (
            section,
            name,
            number,
            verdict,
            where,
        )
        self.measurements = of

    def lines(self, width: int) -> list[str]:
        """Return the row, continued on further lines where it exceeds the width."""
        indent = "  " if self.section else ""
        first = f"{indent}{self.name:<22} {self.number:<32} {self.verdict}"
        line = f"{first:<{len(indent) + 68}} {self.where}".rstrip() if self.where else first
        if len(line) <= width:
            return [line]
        text = f"{indent}{self.name} {self.number}, {self.verdict}" + (
            f", {self.where}" if self.where else ""
        )
        return _wrap(text, f"{indent}    ", width, max_lines=3)


def sections_of_leading() -> dict[str, str]:
    """Return the section of each quantity that leads in one, in the order of a summary."""
    return {name: known.section for name, known in QUANTITIES.items() if known.section}


def _rows(
    valued: list[Measurement], frequency: Frequency, width: int
) -> tuple[list[Row], list[Measurement]]:
    """Return the rows shown, and the measurements that are not."""
    leading = sections_of_leading()
    short = len(valued) <= SHORT
    order = list(leading)
    groups: dict[tuple[str, str, bool], list[Measurement]] = {}
    for m in valued:
        groups.setdefault((m.quantity, m.unit, m.amplifier is not None), []).append(m)
    keys = [key for key in groups if short or key[0] in leading]
    if not keys:
        keys = list(groups)
    if not short:
        keys.sort(key=lambda key: order.index(key[0]) if key[0] in order else len(order))
    rows: list[Row] = []
    sections, lines_left = set(), ROW_LINES
    for key in keys:
        section = "" if short else leading.get(key[0], "Other")
        for row in _rows_of(groups[key], section, frequency):
            lines_left -= len(row.lines(width)) + (bool(section) and section not in sections)
            sections.add(section)
            if lines_left >= 0:
                rows.append(row)
    shown = {id(m) for row in rows for m in row.measurements}
    return rows, [m for m in valued if id(m) not in shown]


def _rows_of(measurements: list[Measurement], section: str, frequency: Frequency) -> Iterator[Row]:
    """Yield the rows of one quantity: one for each measurement, or one for a series."""
    if len(measurements) <= SERIES:
        for m in measurements:
            name = m.quantity + (
                ""
                if m.frequency_cy_per_px is None
                else " at {:.3g} {}".format(*frequency(m.frequency_cy_per_px, m))
            )
            yield Row(
                section,
                name,
                number_text(m, frequency),
                verdict_of(m),
                _where(m, measurements),
                [m],
            )
        return
    values = [_display_value(m, frequency) for m in measurements]
    unit = number_unit(measurements[0], frequency)
    low, high = min(values), max(values)
    spread = max(high - low, 1e-12) / 50.0
    number = f"{round_to_spread(low, spread)} … {round_to_spread(high, spread)}{unit}"
    counts = {status: sum(m.status == status for m in measurements) for status in ("ok", "suspect")}
    verdict = ", ".join(f"{n} {status}" for status, n in counts.items() if n)
    yield Row(section, measurements[0].quantity, number, verdict, sparkline(values), measurements)


def number_text(m: Measurement, frequency: Frequency) -> str:
    """Return value ± 95 % with the unit; frequencies in the displayed unit."""
    if m.value is None or m.unit != "cy/px":
        return plus_minus(m) + ("" if m.unit == "1" else f" {m.unit}")
    value, unit = frequency(m.value, m)
    if m.interval95 is None:
        return f"{round_to_spread(value, spread_of(m))} {unit}"
    low, high = (frequency(end, m)[0] for end in m.interval95)
    return f"{plus_minus_of(value, low, high)} {unit}"


def number_unit(m: Measurement, frequency: Frequency) -> str:
    """Return the displayed unit of a measurement with a leading space; empty for ratios."""
    if m.unit == "1":
        return ""
    return f" {frequency(1.0, m)[1] if m.unit == 'cy/px' else m.unit}"


def _display_value(m: Measurement, frequency: Frequency) -> float:
    assert m.value is not None
    return frequency(m.value, m)[0] if m.unit == "cy/px" else m.value


def verdict_of(m: Measurement) -> str:
    """Return the status of a measurement with its flags."""
    return m.status + (f": {', '.join(m.flags)}" if m.flags else "")


def setting_of(m: Measurement) -> str:
    """Return the setting at which one of several was measured, as a note states it; else "".

    Examples
    --------
    >>> from labdata import measurement_from_sd
    >>> setting_of(measurement_from_sd("prnu", "%", 1, 0.1, method="m", notes=("at 700 V: a, b",)))
    'at 700 V'
    """
    stated = (re.match(r"(?:measured |MCP )?(at [^:]+)", note) for note in m.notes)
    return next((match[1] for match in stated if match), "")


def _where(m: Measurement, among: list[Measurement]) -> str:
    """Return stack, region and direction of a measurement, those that differ among the others."""
    parts = [m.stack] if m.stack and len({other.stack for other in among}) > 1 else []
    if len(among) > 1 and (setting := setting_of(m)):
        parts = [setting]
    if m.amplifier:
        parts.append(f"amplifier {m.amplifier}")
    elif m.region is not None and len({other.region for other in among}) > 1:
        parts.append(",".join(map(str, m.region)))
    if m.orientation_deg is not None and len({other.orientation_deg for other in among}) > 1:
        parts.append(f"{m.orientation_deg:.3g} deg")
    return " ".join(parts)


def sparkline(values: list[float], max_bars: int = 30) -> str:
    """Return values as bars of eight heights, at most `max_bars` of them.

    Examples
    --------
    >>> sparkline([0.0, 1.0, 2.0])
    '▁▅█'
    """
    step = -(-len(values) // max_bars)
    shown = values[::step]
    low, high = min(shown), max(shown)
    scale = (len(BARS) - 1) / (high - low) if high > low else 0.0
    return "".join(BARS[int((value - low) * scale + 0.5)] for value in shown)


def _flag_lines(shown: Iterable[Measurement], width: int) -> list[str]:
    """Return one entry for each flag: its largest finding with the remedy, else its sentence."""
    shown = list(shown)
    entries = []
    for flag in dict.fromkeys(flag for m in shown for flag in m.flags):
        having = [m for m in shown if flag in m.flags]
        findings = dict.fromkeys(
            note for m in having for note in m.notes if note.startswith(f"{flag}: ")
        )
        text = next(iter(findings), f"{flag}: {FLAGS[flag]}")
        quantities = list(dict.fromkeys(m.quantity for m in having))
        of = f" [{', '.join(quantities[:3])}{' ...' if len(quantities) > 3 else ''}]"
        entries.append(_wrap(f"! {text}{of}", "    ", width, max_lines=2))
    return _first_entries(entries, FLAG_LINES, "flags")


def _reason_lines(refused: list[Measurement], width: int) -> list[str]:
    """Return what was not measured and why, one entry for each reason."""
    by_reason: dict[str, list[Measurement]] = {}
    for m in refused:
        reason = m.reason or ""
        by_reason.setdefault(
            reason.replace(m.stack, "the stack") if m.stack else reason, []
        ).append(m)
    entries = []
    for reason, of_reason in by_reason.items():
        names, stacks = (
            list(dict.fromkeys(getattr(m, name) for m in of_reason))
            for name in ("quantity", "stack")
        )
        named = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        named += (
            f" of {len(stacks)} stacks"
            if len(stacks) > 1
            else f" of {stacks[0]}"
            if stacks[0]
            else ""
        )
        entries.append(_wrap(f"  {named}: {reason}", "      ", width, max_lines=2))
    return (
        ["Not measured", *_first_entries(entries, REASON_LINES - 1, "reasons")] if entries else []
    )


def _note_lines(shown: list[Measurement], width: int) -> list[str]:
    """Return the first notes: one on each finding that an interval holds, then the others."""
    held, others = dict[str, str](), dict[str, None]()
    for m in shown:
        for note in m.notes:
            flag = note.partition(":")[0]
            if flag not in FLAGS:
                others[note] = None
            elif flag not in m.flags:
                held.setdefault(flag, f"{note} [{m.quantity}]")
    notes = (f"note: {note}" for note in (*held.values(), *others))
    return _first_entries(
        [_wrap(note, "    ", width, max_lines=2) for note in notes], NOTE_LINES, "notes"
    )


def _first_entries(entries: list[list[str]], max_lines: int, name: str) -> list[str]:
    """Return the lines of the first entries that fit into `max_lines` lines, and the number of
    omitted entries.
    """
    if sum(map(len, entries)) <= max_lines:
        return [line for entry in entries for line in entry]
    lines: list[str] = []
    for number, entry in enumerate(entries):
        if len(lines) + len(entry) > max_lines - 1:
            return [*lines, f"and {len(entries) - number} more {name} (`everything`)"]
        lines += entry
    return lines


def _wrap(text: str, indent: str, width: int, *, max_lines: int) -> list[str]:
    """Return text in lines of a width, cut after `max_lines` of them with an ellipsis."""
    lines = textwrap.wrap(
        text, width - 2, subsequent_indent=indent, max_lines=max_lines, placeholder=" …"
    )
    return lines or [""]
