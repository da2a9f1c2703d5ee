"""Bias of the bar methods and cover of their intervals, cell by cell: `make study NAME=bar-bias`
keeps the table.

A cell is one blur, frequency, tilt and grain of the noise. Its noise is drawn in pairs, once as it
is and once upside down: what is linear in the noise cancels in the mean of a pair, and a bias of a
percent stands out of a scatter of ten.
"""

import argparse
import json
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import charact
import charact.estimators.mtf
from benchmarks.studies.figures import COLOURS, pyplot
from benchmarks.studies.harness import judge_measurement
from benchmarks.studies.stability import one_thread_each
from charact.method import Context, choose
from labdata import Measurement
from tests.truth.bars import StripScene
from tests.truth.blur import TrueBlur

TABLE = Path(__file__).with_name("tables") / "bar_bias.json"
# Bias that is allowed, percent, and by how many of its standard errors a cell may seem to exceed
# it.
ALLOWED_PERCENT, CHANCE = 1.0, 2.0
# Cells in which fewer of the answers are ok are ones that the method says it cannot measure.
FLAGGED_FRACTION = 0.5
VERDICTS = ("within", "chance", "off", "told")


@dataclass(frozen=True, kw_only=True)
class BarScenarioOutcome:
    """What became of the drawings of one cell.

    Parameters
    ----------
    number
        Place among the cells, and seed.
    blur, frequency_cy_per_px, tilt_deg, grain_px, phase_px
        The cell: name of the blur, the bars' frequency and tilt, blur of the noise, and where their
        middle lies; None: evenly over a pixel.
    truth
        MTF, pixel included.
    draws, numbers, ok
        Drawings, those with a number, and those with verdict ok.
    bias_percent, standard_error_percent, scatter_percent
        Mean error over the pairs, its standard error, and root mean squared error, % of the truth;
        a suspect number counts all the same.
    held68, held95
        Numbers whose intervals hold the truth.
    silent
        Numbers that are ok with the truth beyond twice the half of their 95 % interval.
    first
        The first numbers.
    """

    number: int
    blur: str
    frequency_cy_per_px: float
    tilt_deg: float
    grain_px: float
    phase_px: float | None
    truth: float
    draws: int
    numbers: int
    ok: int
    bias_percent: float | None
    standard_error_percent: float | None
    scatter_percent: float | None
    held68: int
    held95: int
    silent: int
    first: list[float | None]

    @property
    def told(self) -> bool:
        """Whether the method mostly says that it cannot tell: suspect or refused."""
        return self.ok < FLAGGED_FRACTION * self.draws

    @property
    def excess(self) -> float:
        """Bias beyond what is allowed, in its standard errors; negative within."""
        if self.bias_percent is None or not self.standard_error_percent:
            return float("inf")
        return (abs(self.bias_percent) - ALLOWED_PERCENT) / self.standard_error_percent

    @property
    def verdict(self) -> str:
        """`within` one percent, `chance` where the excess may be chance, `told` where it is no ok
        number, or `off`.
        """
        if self.told:
            return "told"
        if self.excess <= 0:
            return "within"
        return "chance" if self.excess <= CHANCE else "off"


@dataclass(frozen=True, kw_only=True)
class Tally:
    """What all cells say together.

    Parameters
    ----------
    verdicts
        Cells by verdict.
    held
        Shares of the numbers whose 68 % and 95 % intervals hold the truth, over all cells and by
        class.
    silent, ok
        Silent failures, and numbers that are ok.
    largest_standard_error_percent
        Of the bias of the cells that are not told.
    """

    verdicts: dict[str, int]
    held: dict[str, tuple[float, float, int]]
    silent: int
    ok: int
    largest_standard_error_percent: float

    def lines(self) -> list[str]:
        """Sentences of it."""
        within, chance, off, told = (self.verdicts[verdict] for verdict in VERDICTS)
        return [
            f"{within + chance} of {within + chance + off} cells that are measured keep to "
            f"{ALLOWED_PERCENT:g} %: {within} within, {chance} beyond by no more than {CHANCE:g} "
            f"standard errors, the largest of which is {self.largest_standard_error_percent:.2f} %",
            f"{off} cells are off by more; {told} are told as suspect or refused",
            f"{self.silent} silent failures among {self.ok} numbers that are ok",
            *(
                f"{name:22s} 68 % intervals hold {one:.3f}, 95 % {other:.3f} of {numbers} numbers"
                for name, (one, other, numbers) in self.held.items()
            ),
        ]


CLASSES: dict[str, Callable[[BarScenarioOutcome], str]] = {
    "blur": lambda one: one.blur,
    "frequency": lambda one: f"{one.frequency_cy_per_px:g} cy/px",
    "tilt": lambda one: f"{one.tilt_deg:g} deg",
    "grain": lambda one: "noise blurred" if one.grain_px else "noise white",
}


def tally(outcomes: Sequence[BarScenarioOutcome]) -> Tally:
    """Count verdicts, and pool the intervals of cells that are not told, all and by class."""
    measured = [one for one in outcomes if not one.told]
    held = {"all": _coverage(measured)}
    for name in CLASSES.values():
        for label in dict.fromkeys(map(name, measured)):
            held[label] = _coverage([one for one in measured if name(one) == label])
    return Tally(
        verdicts={verdict: sum(one.verdict == verdict for one in outcomes) for verdict in VERDICTS},
        held=held,
        silent=sum(one.silent for one in outcomes),
        ok=sum(one.ok for one in outcomes),
        largest_standard_error_percent=max(
            (one.standard_error_percent or 0.0 for one in measured), default=0.0
        ),
    )


def _coverage(outcomes: Sequence[BarScenarioOutcome]) -> tuple[float, float, int]:
    """Return the shares of numbers whose 68 % and 95 % intervals hold, and their count."""
    count = sum(one.numbers for one in outcomes)
    return (
        sum(one.held68 for one in outcomes) / max(count, 1),
        sum(one.held95 for one in outcomes) / max(count, 1),
        count,
    )


def lines(outcomes: Iterable[BarScenarioOutcome]) -> list[str]:
    """Return the cells as rows for eyes."""
    head = (
        "  no blur                cy/px tilt grain phase     MTF   bias %   se %  rms %  68 %  "
        "95 %    ok number silent"
    )
    return [head, *(_line(one) for one in outcomes)]


def _line(one: BarScenarioOutcome) -> str:
    phase = "  all" if one.phase_px is None else f"{one.phase_px:5.2f}"
    where = (
        f"{one.number:4d} {one.blur:19s} {one.frequency_cy_per_px:5.2f} {one.tilt_deg:4.0f} "
        f"{one.grain_px:5.1f} {phase}"
    )
    if (
        one.bias_percent is None
        or one.standard_error_percent is None
        or one.scatter_percent is None
    ):
        return f"{where} {one.truth:7.4f}  no number: {one.verdict}"
    errors = (
        f"{one.bias_percent:+8.2f} {one.standard_error_percent:6.2f} {one.scatter_percent:6.1f}"
    )
    held = f"{one.held68 / one.numbers:5.2f} {one.held95 / one.numbers:5.2f}"
    shares = f"{one.ok / one.draws:5.2f} {one.numbers / one.draws:6.2f}"
    return f"{where} {one.truth:7.4f} {errors} {held} {shares} {one.silent:6d} {one.verdict}"


def write_table(outcomes: Sequence[BarScenarioOutcome], path: Path = TABLE, *, method: str) -> Path:
    """Write the table: a row for each cell, and what they say together."""
    rows = [[_short(value) for value in asdict(one).values()] for one in outcomes]
    table = {
        "charact": charact.__version__,
        "method": method,
        "seed": "[cell, 17, pair]",
        "tally": tally(outcomes).lines(),
        "columns": [one.name for one in fields(BarScenarioOutcome)],
        "rows": rows,
    }
    path.write_text(json.dumps(table).replace("]], [", "]],\n[") + "\n", encoding="utf-8")
    return path


def read(path: Path = TABLE) -> list[BarScenarioOutcome]:
    """Return the cells of a table."""
    table = json.loads(path.read_text())
    return [
        BarScenarioOutcome(**dict(zip(table["columns"], row, strict=True))) for row in table["rows"]
    ]


def _short(value: Any) -> Any:
    if isinstance(value, list):
        return [_short(one) for one in value]
    return float(f"{value:.5g}") if isinstance(value, float) else value


METHOD = "bars-forward"
BLURS = {
    "Gaussian 0.8 px": TrueBlur(sigma_px=0.8),
    "Gaussian 1.5 px": TrueBlur(sigma_px=1.5),
    "tube fc 0.25 n 1.1": TrueBlur(form="exponential", frequency_cy_per_px=0.25, exponent=1.1),
}
FREQUENCIES = (0.05, 0.1, 0.2, 0.3, 0.35, 0.4)
TILTS_DEG = (0.0, 2.0, 8.0)
# Where untilted bars lie on the pixels, at which frequencies it may matter: a pixel's middle, its
# border and between.
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
    """Every blur at every frequency and tilt, its noise white, or blurred behind the gain and
    turned; then phases.
    """
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
    while len(found) < least or (
        len(found) < most and _needs_more_pairs(found, cell.scene.truth_mtf)
    ):
        found.append(
            [measure_scene(scene, number, len(found), method) for scene in cell.drawn(len(found))]
        )
    return _outcome(number, cell, found)


def _needs_more_pairs(found: Sequence[Sequence[Measurement]], truth: float) -> bool:
    """Tell whether more pairs are wanted: most numbers are ok, and the bias is not yet known well
    enough.
    """
    ok = sum(one.status == "ok" for pair in found for one in pair)
    _, standard_error = _bias(found, truth)
    return ok > len(found) and (standard_error is None or standard_error > SURE_PERCENT)


def _bias(
    found: Sequence[Sequence[Measurement]], truth: float
) -> tuple[float | None, float | None]:
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
    error = np.array(
        [100.0 * (one.value / truth - 1.0) for one in numbers if one.value is not None]
    )
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


def measure_scenarios(
    numbers: Sequence[int], *, workers: int | None = None, **asked: Any
) -> list[BarScenarioOutcome]:
    """Measure cells as `measure_scenario` does, on all cores unless told otherwise."""
    with (
        one_thread_each(),
        ProcessPoolExecutor(workers or os.cpu_count(), mp_context=get_context("spawn")) as pool,
    ):
        return list(pool.map(partial(measure_scenario, **asked), numbers))


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure the cells that are asked for, put them into the table and print what it says."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.studies.bar_bias", description=__doc__
    )
    parser.add_argument("--method", default=METHOD)
    parser.add_argument("--first", type=int, default=0, help="number of the first cell")
    parser.add_argument("--cells", type=int, default=len(CELLS), help="number of cells")
    parser.add_argument(
        "--least", type=int, default=LEAST_PAIRS, help="least number of pairs of each"
    )
    parser.add_argument(
        "--most", type=int, default=MOST_PAIRS, help="largest number of pairs of each"
    )
    parser.add_argument(
        "--workers", type=int, default=None, help="processes; else one for each core"
    )
    parser.add_argument(
        "--out", type=Path, default=TABLE, help="table to write; cells that it holds already stay"
    )
    asked = parser.parse_args(arguments)
    numbers = range(asked.first, min(asked.first + asked.cells, len(CELLS)))
    ask = {"least": asked.least, "most": asked.most, "method": asked.method}
    new = measure_scenarios(numbers, workers=asked.workers, **ask)
    kept = (
        [one for one in read(asked.out) if one.number not in numbers] if asked.out.is_file() else []
    )
    outcomes = sorted([*kept, *new], key=lambda one: one.number)
    write_table(outcomes, asked.out, method=asked.method)
    print("\n".join([*lines(new), *tally(outcomes).lines()]))


FIGURE = Path("docs/pictures/mtf/bar-bias.png")
# Tilts apart by so much, so that their bars do not hide each other, cycles per pixel.
APART = 0.004
MARKS = {0.0: "o", 2.0: "s", 8.0: "^"}


def plot_bias(outcomes: Sequence[BarScenarioOutcome], path: Path = FIGURE) -> Path:
    """Draw the bias of every cell that is measured, and name the frequencies that are told as low
    signal.

    Parameters
    ----------
    outcomes
        Cells of the table.
    path
        Where the PNG goes.
    """
    evenly = [one for one in outcomes if one.phase_px is None]
    blurs = list(dict.fromkeys(one.blur for one in evenly))
    figure, panels = pyplot().subplots(
        1, len(blurs), figsize=(11.0, 4.2), sharey=True, layout="constrained"
    )
    for panel, blur in zip(panels, blurs, strict=True):
        _draw_panel(panel, [one for one in evenly if one.blur == blur])
        panel.set(title=blur, xlabel="frequency of the bars (cy/px)", xlim=(0.02, 0.43))
    panels[0].set(ylabel="bias of the MTF (% of the truth)")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, frameon=False, fontsize=8)
    figure.suptitle(
        "Four bars over 20 rows of one frame, step ten times a pixel's noise; lines: one standard "
        "error; grey: 1 %",
        fontsize=9,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    pyplot().close(figure)
    return path


def _draw_panel(panel: Any, cells: Sequence[BarScenarioOutcome]) -> None:
    """Draw one blur: tilts by mark, white and blurred noise by colour; frequencies without a
    measured cell in words.
    """
    panel.axhspan(-ALLOWED_PERCENT, ALLOWED_PERCENT, color="0.9", zorder=0)
    panel.axhline(0.0, color="0.6", linewidth=0.8)
    for colour, blurred in zip(COLOURS, (False, True), strict=False):
        for shift, (tilt, mark) in zip((-1, 0, 1), MARKS.items(), strict=True):
            own = [
                c
                for c in cells
                if c.tilt_deg == tilt and (c.grain_px > 0) == blurred and not c.told
            ]
            label = f"{tilt:g} deg, noise {'blurred' if blurred else 'white'}"
            panel.errorbar(
                [c.frequency_cy_per_px + (shift + (0.5 if blurred else 0.0)) * APART for c in own],
                [c.bias_percent for c in own],
                yerr=[c.standard_error_percent for c in own],
                fmt=mark,
                color=colour,
                markersize=4,
                linewidth=1.0,
                label=label,
            )
    for frequency in sorted({c.frequency_cy_per_px for c in cells}):
        if all(c.told for c in cells if c.frequency_cy_per_px == frequency):
            truth = next(c.truth for c in cells if c.frequency_cy_per_px == frequency)
            panel.text(
                frequency,
                0.0,
                f"MTF {truth:.1g}: low-signal",
                rotation=90,
                ha="center",
                va="center",
                fontsize=7,
                backgroundcolor="white",
            )


if __name__ == "__main__":
    main()
