"""Chart of the methods of a quantity from the shipped table: error against computing time."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from charact.method.stopwatch import time_text
from charact.reporting.figure_svg import Label, path_svg, svg_head
from charact.reporting.style import COLOURS, PAPER_INK
from labdata.file_io import write_atomically

# Size of the chart, points.
WIDTH, HEIGHT = 404.0, 274.0
Row = Mapping[str, Any]


def chart_lines(quantity: str, rows: Sequence[Row]) -> Iterator[str]:
    """Yield the table of a chart, the fastest method first."""
    yield (
        f"{quantity}: error of values on {rows[0]['cases']} cases of known truth, and computing "
        f"time"
    )
    yield f"{'method':20} {'95th percentile':>16} {'upper limit':>12} {'median time':>12}"
    for row in sorted(rows, key=lambda row: row["seconds"]):
        limit = row.get("error_limit_percent")
        limit_text = "" if limit is None else f"{limit:.3g} %"
        yield (
            f"{row['method']:20} {row['error_percent']:14.3g} % {limit_text:>12} "
            f"{time_text(row['seconds']):>12}"
        )


def failure_lines(quantity: str, rows: Sequence[Row]) -> Iterator[str]:
    """Yield how often each method was ok, suspect, refused and silently wrong on the cases of the
    chart.
    """
    yield (
        f"{quantity}: outcome on the cases of the chart; silent: ok, and off by over twice the "
        f"interval"
    )
    names = ("cases", "ok", "suspect", "refused", "silent")
    yield f"{'method':20}" + "".join(f"{name:>9}" for name in (*names, "missed"))
    for row in rows:
        missed = row.get("missed_fraction")
        missed_text = "" if missed is None else f"{100 * missed:.1f} %"
        yield (
            f"{row['method']:20}"
            + "".join(f"{row.get(name, 0):9d}" for name in names)
            + f"{missed_text:>9}"
        )


def write_chart(quantity: str, rows: Sequence[Row], out: Path) -> Path:
    """Plot error against time of each method into a folder, and return the file, an SVG.

    It is written without matplotlib, whose import takes longer than all else that this verb does.
    """
    limits = [row.get("error_limit_percent", row["error_percent"]) for row in rows]
    times, errors = [row["seconds"] for row in rows], [row["error_percent"] for row in rows]
    # Room for the names at the right.
    across = _LogScale(min(times) / 2.0, max(times) * 6.0, 44.0, WIDTH - 6.0)
    up = _LogScale(min(errors) / 1.2, max(limits) * 1.2, 36.0, HEIGHT - 22.0)
    low, high = (across.start, up.start), (across.end, up.end)
    grid = [
        step
        for x in across.ticks
        for step in (("M", across(x), HEIGHT - low[1]), ("V", HEIGHT - high[1]))
    ]
    grid += [step for y in up.ticks for step in (("M", low[0], HEIGHT - up(y)), ("H", high[0]))]
    frame = (("M", low[0], HEIGHT - high[1]), ("V", HEIGHT - low[1]), ("H", high[0]))
    texts = [Label(f"{x:g}", across(x), low[1] - 10.0, 9.0) for x in across.ticks]
    texts += [Label(f"{y:g}", low[0] - 5.0, up(y), 9.0, "end") for y in up.ticks]
    texts += [
        Label("median computing time (s)", 0.5 * (low[0] + high[0]), 9.0, 9.0),
        Label(
            f"error of {quantity}, 95th percentile (%)",
            10.0,
            0.5 * (low[1] + high[1]),
            9.0,
            angle=90.0,
        ),
        Label(
            "bars: to the upper 95 % confidence limit", 0.5 * (low[0] + high[0]), HEIGHT - 11.0, 9.5
        ),
    ]
    parts = [path_svg(grid, 'stroke="#ddd"'), path_svg(frame, f'fill="none" stroke="{PAPER_INK}"')]
    parts += (text.svg(HEIGHT) for text in texts)
    for colour, row, limit in zip(COLOURS * 2, rows, limits, strict=False):
        x, y, top = across(row["seconds"]), HEIGHT - up(row["error_percent"]), HEIGHT - up(limit)
        bar = (("M", x, y), ("V", top), ("M", x - 3.0, top), ("H", x + 3.0))
        mark = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3"/>' + path_svg(
            bar, f'stroke="{colour}" stroke-width="1.4"'
        )
        name = Label(row["method"], x + 6.0, HEIGHT - y + 6.0, 8.0, "start").svg(HEIGHT)
        parts.append(f'<g fill="{colour}">{mark}{name}</g>')
    box = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {HEIGHT:g}"'
    head = svg_head(box, f"Error against computing time of the methods of {quantity}")
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"chart-{quantity}.svg"
    body = (
        '<rect width="100%" height="100%" fill="white"/><g '
        f'fill="{PAPER_INK}">{"".join(parts)}</g></svg>'
    )
    write_atomically(path, (head + body).encode())
    return path


@dataclass(frozen=True)
class _LogScale:
    """Logarithmic scale of values `low` to `high` on places `start` to `end`, points."""

    low: float
    high: float
    start: float
    end: float

    def __call__(self, value: float) -> float:
        return self.start + (self.end - self.start) * math.log(value / self.low) / math.log(
            self.high / self.low
        )

    @property
    def ticks(self) -> list[float]:
        """Return 1, 2 and 5 of each decade within the scale; at the rim a label would be cut."""
        decades = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)))
        values = [factor * 10.0**decade for decade in decades for factor in (1.0, 2.0, 5.0)]
        return [value for value in values if 1.02 * self.low < value < self.high / 1.02]
