"""Where edges of intensified cameras break: random cameras of few codes and pulses, half of them with one thing wrong.

`make edge-pulse-map` writes the table. A cell is one edge drawn photoelectron by photoelectron: blur, pulses, light,
frames, direction, read noise; what breaks it goes from too little to matter to far too much.
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
from charact.study.edge.pulses import PulseEdge
from charact.study.edge.scene import Blur
from charact.study.harness import Case, attempt
from labdata.frames import FrameStack

TABLE = Path(__file__).resolve().parents[1] / "tables" / "edge_pulse_map.json"
METHOD, QUANTITY = "edge-parametric", "mtf50"
CELLS, REPEATS = 1000, 2
# What is flagged was set looking at cells 0 to 1999: nothing was on these.
FIRST = 2000
# What breaks edges, from where it hardly matters to where nothing is left, and whether steps are even in ln.
BREAKING: Breaking = {
    "photoelectrons": (0.001, 0.1, True),
    "pulse_peak_dn": (40.0, 2000.0, True),
    "gain_spread": (1.0, 10.0, True),
    "ion_share": (1e-4, 0.03, True),
    "bright_dn": (200.0, 1500.0, True),
    "codes": (2.0, 40.0, True),
    "black_dn": (-20.0, 6.0, False),
    "read_dn": (2.0, 60.0, True),
    "row_noise_dn": (0.3, 30.0, True),
    "pattern": (0.003, 0.3, True),
    "lag": (0.01, 0.7, True),
    "flicker": (0.01, 0.5, True),
    "jitter_px": (0.03, 3.0, True),
    "drift_px": (0.1, 6.0, True),
    "motion_px": (0.05, 3.0, True),
    "motion_untold_px": (0.05, 3.0, True),
    "gradient": (0.05, 0.8, True),
    "vignetting": (0.05, 0.95, False),
    "sagitta_px": (0.05, 6.0, True),
    "gamma": (0.45, 2.2, True),
    "sharpening": (0.05, 2.0, True),
    "hot_share": (1e-4, 0.05, True),
    "angle_deg": (0.0, 1.0, False),
    "rows": (8.0, 40.0, False),
    "frames": (1.0, 4.0, False),
    "blur_px": (3.0, 20.0, True),
    "halo_px": (80.0, 400.0, True),
}
# Those in codes of eight bits: they grow with full scale.
OF_FULL_SCALE = ("pulse_peak_dn", "bright_dn", "black_dn", "read_dn", "row_noise_dn")
# Step over the noise of the mean frame inside the scope, and what of full scale five of a pixel's sd must leave, DN.
LEAST_SNR, MOST_SNR, SPARED_SD = 4.0, 100.0, 5.0
# Mean light of scenes whose pulses are too bright for the scale, DN of eight bits: far below full scale itself.
DIM_DN = 60.0


def cell_of(number: int) -> Cell[PulseEdge]:
    """Return a cell from its number."""
    return cell_drawn(number, BREAKING, _scene_in_scope, _broken)


def _scene_in_scope(rng: np.random.Generator) -> PulseEdge:
    while True:
        scene = _scene(rng)
        one_frame_sd = scene.bright_dn * (1.0 - scene.dark_share) / scene.snr * np.sqrt(scene.frames)
        unclipped = scene.black_dn + scene.bright_dn + SPARED_SD * one_frame_sd < scene.full_scale_dn
        if unclipped and LEAST_SNR < scene.snr < MOST_SNR:
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
    # One camera in three has twelve bits.
    full_scale_dn = float(rng.choice([255.0, 255.0, 4095.0]))
    scale = full_scale_dn / 255.0
    bright_dn = float(rng.uniform(30.0, 190.0)) * scale
    return PulseEdge(
        blur=blur,
        pulse_px=float(rng.uniform(0.4, 0.9)),
        # A photoelectron's pulse of a few to fifty codes of eight bits: what gains of intensified cameras make of it.
        photoelectrons=bright_dn / (scale * float(np.exp(rng.uniform(np.log(3.0), np.log(150.0))))),
        bright_dn=bright_dn,
        dark_share=float(rng.uniform(0.02, 0.5)),
        gain_spread=float(rng.uniform(0.3, 1.0)),
        read_dn=float(rng.uniform(0.5, 2.0) * np.sqrt(scale)),
        rows=int(rng.integers(size, 121)),
        cols=int(rng.integers(size, 121)),
        frames=int(rng.choice([1, 4, 8, 16, 32])),
        angle_deg=float(rng.choice([0, 90, 180, 270]) + rng.choice([-1, 1]) * tilt),
        interlaced=bool(rng.random() < 1.0 / 3.0),
        black_dn=12.0 * scale,
        full_scale_dn=full_scale_dn,
    )


def _broken(scene: PulseEdge, axis: str, strength: float) -> PulseEdge:
    """Return a scene with one thing wrong."""
    scale = scene.full_scale_dn / 255.0
    if axis in OF_FULL_SCALE:
        strength *= scale
    dim_dn = DIM_DN * scale
    changed: dict[str, Any] = {
        "photoelectrons": {"photoelectrons": strength, "bright_dn": strength * scene.gain_dn},
        "pulse_peak_dn": {
            "bright_dn": dim_dn, "photoelectrons": scene.photoelectrons * dim_dn / scene.bright_dn
            * scene.pulse_peak_dn / strength,
        },
        "bright_dn": {"bright_dn": strength, "photoelectrons": scene.photoelectrons * strength / scene.bright_dn},
        "codes": {"bright_dn": strength, "read_dn": 0.3},
        "motion_px": {"motion_px": strength, "interlaced": True},
        "motion_untold_px": {"motion_px": strength, "interlaced": False},
        "angle_deg": {"angle_deg": round(scene.angle_deg / 90.0) * 90.0 + strength},
        "rows": {"rows": round(strength), "cols": round(strength)},
        "frames": {"frames": round(strength)},
        "blur_px": {"blur": Blur(sigma_px=strength)},
        "halo_px": {"blur": replace(scene.blur, halo_px=strength, halo_share=max(scene.blur.halo_share, 0.1))},
    }.get(axis, {axis: strength})  # fmt: skip
    return replace(scene, **changed)


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
