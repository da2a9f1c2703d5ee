"""Figure of the map of gains: what became of the drawings along everything that breaks them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from charact.study import scenario_map_figure
from charact.study.flats.gain_map import BREAKING, TABLE, cell_of

FIGURE = Path("docs/noise/gain-map.png")
LABELS = {
    "decay_ms": "decay of the screen (ms)",
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


def plot_map(found: Mapping[str, Any], path: Path) -> Path:
    """Draw the table of `charact.study.flats.gain_map`; returns the path of the PNG."""
    scope = ("photoelectrons of the brightest level (1)", _brightest)
    return scenario_map_figure.plot_map(found, path, breaking=BREAKING, labels=LABELS, scope=scope, columns=4)


def _brightest(number: int) -> float:
    return float(cell_of(number).scene.photoelectrons[-1])


def main() -> None:
    """Draw the table that is there."""
    scenario_map_figure.make(plot_map, table=TABLE, figure=FIGURE, about=__doc__)


if __name__ == "__main__":
    main()
