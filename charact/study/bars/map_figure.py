"""Figure of the map of bars: what became of the drawings along everything that breaks them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from charact.study import cell_map_figure
from charact.study.bars.map import BREAKING, TABLE, cell_of

FIGURE = Path("docs/mtf/bar-map.png")
LABELS = {
    "snr": "step / sd of the noise (1)",
    "frequency_cy_per_px": "high frequency (cy/px)",
    "frequency_untilted": "the same, bars untilted (cy/px)",
    "blur_px": "sd of a wide blur (px)",
    "rows": "rows and columns (px)",
    "off_centre_px": "target off the middle (px)",
    "gamma": "exponent of the response (1)",
    "gradient": "light, right over left less 1 (1)",
    "motion_px": "motion between fields (px)",
    "jitter_px": "motion from frame to frame (px rms)",
    "clip_share": "share of the step clipped (1)",
    "hot_share": "share of stuck pixels (1)",
    "neighbour_px": "gap to another target (px)",
    "halo_share": "share of a halo of 30 px (1)",
    "bars_too_many": "bars asked for, too many (1)",
    "frequency_off": "frequency asked for, off by (1)",
    "codes": "codes of the step (DN)",
}


def draw_map(found: Mapping[str, Any], path: Path) -> Path:
    """Draw the table of `charact.study.bars.map`; returns the path of the PNG."""
    scope = ("frequency (cy/px)", lambda number: cell_of(number).scene.scene.frequency_cy_per_px)
    return cell_map_figure.draw_map(found, path, breaking=BREAKING, labels=LABELS, scope=scope, columns=5)


def main() -> None:
    """Draw the table that is there."""
    cell_map_figure.make(draw_map, table=TABLE, figure=FIGURE, about=__doc__)


if __name__ == "__main__":
    main()
