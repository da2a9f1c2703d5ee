"""Figure of the grid of single photoelectrons: bias, scatter over the bound and cover of every cell."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from charact.study.draw import _pyplot
from charact.study.flats.gain_grid import (
    BLURS_PX,
    EXCESS_NOISE_FACTORS,
    METHOD,
    PHOTOELECTRONS,
    TABLE,
    Outcome,
    read,
    told,
)

FIGURE = Path(__file__).resolve().parents[3] / "docs" / "noise" / "gain-grid.png"
# What a panel shows, its title, the range of its colours and how its numbers are written.
PANELS = (
    ("bias", "bias (% of the gain)", "RdBu_r", (-4.0, 4.0), "{:+.1f}"),
    ("ratio", "scatter / least scatter (1)", "PuOr_r", (0.6, 1.4), "{:.2f}"),
    ("cover", "95 % intervals that hold (%)", "PRGn", (90.0, 100.0), "{:.0f}"),
    ("plain", "plain variance reading (% of the gain)", "Greys", (0.0, 150.0), "{:.0f}"),
)


def draw_grid(outcomes: Sequence[Outcome], path: Path) -> Path:
    """Draw the cells of the table of `charact.study.flats.gain_grid`, one row of panels for each light."""
    lights = len(PHOTOELECTRONS)
    figure, grid = _pyplot().subplots(lights, len(PANELS), figsize=(14.0, 2.1 * lights + 0.8), layout="constrained")
    for row, photoelectrons in zip(grid, PHOTOELECTRONS, strict=True):
        own = [one for one in outcomes if one.photoelectrons == photoelectrons]
        for axes, panel in zip(row, PANELS, strict=True):
            _draw_panel(axes, own, panel)
        row[0].set_ylabel(f"{photoelectrons:g} pe a pixel\n$F^2$")
    for axes, (_, title, *_) in zip(grid[0], PANELS, strict=True):
        axes.set_title(title, fontsize=10)
    for axes in grid[-1]:
        axes.set_xlabel("blur after the gain, Gaussian sd (px)")
    whole = told(outcomes)
    figure.suptitle(
        f"{METHOD}: {whole['drawings']} stacks of 128 x 128 px; bias {whole['bias_percent']:+.2f} ± "
        f"{whole['bias_sd_percent']:.2f} %, scatter {whole['scatter_over_bound']:.2f} of the least, "
        f"{whole['covered_percent']:.1f} % held, {whole['silent']} silent failures",
        fontsize=11,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)
    _pyplot().close(figure)
    return path


def _draw_panel(axes: Any, outcomes: Sequence[Outcome], panel: tuple[str, str, str, tuple[float, float], str]) -> None:
    """Draw one figure of every cell of a light, pulse heights against blur."""
    name, _, colours, (low, high), written = panel
    values = np.full((len(EXCESS_NOISE_FACTORS), len(BLURS_PX)), np.nan)
    for one in outcomes:
        values[EXCESS_NOISE_FACTORS.index(one.excess_noise_factor), BLURS_PX.index(one.blur_px)] = _value(one, name)
    image = axes.imshow(values, cmap=colours, vmin=low, vmax=high, origin="lower", aspect="auto")
    for (row, col), value in np.ndenumerate(values):
        dark = np.mean(image.cmap(image.norm(value))[:3]) < 0.5
        axes.text(col, row, written.format(value), ha="center", va="center", fontsize=8, color="white" if dark else "k")
    axes.set_xticks(range(len(BLURS_PX)), [f"{at:g}" for at in BLURS_PX])
    axes.set_yticks(range(len(EXCESS_NOISE_FACTORS)), [f"{at:g}" for at in EXCESS_NOISE_FACTORS])
    axes.grid(visible=False)


def _value(one: Outcome, name: str) -> float:
    return {
        "bias": one.bias_percent,
        "ratio": one.scatter_percent / one.bound_percent,
        "cover": 100.0 * one.covered / one.measured,
        "plain": one.variance_percent,
    }[name]


def main() -> None:
    """Draw the table that is there."""
    parser = argparse.ArgumentParser(prog="python -m charact.study.flats.gain_grid_figure", description=__doc__)
    parser.add_argument("--table", type=Path, default=TABLE, help="table to read")
    parser.add_argument("--figure", type=Path, default=FIGURE, help="PNG to write")
    asked = parser.parse_args()
    draw_grid(read(asked.table), asked.figure)


if __name__ == "__main__":
    main()
