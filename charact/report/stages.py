"""Figures of what an MTF is made of: the stages of the camera along rows and columns; a curve through bar groups."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from charact.report.plot_helpers import first_array
from charact.report.style import COLOURS, INK, panels

Data = Mapping[str, Any]
# Colour of each stage, the same in every report.
STAGES = dict(
    zip(
        ("lens", "halo", "tube before the gain", "tube after the gain", "taper", "pixel", "video"),
        (COLOURS[2], COLOURS[3], COLOURS[4], COLOURS[1], COLOURS[6], COLOURS[5], COLOURS[0]),
        strict=True,
    )
)
DIRECTIONS = {"horizontal": "Along rows", "vertical": "Along columns"}
# A stage that never leaves less than this does nothing in a direction and is not drawn there.
NOTHING_LOST = 0.9995
# A band less wide than this is a line.
NARROWEST = 1e-3
# Every so many points of a measured curve has a dot.
EACH = 8
AXIS = "frequency (cycles per column pitch)"
LINES = "solid: identified or known; dashed: as described, or only in a product; bands: 95 %"


def plot_mtf_budget(data: Data) -> Any:
    """Draw every stage's MTF with its 95 % band, their product, and the measured curves as dots with arms."""
    figure, grid = panels(2, 1, size=(5.6, 7.4), sharex=True)
    solid = {*data["identified"], *data["known"]}
    handles = {}
    for axes, (direction, title) in zip(grid[:, 0], DIRECTIONS.items(), strict=True):
        _plot_direction(axes, data[direction], solid)
        axes.set_title(title, loc="left")
        handles.update(dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True)))
    _at_the_cathode(grid[0, 0], data["horizontal"])
    grid[1, 0].set(xlabel=AXIS)
    figure.legend(
        handles.values(),
        handles.keys(),
        loc="outside lower center",
        ncols=3,
        title=LINES,
        title_fontsize=8,
        columnspacing=1.4,
    )
    return figure


def _plot_direction(axes: Any, panel: Data, solid: set[str]) -> None:
    """One direction: identified and known stages solid, those still at what the description says dashed."""
    frequency = first_array(panel, "frequency_cy_per_column")
    for stage, band in panel["stages"].items():
        if np.min(first_array(band, "value")) < NOTHING_LOST:
            colour = STAGES.get(stage, COLOURS[7])
            _plot_band(axes, frequency, band, colour)
            style = "-" if stage in solid else (0, (4, 2))
            axes.plot(frequency, first_array(band, "value"), color=colour, linestyle=style, linewidth=1.3, label=stage)
    if "measured_after_gain" in panel:
        axes.plot(
            frequency, first_array(panel["product_after_gain"], "value"), color=INK, linewidth=1.1, alpha=0.55,
            label="product after the gain",
        )  # fmt: skip
        _plot_measured(axes, frequency, panel["measured_after_gain"], "s", "measured after the gain, 95 %")
    axes.plot(frequency, first_array(panel["product"], "value"), color=INK, linewidth=1.8, label="product of all")
    _plot_measured(axes, frequency, panel["measured"], "o", "measured, 95 %")
    axes.axhline(0.5, color=INK, linewidth=0.6, alpha=0.5)
    axes.set(xlim=(0, frequency[-1]), ylim=(-0.02, 1.03), ylabel="MTF (1)")


def _at_the_cathode(axes: Any, panel: Data) -> None:
    """Say above a panel what its frequencies are at the photocathode."""
    scale = float(first_array(panel, "cathode_lp_per_mm")[-1] / first_array(panel, "frequency_cy_per_column")[-1])
    above = axes.secondary_xaxis("top", functions=(lambda x: x * scale, lambda x: x / scale))
    above.set_xlabel("at the photocathode (lp/mm)")


def _plot_band(axes: Any, frequency: Any, band: Data, colour: str) -> None:
    """A faint band with fine borders, for bands lie on one another."""
    low, high = first_array(band, "low95"), first_array(band, "high95")
    if np.max(high - low) > NARROWEST:
        axes.fill_between(frequency, low, high, facecolor=(colour, 0.1), edgecolor=(colour, 0.45), linewidth=0.5)


def _plot_measured(axes: Any, frequency: Any, band: Data, marker: str, label: str) -> None:
    """Dots of a measured curve with arms of its 95 % interval."""
    value, low, high = (first_array(band, name)[EACH::EACH] for name in ("value", "low95", "high95"))
    arms = np.maximum([value - low, high - value], 0.0)
    axes.errorbar(
        frequency[EACH::EACH], value, yerr=arms, fmt=marker, markersize=3.6, elinewidth=0.9, color=INK,
        markerfacecolor="none" if marker == "s" else INK, label=label,
    )  # fmt: skip


def plot_bar_groups(data: Data) -> Any:
    """Draw the curve through several groups of bars with its 95 % band, and what each group read."""
    figure, grid = panels(size=(5.6, 3.6))
    axes = grid[0, 0]
    frequency = first_array(data, "curve_cy_per_px")
    axes.fill_between(
        frequency,
        first_array(data, "curve_low95"),
        first_array(data, "curve_high95"),
        color=COLOURS[0],
        alpha=0.22,
        linewidth=0,
    )
    axes.plot(frequency, first_array(data, "curve"), color=COLOURS[0], label="one curve through the groups, 95 %")
    axes.errorbar(
        first_array(data, "frequency_cy_per_px"), first_array(data, "mtf"), yerr=1.96 * first_array(data, "sd"), fmt="s", markersize=4,
        elinewidth=1, capsize=2.5, color=INK, label="groups of bars, 95 %",
    )  # fmt: skip
    axes.axhline(0.5, color=INK, linewidth=0.6, alpha=0.5)
    axes.set(xlim=(0, frequency[-1]), ylim=(-0.02, 1.05), xlabel="frequency (cycles per column pitch)")
    axes.set(ylabel="MTF (1)")
    axes.legend(loc="upper right")
    return figure
