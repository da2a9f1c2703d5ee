"""Figure of the economy of light: differences of frames over savings of time, and the worst case in pictures."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from charact.study.light.effect_selection_study import (
    TABLE,
    TOLERANCE,
    SelectionOutcome,
    pair_of,
    read,
    summarise_outcomes,
)
from charact.study.light.scenes import CAMERAS
from charact.study.study_figures import _pyplot

FIGURE = Path(__file__).resolve().parents[3] / "docs" / "night-scenes" / "economy.png"
# Differences of no size, as of frames that are full everywhere, are drawn here.
LOWEST = 2e-3
MARKS = dict(zip(CAMERAS, "osD", strict=True))


def plot_economy(outcomes: Sequence[SelectionOutcome], path: Path) -> Path:
    """Draw all cases of a table, and render the worst again."""
    figure, (left, *right) = _pyplot().subplots(
        1, 4, figsize=(15.0, 4.0), layout="constrained", width_ratios=(1.6, 1.0, 1.0, 1.0)
    )
    whole = summarise_outcomes(outcomes)
    _draw_cases(left, outcomes)
    pair = pair_of(whole["worst"])
    low, high = np.percentile(pair.exact_dn, (0.0, 99.5))
    for axes, (title, frame) in zip(right, (("exact", pair.exact_dn), ("by the plan", pair.planned_dn)), strict=False):
        drawn: Any = axes.imshow(frame, cmap="gray", vmin=low, vmax=max(high, low + 1.0))
        figure.colorbar(drawn, ax=axes, label="DN", shrink=0.7)
        axes.set_title(title, fontsize=9)
    drawn = right[2].imshow(pair.difference, cmap="RdBu_r", vmin=-0.5, vmax=0.5)
    figure.colorbar(drawn, ax=right[2], label="difference / noise (1)", shrink=0.7)
    right[2].set_title("difference", fontsize=9)
    for axes in right:
        axes.set_xlabel("column (px)")
        axes.grid(visible=False)
    right[0].set_ylabel("row (px)")
    figure.suptitle(
        f"{whole['within']} of {whole['cases']} frames differ from exact ones by less than {TOLERANCE:.0%} of their "
        f"noise; median saving of time {whole['median_saving']:.1f}-fold; right: the worst, case {whole['worst']}, "
        f"{pair.case.light}, {pair.case.sensor}",
        fontsize=10,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)
    _pyplot().close(figure)
    return path


def _draw_cases(axes: Any, outcomes: Sequence[SelectionOutcome]) -> None:
    """Draw a mark for each case, its shape by camera and its colour by light."""
    lights = sorted({one.light.removesuffix(" with lamps") for one in outcomes})
    for number, light in enumerate(lights):
        for sensor, mark in MARKS.items():
            own = [one for one in outcomes if one.light.startswith(light) and one.sensor == sensor]
            if own:
                axes.plot(
                    [one.saving for one in own], [max(one.difference, LOWEST) for one in own], mark,
                    color=f"C{number}", alpha=0.7, label=light if sensor == CAMERAS[0] else None, ms=5,
                )  # fmt: skip
    for sensor, mark in MARKS.items():
        axes.plot([], [], mark, color="0.4", ms=5, label=sensor)
    axes.axhline(TOLERANCE, color="k", lw=1, ls="--")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("time of the exact mode over that of the plan (1)")
    axes.set_ylabel(f"difference of frames / noise, rms (1; at least {LOWEST:g})")
    axes.set_ylim(bottom=LOWEST / 15.0)
    axes.legend(fontsize=7, ncols=2, loc="lower left")


def main() -> None:
    """Draw the table that is there."""
    parser = argparse.ArgumentParser(prog="python -m charact.study.light.effect_selection_figure", description=__doc__)
    parser.add_argument("--table", type=Path, default=TABLE, help="table to read")
    parser.add_argument("--figure", type=Path, default=FIGURE, help="PNG to write")
    asked = parser.parse_args()
    plot_economy(read(asked.table), asked.figure)


if __name__ == "__main__":
    main()
