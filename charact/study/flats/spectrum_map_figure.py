"""Figure of the map of noise spectra: what became of the drawings along everything that breaks them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from charact.study import scenario_map_figure
from charact.study.flats.spectrum_map import BREAKING, TABLE, cell_of

FIGURE = Path("docs/mtf/spectrum-map.png")
LABELS = {
    "photoelectrons": "few photoelectrons (1/px)",
    "bright_photoelectrons": "many photoelectrons (1/px)",
    "read_noise_dn": "read noise (DN)",
    "codes": "gain on few codes (DN/photoelectron)",
    "wide_cy_per_px": "half frequency, wide blur (cy/px)",
    "sharp_cy_per_px": "half frequency, sharp blur (cy/px)",
    "exponent": "exponent of a blur with tails (1)",
    "steep": "exponent of a steep blur (1)",
    "anisotropy": "columns' over rows' frequency (1)",
    "halo_fraction": "light in a veil of sd 6 px (1)",
    "halo_px": "sd of a veil of a tenth (px)",
    "coloured_px": "sd of blurred read noise (px)",
    "coloured_no_darks_px": "the same without darks (px)",
    "row_noise_dn": "noise of whole rows (DN)",
    "electron_gain_dn": "CCD's gain (DN/electron)",
    "rows": "rows and columns (px)",
    "frames": "frames of each stack (1)",
    "lag": "lag (share of an exposure)",
    "lag_between_fields": "the same, of fields (share)",
    "gamma": "exponent of the response (1)",
    "saturation": "brightest level / full scale (1)",
    "flicker": "rms flicker of the light (1)",
    "vignetting": "light lost in the corners (1)",
    "ion_share": "share of pulses by ions (1)",
}


def plot_map(found: Mapping[str, Any], path: Path) -> Path:
    """Draw the table of `charact.study.flats.spectrum_map`; returns the path of the PNG."""
    scope = ("half frequency after the gain (cy/px)", lambda number: cell_of(number).scene.half_frequency_cy_per_px)
    return scenario_map_figure.plot_map(found, path, breaking=BREAKING, labels=LABELS, scope=scope, columns=7)


def main() -> None:
    """Draw the table that is there."""
    scenario_map_figure.make(plot_map, table=TABLE, figure=FIGURE, about=__doc__)


if __name__ == "__main__":
    main()
