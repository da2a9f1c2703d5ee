"""Figure of the map of edges: what became of the drawings along everything that breaks them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from charact.study import scenario_map_figure
from charact.study.edge.map import BREAKING, TABLE, cell_of
from charact.study.study_figures import plain_numbers

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


def plot_map(found: Mapping[str, Any], path: Path) -> Path:
    """Draw the table of `charact.study.edge.map`; returns the path of the PNG."""
    scope = (LABELS["snr"], lambda number: cell_of(number).scene.snr)
    return scenario_map_figure.plot_map(
        found, path, breaking=BREAKING, labels=LABELS, scope=scope, columns=5, last=_draw_widths
    )


def _draw_widths(panel: Any, inside: scenario_map_figure.Rows) -> None:
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
    scenario_map_figure.make(plot_map, table=TABLE, figure=FIGURE, about=__doc__)


if __name__ == "__main__":
    main()
