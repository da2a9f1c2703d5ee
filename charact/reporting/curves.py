"""Figures of the MTF: edge and bar profiles, joint MTF, and MTF budget."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.reporting.style import (
    COLOURS,
    DATA,
    INK,
    MODEL,
    arms,
    first_array,
    has_all,
    panel,
    panels,
    plot_band,
    plot_line,
    plot_points,
    zero_line,
)
from labdata import Array

Data = Mapping[str, Any]


def half_line(axes: Any) -> None:
    """Mark an MTF of one half."""
    axes.axhline(0.5, color=INK, linewidth=0.6, alpha=0.5)


def plot_edge_spread(data: Data) -> Any:
    """Plot the edge spread function near the edge with its model, and the residual over the fitted
    width.
    """
    x, measured = first_array(data, "distance_px"), first_array(data, "value_dn")
    modelled = has_all(data, "model_dn")
    figure, grid = panels(2, 1, size=(5.6, 4.4), height_ratios=(3, 1.4)) if modelled else panels()
    # Four times the 10-90 % width of the step, at least 8 px, about its middle.
    middle = x[np.argmin(np.abs(measured - (measured.min() + measured.max()) / 2))]
    low, high = np.percentile(measured, [1, 99])
    step = x[(measured > low + 0.1 * (high - low)) & (measured < high - 0.1 * (high - low))]
    within_view = np.abs(x - middle) <= max(8.0, 4.0 * float(np.ptp(step)) if len(step) else 8.0)
    _profile(grid[0, 0], data, x, measured, within_view)
    grid[0, 0].set(xlabel="distance from the edge (px)", ylabel="signal (DN)")
    if modelled:
        _residual(grid[1, 0], data, x, measured, "distance from the edge, complete fit range (px)")
    return figure


def plot_bars(data: Data) -> Any:
    """Plot the profile across the bars with its model, and the residual."""
    x, measured = first_array(data, "distance_px"), first_array(data, "value_dn")
    figure, grid = panels(2, 1, size=(5.6, 4.4), height_ratios=(3, 1.4), sharex=True)
    _profile(grid[0, 0], data, x, measured, np.ones(len(x), bool))
    grid[0, 0].set(ylabel="signal (DN)")
    _residual(grid[1, 0], data, x, measured, "distance across the bars (px)")
    return figure


def _profile(axes: Any, data: Data, x: Array, measured: Array, shown: NDArray[np.bool_]) -> None:
    """Plot measured points and their model."""
    sd = first_array(data, "sd_dn")[shown] if has_all(data, "sd_dn") else None
    label = "measured" if sd is None else "measured, ± 1 sd"
    plot_points(axes, x[shown], measured[shown], sd, color=DATA, alpha=0.7, label=label)
    if has_all(data, "model_dn"):
        plot_line(
            axes,
            x[shown],
            first_array(data, "model_dn")[shown],
            color=MODEL,
            label="model",
            zorder=3,
        )
    axes.legend()


def _residual(axes: Any, data: Data, x: Array, measured: Array, xlabel: str) -> None:
    """Plot the residual, data minus model."""
    axes.set(xlabel=xlabel, ylabel="residual (DN)")
    zero_line(axes)
    if has_all(data, "model_dn"):
        sd = first_array(data, "sd_dn") if has_all(data, "sd_dn") else None
        plot_points(axes, x, measured - first_array(data, "model_dn"), sd, color=DATA, alpha=0.7)


def plot_mtf_differences(data: Data) -> Any:
    """Plot MTF differences between targets at the bar frequencies with joint 95 % intervals."""
    figure, axes = panel((5.6, 3.4))
    frequency, difference, half = (
        first_array(data, key) for key in ("frequency_cy_per_px", "difference", "half_width")
    )
    for number, (colour, pair) in enumerate(
        zip(COLOURS, dict.fromkeys(data["pair"]), strict=False)
    ):
        shown = np.array(data["pair"]) == pair
        axes.errorbar(
            frequency[shown] + 0.003 * (number - 1),
            difference[shown],
            yerr=half[shown],
            color=colour,
            linestyle="",
            marker="o",
            markersize=4,
            label=pair,
        )
    zero_line(axes)
    axes.set(xlabel="spatial frequency (cy/px)", ylabel="difference of MTFs, joint 95 % (1)")
    limit = float(np.max(np.abs(difference) + half))
    axes.set_ylim(-1.1 * limit, 1.5 * limit)
    axes.legend(ncols=3, loc="upper center")
    return figure


def plot_joint_mtf(data: Data) -> Any:
    """Plot the residuals of the joint MTF for each target, in standard deviations."""
    figure, axes = panel((5.6, 3.2))
    kinds = list(dict.fromkeys(data["kind"]))
    for number, (kind, residuals) in enumerate(
        zip(data["kind"], data["residuals_sd"], strict=True)
    ):
        offsets = number + 0.12 * (np.arange(len(residuals)) - (len(residuals) - 1) / 2)
        axes.plot(
            offsets, residuals, "o", markersize=4, color=COLOURS[kinds.index(kind) % len(COLOURS)]
        )
    axes.axhspan(-1.96, 1.96, color=INK, alpha=0.07, linewidth=0)
    zero_line(axes)
    axes.set_xticks(range(len(data["target"])), data["target"], rotation=30, ha="right")
    axes.set(ylabel="target minus joint MTF\n(standard deviations)")
    return figure


UNIFORMITY_AXES = {
    "row_px": "row of the target (px)",
    "col_px": "column of the target (px)",
    "mcp_v": "MCP voltage (V)",
    "ln_light": "ln of the light",
}


def plot_mtf_uniformity(data: Data) -> Any:
    """Plot the MTF50 of the targets against each varied setting, with 95 % intervals and mean."""
    keys = list(data["slopes"])
    figure, grid = panels(1, len(keys), size=(max(3.4, 2.4 * len(keys)), 3.0), sharey=True)
    value, half = first_array(data, "mtf50_cy_per_px"), 1.96 * first_array(data, "sd_cy_per_px")
    for axes, key in zip(grid[0], keys, strict=True):
        axes.errorbar(
            first_array(data, key),
            value,
            yerr=half,
            fmt="o",
            markersize=4,
            color=COLOURS[0],
            linewidth=1,
        )
        axes.axhline(data["mean_mtf50_cy_per_px"], color=INK, linewidth=0.8)
        axes.set(xlabel=UNIFORMITY_AXES[key])
    grid[0, 0].set(ylabel="MTF50 (cy/px)")
    return figure


# Colour of each stage, the same in every report.
STAGES = {
    "lens": COLOURS[2],
    "halo": COLOURS[3],
    "tube before the gain": COLOURS[4],
    "tube after the gain": COLOURS[1],
    "taper": COLOURS[6],
    "pixel": COLOURS[5],
    "video": COLOURS[0],
}


def plot_mtf_budget(data: Data) -> Any:
    """Plot the MTF of every stage with 95 % bands, their product, and the measured curves with
    error bars.
    """
    figure, grid = panels(2, 1, size=(5.6, 7.4), sharex=True)
    handles = {}
    for axes, direction, title in zip(
        grid[:, 0], ("horizontal", "vertical"), ("Along rows", "Along columns"), strict=True
    ):
        _plot_direction(axes, data[direction], {*data["identified"], *data["known"]})
        axes.set_title(title, loc="left")
        handles.update(dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True)))
    rows = data["horizontal"]
    scale = float(
        first_array(rows, "cathode_lp_per_mm")[-1]
        / first_array(rows, "frequency_cy_per_column")[-1]
    )
    cathode_axis = grid[0, 0].secondary_xaxis(
        "top", functions=(lambda x: x * scale, lambda x: x / scale)
    )
    cathode_axis.set_xlabel("at the photocathode (lp/mm)")
    grid[1, 0].set(xlabel="frequency (cycles per column pitch)")
    figure.legend(
        handles.values(),
        handles.keys(),
        loc="outside lower center",
        ncols=3,
        title_fontsize=8,
        columnspacing=1.4,
        title=(
            "solid: identified or known; dashed: from the description, or only as a product; "
            "bands: 95 %"
        ),
    )
    return figure


def _plot_direction(axes: Any, data: Data, solid: set[str]) -> None:
    """Plot one direction: identified and known stages solid, those from the description dashed."""
    frequency = first_array(data, "frequency_cy_per_column")
    for stage, band in data["stages"].items():
        value, low, high = (first_array(band, name) for name in ("value", "low95", "high95"))
        # A stage whose MTF stays above this is not shown, and a narrower band is a line.
        if np.min(value) >= 0.9995:
            continue
        colour = STAGES.get(stage, COLOURS[7])
        if np.max(high - low) > 1e-3:
            axes.fill_between(
                frequency,
                low,
                high,
                facecolor=(colour, 0.1),
                edgecolor=(colour, 0.45),
                linewidth=0.5,
            )
        style = "-" if stage in solid else (0, (4, 2))
        axes.plot(frequency, value, color=colour, linestyle=style, linewidth=1.3, label=stage)
    if "measured_after_gain" in data:
        product = first_array(data["product_after_gain"], "value")
        axes.plot(
            frequency, product, color=INK, linewidth=1.1, alpha=0.55, label="product after the gain"
        )
        _plot_measured(
            axes, frequency, data["measured_after_gain"], "s", "measured after the gain, 95 %"
        )
    axes.plot(
        frequency,
        first_array(data["product"], "value"),
        color=INK,
        linewidth=1.8,
        label="product of all",
    )
    _plot_measured(axes, frequency, data["measured"], "o", "measured, 95 %")
    half_line(axes)
    axes.set(xlim=(0, frequency[-1]), ylim=(-0.02, 1.03), ylabel="MTF (1)")


def _plot_measured(axes: Any, frequency: Any, band: Data, marker: str, label: str) -> None:
    """Plot every eighth point of a measured curve with 95 % error bars."""
    value, low, high = (first_array(band, name)[8::8] for name in ("value", "low95", "high95"))
    axes.errorbar(
        frequency[8::8],
        value,
        yerr=arms(value, low, high),
        fmt=marker,
        markersize=3.6,
        elinewidth=0.9,
        color=INK,
        markerfacecolor="none" if marker == "s" else INK,
        label=label,
    )


def plot_bar_groups(data: Data) -> Any:
    """Plot the MTF of several bar groups and the curve through them with its 95 % band."""
    figure, axes = panel((5.6, 3.6))
    frequency = first_array(data, "curve_cy_per_px")
    plot_band(
        axes,
        frequency,
        first_array(data, "curve_low95"),
        first_array(data, "curve_high95"),
        COLOURS[0],
        0.22,
    )
    axes.plot(
        frequency,
        first_array(data, "curve"),
        color=COLOURS[0],
        label="curve through the groups, 95 %",
    )
    axes.errorbar(
        first_array(data, "frequency_cy_per_px"),
        first_array(data, "mtf"),
        yerr=1.96 * first_array(data, "sd"),
        fmt="s",
        markersize=4,
        elinewidth=1,
        capsize=2.5,
        color=INK,
        label="bar groups, 95 %",
    )
    half_line(axes)
    axes.set(
        xlim=(0, frequency[-1]), ylim=(-0.02, 1.05), xlabel="frequency (cycles per column pitch)"
    )
    axes.set(ylabel="MTF (1)")
    axes.legend(loc="upper right")
    return figure
