"""Figure of the map of edges of intensified cameras: what became of the drawings along everything that breaks them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from charact.study import cell_map_figure, pulse_cameras
from charact.study.edge.pulse_map import BREAKING, TABLE, cell_of

FIGURE = Path("docs/mtf/edge-pulse-map.png")
LABELS = {
    **pulse_cameras.LABELS,
    "sagitta_px": "bow of the edge (px)",
    "angle_deg": "small tilt (deg)",
    "rows": "rows and columns (px)",
    "halo_px": "diameter of a wide halo (px)",
}


def draw_map(found: Mapping[str, Any], path: Path) -> Path:
    """Draw the table of `charact.study.edge.pulse_map`; returns the path of the PNG."""
    scope = ("step over noise of the mean frame (1)", lambda number: cell_of(number).scene.snr)
    return cell_map_figure.draw_map(found, path, breaking=BREAKING, labels=LABELS, scope=scope, columns=6)


def main() -> None:
    """Draw the table that is there."""
    cell_map_figure.make(draw_map, table=TABLE, figure=FIGURE, about=__doc__)


if __name__ == "__main__":
    main()
