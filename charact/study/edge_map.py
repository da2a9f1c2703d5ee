"""Where edges break: thousands of random cells, each drawn many times, half of them past the declared scope.

`make edge-map` writes the table. A cell is one scene: blur, size, direction, noise and light, and in half of the
cells one thing that breaks edge methods, from too little to matter to far too much.
"""

import argparse
import json
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import charact.mtf  # registers the methods
from charact.method import Context
from charact.method.registry import of_kind
from charact.study.edge import Blur, EdgeScene
from charact.study.edge_bound import least_relative_sd
from charact.study.failure_map import one_thread_each
from charact.study.harness import Case, Row, attempt
from labdata.frames import FrameStack

TABLE = Path(__file__).resolve().parent / "tables" / "edge_map.json"
METHOD = "edge-parametric"
CELLS, REPEATS = 5000, 20
# One cell in fifty is measured by Markov chains too.
CHAINED = 50
# Streams of a cell's scene and of its repeats, so that neither depends on the other.
SCENE, NOISE = 11, 12
# What breaks edge methods, from where it hardly matters to where nothing is left, and whether steps are even in ln.
BREAKING: dict[str, tuple[float, float, bool]] = {
    "snr": (0.2, 3.0, True),
    "angle_deg": (0.0, 1.0, False),
    "rows": (8.0, 30.0, False),
    "gamma": (0.45, 2.2, True),
    "gradient": (0.1, 0.8, True),
    "motion_px": (0.05, 3.0, True),
    "sagitta_px": (0.05, 6.0, True),
    "clip_share": (0.002, 0.6, True),
    "hot_share": (1e-4, 0.05, True),
    "sharpness": (0.05, 0.35, True),
    "blur_px": (4.0, 40.0, True),
    "halo_px": (80.0, 400.0, True),
}


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One scene of the map.

    Parameters
    ----------
    number
        Seed of the cell.
    axis, strength
        What breaks the scene and by how much, in the unit of its name; "none" and 0 inside the scope.
    scene
        The scene without its place, which differs from repeat to repeat.
    """

    number: int
    axis: str
    strength: float
    scene: EdgeScene

    @property
    def in_scope(self) -> bool:
        """Whether the method declares to measure such a scene."""
        return self.axis == "none"


def cell_of(number: int) -> Cell:
    """Return a cell from its number."""
    rng = np.random.default_rng([number, SCENE])
    scene = _scene_in_scope(rng)
    if rng.random() < 0.5:
        return Cell(number=number, axis="none", strength=0.0, scene=scene)
    axis = str(rng.choice(list(BREAKING)))
    low, high, even_in_ln = BREAKING[axis]
    share = rng.random()
    strength = float(low * (high / low) ** share if even_in_ln else low + (high - low) * share)
    return Cell(number=number, axis=axis, strength=strength, scene=_broken(scene, axis, strength))


def _scene_in_scope(rng: np.random.Generator) -> EdgeScene:
    form = str(rng.choice(["gaussian", "exponential", "moffat", "halo"]))
    blur = Blur(
        form="gaussian" if form == "halo" else form,  # pyright: ignore[reportArgumentType]
        sigma_px=float(rng.uniform(0.5, 2.0)),
        frequency_cy_per_px=float(rng.uniform(0.12, 0.4)),
        exponent=float(rng.uniform(1.05, 2.2)),
        moffat_px=float(rng.uniform(1.0, 3.0)),
        moffat_exponent=float(rng.uniform(1.5, 4.0)),
        halo_share=float(rng.uniform(0.03, 0.3)) if form == "halo" else 0.0,
        halo_px=float(rng.uniform(12.0, 40.0)),
    )
    dark = float(rng.uniform(1300.0, 3500.0))
    tilt = float(np.exp(rng.uniform(np.log(1.5), np.log(40.0))))
    size = 60 if tilt > 3 else 90
    return EdgeScene(
        blur=blur,
        rows=int(rng.integers(size, 141)),
        cols=int(rng.integers(size, 141)),
        angle_deg=float(rng.choice([0, 90, 180, 270]) + rng.choice([-1, 1]) * tilt),
        dark_dn=dark,
        bright_dn=dark + 1500.0,
        snr=float(np.exp(rng.uniform(np.log(3), np.log(100)))),
        shot_share=float(rng.choice([0.0, 0.8])),
        noise_blur_px=float(rng.choice([0.0, 0.5, 0.9])),
        gradient=float(rng.uniform(-0.05, 0.05)) if rng.random() < 0.3 else 0.0,
        black_dn=200.0,
        full_scale_dn=65535.0,
    )


def _broken(scene: EdgeScene, axis: str, strength: float) -> EdgeScene:
    """Return a scene with one thing wrong."""
    if axis == "angle_deg":
        return replace(scene, angle_deg=round(scene.angle_deg / 90.0) * 90.0 + strength)
    if axis == "rows":
        return replace(scene, rows=round(strength), cols=round(strength))
    if axis == "gamma":
        # On a scale that the scene fills, as a camera with a gamma would.
        return replace(scene, gamma=strength, full_scale_dn=1.1 * scene.bright_dn)
    if axis == "clip_share":
        return replace(scene, clip_share=strength, full_scale_dn=scene.bright_dn)
    if axis == "hot_share":
        return replace(scene, hot_share=strength, full_scale_dn=1.3 * scene.bright_dn)
    if axis == "sharpness":
        return replace(scene, blur=Blur(sigma_px=strength))
    if axis == "blur_px":
        return replace(scene, blur=Blur(sigma_px=strength))
    if axis == "halo_px":
        share = max(scene.blur.halo_share, 0.15)
        return replace(scene, blur=replace(scene.blur, halo_px=strength, halo_share=share))
    return replace(scene, **{axis: strength})


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of the repeats of one cell.

    Parameters
    ----------
    number, axis, strength
        As of the cell.
    ok, suspect, refused, crashed
        Repeats by status.
    silent, missed
        Repeats that are ok with the truth beyond twice the 95 % half interval, and outside the 95 % interval.
    truth_cy_per_px
        MTF50.
    worst_percent
        Largest error of an ok number, % of the truth; None: there is none.
    sd_percent
        Median over the ok numbers of a quarter of the 95 % interval's width over 0.98, % of the truth.
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
    truth_cy_per_px: float
    worst_percent: float | None
    sd_percent: float | None
    bound_percent: float | None
    seconds: float


def measured_cell(number: int, *, repeats: int = REPEATS, quick: bool = True, bound: bool = False) -> Outcome:
    """Draw a cell's frames and put the method to each of them."""
    cell = cell_of(number)
    truth = cell.scene.truth_mtf50
    rows = [attempt(of_kind("edge")[METHOD], case_of(cell, truth, i), Context(quick=quick)) for i in range(repeats)]
    sure = [row for row in rows if row.status == "ok"]
    truths = truths_of(cell)
    widths = [(row.high95 - row.low95) / 3.92 / truth for row in sure if row.high95 and row.low95]
    statuses = [row.status for row in rows]
    return Outcome(
        number=number,
        axis=cell.axis,
        strength=cell.strength,
        ok=len(sure),
        suspect=statuses.count("suspect"),
        refused=statuses.count("refused"),
        crashed=statuses.count("crashed"),
        silent=sum(silent(row, truths) for row in sure),
        missed=sum(not covers(row, truths) for row in sure),
        truth_cy_per_px=truth,
        worst_percent=max((row.error_percent or 0.0 for row in sure), default=None),
        sd_percent=100.0 * float(np.median(widths)) if widths else None,
        bound_percent=100.0 * least_relative_sd(cell.scene) if bound and cell.in_scope else None,
        seconds=float(np.median([row.seconds for row in rows])),
    )


def truths_of(cell: Cell) -> tuple[float, float]:
    """Return the least and the largest MTF50 that are right for a cell, cy/px.

    Light spread wider than the window belongs to the normalisation as far as it is seen, and a result says that it is
    normalised to the light inside: right is what counts all of that light, none of it, or a part.
    """
    truth = cell.scene.truth_mtf50
    if cell.axis != "halo_px":
        return truth, truth
    core = replace(cell.scene.blur, halo_share=0.0)
    return truth, core.mtf50(cell.scene.angle_deg)


def covers(row: Row, truths: tuple[float, float]) -> bool:
    """Tell whether a 95 % interval holds a right value."""
    low, high = _interval(row)
    return low <= truths[1] and high >= truths[0]


def silent(row: Row, truths: tuple[float, float]) -> bool:
    """Tell whether an ok number is off by more than twice its 95 % half interval on the side of the right value."""
    value, (low, high) = row.value or 0.0, _interval(row)
    off = float(np.clip(value, *truths)) - value
    return abs(off) > 2.0 * ((high - value) if off > 0 else (value - low))


def _interval(row: Row) -> tuple[float, float]:
    assert row.low95 is not None and row.high95 is not None, "an ok number has an interval"
    return row.low95, row.high95


def case_of(cell: Cell, truth: float, repeat: int) -> Case:
    """Return one drawing of a cell, the edge at a place of its own."""

    def draw(rng: np.random.Generator) -> FrameStack:
        return replace(cell.scene, offset_px=float(rng.uniform(-2.0, 2.0))).frames_drawn(rng)

    return Case(
        kind="edge",
        name=f"cell {cell.number}, drawing {repeat}",
        axis=cell.axis,
        position=cell.strength,
        unit="",
        quantity="mtf50",
        truth=truth,
        in_scope=cell.in_scope,
        seed=int(np.random.SeedSequence([cell.number, NOISE, repeat]).generate_state(1)[0]),
        draw=draw,
    )


def mapped(cells: Sequence[int], *, repeats: int = REPEATS, quick: bool = True, bounds_each: int = 10) -> list[Outcome]:
    """Measure cells on all cores, the Cramer-Rao bound of one in `bounds_each`."""
    with one_thread_each(), ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
        asked = [
            pool.submit(partial(measured_cell, n, repeats=repeats, quick=quick, bound=n % bounds_each == 0))
            for n in cells
        ]
        return [one.result() for one in asked]


def told(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return the figures of a map: silent failures, misses, share ok in scope, width against the bound."""
    inside = [one for one in outcomes if one.axis == "none"]
    drawn = sum(_draws(one) for one in inside)
    ok, missed = sum(one.ok for one in outcomes), sum(one.missed for one in outcomes)
    bounded = [one for one in inside if one.bound_percent and one.sd_percent]
    ratios = np.array([(one.sd_percent or 0.0) / (one.bound_percent or 1.0) for one in bounded])
    share = missed / max(ok, 1)
    return {
        "cells": len(outcomes),
        "draws": sum(_draws(one) for one in outcomes),
        "ok": ok,
        "crashed": sum(one.crashed for one in outcomes),
        "silent": sum(one.silent for one in outcomes),
        "silent_in_scope": sum(one.silent for one in inside),
        "silent_of_honest_gaussian": ok * 8.9e-5,
        "missed_percent": 100.0 * share,
        "missed_standard_errors_over_5_percent": float((share - 0.05) / np.sqrt(0.05 * 0.95 / max(ok, 1))),
        "in_scope_ok_percent": 100.0 * sum(one.ok for one in inside) / max(drawn, 1),
        "median_sd_over_bound": float(np.median(ratios)) if ratios.size else None,
        "cells_with_bound": len(bounded),
        "by_axis": {axis: _by_axis([one for one in outcomes if one.axis == axis]) for axis in ("none", *BREAKING)},
        "worst": [one.number for one in worst(outcomes)],
    }


def _draws(one: Outcome) -> int:
    return one.ok + one.suspect + one.refused + one.crashed


def _by_axis(own: Sequence[Outcome]) -> dict[str, int]:
    names = ("ok", "suspect", "refused", "crashed", "missed", "silent")
    return {"cells": len(own), **{name: sum(getattr(one, name) for one in own) for name in names}}


def worst(outcomes: Sequence[Outcome], count: int = 10) -> list[Outcome]:
    """Return the cells with the most silent failures, then misses, then the largest error of an ok number."""
    return sorted(outcomes, key=lambda one: (-one.silent, -one.missed, -(one.worst_percent or 0.0)))[:count]


def written(outcomes: Sequence[Outcome], chained: Sequence[Outcome], path: Path = TABLE) -> Path:
    """Write the table: a row for each cell, and what it says as a whole."""
    names = [one.name for one in fields(Outcome)]
    table = {
        "charact": charact.__version__,
        "method": METHOD,
        "quick": _part(outcomes, names),
        "chains": _part(chained, names),
    }
    text = json.dumps(table).replace("], [", "],\n[")
    path.write_text(text + "\n", encoding="utf-8")
    return path


def _part(outcomes: Sequence[Outcome], names: list[str]) -> dict[str, Any]:
    rows = [[_short(value) for value in asdict(one).values()] for one in outcomes]
    return {"summary": told(outcomes), "columns": names, "rows": rows}


def _short(value: Any) -> Any:
    return float(f"{value:.4g}") if isinstance(value, float) else value


def main() -> None:
    """Make the map, print what it says and write the table."""
    parser = argparse.ArgumentParser(prog="python -m charact.study.edge_map", description=__doc__)
    parser.add_argument("--cells", type=int, default=CELLS, help="number of cells")
    parser.add_argument("--first", type=int, default=0, help="number of the first cell")
    parser.add_argument("--repeats", type=int, default=REPEATS, help="drawings of each")
    parser.add_argument("--out", type=Path, default=TABLE, help="table to write")
    asked = parser.parse_args()
    numbers = range(asked.first, asked.first + asked.cells)
    quick = mapped(numbers, repeats=asked.repeats)
    # Half an hour's work is on disk before the chains begin.
    written(quick, [], asked.out)
    chained = mapped(numbers[::CHAINED], repeats=1, quick=False)
    written(quick, chained, asked.out)
    for part in (quick, chained):
        print(json.dumps(told(part), indent=1))
    for one in worst(quick):
        print(json.dumps(asdict(one)))


if __name__ == "__main__":
    main()
