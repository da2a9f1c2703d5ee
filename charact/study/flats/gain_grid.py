"""Covariance gains of stacks put together from single photoelectrons: bias, scatter and cover over all cells of a grid.

`make gain-grid` writes the table. A cell is one blur, one spread of pulse heights and one light, drawn many times: a
dark and a flat each time, from a seed that cell and drawing fix. Its scatter stands beside the least there can be
(`charact.study.flats.gain_bound`), and beside both what the plain variance says of itself.
"""

import argparse
import json
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import charact
import charact.noise  # registers the methods
from charact.method import Context, choose
from charact.study.failure_map import one_thread_each
from charact.study.flats.gain_bound import least_relative_sd
from charact.study.flats.pulse_frames import PulseScene
from charact.study.flats.stacks import HeldStack
from labdata.conditions import Conditions
from labdata.frames import FrameStack
from labdata.measurement import Measurement
from labdata.session import Kind, Session

TABLE = Path(__file__).resolve().parents[1] / "tables" / "gain_grid.json"
METHOD = "covariance-sum"
BLURS_PX = (0.0, 0.5, 0.7, 1.0, 1.5, 2.0)
EXCESS_NOISE_FACTORS = (1.3, 1.6, 2.0)
PHOTOELECTRONS = (0.5, 10.0, 100.0)
CELLS = tuple(product(PHOTOELECTRONS, EXCESS_NOISE_FACTORS, BLURS_PX))
REPEATS, FRAMES = 40, 12
# Drawings of each cell that the table keeps one by one.
FIRST = 3
# One light tells no law, which is no fault of what is measured here.
EXPECTED = {"too-few-frames"}
DRAWN = 13


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of the drawings of one cell.

    Parameters
    ----------
    number
        Place in `CELLS`, and seed.
    photoelectrons, excess_noise_factor, blur_px
        The cell: mean number on a pixel and frame, F^2, standard deviation of the blur after the gain.
    repeats, measured
        Drawings, and those with a covariance gain.
    bias_percent, scatter_percent
        Mean and standard deviation of the covariance gain less its truth, % of the truth.
    bound_percent
        Least standard deviation, % of the truth.
    given_percent
        Median of the standard deviation that the 95 % interval stands for, % of the truth.
    covered, silent
        Drawings whose 95 % interval holds the truth, and those with the truth beyond twice its half.
    flagged
        Covariance gains with a flag besides that of the single light.
    variance_flagged, variance_percent
        Plain gains by variance that are flagged `correlated-noise` or refused, and their median, % of the truth.
    first_percent
        Covariance gains of the first drawings less their truth, % of the truth.
    """

    number: int
    photoelectrons: float
    excess_noise_factor: float
    blur_px: float
    repeats: int
    measured: int
    bias_percent: float
    scatter_percent: float
    bound_percent: float
    given_percent: float
    covered: int
    silent: int
    flagged: int
    variance_flagged: int
    variance_percent: float
    first_percent: list[float]

    @property
    def correlated(self) -> bool:
        """Whether neighbours share noise."""
        return self.blur_px > 0


def scene_of(number: int) -> PulseScene:
    """Return the light and the camera of a cell."""
    photoelectrons, factor, blur_px = CELLS[number]
    return PulseScene(photoelectrons=photoelectrons, excess_noise_factor=factor, blur_px=blur_px, frames=FRAMES)


def session_of(scene: PulseScene, rng: np.random.Generator) -> Session:
    """Draw a dark and a flat."""
    dark, flat = replace(scene, photoelectrons=0.0).drawn(rng), scene.drawn(rng)
    stacks = (_entry("dark", dark, 0.0), _entry("flat", flat, scene.photoelectrons))
    return Session(folder=Path("."), name="single photoelectrons", stacks=stacks)


def _entry(kind: Kind, frames: FrameStack, light: float) -> HeldStack:
    conditions = Conditions(illuminance_lux=1e-6 * light, mcp_v=800.0)
    return HeldStack(label=kind, kind=kind, frames="", conditions=conditions, folder=Path("."), held=frames)


def measured_once(number: int, repeat: int) -> tuple[Measurement, Measurement]:
    """Return the covariance gain and the plain gain by variance of one drawing."""
    session = session_of(scene_of(number), np.random.default_rng([number, DRAWN, repeat]))
    context = Context(seed=repeat, quick=True)
    (covariance,) = choose("flats", METHOD).function(session, context=context).find("covariance_gain")
    (plain,) = choose("flats", "variance").function(session, context=context).find("system_gain")
    return covariance, plain


def measured_cell(number: int, *, repeats: int = REPEATS) -> Outcome:
    """Draw a cell many times and measure each."""
    scene = scene_of(number)
    truth = scene.covariance_gain_dn
    both = [measured_once(number, repeat) for repeat in range(repeats)]
    found = [one for one, _ in both if one.value is not None and one.interval95 is not None]
    value = np.array([one.value for one in found]) / truth - 1.0
    low, high = np.array([one.interval95 for one in found]).T / truth - 1.0
    half = np.where(value < 0, high - value, value - low)
    plain = [one.value for _, one in both if one.value is not None]
    return Outcome(
        number=number,
        photoelectrons=scene.photoelectrons,
        excess_noise_factor=scene.excess_noise_factor,
        blur_px=scene.blur_px,
        repeats=repeats,
        measured=len(found),
        bias_percent=100.0 * float(value.mean()),
        scatter_percent=100.0 * float(value.std(ddof=1)),
        bound_percent=100.0 * least_relative_sd(scene),
        given_percent=100.0 * float(np.median(high - low)) / 3.92,
        covered=int(np.sum((low <= 0) & (high >= 0))),
        silent=int(np.sum(np.abs(value) > 2.0 * half)),
        flagged=sum(bool(set(one.flags) - EXPECTED) for one in found),
        variance_flagged=sum(one.value is None or "correlated-noise" in one.flags for _, one in both),
        variance_percent=100.0 * float(np.median(plain)) / truth if plain else 0.0,
        first_percent=[100.0 * float(one) for one in value[:FIRST]],
    )


def measured_cells(numbers: Sequence[int], *, repeats: int = REPEATS, workers: int | None = None) -> list[Outcome]:
    """Measure cells, on all cores unless told otherwise."""
    with one_thread_each(), ProcessPoolExecutor(workers or os.cpu_count(), mp_context=get_context("spawn")) as pool:
        return list(pool.map(partial(measured_cell, repeats=repeats), numbers))


def told(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return what the cells say together, and by each of their three axes."""
    by = {
        axis: {f"{at:g}": _together([one for one in outcomes if getattr(one, axis) == at]) for at in positions}
        for axis, positions in (
            ("blur_px", BLURS_PX), ("excess_noise_factor", EXCESS_NOISE_FACTORS), ("photoelectrons", PHOTOELECTRONS)
        )
    }  # fmt: skip
    return {**_together(outcomes), "by": by}


def _together(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Pool cells, each drawing counting alike."""
    if not outcomes:
        return {"cells": 0}
    weight = np.array([one.measured for one in outcomes], float)
    weight = weight / weight.sum()
    scatter = np.array([one.scatter_percent for one in outcomes])
    bound = np.array([one.bound_percent for one in outcomes])
    count = sum(one.measured for one in outcomes)
    tied = [one for one in outcomes if one.correlated]
    return {
        "cells": len(outcomes),
        "drawings": sum(one.repeats for one in outcomes),
        "measured": count,
        "bias_percent": float(weight @ [one.bias_percent for one in outcomes]),
        "bias_sd_percent": float(np.sqrt(np.sum(weight * scatter**2) / count)),
        "scatter_over_bound": float(np.sqrt(np.sum(weight * (scatter / bound) ** 2))),
        "covered_percent": 100.0 * sum(one.covered for one in outcomes) / count,
        "silent": sum(one.silent for one in outcomes),
        "flagged": sum(one.flagged for one in outcomes),
        "correlated": sum(one.repeats for one in tied),
        "correlated_flagged": sum(one.variance_flagged for one in tied),
    }


def written(outcomes: Sequence[Outcome], path: Path = TABLE) -> Path:
    """Write the table: a row for each cell, and what they say together."""
    names = [one.name for one in fields(Outcome)]
    rows = [[_short(value) for value in asdict(one).values()] for one in outcomes]
    table = {
        "charact": charact.__version__, "method": METHOD, "frames": FRAMES, "seed": f"[cell, {DRAWN}, drawing]",
        "summary": told(outcomes), "columns": names, "rows": rows,
    }  # fmt: skip
    path.write_text(json.dumps(table).replace("]], [", "]],\n[") + "\n", encoding="utf-8")
    return path


def read(path: Path = TABLE) -> list[Outcome]:
    """Return the cells of a table."""
    table = json.loads(path.read_text())
    return [Outcome(**dict(zip(table["columns"], row, strict=True))) for row in table["rows"]]


def _short(value: Any) -> Any:
    if isinstance(value, list):
        return [_short(one) for one in value]
    return float(f"{value:.4g}") if isinstance(value, float) else value


def main() -> None:
    """Measure the cells that are asked for, put them into the table and print what it says."""
    parser = argparse.ArgumentParser(prog="python -m charact.study.flats.gain_grid", description=__doc__)
    parser.add_argument("--first", type=int, default=0, help="number of the first cell")
    parser.add_argument("--cells", type=int, default=len(CELLS), help="number of cells")
    parser.add_argument("--repeats", type=int, default=REPEATS, help="drawings of each")
    parser.add_argument("--workers", type=int, default=None, help="processes")
    parser.add_argument("--out", type=Path, default=TABLE, help="table to write; cells that it holds already stay")
    asked = parser.parse_args()
    numbers = range(asked.first, min(asked.first + asked.cells, len(CELLS)))
    kept = [one for one in read(asked.out) if one.number not in numbers] if asked.out.is_file() else []
    new = measured_cells(numbers, repeats=asked.repeats, workers=asked.workers)
    outcomes = sorted([*kept, *new], key=lambda one: one.number)
    written(outcomes, asked.out)
    print(json.dumps(told(outcomes), indent=1))


if __name__ == "__main__":
    main()
