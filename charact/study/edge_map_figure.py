"""Figure of the map of edges: what became of the drawings along everything that breaks them."""

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from charact.study.cell_map_figure import draw_fates
from charact.study.draw import _pyplot, plain_numbers
from charact.study.edge_map import BREAKING, TABLE, cell_of

FIGURE = Path("docs/mtf/edge-map.png")
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


def draw_map(found: Mapping[str, Any], path: Path) -> Path:
    """Draw the quick part of the table of `charact.study.edge_map`.

    Parameters
    ----------
    found
        The table.
    path
        Where the PNG goes.
    """
    part = found["quick"]
    cells = [dict(zip(part["columns"], row, strict=True)) for row in part["rows"]]
    figure, grid = _pyplot().subplots(3, 5, figsize=(14.0, 7.8), layout="constrained")
    panels = iter(grid.flat)
    inside = [cell for cell in cells if cell["axis"] == "none"]
    snr = [cell_of(cell["number"]).scene.snr for cell in inside]
    draw_fates(next(panels), inside, snr, log=True, label=LABELS["snr"], title="inside the scope")
    for axis, (_, _, log) in BREAKING.items():
        own = [cell for cell in cells if cell["axis"] == axis]
        draw_fates(next(panels), own, [cell["strength"] for cell in own], log=log, label=LABELS[axis], title=axis)
    _draw_widths(next(panels), inside)
    for spare in panels:
        spare.axis("off")
    for panel in grid[:, 0]:
        panel.set_ylabel("share of the drawings (1)")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    grid[2, 4].legend(handles, labels, loc="center", frameon=False)
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


def _draw_widths(panel: Any, inside: Sequence[Mapping[str, Any]]) -> None:
    """Draw how wide intervals are beside the bound, against the bound itself."""
    both = [(one["bound_percent"], one["sd_percent"]) for one in inside if one["bound_percent"] and one["sd_percent"]]
    bound, sd = np.array(both).T if both else np.ones((2, 0))
    panel.plot(bound, sd / bound, ".", color="#0072b2", markersize=3, alpha=0.6)
    panel.axhline(1.0, color="black", linewidth=0.8)
    if both:
        panel.axhline(np.median(sd / bound), color="#d55e00", linewidth=1.2, linestyle="--", label="_")
    panel.set(xscale="log", yscale="log", xlabel="Cramér–Rao sd of MTF50 (%)", ylabel="given sd / bound (1)")
    plain_numbers(panel.xaxis, panel.yaxis)
    panel.set_title("widths in scope, median dashed")


def main() -> None:
    """Draw the table that is there."""
    parser = argparse.ArgumentParser(prog="python -m charact.study.edge_map_figure", description=__doc__)
    parser.add_argument("--table", type=Path, default=TABLE, help="table to read")
    parser.add_argument("--figure", type=Path, default=FIGURE, help="PNG to write")
    asked = parser.parse_args()
    draw_map(json.loads(asked.table.read_text()), asked.figure)


if __name__ == "__main__":
    main()
