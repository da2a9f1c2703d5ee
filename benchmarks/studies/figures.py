"""Figures of a study: error against time, and a map of truth against estimate along every axis."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.studies.harness import CaseResult, MethodSummary, axes_of
from labdata.quantity import QUANTITIES

# Colours that differ in lightness too (Okabe and Ito), and a mark for each verdict.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
MARKS = {"ok": "o", "suspect": "^", "refused": "x", "crashed": "P"}


def pyplot() -> Any:
    """Matplotlib without a screen, text kept as text."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    plt.rcParams.update(
        {"svg.fonttype": "none", "svg.hashsalt": "charact", "font.size": 9, "axes.grid": True}
    )
    plt.rcParams.update({"grid.alpha": 0.25, "axes.spines.top": False, "axes.spines.right": False})
    return plt


def save_figure(figure: Any, path: Path) -> Path:
    """Write the figure as its SVG and as PNG next to it."""
    figure.savefig(path, metadata={"Date": None})
    figure.savefig(path.with_suffix(".png"), dpi=110)
    pyplot().close(figure)
    return path


def plot_chart(
    quantity: str, rows: Sequence[CaseResult], summaries: Sequence[MethodSummary], path: Path
) -> Path:
    """Draw relative error (95th percentile as a mark, every case as a dot) against time, a panel
    for each kind.
    """
    kinds = list(dict.fromkeys(row.kind for row in rows))
    figure, grid = pyplot().subplots(
        1,
        len(kinds),
        figsize=(2.0 + 5.5 * len(kinds), 4.6),
        layout="constrained",
        squeeze=False,
        sharey=True,
    )
    for axes, kind in zip(grid.flat, kinds, strict=True):
        kind_rows = [row for row in rows if row.kind == kind]
        _draw_kind(
            axes,
            kind,
            kind_rows,
            [method for method in summaries if method.method in {row.method for row in kind_rows}],
        )
    grid[0, 0].set_ylabel(f"error of {quantity} (% of the truth)")
    figure.suptitle(QUANTITIES[quantity].title, fontsize=11)
    return save_figure(figure, path)


def _draw_kind(
    axes: Any, kind: str, rows: list[CaseResult], summaries: list[MethodSummary]
) -> None:
    """One panel: the methods of one kind of target."""
    for colour, method in zip(_cycle_colours(len(summaries)), summaries, strict=True):
        method_rows = [
            row for row in rows if row.method == method.method and row.error_percent is not None
        ]
        errors = [max(row.error_percent or 0.0, 1e-3) for row in method_rows]
        axes.scatter(
            [row.seconds for row in method_rows],
            errors,
            s=9,
            color=colour,
            alpha=0.35,
            linewidths=0,
        )
        label = (
            f"{method.method}: {method.error_percent:.2g} % in {method.seconds:.2g} s, "
            f"{method.ok_fraction:.0%} ok"
        )
        axes.scatter(
            [method.seconds],
            [method.error_percent],
            s=90,
            color=colour,
            edgecolor="black",
            label=label,
            zorder=3,
        )
    axes.set(xscale="log", yscale="log", xlabel="time for one stack (s)")
    plain_numbers(axes.xaxis, axes.yaxis)
    axes.set_title(
        f"{kind}, {summaries[0].cases} cases; large: median time, 95th percentile", fontsize=9
    )
    axes.legend(frameon=False, fontsize=8)


def plain_numbers(*axes: Any, subs: tuple[float, ...] = (1.0, 2.0, 5.0)) -> None:
    """Label some of every decade of logarithmic axes as plain numbers, by default 1, 2 and 5."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    for axis in axes:
        axis.set_major_locator(LogLocator(subs=subs, numticks=20))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())


def _cycle_colours(count: int) -> list[str]:
    return [COLOURS[number % len(COLOURS)] for number in range(count)]


def plot_stability(quantity: str, rows: Sequence[CaseResult], kind: str, path: Path) -> Path:
    """Draw value over truth along every axis of a kind with its 95 % interval, verdict as the mark,
    lies in red.

    Of an error whose truth is 0, 1 plus the error is drawn.
    """
    rows = [row for row in rows if row.kind == kind]
    names, methods = axes_of(rows), tuple(dict.fromkeys(row.method for row in rows))
    columns = 3
    lines = -(-len(names) // columns)
    figure, grid = pyplot().subplots(
        lines,
        columns,
        figsize=(13, 2.9 * lines + 0.5),
        layout="constrained",
        squeeze=False,
        sharey=True,
    )
    for panel, name in zip(grid.flat, names, strict=False):
        _draw_axis(panel, [row for row in rows if row.axis == name], methods, quantity)
    for panel in grid.flat[len(names) :]:
        panel.set_visible(False)
    title = (
        f"{kind}: {QUANTITIES[quantity].title}; lines are 95 % intervals, marks at the rim "
        f"lie beyond it"
    )
    handles = _legend(methods)
    figure.legend(
        handles=handles, title=title, loc="outside upper center", ncols=len(handles), frameon=False
    )
    return save_figure(figure, path)


def _draw_axis(panel: Any, rows: list[CaseResult], methods: tuple[str, ...], quantity: str) -> None:
    """One panel: positions side by side, methods next to each other within a position."""
    positions = list(dict.fromkeys(row.position for row in rows))
    scope = [
        n for n, p in enumerate(positions) if any(row.in_scope for row in rows if row.position == p)
    ]
    if scope:
        panel.axvspan(scope[0] - 0.45, scope[-1] + 0.45, color="#009e73", alpha=0.09, linewidth=0)
    panel.axhline(1.0, color="black", linewidth=0.8)
    for number, (method, colour) in enumerate(
        zip(methods, _cycle_colours(len(methods)), strict=True)
    ):
        method_rows = [row for row in rows if row.method == method]
        shift = (number - (len(methods) - 1) / 2) * 0.8 / len(methods)
        for x, row in _spread(method_rows, positions):
            _draw_row(panel, x + shift, row, colour)
    unit = "" if rows[0].unit in ("", "1") else f" ({rows[0].unit})"
    panel.set(ylim=(0.45, 1.6), xlabel=f"{rows[0].axis}{unit}")
    panel.set_xticks(range(len(positions)), [f"{p:g}" for p in positions])
    if panel.get_subplotspec().is_first_col():
        panel.set_ylabel(f"{quantity}: measured / true")


def _spread(rows: list[CaseResult], positions: list[float]) -> list[tuple[float, CaseResult]]:
    """Places of the draws at a position, side by side."""
    placed = []
    for number, position in enumerate(positions):
        at = [row for row in rows if row.position == position]
        steps = np.linspace(-0.1, 0.1, len(at)) if len(at) > 1 else np.zeros(1)
        placed += [(number + float(step), row) for step, row in zip(steps, at, strict=True)]
    return placed


def _draw_row(panel: Any, x: float, row: CaseResult, colour: str) -> None:
    """One estimate over its truth; what has no number stands at the lower rim, what lies beyond it
    at the rim.
    """
    mark = MARKS[row.status]
    if row.value is None or row.truth is None:
        height = 0.5 if row.value is None else 1.55
        panel.plot(x, height, mark, color="red" if row.silent else colour, markersize=5, alpha=0.8)
        return
    ratio = row.value / row.truth if row.truth else 1.0 + row.value / 100.0
    if row.low95 is not None and row.high95 is not None and row.truth:
        panel.plot(
            [x] * 2,
            [row.low95 / row.truth, row.high95 / row.truth],
            color=colour,
            linewidth=1,
            alpha=0.7,
        )
    panel.plot(x, float(np.clip(ratio, 0.47, 1.58)), mark, color=colour, markersize=4)
    if row.silent:
        panel.plot(
            x,
            float(np.clip(ratio, 0.47, 1.58)),
            "o",
            mfc="none",
            mec="red",
            markersize=12,
            mew=1.8,
        )


def _legend(methods: tuple[str, ...]) -> list[Any]:
    """Handles: methods by colour, verdicts by mark."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    colours = [
        Patch(color=colour, label=method)
        for method, colour in zip(methods, _cycle_colours(len(methods)), strict=True)
    ]
    marks = [
        Line2D([], [], color="gray", marker=mark, linestyle="", label=word)
        for word, mark in MARKS.items()
    ]
    lie = Line2D(
        [],
        [],
        marker="o",
        linestyle="",
        mfc="none",
        mec="red",
        markersize=10,
        label="silent failure",
    )
    return [*colours, *marks, lie, Patch(color="#009e73", alpha=0.15, label="inside the scope")]
