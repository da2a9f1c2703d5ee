"""Where edges break: thousands of random cells, each drawn many times, half of them past the
declared scope.

`make study NAME=edge-map` writes the table. A cell is one scene: blur, size, direction, noise and
light, and in half of the cells one thing that breaks edge methods, from too little to matter to far
too much.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import charact.estimators.mtf  # noqa: F401  # registers the methods
from benchmarks.studies import scenario_map
from benchmarks.studies.cramer_rao import least_relative_sd
from benchmarks.studies.figures import plain_numbers
from benchmarks.studies.harness import attempt
from benchmarks.studies.scenario_map import (
    Breaking,
    Scenario,
    ScenarioOutcome,
    draw_case,
    draw_scenario,
    outcome_of,
)
from charact.method import Context
from charact.method.registry import methods_of_kind
from labdata import FrameStack
from tests.truth.blur import TrueBlur
from tests.truth.cases.case import Case
from tests.truth.edge import EdgeScene

TABLE = Path(__file__).with_name("tables") / "edge_map.json"
METHOD = "edge-parametric"
CELLS, REPEATS = 5000, 20
# Margins, weights, priors and the noise were chosen on cells 0 to 58899: the map is of cells on
# which nothing was.
FIRST = 58900
# Share of the cells of which one drawing is measured in full too: one drawing in fifty of all.
CHAINED_CELLS = 0.4
# What breaks edge methods, from where it hardly matters to where nothing is left, and whether steps
# are even in ln.
BREAKING: Breaking = {
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


def cell_of(number: int) -> Scenario[EdgeScene]:
    """Return a cell from its number."""
    return draw_scenario(number, BREAKING, _scene_in_scope, _broken)


def _scene_in_scope(rng: np.random.Generator) -> EdgeScene:
    form = str(rng.choice(["gaussian", "exponential", "moffat", "halo"]))
    blur = TrueBlur(
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
        return replace(scene, blur=TrueBlur(sigma_px=strength))
    if axis == "blur_px":
        return replace(scene, blur=TrueBlur(sigma_px=strength))
    if axis == "halo_px":
        share = max(scene.blur.halo_share, 0.15)
        return replace(scene, blur=replace(scene.blur, halo_px=strength, halo_share=share))
    return replace(scene, **{axis: strength})


def measure_scenario(
    number: int, *, repeats: int = REPEATS, quick: bool = True, method: str = METHOD
) -> ScenarioOutcome:
    """Draw a cell's frames and put the method to each of them."""
    cell = cell_of(number)
    truth = cell.scene.truth_mtf50
    rows = [
        attempt(methods_of_kind("edge")[method], case_of(cell, truth, i), Context(quick=quick))
        for i in range(repeats)
    ]
    bound = 100.0 * least_relative_sd(cell.scene) if cell.in_scope else None
    return outcome_of(cell, rows, truth, truths=truths_of(cell), bound_percent=bound)


def truths_of(cell: Scenario[EdgeScene]) -> tuple[float, float]:
    """Return the least and the largest MTF50 that are right for a cell, cy/px.

    Light spread wider than the window belongs to the normalisation as far as it is seen, and a
    result says that it is normalised to the light inside: right is what counts all of that light,
    none of it, or a part.
    """
    truth = cell.scene.truth_mtf50
    if cell.axis != "halo_px":
        return truth, truth
    core = replace(cell.scene.blur, halo_share=0.0)
    return truth, core.mtf50(cell.scene.angle_deg)


def case_of(cell: Scenario[EdgeScene], truth: float, repeat: int) -> Case:
    """Return one drawing of a cell, the edge at a place of its own."""

    def draw(rng: np.random.Generator) -> FrameStack:
        return replace(cell.scene, offset_px=float(rng.uniform(-2.0, 2.0))).frames_drawn(rng)

    return draw_case(
        cell,
        repeat,
        kind="edge",
        quantity="mtf50",
        truth=truth,
        draw=draw,
    )


def main() -> None:
    """Make the map."""
    scenario_map.make_map(
        measure_scenario,
        kind="edge",
        method=METHOD,
        table=TABLE,
        cells=CELLS,
        repeats=REPEATS,
        about=__doc__,
        first=FIRST,
        chained=CHAINED_CELLS,
    )
    plot_map(json.loads(TABLE.read_text()), FIGURE)


FIGURE = Path("docs/pictures/mtf/edge-map.png")
LABELS = {
    "snr": "step / sd of the noise (1)",
    "angle_deg": "tilt (deg)",
    "rows": "rows and columns (px)",
    "gamma": "exponent of the response (1)",
    "gradient": "light, right over left less 1 (1)",
    "motion_px": "motion between fields (px)",
    "sagitta_px": "bow of the edge (px)",
    "clip_share": "share of the step clipped (1)",
    "hot_share": "share of stuck pixels (1)",
    "sharpness": "sd of a very sharp blur (px)",
    "blur_px": "sd of a very wide blur (px)",
    "halo_px": "diameter of a wide halo (px)",
}


def plot_map(found: Mapping[str, Any], path: Path) -> Path:
    """Draw the table of `benchmarks.studies.edge_map`; returns the path of the PNG."""
    scope = (LABELS["snr"], lambda number: cell_of(number).scene.snr)
    return scenario_map.plot_map(
        found, path, breaking=BREAKING, labels=LABELS, scope=scope, columns=5, last=_draw_widths
    )


def _draw_widths(panel: Any, inside: scenario_map.Rows) -> None:
    """Draw how wide intervals are beside the bound, against the bound itself."""
    both = [
        (one["bound_percent"], one["sd_percent"])
        for one in inside
        if one["bound_percent"] and one["sd_percent"]
    ]
    bound, sd = np.array(both).T if both else np.ones((2, 0))
    panel.plot(bound, sd / bound, ".", color="#0072b2", markersize=3, alpha=0.6)
    panel.axhline(1.0, color="black", linewidth=0.8)
    if both:
        panel.axhline(
            np.median(sd / bound), color="#d55e00", linewidth=1.2, linestyle="--", label="_"
        )
    panel.set(
        xscale="log",
        yscale="log",
        xlabel="Cramér–Rao sd of MTF50 (%)",
        ylabel="given sd / bound (1)",
    )
    plain_numbers(panel.xaxis, panel.yaxis)
    panel.set_title("widths in scope, median dashed")


if __name__ == "__main__":
    main()
