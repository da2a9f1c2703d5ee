"""Where halo and bloom diameters break: thousands of random series, half of them with one thing wrong.

`make bloom-map` writes the table. A cell is a point source at a few levels, drawn in closed form; what breaks it goes
from too little to matter to far too much. The halo diameter is the main quantity; silent failures of bloom diameters
are counted beside it, stack by stack.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import charact.bloom  # noqa: F401  # registers the methods
from charact.method.registry import of_kind
from charact.study import cell_map
from charact.study.bloom.camera import expected
from charact.study.bloom.coverage import is_silent
from charact.study.bloom.scene import BloomScene
from charact.study.bloom.series import BloomSeries, halo_overload, levels_in_scope, measured, scene_in_scope
from charact.study.bloom.truth import diameter_of_picture
from charact.study.cell_map import Breaking, Cell, Outcome, cell_drawn, outcome_of, seed_of
from charact.study.harness import Row, judged
from labdata.measurement import Measurement

TABLE = Path(__file__).resolve().parents[1] / "tables" / "bloom_map.json"
METHOD, QUANTITY = "series-forward", "halo_diameter"
CELLS, REPEATS = 2000, 1
# Cells that are measured before the table is written again.
PART = 20
# Series of the map are smaller than those of the scope at large: it holds five times as many.
WIDEST_PX, MOST_FRAMES, SHOWN = 40.0, 6, 3
# What breaks series, from where it hardly matters to where nothing is left, and whether steps are even in ln.
BREAKING: Breaking = {
    "faintest": (0.003, 30.0, True),
    "levels": (1.0, 3.0, False),
    "off_centre": (0.1, 0.5, False),
    "second_ratio": (0.003, 1.0, True),
    "second_distance_px": (3.0, 70.0, True),
    "motion_px": (0.03, 10.0, True),
    "moving_lag": (0.02, 0.7, True),
    "agc": (0.03, 30.0, True),
    "codes": (4.0, 200.0, True),
    "dark_too_high_dn": (0.1, 60.0, True),
    "dark_too_low_dn": (0.1, 10.0, True),
    "full_well": (1.05, 100.0, True),
    "smear_fraction": (1e-5, 1e-1, True),
    "plate_saturation": (0.1, 1e3, True),
    "wing_share": (0.15, 0.7, True),
    "elastic_share": (0.0, 0.1, False),
    "halo_fraction": (1e-4, 0.02, True),
    "glare_fraction": (0.05, 0.8, True),
    "frames": (1.0, 3.0, False),
    "photoelectron_dn": (4.0, 120.0, True),
    "no_darks": (0.3, 60.0, True),
}
# Which levels are left where there are few: all of them show the halo.
PICKED = {1: (2,), 2: (1, 3), 3: (1, 2, 3)}
# How fast the source moves where it is the lag that breaks, px a frame, and how far the second one is, px.
MOVING_PX, SECOND_PX = 2.0, 20.0


@dataclass(frozen=True, kw_only=True)
class BloomOutcome(Outcome):
    """What became of the repeats of one cell, and of the bloom diameters of its stacks.

    Parameters
    ----------
    blooms, bloom_ok, bloom_missed, bloom_silent
        Stacks; those with an ok bloom diameter; of these, those whose 95 % interval misses, and silent failures.
    bloom_worst_px
        Largest error of an ok bloom diameter, px.
    """

    blooms: int
    bloom_ok: int
    bloom_missed: int
    bloom_silent: int
    bloom_worst_px: float


def cell_of(number: int) -> Cell[BloomSeries]:
    """Return a cell from its number."""
    return cell_drawn(number, BREAKING, _series_in_scope, _broken)


def _series_in_scope(rng: np.random.Generator) -> BloomSeries:
    scene = scene_in_scope(rng, widest_px=WIDEST_PX, most_frames=MOST_FRAMES)
    return BloomSeries(scene=scene, overloads=levels_in_scope(scene, rng, shown=SHOWN))


def _broken(series: BloomSeries, axis: str, strength: float) -> BloomSeries:
    """Return a series with one thing wrong."""
    if axis == "faintest":
        overload = strength * halo_overload(series.scene)
        return replace(series, overloads=tuple(float(one) for one in overload * np.geomspace(1.0, 100.0, 5)))
    if axis == "levels":
        return replace(series, overloads=tuple(series.overloads[one] for one in PICKED[round(strength)]))
    if axis == "agc":
        series = replace(series, overloads=tuple(strength * one for one in series.overloads))
    return replace(series, scene=_wrong(series.scene, axis, strength), darks=axis != "no_darks")


def _wrong(scene: BloomScene, axis: str, strength: float) -> BloomScene:
    """Return a scene with one thing wrong."""
    span = scene.span_dn
    changed: dict[str, Any] = {
        "off_centre": {"col": (0.5 - strength) * (scene.cols - 1)},
        "second_ratio": {"second_ratio": strength, "second_distance_px": SECOND_PX},
        "moving_lag": {"lag": strength, "motion_px": MOVING_PX},
        "agc": {"agc": True},
        "codes": _coarse(scene, strength),
        "dark_too_high_dn": {"wrong_dark_dn": strength * span / 243.0},
        "dark_too_low_dn": {"wrong_dark_dn": -strength * span / 243.0},
        "full_well": {"full_well_dn": strength * span},
        "plate_saturation": {"plate_saturation_dn": strength * span},
        "elastic_share": {"halo_elastic_share": strength},
        "frames": {"frames": round(strength)},
        "photoelectron_dn": {"photoelectron_dn": strength * span / 243.0},
        "no_darks": {"background_dn": strength * span / 243.0},
    }.get(axis, {axis: strength})
    return replace(scene, **changed)


def _coarse(scene: BloomScene, codes: float) -> dict[str, float]:
    """The same camera with fewer codes: all its levels shrink alike."""
    names = ("dark_dn", "background_dn", "photoelectron_dn", "read_noise_dn", "full_scale_dn")
    scale = codes / scene.full_scale_dn
    return {name: getattr(scene, name) * scale for name in names} | {"full_scale_dn": float(round(codes))}


def measured_cell(number: int, *, repeats: int = REPEATS, quick: bool = True, method: str = METHOD) -> BloomOutcome:
    """Draw a cell's frames and put the method to each of them."""
    cell = cell_of(number)
    tries = [_measured_once(cell, repeat, quick, method) for repeat in range(repeats)]
    truth = cell.scene.scene.halo_diameter_px
    halo = outcome_of(cell, [row for row, _ in tries], truth, truths=(truth, truth))
    blooms = [one for _, found in tries for one in found]
    return BloomOutcome(**asdict(halo), **_of_blooms(cell.scene, blooms))


def _measured_once(cell: Cell[BloomSeries], repeat: int, quick: bool, method: str) -> tuple[Row, list[Measurement]]:
    """The row of the halo diameter, and the bloom diameters."""
    series, seed = cell.scene, seed_of(cell, repeat)
    drawn = series.session_drawn(np.random.default_rng(seed))
    found, seconds = measured(of_kind("bloom")[method], series, drawn, seed=seed, quick=quick)
    truth = series.scene.halo_diameter_px
    fields: dict[str, Any] = {
        "method": method, "kind": "bloom", "case": f"cell {cell.number}", "axis": cell.axis, "position": cell.strength,
        "unit": "", "in_scope": cell.in_scope, "seed": seed, "truth": truth, "seconds": seconds,
    }  # fmt: skip
    halos = [one for one in found or () if one.quantity == QUANTITY]
    if not halos:
        return Row(**fields, status="crashed" if found is None else "refused"), []
    halo = halos[0]
    low, high = halo.interval95 or (None, None)
    row = Row(**fields, status=halo.status, value=halo.value, low95=low, high95=high, flags=halo.flags,
              reason=halo.reason, **judged(halo, truth))  # fmt: skip
    return row, [one for one in found or () if one.quantity == "bloom_diameter"]


def _of_blooms(series: BloomSeries, found: Sequence[Measurement]) -> dict[str, Any]:
    """Judge bloom diameters; where the source moves, all from a still one's to the mean frame's is right."""
    sure = [one for one in found if one.status == "ok" and one.value is not None]
    truths = [_bloom_truths(series, one.stack or "") for one in sure]
    rights = [float(np.clip(one.value or 0.0, *truth)) for one, truth in zip(sure, truths, strict=True)]
    intervals = [one.interval95 or (one.value or 0.0, one.value or 0.0) for one in sure]
    return {
        "blooms": len(found),
        "bloom_ok": len(sure),
        "bloom_missed": sum(
            low > most or high < least for (low, high), (least, most) in zip(intervals, truths, strict=True)
        ),
        "bloom_silent": sum(is_silent(one, right) for one, right in zip(sure, rights, strict=True)),
        "bloom_worst_px": max(
            (abs((one.value or 0.0) - right) for one, right in zip(sure, rights, strict=True)), default=0.0
        ),
    }


def _bloom_truths(series: BloomSeries, stack: str) -> tuple[float, float]:
    """Least and largest bloom diameter that is right."""
    still, scene = series.truth("bloom_diameter", stack) or 0.0, series.scene
    if scene.motion_px == 0:
        return still, still
    overload = series.overloads[int(stack.removeprefix("point-"))]
    moves = scene.motion_px * (np.arange(scene.frames + 1) - (scene.frames + 1) / 2)
    row, col = scene.centre
    light = np.array([expected(replace(scene, row=row, col=float(col + move)), overload) for move in moves])
    seen = np.minimum((1.0 - scene.lag) * light[1:] + scene.lag * light[:-1], scene.full_scale_dn).mean(axis=0)
    moving = diameter_of_picture(scene, scene.dark_dn + 0.5 * scene.span_dn, seen)
    return min(still, moving), max(still, moving)


def bloom_told(outcomes: Sequence[BloomOutcome]) -> dict[str, Any]:
    """Return what became of the bloom diameters, all together and by what breaks the cells."""
    axes = dict.fromkeys(["none", *(one.axis for one in outcomes)])
    names = ("blooms", "bloom_ok", "bloom_missed", "bloom_silent")

    def summed(own: Sequence[BloomOutcome]) -> dict[str, int]:
        return {name: sum(getattr(one, name) for one in own) for name in names}

    by_axis = {axis: summed([one for one in outcomes if one.axis == axis]) for axis in axes}
    silent = [one.number for one in outcomes if one.bloom_silent]
    return {**summed(outcomes), "by_axis": by_axis, "silent_cells": silent}


def main() -> None:
    """Make the map, part by part: a run that is stopped goes on where its table ends."""
    parser = argparse.ArgumentParser(prog="python -m charact.study.bloom.map", description=__doc__)
    parser.add_argument("--cells", type=int, default=CELLS, help="number of cells")
    parser.add_argument("--method", default=METHOD, help="name of a bloom method")
    parser.add_argument("--workers", type=int, default=None, help="processes")
    parser.add_argument("--out", type=Path, default=TABLE, help="table to write; cells that it holds already stay")
    asked = parser.parse_args()
    measure = partial(measured_cell, method=asked.method)
    quick, chained = read(asked.out) if asked.out.is_file() else ([], [])
    while len(quick) < asked.cells:
        numbers = range(len(quick), min(asked.cells, len(quick) + PART))
        quick += cell_map.mapped(measure, numbers, repeats=REPEATS, workers=asked.workers)
        chains = [number for number in numbers if number % cell_map.CHAINED == 0]
        chained += cell_map.mapped(measure, chains, repeats=1, quick=False, workers=asked.workers)
        cell_map.written(quick, chained, asked.out, method=asked.method)
    for part in (quick, chained):
        print(json.dumps({**cell_map.told(part), "blooms": bloom_told(part)}, indent=1))
    for one in [*cell_map.worst(quick), *(one for one in quick if one.bloom_silent)]:
        print(json.dumps(asdict(one)))


def read(path: Path) -> tuple[list[BloomOutcome], list[BloomOutcome]]:
    """Return the cells of a table: quick ones, and those measured by chains."""
    table = json.loads(path.read_text())
    quick, chained = (
        [BloomOutcome(**dict(zip(table[part]["columns"], row, strict=True))) for row in table[part]["rows"]]
        for part in ("quick", "chains")
    )
    return quick, chained


if __name__ == "__main__":
    main()
