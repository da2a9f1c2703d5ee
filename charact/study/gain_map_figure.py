"""Figure of the map of gains: what became of the drawings along everything that breaks them."""

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from charact.study.cell_map_figure import draw_fates
from charact.study.draw import _pyplot
from charact.study.gain_map import BREAKING, TABLE, cell_of

FIGURE = Path("docs/noise/gain-map.png")
LABELS = {
    "decay_ms": "decay of the screen, frames of 33 ms (ms)",
    "interlaced_decay_ms": "the same, interlaced (ms)",
    "gain_range_db": "range of an automatic gain (dB)",
    "flicker": "rms flicker of the light (1)",
    "drift": "drift of the light, last over first less 1 (1)",
    "saturation": "brightest level / full scale (1)",
    "gamma": "exponent of the response (1)",
    "frames": "frames of each stack (1)",
    "rows": "rows, and columns less 8 (px)",
    "dim_dn": "signal of the brightest level (DN)",
}


def draw_map(found: Mapping[str, Any], path: Path) -> Path:
    """Draw the quick part of the table of `charact.study.gain_map`.

    Parameters
    ----------
    found
        The table.
    path
        Where the PNG goes.
    """
    part = found["quick"]
    cells = [dict(zip(part["columns"], row, strict=True)) for row in part["rows"]]
    figure, grid = _pyplot().subplots(3, 4, figsize=(13.0, 8.0), layout="constrained")
    panels = iter(grid.flat)
    inside = [cell for cell in cells if cell["axis"] == "none"]
    brightest = [float(cell_of(cell["number"]).scene.photoelectrons[-1]) for cell in inside]
    draw_fates(next(panels), inside, brightest, log=True, label="photoelectrons of the brightest level (1)",
               title="inside the scope")  # fmt: skip
    for axis, (_, _, log) in BREAKING.items():
        own = [cell for cell in cells if cell["axis"] == axis]
        draw_fates(next(panels), own, [cell["strength"] for cell in own], log=log, label=LABELS[axis], title=axis)
    for panel in grid[:, 0]:
        panel.set_ylabel("share of the drawings (1)")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    last = next(panels)
    last.axis("off")
    last.legend(handles, labels, loc="center", frameon=False)
    summary = part["summary"]
    figure.suptitle(
        f"{found['method']}, quick: {summary['cells']} cells, {summary['draws']} drawings, {summary['ok']} ok, "
        f"{summary['silent']} silent failures; in scope {summary['in_scope_ok_percent']:.1f} % ok",
        fontsize=11,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)
    _pyplot().close(figure)
    return path


def main() -> None:
    """Draw the table that is there."""
    parser = argparse.ArgumentParser(prog="python -m charact.study.gain_map_figure", description=__doc__)
    parser.add_argument("--table", type=Path, default=TABLE, help="table to read")
    parser.add_argument("--figure", type=Path, default=FIGURE, help="PNG to write")
    asked = parser.parse_args()
    draw_map(json.loads(asked.table.read_text()), asked.figure)


if __name__ == "__main__":
    main()
