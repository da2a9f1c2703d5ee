"""Where points break: thousands of random sources, half of them with one thing wrong.

`make point-map` writes the table. A cell is one source drawn photoelectron by photoelectron before an intensified or an
ordinary camera: blur, light, place, frames, noise; what breaks it goes from too little to matter to far too much.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import charact.mtf  # noqa: F401  # registers the methods
from charact.method import Context
from charact.method.registry import of_kind
from charact.study import cell_map
from charact.study.cell_map import Breaking, Cell, Outcome, case_drawn, cell_drawn, outcome_of
from charact.study.edge.scene import Blur
from charact.study.harness import Case, attempt
from charact.study.point.scene import PointScene

TABLE = Path(__file__).resolve().parents[1] / "tables" / "point_map.json"
METHOD, QUANTITY = "point-parametric", "mtf50"
CELLS, REPEATS = 1000, 2
# What is flagged, and how forms and rounding weigh, was set looking at cells 0 to 7999: nothing was on these.
FIRST = 8000
# What breaks points, from where it hardly matters to where nothing is left, and whether steps are even in ln.
BREAKING: Breaking = {
    "photoelectrons": (1.0, 300.0, True),
    "read_dn": (2.0, 60.0, True),
    "sharpness": (0.05, 0.5, True),
    "blur_px": (1.5, 10.0, True),
    "peak_dn": (230.0, 2000.0, True),
    "codes": (2.0, 60.0, True),
    "gamma": (0.45, 2.2, True),
    "background": (0.05, 5.0, True),
    "gradient": (0.1, 3.0, True),
    "motion_px": (0.03, 4.0, True),
    "drift_px": (0.1, 6.0, True),
    "jitter_px": (0.03, 3.0, True),
    "frames": (1.0, 4.0, False),
    "rows": (10.0, 64.0, False),
    "off_centre_px": (4.0, 46.0, False),
    "neighbour_px": (0.5, 40.0, True),
    "neighbour_share": (0.002, 0.5, True),
    "pinhole_px": (0.3, 6.0, True),
    "hot_share": (1e-5, 0.01, True),
    "halo_px": (40.0, 300.0, True),
}
# Those in codes of eight bits: they grow with full scale.
OF_FULL_SCALE = ("read_dn", "peak_dn")
# Places of a second source of little light, and background of light that slopes, photoelectrons a pixel.
SECOND_PX, SLOPING = 10.0, 0.5
# Bare ground beyond a halo that tells it from the background, and how far methods look, px.
BARE_PX, REACH_PX = 9.0, 36.0


def cell_of(number: int) -> Cell[PointScene]:
    """Return a cell from its number."""
    return cell_drawn(number, BREAKING, _scene_in_scope, _broken)


def _scene_in_scope(rng: np.random.Generator) -> PointScene:
    form = str(rng.choice(["gaussian", "exponential", "halo"]))
    blur = Blur(
        form="exponential" if form == "exponential" else "gaussian",
        sigma_px=float(rng.uniform(0.5, 1.5)),
        frequency_cy_per_px=float(rng.uniform(0.2, 0.4)),
        exponent=float(rng.uniform(1.05, 1.9)),
        halo_share=float(rng.uniform(0.02, 0.2)) if form == "halo" else 0.0,
        halo_px=float(rng.uniform(8.0, 30.0)),
    )
    ordinary = rng.random() < 1.0 / 3.0
    # One camera in three has twelve bits.
    full_scale_dn = float(rng.choice([255.0, 255.0, 4095.0]))
    scale = full_scale_dn / 255.0
    return PointScene(
        blur=blur,
        pulse_px=0.0 if ordinary else float(rng.uniform(0.4, 0.8)),
        gain_spread=0.0 if ordinary else float(rng.uniform(0.3, 1.0)),
        photoelectrons=float(np.exp(rng.uniform(np.log(1000.0 if ordinary else 300.0), np.log(30000.0)))),
        peak_dn=float(rng.uniform(80.0, 180.0)) * scale,
        background=float(rng.uniform(0.0, 0.05)),
        frames=int(rng.choice([4, 8, 16])),
        row_px=float(rng.uniform(-3.0, 3.0)),
        col_px=float(rng.uniform(-3.0, 3.0)),
        read_dn=float(rng.uniform(0.5, 2.0) * np.sqrt(scale)),
        black_dn=12.0 * scale,
        full_scale_dn=full_scale_dn,
    )


def _broken(scene: PointScene, axis: str, strength: float) -> PointScene:
    """Return a scene with one thing wrong."""
    if axis in OF_FULL_SCALE:
        strength *= scene.full_scale_dn / 255.0
    changed: dict[str, Any] = {
        "sharpness": {"blur": Blur(sigma_px=strength), "pulse_px": min(scene.pulse_px, strength)},
        "blur_px": {"blur": Blur(sigma_px=strength)},
        "codes": {"peak_dn": strength, "read_dn": 0.3},
        "gradient": {"gradient": strength, "background": SLOPING},
        "frames": {"frames": round(strength)},
        "rows": {"rows": round(strength), "cols": round(strength), "row_px": 0.0, "col_px": 0.0},
        "off_centre_px": {"col_px": strength},
        "neighbour_share": {"neighbour_share": strength, "neighbour_px": SECOND_PX},
        "halo_px": {"blur": replace(scene.blur, halo_px=strength, halo_share=max(scene.blur.halo_share, 0.1))},
    }.get(axis, {axis: strength})
    return replace(scene, **changed)


def measured_cell(number: int, *, repeats: int = REPEATS, quick: bool = True, method: str = METHOD) -> Outcome:
    """Draw a cell's frames and put the method to each of them."""
    cell = cell_of(number)
    truth = cell.scene.truth_mtf50
    rows = [attempt(of_kind("point")[method], case_of(cell, truth, i), Context(quick=quick)) for i in range(repeats)]
    return outcome_of(cell, rows, truth, truths=truths_of(cell))


def truths_of(cell: Cell[PointScene]) -> tuple[float, float]:
    """Return the least and the largest MTF50 that are right for a cell, cy/px.

    Of a halo wider than the window all, a part, or none of the light may be counted.
    """
    scene = cell.scene
    truth = scene.truth_mtf50
    seen_px = min(scene.rows / 2 - abs(scene.row_px), scene.cols / 2 - abs(scene.col_px), REACH_PX)
    if not scene.blur.halo_share or seen_px > scene.blur.halo_px / 2 + BARE_PX:
        return truth, truth
    return truth, replace(scene, blur=replace(scene.blur, halo_share=0.0)).truth_mtf50


def case_of(cell: Cell[PointScene], truth: float, repeat: int) -> Case:
    """Return one drawing of a cell, the source at a place of its own within a pixel."""
    scene = cell.scene

    def draw(rng: np.random.Generator) -> Any:
        row, col = rng.uniform(-0.5, 0.5, 2)
        return replace(scene, row_px=scene.row_px + float(row), col_px=scene.col_px + float(col)).frames_drawn(rng)

    return case_drawn(
        cell,
        repeat,
        kind="point",
        quantity=QUANTITY,
        truth=truth,
        draw=draw,
        arguments={"pinhole_px": scene.pinhole_px or None},
        context={"interlaced": cell.axis == "motion_px", "full_scale_dn": scene.full_scale_dn},
    )


def main() -> None:
    """Make the map."""
    cell_map.make(
        measured_cell,
        kind="point",
        method=METHOD,
        table=TABLE,
        cells=CELLS,
        repeats=REPEATS,
        about=__doc__,
        first=FIRST,
    )


if __name__ == "__main__":
    main()
