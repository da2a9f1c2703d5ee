"""Figures behind the MTF of a whole session: what each target told beside the joint curve, and MTF50 over the field."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from charact.report.plot_helpers import first_array
from charact.report.style import COLOURS, INK, panels

Data = Mapping[str, Any]
AXES = {
    "row_px": "row of the target (px)",
    "col_px": "column of the target (px)",
    "mcp_v": "plate voltage (V)",
    "ln_light": "ln of the light",
}


def plot_joint_mtf(data: Data) -> Any:
    """Residuals of every number that a target told, in standard deviations, target by target."""
    figure, grid = panels(size=(5.6, 3.2))
    axes = grid[0, 0]
    kinds = list(dict.fromkeys(data["kind"]))
    for place, (kind, own) in enumerate(zip(data["kind"], data["residuals_sd"], strict=True)):
        offsets = place + 0.12 * (np.arange(len(own)) - (len(own) - 1) / 2)
        axes.plot(offsets, own, "o", markersize=4, color=COLOURS[kinds.index(kind) % len(COLOURS)])
    axes.axhspan(-1.96, 1.96, color=INK, alpha=0.07, linewidth=0)
    axes.axhline(0, color=INK, linewidth=0.8)
    axes.set_xticks(range(len(data["target"])), data["target"], rotation=30, ha="right")
    axes.set(ylabel="told less joint MTF\n(standard deviations)")
    return figure


def plot_mtf_uniformity(data: Data) -> Any:
    """MTF50 of the targets against each setting that differs, with 95 % intervals and their mean."""
    keys = list(data["slopes"])
    figure, grid = panels(1, len(keys), size=(max(3.4, 2.4 * len(keys)), 3.0), sharey=True)
    value, half = first_array(data, "mtf50_cy_per_px"), 1.96 * first_array(data, "sd_cy_per_px")
    for axes, key in zip(grid[0], keys, strict=True):
        axes.errorbar(first_array(data, key), value, yerr=half, fmt="o", markersize=4, color=COLOURS[0], linewidth=1)
        axes.axhline(data["mean_mtf50_cy_per_px"], color=INK, linewidth=0.8)
        axes.set(xlabel=AXES[key])
    grid[0, 0].set(ylabel="MTF50 (cy/px)")
    return figure
