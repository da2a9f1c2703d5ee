"""Figure of a map of cells: what became of the drawings along everything that breaks them, a panel each."""

import argparse
import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from charact.study.scenario_map import Breaking
from charact.study.study_figures import _pyplot, plain_numbers

Rows = Sequence[Mapping[str, Any]]

BINS = 9
# What a drawing may come to, from the floor of a panel to its top, in colours that differ in lightness too.
FATES = (
    ("ok, interval holds", "#0072b2"),
    ("ok, interval misses", "#e69f00"),
    ("silent failure", "#c00000"),
    ("suspect", "#b8b8b8"),
    ("refused", "#e8e8e8"),
)


def plot_map(
    found: Mapping[str, Any],
    path: Path,
    *,
    breaking: Breaking,
    labels: Mapping[str, str],
    scope: tuple[str, Callable[[int], float]],
    columns: int,
    last: Callable[[Any, Rows], None] | None = None,
) -> Path:
    """Draw the quick part of a table that `charact.study.scenario_map.write_table` wrote.

    Parameters
    ----------
    found
        The table.
    path
        Where the PNG goes.
    breaking, labels
        What breaks the cells, and the label of each of its axes.
    scope
        Along what the cells inside the scope are laid out: its label, and the place of a cell by its number.
    columns
        Panels side by side.
    last
        Draws one panel more of the cells inside the scope.
    """
    part = found["quick"]
    cells = [dict(zip(part["columns"], row, strict=True)) for row in part["rows"]]
    rows = -(-(len(breaking) + 2 + (last is not None)) // columns)
    figure, grid = _pyplot().subplots(rows, columns, figsize=(2.8 * columns, 2.6 * rows), layout="constrained")
    panels = iter(grid.flat)
    inside = [cell for cell in cells if cell["axis"] == "none"]
    label, place = scope
    _draw_fates(next(panels), inside, [place(cell["number"]) for cell in inside], log=True, label=label,
                title="inside the scope")  # fmt: skip
    for axis, (_, _, log) in breaking.items():
        own = [cell for cell in cells if cell["axis"] == axis]
        _draw_fates(next(panels), own, [cell["strength"] for cell in own], log=log, label=labels[axis],
                    title=re.sub("_(cy_per_px|px|dn)$", "", axis).replace("_", " "))  # fmt: skip
    if last is not None:
        last(next(panels), inside)
    for spare in panels:
        spare.axis("off")
    for panel in grid[:, 0]:
        panel.set_ylabel("share of the drawings (1)")
    handles, names = grid[0, 0].get_legend_handles_labels()
    nothing = _pyplot().Rectangle((0, 0), 1, 1, facecolor="white", edgecolor="#b8b8b8")
    grid[-1, -1].legend([*handles, nothing], [*names, "no cell drawn here"], loc="center", frameon=False)
    figure.suptitle(_title(found), fontsize=11)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)
    _pyplot().close(figure)
    return path


def _title(found: Mapping[str, Any]) -> str:
    summary = found["quick"]["summary"]
    return (
        f"{found['method']}, quick: {summary['cells']} cells, {summary['draws']} drawings, {summary['ok']} ok, "
        f"{summary['silent']} silent failures; in scope {summary['in_scope_ok_percent']:.1f} % ok"
    )


def _draw_fates(panel: Any, cells: Rows, at: Sequence[float], *, log: bool, label: str, title: str) -> None:
    """Stack the shares of what became of the drawings over one axis."""
    place = np.asarray(at, float)
    low, high = (place.min(), place.max()) if place.size else (0.1, 1.0)
    borders = np.geomspace(low, high, BINS + 1) if log else np.linspace(low, high, BINS + 1)
    counts = np.array([_fates(cell) for cell in cells], float).reshape(-1, len(FATES))
    which = np.clip(np.searchsorted(borders, place, side="right") - 1, 0, BINS - 1)
    totals = np.array([counts[which == index].sum(axis=0) for index in range(BINS)])
    shares = totals / np.maximum(totals.sum(axis=1, keepdims=True), 1.0)
    floor = np.zeros(BINS)
    for (name, colour), share in zip(FATES, shares.T, strict=True):
        panel.bar(borders[:-1], share, np.diff(borders), bottom=floor, align="edge", color=colour, label=name)
        floor = floor + share
    panel.set(xlim=(low, high), ylim=(0, 1), xlabel=label, title=title, xscale="log" if log else "linear")
    if log:
        plain_numbers(panel.xaxis, subs=_subs(high / low))
    panel.grid(visible=False)


def _subs(span: float) -> tuple[float, ...]:
    """Which numbers of a decade stand at an axis that spans so many times its lowest."""
    if span > 3e2:
        return (1.0,)
    return (1.0, 3.0) if span > 20.0 else (1.0, 2.0, 5.0)


def _fates(cell: Mapping[str, Any]) -> tuple[int, ...]:
    missed = cell["missed"] - cell["silent"]
    return cell["ok"] - cell["missed"], missed, cell["silent"], cell["suspect"], cell["refused"] + cell["crashed"]


def make(draw: Callable[[Mapping[str, Any], Path], Path], *, table: Path, figure: Path, about: str | None) -> None:
    """Draw the table that is there, as the command line asks."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--table", type=Path, default=table, help="table to read")
    parser.add_argument("--figure", type=Path, default=figure, help="PNG to write")
    asked = parser.parse_args()
    draw(json.loads(asked.table.read_text()), asked.figure)
