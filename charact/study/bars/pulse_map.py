"""Where bars of intensified cameras break: random cameras of few codes and pulses, half of them with one thing wrong.

`make bar-pulse-map` writes the table. A cell is one target drawn photoelectron by photoelectron: blur, pulses, light,
frames, bars, direction, read noise; what breaks it goes from too little to matter to far too much.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import charact.mtf  # noqa: F401  # registers the methods
from charact.method import Context
from charact.method.registry import of_kind
from charact.study import cell_map, pulse_cameras
from charact.study.bars.pulses import PulsedBars
from charact.study.cell_map import Breaking, Cell, Outcome, case_drawn, cell_drawn, outcome_of
from charact.study.edge.scene import Blur
from charact.study.harness import Case, attempt
from charact.study.pulse_cameras import camera_drawn, unclipped

TABLE = Path(__file__).resolve().parents[1] / "tables" / "bar_pulse_map.json"
METHOD, QUANTITY = "bars-forward", "mtf"
CELLS, REPEATS = 1000, 1
# Forms, responses and what is asked of dim targets were set looking at cells 0 to 3999: nothing was on these.
FIRST = 4000
# Share of the cells that are measured in full too.
CHAINED_CELLS = 0.1
BREAKING: Breaking = {
    **pulse_cameras.BREAKING,
    "frequency_cy_per_px": (0.3, 0.5, False),
    "rows": (20.0, 90.0, False),
    "off_centre_px": (10.0, 90.0, False),
    "halo_share": (0.01, 0.4, True),
}
# Step over the noise of the mean frame, and the fundamental over its own, inside the scope; the method asks for 5.
LEAST_SNR, MOST_SNR, LEAST_FUNDAMENTAL = 4.0, 150.0, 10.0
GROUND_PX = 35.0


def cell_of(number: int) -> Cell[PulsedBars]:
    """Return a cell from its number."""
    return cell_drawn(number, BREAKING, _scene_in_scope, _broken)


def _scene_in_scope(rng: np.random.Generator) -> PulsedBars:
    while True:
        scene = _scene(rng)
        if unclipped(scene) and LEAST_SNR < scene.snr < MOST_SNR and scene.fundamental_snr > LEAST_FUNDAMENTAL:
            return scene


def _scene(rng: np.random.Generator) -> PulsedBars:
    form = str(rng.choice(["gaussian", "exponential"]))
    bars, frequency = int(rng.choice([3, 4, 5])), float(np.exp(rng.uniform(np.log(0.06), np.log(0.3))))
    # The longer side of the target, turned by up to 12 degrees, and ground around it.
    size = round(1.2 * max(2 * bars - 1, 7) * 0.5 / frequency + 2 * GROUND_PX)
    return PulsedBars(
        **camera_drawn(rng),
        blur=Blur(
            form=form,  # pyright: ignore[reportArgumentType]
            sigma_px=float(rng.uniform(0.4, 1.2)),
            frequency_cy_per_px=float(rng.uniform(0.2, 0.5)),
            exponent=float(rng.uniform(1.05, 1.9)),
        ),
        bars=bars,
        frequency_cy_per_px=frequency,
        rows=size,
        cols=size + 10,
        angle_deg=float(rng.choice([0, 90]) + rng.choice([-1, 1]) * rng.uniform(1.0, 12.0)),
        row_px=float(rng.uniform(-4.0, 4.0)),
        col_px=float(rng.uniform(-4.0, 4.0)),
    )


def _broken(scene: PulsedBars, axis: str, strength: float) -> PulsedBars:
    """Return a scene with one thing wrong."""
    if axis == "halo_share":
        return replace(scene, blur=replace(scene.blur, halo_share=strength))
    return pulse_cameras.broken(scene, "col_px" if axis == "off_centre_px" else axis, strength)


def measured_cell(number: int, *, repeats: int = REPEATS, quick: bool = True, method: str = METHOD) -> Outcome:
    """Draw a cell's frames and put the method to each of them."""
    cell = cell_of(number)
    truth = cell.scene.truth_mtf
    rows = [attempt(of_kind("bars")[method], case_of(cell, truth, i), Context(quick=quick)) for i in range(repeats)]
    return outcome_of(cell, rows, truth, truths=truths_of(cell))


def truths_of(cell: Cell[PulsedBars]) -> tuple[float, float]:
    """Return the least and the largest MTF that are right: of a halo that nobody described any part may count."""
    bare = replace(cell.scene, blur=replace(cell.scene.blur, halo_share=0.0))
    return cell.scene.truth_mtf, bare.truth_mtf


def case_of(cell: Cell[PulsedBars], truth: float, repeat: int) -> Case:
    """Return one drawing of a cell, the target at a phase of its own."""
    scene = cell.scene

    def draw(rng: np.random.Generator) -> Any:
        row, col = rng.uniform(-1.0, 1.0, 2)
        return replace(scene, row_px=scene.row_px + float(row), col_px=scene.col_px + float(col)).frames_drawn(rng)

    return case_drawn(
        cell,
        repeat,
        kind="bars",
        quantity=QUANTITY,
        truth=truth,
        draw=draw,
        arguments={"bars": scene.bars, "frequency_cy_per_px": scene.frequency_cy_per_px},
        context={"interlaced": scene.interlaced, "full_scale_dn": scene.full_scale_dn},
    )


def main() -> None:
    """Make the map."""
    cell_map.make(
        measured_cell,
        kind="bars",
        method=METHOD,
        table=TABLE,
        cells=CELLS,
        repeats=REPEATS,
        about=__doc__,
        first=FIRST,
        chained=CHAINED_CELLS,
    )


if __name__ == "__main__":
    main()
