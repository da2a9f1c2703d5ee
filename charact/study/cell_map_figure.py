"""How the figure of a map shows what became of its drawings along one axis."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from charact.study.draw import plain_numbers

BINS = 9
# What a drawing may come to, from the floor of a panel to its top, in colours that differ in lightness too.
FATES = (
    ("ok, interval holds", "#0072b2"),
    ("ok, interval misses", "#e69f00"),
    ("silent failure", "#c00000"),
    ("suspect", "#b8b8b8"),
    ("refused", "#e8e8e8"),
)


def draw_fates(
    panel: Any, cells: Sequence[Mapping[str, Any]], at: Sequence[float], *, log: bool, label: str, title: str
) -> None:
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
        plain_numbers(panel.xaxis, subs=(1.0, 3.0) if high > 6.0 * low else (1.0, 2.0, 5.0))
    panel.grid(visible=False)


def _fates(cell: Mapping[str, Any]) -> tuple[int, ...]:
    missed = cell["missed"] - cell["silent"]
    return cell["ok"] - cell["missed"], missed, cell["silent"], cell["suspect"], cell["refused"] + cell["crashed"]
