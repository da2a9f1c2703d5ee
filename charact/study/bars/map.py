"""Where bars break: thousands of random targets, half of them with one thing wrong.

`make bar-map` writes the table. A cell is one finite target drawn in closed form: blur, frequency, direction, size,
noise; what breaks it goes from too little to matter to far too much.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import charact.mtf  # noqa: F401  # registers the methods
from charact.method import Context
from charact.method.registry import of_kind
from charact.study import cell_map
from charact.study.bars.scene import BarScene
from charact.study.cell_map import Breaking, Cell, Outcome, case_drawn, cell_drawn, outcome_of
from charact.study.edge.scene import Blur
from charact.study.harness import Case, attempt

TABLE = Path(__file__).resolve().parents[1] / "tables" / "bar_map.json"
METHOD, QUANTITY = "bars-forward", "mtf"
CELLS, REPEATS = 1000, 1
# What is flagged, how forms, rounding and responses weigh, was set looking at cells 0 to 8999: nothing was on these.
FIRST = 9000
# Share of the cells that are measured in full too.
CHAINED_CELLS = 0.1
# What breaks bars, from where it hardly matters to where nothing is left, and whether steps are even in ln.
BREAKING: Breaking = {
    "snr": (0.2, 5.0, True),
    "frequency_cy_per_px": (0.3, 0.5, False),
    "frequency_untilted": (0.3, 0.5, False),
    "blur_px": (1.5, 6.0, True),
    "rows": (20.0, 90.0, False),
    "off_centre_px": (10.0, 90.0, False),
    "gamma": (0.45, 2.2, True),
    "gradient": (0.03, 0.8, True),
    "motion_px": (0.03, 4.0, True),
    "jitter_px": (0.03, 4.0, True),
    "clip_share": (0.005, 0.5, True),
    "hot_share": (1e-5, 0.05, True),
    "neighbour_px": (2.0, 40.0, True),
    "halo_share": (0.01, 0.4, True),
    "bars_too_many": (-2.0, 2.0, False),
    "frequency_off": (0.005, 0.3, True),
    "codes": (2.0, 40.0, True),
}


@dataclass(frozen=True, kw_only=True)
class BarTarget:
    """A target and what the method is told of it.

    Parameters
    ----------
    scene
        The target as it is.
    bars, frequency_cy_per_px
        What is asked for.
    interlaced
        Whether the camera is told to be interlaced.
    """

    scene: BarScene
    bars: int
    frequency_cy_per_px: float
    interlaced: bool = False


def cell_of(number: int) -> Cell[BarTarget]:
    """Return a cell from its number."""
    return cell_drawn(number, BREAKING, _target_in_scope, _broken)


def _target_in_scope(rng: np.random.Generator) -> BarTarget:
    form = str(rng.choice(["gaussian", "exponential"]))
    blur = Blur(
        form=form,  # pyright: ignore[reportArgumentType]
        sigma_px=float(rng.uniform(0.5, 1.3)),
        frequency_cy_per_px=float(rng.uniform(0.2, 0.5)),
        exponent=float(rng.uniform(1.05, 1.9)),
    )
    level, snr = float(rng.uniform(500.0, 1200.0)), float(np.exp(rng.uniform(np.log(5.0), np.log(60.0))))
    scene = BarScene(
        blur=blur,
        bars=int(rng.choice([3, 4, 5])),
        frequency_cy_per_px=float(np.exp(rng.uniform(np.log(0.06), np.log(0.3)))),
        rows=200,
        cols=220,
        frames=int(rng.choice([1, 4, 8, 16])),
        angle_deg=float(rng.choice([0, 90]) + rng.choice([-1, 1]) * rng.uniform(1.0, 12.0)),
        row_px=float(rng.uniform(-4.0, 4.0)),
        col_px=float(rng.uniform(-4.0, 4.0)),
        black_dn=100.0,
        # Noise stays above the lowest code.
        pedestal_dn=float(rng.uniform(150.0, 600.0)) + 4.0 * level / snr,
        level_dn=level,
        full_scale_dn=4095.0,
        snr=snr,
        shot_share=float(rng.choice([0.0, 0.8])),
        noise_blur_px=float(rng.choice([0.0, 0.5, 0.9])),
    )
    return _asked(scene)


def _asked(scene: BarScene, **told: Any) -> BarTarget:
    return BarTarget(
        scene=scene, **{"bars": scene.bars, "frequency_cy_per_px": scene.frequency_cy_per_px, **told}
    )  # fmt: skip


def _broken(target: BarTarget, axis: str, strength: float) -> BarTarget:
    """Return a target with one thing wrong, or one wrong word about it."""
    scene = target.scene
    if axis == "bars_too_many":
        bars = scene.bars + int(np.sign(strength) * np.ceil(abs(strength)))
        return _asked(scene, bars=max(bars, 2 if scene.bars != 2 else 3))
    if axis == "frequency_off":
        sign = -1.0 if round(1e4 * scene.snr) % 2 else 1.0
        return _asked(scene, frequency_cy_per_px=scene.frequency_cy_per_px * (1.0 + sign * strength))
    changed: dict[str, Any] = {
        "frequency_untilted": {"frequency_cy_per_px": strength, "angle_deg": 90.0 * round(scene.angle_deg / 90.0)},
        "blur_px": {"blur": Blur(sigma_px=strength)},
        "rows": {"rows": round(strength), "cols": round(strength)},
        "off_centre_px": {"col_px": strength},
        "gamma": {"gamma": strength, "full_scale_dn": 1.1 * (scene.pedestal_dn + scene.level_dn)},
        "clip_share": {"clip_share": strength, "full_scale_dn": round(scene.pedestal_dn + scene.level_dn)},
        "neighbour_px": {"neighbour_px": strength, "rows": 320, "cols": 320},
        "halo_share": {"blur": replace(scene.blur, halo_share=strength)},
        "codes": _coarse(scene, strength),
    }.get(axis, {axis: strength})
    return _asked(replace(scene, **changed)) if axis != "motion_px" else _moved(scene, strength)


def _moved(scene: BarScene, motion_px: float) -> BarTarget:
    return _asked(replace(scene, motion_px=motion_px), interlaced=True)


def _coarse(scene: BarScene, codes: float) -> dict[str, float]:
    """The same light on fewer codes: all its levels shrink alike."""
    scale = codes / scene.level_dn
    return {name: getattr(scene, name) * scale for name in ("black_dn", "pedestal_dn", "level_dn")} | {
        "full_scale_dn": 255.0
    }


def measured_cell(number: int, *, repeats: int = REPEATS, quick: bool = True, method: str = METHOD) -> Outcome:
    """Draw a cell's frames and put the method to each of them."""
    cell = cell_of(number)
    truth = cell.scene.scene.truth_mtf
    rows = [attempt(of_kind("bars")[method], case_of(cell, truth, i), Context(quick=quick)) for i in range(repeats)]
    return outcome_of(cell, rows, truth, truths=truths_of(cell))


def truths_of(cell: Cell[BarTarget]) -> tuple[float, float]:
    """Return the least and the largest MTF that are right for a cell.

    It is told at the frequency asked for or at the bars' own, and says which. Of a halo that nobody described all, a
    part, or none of the light may be counted.
    """
    scene = cell.scene.scene
    frequencies = cell.scene.frequency_cy_per_px, scene.frequency_cy_per_px
    blurs = scene.blur, replace(scene.blur, halo_share=0.0)
    right = [float(blur.mtf(frequency, scene.angle_deg)) for blur in blurs for frequency in frequencies]
    return min(right), max(right)


def case_of(cell: Cell[BarTarget], truth: float, repeat: int) -> Case:
    """Return one drawing of a cell, the target at a phase of its own."""
    target = cell.scene

    def draw(rng: np.random.Generator) -> Any:
        row, col = rng.uniform(-1.0, 1.0, 2)
        scene = target.scene
        return replace(scene, row_px=scene.row_px + float(row), col_px=scene.col_px + float(col)).frames_drawn(rng)

    return case_drawn(
        cell,
        repeat,
        kind="bars",
        quantity=QUANTITY,
        truth=truth,
        draw=draw,
        arguments={"bars": target.bars, "frequency_cy_per_px": target.frequency_cy_per_px},
        context={"interlaced": target.interlaced, "full_scale_dn": target.scene.full_scale_dn},
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
