"""Figure of the map of points: what became of the drawings along everything that breaks them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from charact.study import cell_map_figure
from charact.study.point.map import BREAKING, TABLE, cell_of

FIGURE = Path("docs/mtf/point-map.png")
LABELS = {
    "photoelectrons": "photoelectrons a frame (1)",
    "read_dn": "read noise (DN of 8 bits)",
    "sharpness": "sd of a very sharp blur (px)",
    "blur_px": "sd of a wide blur (px)",
    "peak_dn": "peak, full scale 243 (DN of 8 bits)",
    "codes": "faint peak (DN)",
    "gamma": "exponent of the response (1)",
    "background": "background (photoelectrons/px)",
    "gradient": "background, right over left less 1 (1)",
    "motion_px": "motion between fields (px)",
    "drift_px": "drift through the stack (px)",
    "jitter_px": "motion from frame to frame (px rms)",
    "frames": "frames (1)",
    "rows": "rows and columns (px)",
    "off_centre_px": "source off the middle (px)",
    "neighbour_px": "another of half the light at (px)",
    "neighbour_share": "light of another, 10 px away (1)",
    "pinhole_px": "diameter of the pinhole, told (px)",
    "hot_share": "share of stuck pixels (1)",
    "halo_px": "diameter of a wide halo (px)",
}


def draw_map(found: Mapping[str, Any], path: Path) -> Path:
    """Draw the table of `charact.study.point.map`; returns the path of the PNG."""
    scope = (LABELS["photoelectrons"], lambda number: cell_of(number).scene.photoelectrons)
    return cell_map_figure.draw_map(found, path, breaking=BREAKING, labels=LABELS, scope=scope, columns=6)


def main() -> None:
    """Draw the table that is there."""
    cell_map_figure.make(draw_map, table=TABLE, figure=FIGURE, about=__doc__)


if __name__ == "__main__":
    main()
