"""Figures behind an MTF: edge spread with its model and what is left over, and bars with theirs."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.report.plot_helpers import first_array, has_all, plot_line, plot_points
from charact.report.style import COLOURS, DATA, INK, MODEL, panels

Data = Mapping[str, Any]
Array = NDArray[np.float64]


def plot_edge_spread(data: Data) -> Any:
    """Edge spread near the edge with its model, and the residual over the whole width that was fitted."""
    x, measured = first_array(data, "distance_px"), first_array(data, "value_dn")
    modelled = has_all(data, "model_dn")
    figure, grid = panels(2, 1, size=(5.6, 4.4), height_ratios=(3, 1.4)) if modelled else panels()
    near = np.abs(x - _middle(x, measured)) <= _reach(x, measured)
    _profile(grid[0, 0], data, x, measured, near)
    grid[0, 0].set(xlabel="distance from the edge, near it (px)", ylabel="signal (DN)")
    if modelled:
        _residual(grid[1, 0], data, x, measured, "distance from the edge, all that was fitted (px)")
    return figure


def plot_bars(data: Data) -> Any:
    """Profile across the bars with its model, and the residual."""
    x, measured = first_array(data, "distance_px"), first_array(data, "value_dn")
    figure, grid = panels(2, 1, size=(5.6, 4.4), height_ratios=(3, 1.4), sharex=True)
    _profile(grid[0, 0], data, x, measured, np.ones(len(x), bool))
    grid[0, 0].set(ylabel="signal (DN)")
    _residual(grid[1, 0], data, x, measured, "distance across the bars (px)")
    return figure


def plot_mtf_differences(data: Data) -> Any:
    """Differences between targets at the bars' frequencies with their joint 95 % intervals."""
    figure, grid = panels(size=(5.6, 3.4))
    axes = grid[0, 0]
    frequency, pairs = first_array(data, "frequency_cy_per_px"), np.array(data["pair"])
    for number, (colour, pair) in enumerate(zip(COLOURS, dict.fromkeys(data["pair"]), strict=False)):
        shown = pairs == pair
        axes.errorbar(
            frequency[shown] + 0.003 * (number - 1), first_array(data, "difference")[shown],
            yerr=first_array(data, "half_width")[shown], color=colour, linestyle="", marker="o", markersize=4, label=pair,
        )  # fmt: skip
    axes.axhline(0, color=INK, linewidth=0.8)
    axes.set(xlabel="spatial frequency (cy/px)", ylabel="difference of MTFs, joint 95 % (1)")
    reach = float(np.max(np.abs(first_array(data, "difference")) + first_array(data, "half_width")))
    axes.set_ylim(-1.1 * reach, 1.5 * reach)
    axes.legend(ncols=3, loc="upper center")
    return figure


def _profile(axes: Any, data: Data, x: Array, measured: Array, shown: NDArray[np.bool_]) -> None:
    """Measured points under their model."""
    sd = first_array(data, "sd_dn")[shown] if has_all(data, "sd_dn") else None
    plot_points(
        axes,
        x[shown],
        measured[shown],
        sd,
        color=DATA,
        alpha=0.7,
        label="measured" if sd is None else "measured, ± 1 sd",
    )
    if has_all(data, "model_dn"):
        plot_line(axes, x[shown], first_array(data, "model_dn")[shown], color=MODEL, label="model", zorder=3)
    axes.legend()


def _residual(axes: Any, data: Data, x: Array, measured: Array, xlabel: str) -> None:
    """Measured less model, in the same unit."""
    axes.set(xlabel=xlabel, ylabel="residual (DN)")
    axes.axhline(0, color=INK, linewidth=0.8)
    if has_all(data, "model_dn"):
        sd = first_array(data, "sd_dn") if has_all(data, "sd_dn") else None
        plot_points(axes, x, measured - first_array(data, "model_dn"), sd, color=DATA, alpha=0.7)


def _middle(x: Array, measured: Array) -> float:
    """Where the profile is half way up."""
    half = (measured.min() + measured.max()) / 2
    return float(x[np.argmin(np.abs(measured - half))])


def _reach(x: Array, measured: Array) -> float:
    """Four times the distance between a tenth and nine tenths of the step, at least 8 px."""
    low, high = np.percentile(measured, [1, 99])
    inside = x[(measured > low + 0.1 * (high - low)) & (measured < high - 0.1 * (high - low))]
    return max(8.0, 4.0 * float(np.ptp(inside)) if len(inside) else 8.0)
