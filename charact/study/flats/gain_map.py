"""Where the covariance gain breaks: thousands of random simulated cameras, half of them past the declared scope.

`make gain-map` writes the table. A cell is one specimen of the intensified camera with a dark and some flats, lag,
interlace and automatic gain off; in half of the cells one thing breaks it, from too little to matter to far too much.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import charact.noise  # noqa: F401  # registers the methods
from charact.method import Context
from charact.method.registry import methods_of_kind
from charact.study import scenario_map
from charact.study.flats.gain_scene import BLACK_AND_FULL_DN, GainScene
from charact.study.harness import Case, attempt
from charact.study.scenario_map import Breaking, Scenario, ScenarioOutcome, draw_case, draw_scenario, outcome_of

TABLE = Path(__file__).resolve().parents[1] / "tables" / "gain_map.json"
METHOD, QUANTITY = "covariance-sum", "covariance_gain"
CELLS, REPEATS = 3000, 1
# What breaks gains, from where it hardly matters to where nothing is left, and whether steps are even in ln.
BREAKING: Breaking = {
    "decay_ms": (1.0, 100.0, True),
    "interlaced_decay_ms": (1.0, 60.0, True),
    "gain_range_db": (0.1, 20.0, True),
    "flicker": (0.001, 0.5, True),
    "drift": (0.002, 0.8, True),
    "saturation": (0.6, 4.0, True),
    "gamma": (0.45, 2.2, True),
    "frames": (2.0, 8.0, False),
    "rows": (24.0, 96.0, True),
    "dim_dn": (0.02, 2.0, True),
}


def cell_of(number: int) -> Scenario[GainScene]:
    """Return a cell from its number."""
    return draw_scenario(number, BREAKING, _scene_in_scope, _broken)


def _scene_in_scope(rng: np.random.Generator) -> GainScene:
    size = int(rng.integers(112, 161))
    brightest = float(np.exp(rng.uniform(np.log(25.0), np.log(140.0))))
    return GainScene(
        specimen=int(rng.integers(1 << 31)),
        mcp_v=float(rng.uniform(720.0, 840.0)),
        signal_dn=_levels(brightest, float(rng.uniform(3.0, 10.0)), int(rng.integers(3, 6))),
        frames=int(rng.integers(8, 25)),
        rows=size,
        columns=size + 16,
    )


def _levels(brightest_dn: float, span: float, count: int) -> tuple[float, ...]:
    return tuple(float(level) for level in brightest_dn * np.geomspace(1.0 / span, 1.0, count))


def _broken(scene: GainScene, axis: str, strength: float) -> GainScene:
    """Return a scene with one thing wrong."""
    if axis == "interlaced_decay_ms":
        return replace(scene, interlaced=True, decay_ms=strength)
    if axis == "saturation":
        black, full = BLACK_AND_FULL_DN
        return replace(scene, signal_dn=_levels(strength * (full - black), 10.0, len(scene.signal_dn)))
    if axis == "frames":
        return replace(scene, frames=round(strength))
    if axis == "rows":
        return replace(scene, rows=round(strength), columns=round(strength) + 8)
    if axis == "dim_dn":
        return replace(scene, signal_dn=_levels(strength, 4.0, len(scene.signal_dn)))
    return replace(scene, **{axis: strength})


def measure_scenario(
    number: int, *, repeats: int = REPEATS, quick: bool = True, method: str = METHOD
) -> ScenarioOutcome:
    """Draw a cell's frames and put the method to each of them."""
    cell = cell_of(number)
    truth = cell.scene.truth[QUANTITY]
    rows = [attempt(methods_of_kind("flats")[method], case_of(cell, i), Context(quick=quick)) for i in range(repeats)]
    return outcome_of(cell, rows, truth, truths=(truth, truth))


def case_of(cell: Scenario[GainScene], repeat: int) -> Case:
    """Return one drawing of a cell."""
    scene = cell.scene
    return draw_case(
        cell,
        repeat,
        kind="flats",
        quantity=QUANTITY,
        truth=scene.truth[QUANTITY],
        draw=scene.session_drawn,
        context={
            "sensor": scene.description,
            "interlaced": scene.interlaced,
            "full_scale_dn": BLACK_AND_FULL_DN[1],
        },
    )


def main() -> None:
    """Make the map."""
    scenario_map.make_map(
        measure_scenario, kind="flats", method=METHOD, table=TABLE, cells=CELLS, repeats=REPEATS, about=__doc__
    )


if __name__ == "__main__":
    main()
