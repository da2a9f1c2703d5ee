"""Figure of the map of edges of intensified cameras: what became of the drawings along everything that breaks them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from charact.study import cell_map_figure
from charact.study.edge.pulse_map import BREAKING, TABLE, cell_of

FIGURE = Path("docs/mtf/edge-pulse-map.png")
LABELS = {
    "photoelectrons": "faint light (photoelectrons/px)",
    "pulse_peak_dn": "peak of a pulse (DN of 8 bits)",
    "gain_spread": "relative variance of heights (1)",
    "ion_share": "share of ions' pulses (1)",
    "bright_dn": "bright side (DN of 8 bits)",
    "codes": "faint bright side (DN)",
    "black_dn": "code at no light (DN of 8 bits)",
    "read_dn": "read noise (DN of 8 bits)",
    "row_noise_dn": "noise of whole rows (DN of 8 bits)",
    "pattern": "fixed pattern of gains (1)",
    "lag": "lag (share of an exposure)",
    "flicker": "flicker (1)",
    "jitter_px": "motion from frame to frame (px rms)",
    "drift_px": "drift through the stack (px)",
    "motion_px": "motion between fields, told (px)",
    "motion_untold_px": "the same, fields not told (px)",
    "gradient": "light, right over left less 1 (1)",
    "vignetting": "light that corners lose (1)",
    "sagitta_px": "bow of the edge (px)",
    "gamma": "exponent of the response (1)",
    "sharpening": "sharpening (1)",
    "hot_share": "share of stuck pixels (1)",
    "angle_deg": "small tilt (deg)",
    "rows": "rows and columns (px)",
    "frames": "frames (1)",
    "blur_px": "sd of a wide blur (px)",
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
