"""Bias of the bar methods and cover of their intervals, cell by cell: `make bar-study` keeps the table.

A cell is one blur, frequency, tilt and grain of the noise. Its noise is drawn in pairs, once as it is and once upside
down: what is linear in the noise cancels in the mean of a pair, and a bias of a percent stands out of a scatter of ten.
"""

import argparse
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import charact.mtf  # noqa: F401  (registers the methods)
from charact.method import Context, choose
from charact.study.bars.bias_table import TABLE, BarScenarioOutcome, lines, read, tally, write_table
from charact.study.bars.strips import StripScene
from charact.study.edge.scene import TrueBlur
from charact.study.harness import judge_measurement
from charact.study.stability_sweep import one_thread_each
from labdata.measurement import Measurement

METHOD = "bars-forward"
BLURS = {
    "Gaussian 0.8 px": TrueBlur(sigma_px=0.8),
    "Gaussian 1.5 px": TrueBlur(sigma_px=1.5),
    "tube fc 0.25 n 1.1": TrueBlur(form="exponential", frequency_cy_per_px=0.25, exponent=1.1),
}
FREQUENCIES = (0.05, 0.1, 0.2, 0.3, 0.35, 0.4)
TILTS_DEG = (0.0, 2.0, 8.0)
# Where untilted bars lie on the pixels, at which frequencies it may matter: a pixel's middle, its border and between.
PHASES_PX, PHASE_FREQUENCIES = (0.0, 0.25, 0.5), (0.2, 0.25, 0.3, 0.35, 0.4)
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
DRAWN = 17
# Pairs of a cell at least and at most, and the standard error of its bias, percent, that will do.
LEAST_PAIRS, MOST_PAIRS, SURE_PERCENT = 20, 160, 0.4
# Numbers of each cell that the table keeps one by one.
FIRST = 6


@dataclass(frozen=True, kw_only=True)
class Cell:
    """What is measured many times.

    Parameters
    ----------
    blur
        Name of the blur.
    scene
        The bars, but for their phase.
    phase_px
        Where their middle lies, px; None: evenly over a pixel.
    """

    blur: str
    scene: StripScene
    phase_px: float | None = None

    def drawn(self, pair: int) -> tuple[StripScene, StripScene]:
        """Return the scenes of a pair, at a phase of its own where the cell has none."""
        phase = (GOLDEN * pair) % 1.0 - 0.5 if self.phase_px is None else self.phase_px
        scene = replace(self.scene, phase_px=float(phase))
        return scene, replace(scene, noise_sign=-1)


def _cells() -> tuple[Cell, ...]:
    """Every blur at every frequency and tilt, its noise white, or blurred behind the gain and turned; then phases."""
    axes = product(BLURS.items(), FREQUENCIES, TILTS_DEG, (False, True))
    evenly = [
        Cell(blur=name, scene=_scene(blur, frequency, tilt, grain=grain))
        for (name, blur), frequency, tilt, grain in axes
    ]
    phases = [
        Cell(blur=name, scene=_scene(blur, frequency, 0.0, grain=False), phase_px=phase)
        for (name, blur), frequency, phase in product(BLURS.items(), PHASE_FREQUENCIES, PHASES_PX)
    ]
    return (*evenly, *phases)


def _scene(blur: TrueBlur, frequency: float, tilt_deg: float, *, grain: bool) -> StripScene:
    scene = StripScene(blur=blur, frequency_cy_per_px=frequency, angle_deg=tilt_deg)
    return replace(scene, noise_blur_px=0.7, turned=True) if grain else scene


CELLS = _cells()


def measure_scene(scene: StripScene, number: int, pair: int, method: str = METHOD) -> Measurement:
    """Measure one scene with the noise of a cell's pair."""
    stack = scene.frames_drawn(np.random.default_rng([number, DRAWN, pair]))
    context = Context(seed=pair, quick=True, full_scale_dn=scene.full_scale_dn)
    asked = {"bars": scene.bars, "frequency_cy_per_px": scene.frequency_cy_per_px}
    return choose("bars", method).function(stack, context=context, **asked).measurements[0]


def measure_scenario(
    number: int, *, least: int = LEAST_PAIRS, most: int = MOST_PAIRS, method: str = METHOD
) -> BarScenarioOutcome:
    """Measure pairs of a cell until its bias is known, or the method says that it is not."""
    cell = CELLS[number]
    found: list[list[Measurement]] = []
    while len(found) < least or (len(found) < most and _needs_more_pairs(found, cell.scene.truth_mtf)):
        found.append([measure_scene(scene, number, len(found), method) for scene in cell.drawn(len(found))])
    return _outcome(number, cell, found)


def _needs_more_pairs(found: Sequence[Sequence[Measurement]], truth: float) -> bool:
    """Tell whether more pairs are wanted: most numbers are ok, and the bias is not yet known well enough."""
    ok = sum(one.status == "ok" for pair in found for one in pair)
    _, standard_error = _bias(found, truth)
    return ok > len(found) and (standard_error is None or standard_error > SURE_PERCENT)


def _bias(found: Sequence[Sequence[Measurement]], truth: float) -> tuple[float | None, float | None]:
    """Return the mean error of pairs and its standard error, percent."""
    values = [[one.value for one in pair if one.value is not None] for pair in found]
    mean = np.array([100.0 * (np.mean(pair) / truth - 1.0) for pair in values if len(pair) == 2])
    if mean.size < 2:
        return None, None
    return float(mean.mean()), float(mean.std(ddof=1) / np.sqrt(mean.size))


def _outcome(number: int, cell: Cell, found: Sequence[Sequence[Measurement]]) -> BarScenarioOutcome:
    """Count what became of the pairs of a cell."""
    truth = cell.scene.truth_mtf
    every = [one for pair in found for one in pair]
    numbers = [one for one in every if one.value is not None]
    error = np.array([100.0 * (one.value / truth - 1.0) for one in numbers if one.value is not None])
    bias, standard_error = _bias(found, truth)
    return BarScenarioOutcome(
        number=number,
        blur=cell.blur,
        frequency_cy_per_px=cell.scene.frequency_cy_per_px,
        tilt_deg=cell.scene.angle_deg,
        grain_px=cell.scene.noise_blur_px,
        phase_px=cell.phase_px,
        truth=truth,
        draws=len(every),
        numbers=len(numbers),
        ok=sum(one.status == "ok" for one in every),
        bias_percent=bias,
        standard_error_percent=standard_error,
        scatter_percent=float(np.sqrt(np.mean(error**2))) if error.size else None,
        held68=sum(_holds(one.interval68, truth) for one in numbers),
        held95=sum(_holds(one.interval95, truth) for one in numbers),
        silent=sum(judge_measurement(one, truth)["silent"] for one in numbers),
        first=[one.value for one in every[:FIRST]],
    )


def _holds(interval: tuple[float, float] | None, truth: float) -> bool:
    return interval is not None and interval[0] <= truth <= interval[1]


def measure_scenarios(numbers: Sequence[int], *, workers: int | None = None, **asked: Any) -> list[BarScenarioOutcome]:
    """Measure cells as `measure_scenario` does, on all cores unless told otherwise."""
    with one_thread_each(), ProcessPoolExecutor(workers or os.cpu_count(), mp_context=get_context("spawn")) as pool:
        return list(pool.map(partial(measure_scenario, **asked), numbers))


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure the cells that are asked for, put them into the table and print what it says."""
    parser = argparse.ArgumentParser(prog="python -m charact.study.bars.bias", description=__doc__)
    parser.add_argument("--method", default=METHOD)
    parser.add_argument("--first", type=int, default=0, help="number of the first cell")
    parser.add_argument("--cells", type=int, default=len(CELLS), help="number of cells")
    parser.add_argument("--least", type=int, default=LEAST_PAIRS, help="least number of pairs of each")
    parser.add_argument("--most", type=int, default=MOST_PAIRS, help="largest number of pairs of each")
    parser.add_argument("--workers", type=int, default=None, help="processes; else one for each core")
    parser.add_argument("--out", type=Path, default=TABLE, help="table to write; cells that it holds already stay")
    asked = parser.parse_args(arguments)
    numbers = range(asked.first, min(asked.first + asked.cells, len(CELLS)))
    ask = {"least": asked.least, "most": asked.most, "method": asked.method}
    new = measure_scenarios(numbers, workers=asked.workers, **ask)
    kept = [one for one in read(asked.out) if one.number not in numbers] if asked.out.is_file() else []
    outcomes = sorted([*kept, *new], key=lambda one: one.number)
    write_table(outcomes, asked.out, method=asked.method)
    print("\n".join([*lines(new), *tally(outcomes).lines()]))


if __name__ == "__main__":
    main()
