"""Figure of a calibration: the rank histogram of each parameter with the band in which a uniform one stays."""

from pathlib import Path
from typing import Any

from charact.study.calibration import Calibration
from charact.study.study_figures import COLOURS, _pyplot, _save


def plot_calibration(result: Calibration, path: Path) -> Path:
    """Draw a panel for each parameter, at most four in a line; bars outside the 95 % band are red.

    Parameters
    ----------
    result
        Ranks of truths among draws.
    path
        Where the SVG goes; a PNG is put beside it.
    """
    columns = min(4, len(result.names))
    lines = -(-len(result.names) // columns)
    figure, grid = _pyplot().subplots(
        lines, columns, figsize=(1.0 + 3.0 * columns, 0.8 + 2.3 * lines), layout="constrained", squeeze=False
    )
    for panel, name in zip(grid.flat, result.names, strict=False):
        _draw_histogram(panel, result, name)
    for panel in grid.flat[len(result.names) :]:
        panel.set_visible(False)
    for panel in grid[:, 0]:
        panel.set_ylabel("truths")
    flagged = f", {result.flagged} flagged and left out" if result.flagged else ""
    figure.suptitle(f"Ranks of {len(result.ranks)} truths among {result.draws} draws each{flagged}; band: 95 %")
    return _save(figure, path)


def _draw_histogram(panel: Any, result: Calibration, name: str) -> None:
    """One parameter: its bars over the band."""
    counts, (low, high) = result.histogram(name), result.band()
    width = (result.draws + 1) / len(counts)
    panel.axhspan(low, high, color="black", alpha=0.12, linewidth=0)
    panel.axhline(len(result.ranks) / len(counts), color="black", linewidth=0.8)
    colours = [COLOURS[0] if low <= count <= high else COLOURS[1] for count in counts]
    panel.bar([width * (number + 0.5) for number in range(len(counts))], counts, width=0.92 * width, color=colours)
    value, probability = result.chi_squared(name)
    panel.set_title(f"{name}: chi squared {value:.0f} of {len(counts) - 1}, p = {probability:.2g}", fontsize=8)
    panel.set(xlabel="rank of the truth", xlim=(0, result.draws + 1))
