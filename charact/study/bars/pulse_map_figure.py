"""Figure of the map of bars of intensified cameras: what became of the drawings along everything that breaks them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from charact.study import cell_map_figure, pulse_cameras
from charact.study.bars.pulse_map import BREAKING, TABLE, cell_of

FIGURE = Path("docs/mtf/bar-pulse-map.png")
LABELS = {
    **pulse_cameras.LABELS,
    "frequency_cy_per_px": "high frequency (cy/px)",
    "rows": "rows and columns (px)",
    "off_centre_px": "target off the middle (px)",
    "halo_share": "share of a halo of 30 px (1)",
}


def draw_map(found: Mapping[str, Any], path: Path) -> Path:
    """Draw the table of `charact.study.bars.pulse_map`; returns the path of the PNG."""
    scope = ("frequency (cy/px)", lambda number: cell_of(number).scene.frequency_cy_per_px)
    return cell_map_figure.draw_map(found, path, breaking=BREAKING, labels=LABELS, scope=scope, columns=6)


def main() -> None:
    """Draw the table that is there."""
    cell_map_figure.make(draw_map, table=TABLE, figure=FIGURE, about=__doc__)


if __name__ == "__main__":
    main()
