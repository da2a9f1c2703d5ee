"""Maps of where a method breaks: thousands of random cells, what became of each, and what they say
together.
"""

import argparse
import json
import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

import charact
from benchmarks.studies.figures import plain_numbers, pyplot
from benchmarks.studies.harness import CaseResult
from benchmarks.studies.stability import one_thread_each
from charact.method.registry import methods_of_kind
from tests.truth.cases.case import Case

# One cell in fifty is measured in full too, not quickly, unless a map asks for more.
CHAINED = 50
# Streams of a cell's scene and of its repeats, so that neither depends on the other.
SCENE, NOISE = 11, 12


Scene = TypeVar("Scene")
# What breaks a method: from where it hardly matters to where nothing is left, and whether steps are
# even in ln.
Breaking = Mapping[str, tuple[float, float, bool]]


@dataclass(frozen=True, kw_only=True)
class Scenario(Generic[Scene]):
    """One scene of a map.

    Parameters
    ----------
    number
        Seed of the cell.
    axis, strength
        What breaks the scene and by how much, in the unit of its name; "none" and 0 inside the
        scope.
    scene
        What is drawn.
    """

    number: int
    axis: str
    strength: float
    scene: Scene

    @property
    def in_scope(self) -> bool:
        """Whether the method declares to measure such a scene."""
        return self.axis == "none"


def draw_scenario(
    number: int,
    breaking: Breaking,
    scene_in_scope: Callable[[np.random.Generator], Scene],
    broken: Callable[[Scene, str, float], Scene],
) -> Scenario[Scene]:
    """Return a cell from its number: half of all have one thing wrong.

    Parameters
    ----------
    breaking
        What may be wrong.
    scene_in_scope, broken
        Draw a scene, and put one thing wrong in it: its axis and strength.
    """
    rng = np.random.default_rng([number, SCENE])
    scene = scene_in_scope(rng)
    if rng.random() < 0.5:
        return Scenario(number=number, axis="none", strength=0.0, scene=scene)
    axis = str(rng.choice(list(breaking)))
    low, high, even_in_ln = breaking[axis]
    share = rng.random()
    strength = float(low * (high / low) ** share if even_in_ln else low + (high - low) * share)
    return Scenario(
        number=number, axis=axis, strength=strength, scene=broken(scene, axis, strength)
    )


@dataclass(frozen=True, kw_only=True)
class ScenarioOutcome:
    """What became of the repeats of one cell.

    Parameters
    ----------
    number, axis, strength
        As of the cell.
    ok, suspect, refused, crashed
        Repeats by status.
    silent, missed
        Repeats that are ok with the truth beyond twice the 95 % half interval, and outside the 95 %
        interval.
    truth
        What should be found.
    worst_percent
        Largest error of an ok number, % of the truth; None: there is none.
    sd_percent
        Median over the ok numbers of a quarter of the 95 % interval's width over 0.98, % of the
        truth.
    bound_percent
        Least standard deviation by Cramer and Rao, % of the truth; None: not asked.
    seconds
        Median time of a repeat, s.
    """

    number: int
    axis: str
    strength: float
    ok: int
    suspect: int
    refused: int
    crashed: int
    silent: int
    missed: int
    truth: float
    worst_percent: float | None
    sd_percent: float | None
    bound_percent: float | None
    seconds: float


def outcome_of(
    cell: Scenario[Any],
    rows: Sequence[CaseResult],
    truth: float,
    *,
    truths: tuple[float, float],
    bound_percent: float | None = None,
) -> ScenarioOutcome:
    """Sum up the repeats of a cell.

    Parameters
    ----------
    truth
        The value that errors are stated against.
    truths
        Least and largest value that is right.
    bound_percent
        Least standard deviation that there can be, % of the truth.
    """
    sure = [row for row in rows if row.status == "ok"]
    widths = [(row.high95 - row.low95) / 3.92 / truth for row in sure if row.high95 and row.low95]
    statuses = [row.status for row in rows]
    return ScenarioOutcome(
        number=cell.number,
        axis=cell.axis,
        strength=cell.strength,
        ok=len(sure),
        suspect=statuses.count("suspect"),
        refused=statuses.count("refused"),
        crashed=statuses.count("crashed"),
        silent=sum(silent(row, truths) for row in sure),
        missed=sum(not covers(row, truths) for row in sure),
        truth=truth,
        worst_percent=max((row.error_percent or 0.0 for row in sure), default=None),
        sd_percent=100.0 * float(np.median(widths)) if widths else None,
        bound_percent=bound_percent,
        seconds=float(np.median([row.seconds for row in rows])),
    )


def seed_of(cell: Scenario[Any], repeat: int) -> int:
    """Return the seed of one drawing of a cell."""
    return int(np.random.SeedSequence([cell.number, NOISE, repeat]).generate_state(1)[0])


def draw_case(cell: Scenario[Any], repeat: int, **given: Any) -> Case:
    """Return one drawing of a cell as a case; `given` are its other fields, see
    `tests.truth.cases.case.Case`.
    """
    return Case(
        name=f"cell {cell.number}, drawing {repeat}",
        axis=cell.axis,
        position=cell.strength,
        unit="",
        in_scope=cell.in_scope,
        seed=seed_of(cell, repeat),
        **given,
    )


def covers(row: CaseResult, truths: tuple[float, float]) -> bool:
    """Tell whether a 95 % interval holds a right value."""
    low, high = _interval(row)
    return low <= truths[1] and high >= truths[0]


def silent(row: CaseResult, truths: tuple[float, float]) -> bool:
    """Tell whether an ok number is off by more than twice its 95 % half interval on the side of the
    right value.
    """
    value, (low, high) = row.value or 0.0, _interval(row)
    off = float(np.clip(value, *truths)) - value
    return abs(off) > 2.0 * ((high - value) if off > 0 else (value - low))


def _interval(row: CaseResult) -> tuple[float, float]:
    assert row.low95 is not None and row.high95 is not None, "an ok number has an interval"
    return row.low95, row.high95


Of = TypeVar("Of", bound=ScenarioOutcome)
OfOut = TypeVar("OfOut", bound=ScenarioOutcome, covariant=True)


class Measure(Protocol[OfOut]):
    """Measures one cell of a map."""

    def __call__(self, number: int, /, *, repeats: int, quick: bool) -> OfOut: ...


class MeasureBy(Protocol):
    """Measures one cell of a map by a method."""

    def __call__(
        self, number: int, /, *, repeats: int, quick: bool, method: str
    ) -> ScenarioOutcome: ...


def measure_scenarios(
    measure: Measure[Of],
    cells: Sequence[int],
    *,
    repeats: int,
    quick: bool = True,
    workers: int | None = None,
) -> list[Of]:
    """Measure cells, on all cores unless told otherwise; the function must be one that a module
    holds.
    """
    with (
        one_thread_each(),
        ProcessPoolExecutor(workers or os.cpu_count(), mp_context=get_context("spawn")) as pool,
    ):
        asked: Callable[[int], Of] = partial(measure, repeats=repeats, quick=quick)
        return list(pool.map(asked, cells, chunksize=4))


def summarise_outcomes(outcomes: Sequence[ScenarioOutcome]) -> dict[str, Any]:
    """Return the figures of a map: silent failures, misses, share ok in scope, width against the
    bound.
    """
    inside = [one for one in outcomes if one.axis == "none"]
    drawn = sum(_draws(one) for one in inside)
    ok, missed = sum(one.ok for one in outcomes), sum(one.missed for one in outcomes)
    bounded = [one for one in inside if one.bound_percent and one.sd_percent]
    ratios = np.array([(one.sd_percent or 0.0) / (one.bound_percent or 1.0) for one in bounded])
    share = missed / max(ok, 1)
    axes = dict.fromkeys(["none", *(one.axis for one in outcomes)])
    return {
        "cells": len(outcomes),
        "draws": sum(_draws(one) for one in outcomes),
        "ok": ok,
        "crashed": sum(one.crashed for one in outcomes),
        "silent": sum(one.silent for one in outcomes),
        "silent_in_scope": sum(one.silent for one in inside),
        "silent_of_honest_gaussian": ok * 8.9e-5,
        "missed_percent": 100.0 * share,
        "missed_standard_errors_over_5_percent": float(
            (share - 0.05) / np.sqrt(0.05 * 0.95 / max(ok, 1))
        ),
        "in_scope_ok_percent": 100.0 * sum(one.ok for one in inside) / max(drawn, 1),
        "median_sd_over_bound": float(np.median(ratios)) if ratios.size else None,
        "cells_with_bound": len(bounded),
        "by_axis": {axis: _by_axis([one for one in outcomes if one.axis == axis]) for axis in axes},
        "worst": [one.number for one in worst(outcomes)],
    }


def _draws(one: ScenarioOutcome) -> int:
    return one.ok + one.suspect + one.refused + one.crashed


def _by_axis(own: Sequence[ScenarioOutcome]) -> dict[str, int]:
    names = ("ok", "suspect", "refused", "crashed", "missed", "silent")
    return {"cells": len(own), **{name: sum(getattr(one, name) for one in own) for name in names}}


def worst(outcomes: Sequence[ScenarioOutcome], count: int = 10) -> list[ScenarioOutcome]:
    """Return the cells with the most silent failures, then misses, then the largest error of an ok
    number.
    """
    return sorted(
        outcomes, key=lambda one: (-one.silent, -one.missed, -(one.worst_percent or 0.0))
    )[:count]


def write_table(
    outcomes: Sequence[ScenarioOutcome],
    chained: Sequence[ScenarioOutcome],
    path: Path,
    *,
    method: str,
) -> Path:
    """Write a table: a row for each cell, and what it says as a whole."""
    names = [one.name for one in fields(outcomes[0])]
    table = {
        "charact": charact.__version__,
        "method": method,
        "quick": _part(outcomes, names),
        "chains": _part(chained, names),
    }
    text = json.dumps(table).replace("], [", "],\n[")
    path.write_text(text + "\n", encoding="utf-8")
    return path


def _part(outcomes: Sequence[ScenarioOutcome], names: list[str]) -> dict[str, Any]:
    rows = [[_short(value) for value in asdict(one).values()] for one in outcomes]
    return {"summary": summarise_outcomes(outcomes), "columns": names, "rows": rows}


def _short(value: Any) -> Any:
    return float(f"{value:.4g}") if isinstance(value, float) else value


def make_map(
    measure: MeasureBy,
    *,
    kind: str,
    method: str,
    table: Path,
    cells: int,
    repeats: int,
    about: str | None,
    first: int = 0,
    chained: float = 1.0 / CHAINED,
) -> None:
    """Make a map as the command line asks, print what it says and write its table.

    Parameters
    ----------
    kind, method
        What is measured, and by which of its methods unless another is asked for.
    first
        Number of the first cell.
    chained
        Share of the cells, evenly among them, of which one drawing is measured in full too.
    """
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--cells", type=int, default=cells, help="number of cells")
    parser.add_argument("--first", type=int, default=first, help="number of the first cell")
    parser.add_argument("--repeats", type=int, default=repeats, help="drawings of each")
    parser.add_argument(
        "--method", default=method, choices=sorted(methods_of_kind(kind)), help="name of a method"
    )
    parser.add_argument("--out", type=Path, default=table, help="table to write")
    asked = parser.parse_args()
    if min(asked.cells, asked.repeats) < 1:
        parser.error(f"cells and repeats must be at least 1, got {asked.cells} and {asked.repeats}")
    numbers = range(asked.first, asked.first + asked.cells)
    measured: Measure[ScenarioOutcome] = partial(measure, method=asked.method)
    quick = measure_scenarios(measured, numbers, repeats=asked.repeats)
    # Half an hour's work is on disk before the chains begin.
    write_table(quick, [], asked.out, method=asked.method)
    picked = [numbers[int(place / chained)] for place in range(math.ceil(chained * asked.cells))]
    chains = measure_scenarios(measured, picked, repeats=1, quick=False)
    write_table(quick, chains, asked.out, method=asked.method)
    for part in (quick, chains):
        print(json.dumps(summarise_outcomes(part), indent=1))
    for one in worst(quick):
        print(json.dumps(asdict(one)))


Rows = Sequence[Mapping[str, Any]]

BINS = 9
# What a drawing may come to, from the floor of a panel to its top, in colours that differ in
# lightness too.
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
    """Draw the quick part of a table that `benchmarks.studies.scenario_map.write_table` wrote.

    Parameters
    ----------
    found
        The table.
    path
        Where the PNG goes.
    breaking, labels
        What breaks the cells, and the label of each of its axes.
    scope
        Along what the cells inside the scope are laid out: its label, and the place of a cell by
        its number.
    columns
        Panels side by side.
    last
        Draws one panel more of the cells inside the scope.
    """
    part = found["quick"]
    cells = [dict(zip(part["columns"], row, strict=True)) for row in part["rows"]]
    rows = -(-(len(breaking) + 2 + (last is not None)) // columns)
    figure, grid = pyplot().subplots(
        rows, columns, figsize=(2.8 * columns, 2.6 * rows), layout="constrained"
    )
    panels = iter(grid.flat)
    inside = [cell for cell in cells if cell["axis"] == "none"]
    label, place = scope
    _draw_fates(
        next(panels),
        inside,
        [place(cell["number"]) for cell in inside],
        log=True,
        label=label,
        title="inside the scope",
    )
    for axis, (_, _, log) in breaking.items():
        own = [cell for cell in cells if cell["axis"] == axis]
        _draw_fates(
            next(panels),
            own,
            [cell["strength"] for cell in own],
            log=log,
            label=labels[axis],
            title=re.sub("_(cy_per_px|px|dn)$", "", axis).replace("_", " "),
        )
    if last is not None:
        last(next(panels), inside)
    for spare in panels:
        spare.axis("off")
    for panel in grid[:, 0]:
        panel.set_ylabel("share of the drawings (1)")
    handles, names = grid[0, 0].get_legend_handles_labels()
    nothing = pyplot().Rectangle((0, 0), 1, 1, facecolor="white", edgecolor="#b8b8b8")
    grid[-1, -1].legend(
        [*handles, nothing], [*names, "no cell drawn here"], loc="center", frameon=False
    )
    figure.suptitle(_title(found), fontsize=11)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)
    pyplot().close(figure)
    return path


def _title(found: Mapping[str, Any]) -> str:
    summary = found["quick"]["summary"]
    return (
        f"{found['method']}, quick: {summary['cells']} cells, {summary['draws']} drawings, "
        f"{summary['ok']} ok, {summary['silent']} silent failures; in scope "
        f"{summary['in_scope_ok_percent']:.1f} % ok"
    )


def _draw_fates(
    panel: Any, cells: Rows, at: Sequence[float], *, log: bool, label: str, title: str
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
        panel.bar(
            borders[:-1],
            share,
            np.diff(borders),
            bottom=floor,
            align="edge",
            color=colour,
            label=name,
        )
        floor = floor + share
    panel.set(
        xlim=(low, high), ylim=(0, 1), xlabel=label, title=title, xscale="log" if log else "linear"
    )
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
    return (
        cell["ok"] - cell["missed"],
        missed,
        cell["silent"],
        cell["suspect"],
        cell["refused"] + cell["crashed"],
    )
