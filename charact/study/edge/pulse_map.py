"""Where edges of intensified cameras break: random cameras of few codes and pulses, half of them with one thing wrong.

`make edge-pulse-map` writes the table. A cell is one edge drawn photoelectron by photoelectron: blur, pulses, light,
frames, direction, read noise; what breaks it goes from too little to matter to far too much.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import charact.mtf  # noqa: F401  # registers the methods
from charact.method import Context
from charact.method.registry import of_kind
from charact.study import cell_map, pulse_cameras
from charact.study.cell_map import Breaking, Cell, Outcome, case_drawn, cell_drawn, outcome_of
from charact.study.edge.pulses import PulseEdge
from charact.study.edge.scene import Blur
from charact.study.harness import Case, attempt
from charact.study.pulse_cameras import camera_drawn, unclipped
from labdata.frames import FrameStack

TABLE = Path(__file__).resolve().parents[1] / "tables" / "edge_pulse_map.json"
METHOD, QUANTITY = "edge-parametric", "mtf50"
CELLS, REPEATS = 1000, 1
# What is flagged was set looking at cells below: nothing was on these.
FIRST = 3000
BREAKING: Breaking = {
    **pulse_cameras.BREAKING,
    "sagitta_px": (0.05, 6.0, True),
    "angle_deg": (0.0, 1.0, False),
    "rows": (8.0, 40.0, False),
    "halo_px": (80.0, 400.0, True),
}
# Step over the noise of the mean frame inside the scope.
LEAST_SNR, MOST_SNR = 4.0, 100.0


def cell_of(number: int) -> Cell[PulseEdge]:
    """Return a cell from its number."""
    return cell_drawn(number, BREAKING, _scene_in_scope, _broken)


def _scene_in_scope(rng: np.random.Generator) -> PulseEdge:
    while True:
        scene = _scene(rng)
        if unclipped(scene) and LEAST_SNR < scene.snr < MOST_SNR:
            return scene


def _scene(rng: np.random.Generator) -> PulseEdge:
    form = str(rng.choice(["gaussian", "exponential", "moffat", "halo"]))
    blur = Blur(
        form="gaussian" if form == "halo" else form,  # pyright: ignore[reportArgumentType]
        sigma_px=float(rng.uniform(0.5, 1.8)),
        frequency_cy_per_px=float(rng.uniform(0.15, 0.4)),
        exponent=float(rng.uniform(1.05, 2.0)),
        moffat_px=float(rng.uniform(1.0, 2.5)),
        moffat_exponent=float(rng.uniform(1.5, 4.0)),
        halo_share=float(rng.uniform(0.03, 0.25)) if form == "halo" else 0.0,
        halo_px=float(rng.uniform(12.0, 40.0)),
    )
    tilt = float(np.exp(rng.uniform(np.log(1.5), np.log(40.0))))
    size = 60 if tilt > 3 else 90
    return PulseEdge(
        **camera_drawn(rng),
        blur=blur,
        rows=int(rng.integers(size, 121)),
        cols=int(rng.integers(size, 121)),
        angle_deg=float(rng.choice([0, 90, 180, 270]) + rng.choice([-1, 1]) * tilt),
    )


def _broken(scene: PulseEdge, axis: str, strength: float) -> PulseEdge:
    """Return a scene with one thing wrong."""
    if axis != "halo_px":
        return pulse_cameras.broken(scene, axis, strength)
    return replace(scene, blur=replace(scene.blur, halo_px=strength, halo_share=max(scene.blur.halo_share, 0.1)))


def measured_cell(number: int, *, repeats: int = REPEATS, quick: bool = True, method: str = METHOD) -> Outcome:
    """Draw a cell's frames and put the method to each of them."""
    cell = cell_of(number)
    truth = cell.scene.truth_mtf50
    rows = [attempt(of_kind("edge")[method], case_of(cell, truth, i), Context(quick=quick)) for i in range(repeats)]
    return outcome_of(cell, rows, truth, truths=truths_of(cell))


def truths_of(cell: Cell[PulseEdge]) -> tuple[float, float]:
    """Return the least and the largest MTF50 that are right for a cell, cy/px: see `charact.study.edge.map`."""
    truth = cell.scene.truth_mtf50
    if cell.axis != "halo_px":
        return truth, truth
    return truth, replace(cell.scene, blur=replace(cell.scene.blur, halo_share=0.0)).truth_mtf50


def case_of(cell: Cell[PulseEdge], truth: float, repeat: int) -> Case:
    """Return one drawing of a cell, the edge at a place of its own."""

    def draw(rng: np.random.Generator) -> FrameStack:
        return replace(cell.scene, offset_px=float(rng.uniform(-2.0, 2.0))).frames_drawn(rng)

    return case_drawn(
        cell,
        repeat,
        kind="edge",
        quantity=QUANTITY,
        truth=truth,
        draw=draw,
        context={"interlaced": cell.scene.interlaced, "full_scale_dn": cell.scene.full_scale_dn},
    )


def main() -> None:
    """Make the map."""
    cell_map.make(
        measured_cell,
        kind="edge",
        method=METHOD,
        table=TABLE,
        cells=CELLS,
        repeats=REPEATS,
        about=__doc__,
        first=FIRST,
    )


if __name__ == "__main__":
    main()
