"""Figure of the map of blooms: what became of the halo diameters along everything that breaks them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from charact.study import cell_map_figure
from charact.study.bloom.map import BREAKING, TABLE, cell_of

FIGURE = Path("docs/bloom/bloom-map.png")
LABELS = {
    "faintest": "halo over full scale at the faintest level (1)",
    "levels": "levels (1)",
    "off_centre": "source off the middle / frame's width (1)",
    "second_ratio": "second source 20 px away / first (1)",
    "second_distance_px": "second source of equal light, away (px)",
    "motion_px": "source moves (px a frame)",
    "moving_lag": "light that lags, source moves 2 px (1)",
    "agc": "automatic gain: levels over those of scope (1)",
    "codes": "codes of the digitiser (1)",
    "dark_too_high_dn": "dark stack too high (DN of 255)",
    "dark_too_low_dn": "dark stack too low (DN of 255)",
    "full_well": "full well / full scale (1)",
    "smear_fraction": "light that smears over its column (1)",
    "plate_saturation": "plate's half gain / full scale (1)",
    "wing_share": "core's light in its wing (1)",
    "elastic_share": "halo's electrons that keep their energy (1)",
    "halo_fraction": "light in the halo (1)",
    "glare_fraction": "light in the glare (1)",
    "frames": "frames of each stack (1)",
    "photoelectron_dn": "a photoelectron (DN of 255)",
    "no_darks": "no darks; background (DN of 255)",
}


def draw_map(found: Mapping[str, Any], path: Path) -> Path:
    """Draw the table of `charact.study.bloom.map`; returns the path of the PNG."""
    scope = ("light in the halo (1)", _halo_fraction)
    return cell_map_figure.draw_map(found, path, breaking=BREAKING, labels=LABELS, scope=scope, columns=5)


def _halo_fraction(number: int) -> float:
    return cell_of(number).scene.scene.halo_fraction


def main() -> None:
    """Draw the table that is there."""
    cell_map_figure.make(draw_map, table=TABLE, figure=FIGURE, about=__doc__)


if __name__ == "__main__":
    main()
