"""Figure of the bar study: bias of the MTF against the bars' frequency, one panel for each blur."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from charact.study.bars.bias_table import ALLOWED_PERCENT, BarScenarioOutcome, read, tally
from charact.study.study_figures import COLOURS, _pyplot

FIGURE = Path("docs/mtf/bar-bias.png")
# Tilts apart by so much, so that their bars do not hide each other, cycles per pixel.
APART = 0.004
MARKS = {0.0: "o", 2.0: "s", 8.0: "^"}


def plot_bias(outcomes: Sequence[BarScenarioOutcome], path: Path = FIGURE) -> Path:
    """Draw the bias of every cell that is measured, and name the frequencies that are told as low signal.

    Parameters
    ----------
    outcomes
        Cells of the table.
    path
        Where the PNG goes.
    """
    evenly = [one for one in outcomes if one.phase_px is None]
    blurs = list(dict.fromkeys(one.blur for one in evenly))
    figure, panels = _pyplot().subplots(1, len(blurs), figsize=(11.0, 4.2), sharey=True, layout="constrained")
    for panel, blur in zip(panels, blurs, strict=True):
        _draw_panel(panel, [one for one in evenly if one.blur == blur])
        panel.set(title=blur, xlabel="frequency of the bars (cy/px)", xlim=(0.02, 0.43))
    panels[0].set(ylabel="bias of the MTF (% of the truth)")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, frameon=False, fontsize=8)
    figure.suptitle(
        "Four bars over 20 rows of one frame, step ten times a pixel's noise; "
        "lines: one standard error; grey: the 1 % allowed",
        fontsize=9,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    _pyplot().close(figure)
    return path


def _draw_panel(panel: Any, cells: Sequence[BarScenarioOutcome]) -> None:
    """Draw one blur: tilts by mark, white and blurred noise by colour; frequencies without a measured cell in words."""
    panel.axhspan(-ALLOWED_PERCENT, ALLOWED_PERCENT, color="0.9", zorder=0)
    panel.axhline(0.0, color="0.6", linewidth=0.8)
    for colour, blurred in zip(COLOURS, (False, True), strict=False):
        for shift, (tilt, mark) in zip((-1, 0, 1), MARKS.items(), strict=True):
            own = [c for c in cells if c.tilt_deg == tilt and (c.grain_px > 0) == blurred and not c.told]
            label = f"{tilt:g} deg, noise {'blurred' if blurred else 'white'}"
            panel.errorbar(
                [c.frequency_cy_per_px + (shift + (0.5 if blurred else 0.0)) * APART for c in own],
                [c.bias_percent for c in own], yerr=[c.standard_error_percent for c in own],
                fmt=mark, color=colour, markersize=4, linewidth=1.0, label=label,
            )  # fmt: skip
    for frequency in sorted({c.frequency_cy_per_px for c in cells}):
        if all(c.told for c in cells if c.frequency_cy_per_px == frequency):
            truth = next(c.truth for c in cells if c.frequency_cy_per_px == frequency)
            panel.text(
                frequency, 0.0, f"MTF {truth:.1g}: low-signal", rotation=90, ha="center", va="center",
                fontsize=7, backgroundcolor="white",
            )  # fmt: skip


if __name__ == "__main__":
    print("\n".join(tally(read()).lines()))
    print(plot_bias(read()))
