"""Figures of the MTF: curves of all targets, edge and bar profiles, joint MTF, and MTF budget."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.report.style import (
    COLOURS,
    DATA,
    INK,
    MODEL,
    as_svg,
    first_array,
    has_all,
    panels,
    plot_line,
    plot_points,
    report_style,
    subsample,
)
from charact.report.truth import Truth
from labdata.measurement import Curve, Measurement, Result
from labdata.session import Session

HORIZONTAL, VERTICAL, SLANTED = "horizontal frequency", "vertical frequency", "slanted frequency"
DEGREES = {HORIZONTAL: 0.0, VERTICAL: 90.0, SLANTED: 45.0}


def mtf_svgs(session: Session | None, result: Result, truth: Truth | None = None) -> tuple[str, ...]:
    """Plot all MTF curves and bar-target points of a result, one figure for each direction.

    Parameters
    ----------
    session
        The session, for the direction of each target; None for a single file.
    result
        Curves whose name starts with "mtf" and measurements of the quantity "mtf".
    truth
        True values; the entry "mtf" may be a function of frequency and direction.

    Returns
    -------
    tuple of str
        SVG elements; empty if there is no curve and no point.
    """
    curves = [(name, curve) for name, curve in result.curves.items() if name.split(":")[0].startswith("mtf")]
    points = [m for m in result.find("mtf") if m.value is not None and m.frequency_cy_per_px is not None]
    ways = [_direction(session, name, curve.stack) for name, curve in curves]
    point_ways = [_point_way(session, m) for m in points]
    drawn = []
    for way in (way for way in DEGREES if way in (*ways, *point_ways)):
        own = [item for item, its in zip(curves, ways, strict=True) if its == way]
        single = [m for m, its in zip(points, point_ways, strict=True) if its == way]
        with report_style():
            figure, grid = panels(size=(5.6, 3.9))
            _plot_curves(grid[0, 0], way, own, single, truth)
            drawn.append(as_svg(figure, f"MTF of all targets against {way}, with 95 % bands"))
    return tuple(drawn)


def _way(angle_deg: float | None) -> str:
    """Return the direction of a frequency as text."""
    if angle_deg is None:
        return HORIZONTAL
    off = abs((angle_deg + 90) % 180 - 90)
    return HORIZONTAL if off < 25 else VERTICAL if off > 65 else SLANTED


def _point_way(session: Session | None, m: Measurement) -> str:
    """Return the direction of a measurement, else that of its target."""
    return _target_way(session, m.stack) if m.orientation_deg is None else _way(m.orientation_deg)


def _target_way(session: Session | None, label: str | None) -> str:
    known = {} if session is None else {entry.label: entry.target.angle_deg for entry in session.stacks}
    return _way(known.get(label or ""))


def _direction(session: Session | None, name: str, label: str | None) -> str:
    """Return the direction of a curve, from its name or from the target of its stack."""
    kind, _, suffix = name.partition(":")
    return VERTICAL if "vertical" in kind else _target_way(session, label or suffix)


def _plot_curves(
    axes: Any, way: str, curves: list[tuple[str, Curve]], points: list[Measurement], truth: Truth | None
) -> None:
    """Plot one direction: bands, curves, points, truth."""
    top = max([0.5, *(float(curve.frequency_cy_per_px[-1]) for _, curve in curves)])
    for colour, (name, curve) in zip(COLOURS * 4, curves, strict=False):
        _plot_curve(axes, curve, colour, name.partition(":")[2] or curve.stack or name)
    drawn = {curve.stack or name.partition(":")[2] for name, curve in curves}
    # Values read from a curve that is shown are redundant; those of bars are measurements.
    own = [m for m in points if m.method.startswith("bars") or (m.stack or "") not in drawn]
    for m in own:
        axes.errorbar(m.frequency_cy_per_px, m.value, yerr=_arms(m), fmt="s", markersize=4.5, color=INK, linewidth=1)
    if own:
        axes.plot([], [], "s", color=INK, markersize=4.5, label="MTF at one frequency, 95 %")
    known = (truth or {}).get("mtf")
    if callable(known):
        frequency = np.linspace(1e-4, min(top, 1.0), 120)
        axes.plot(frequency, known(frequency, DEGREES[way]), "--", color=INK, linewidth=1.2, label="truth")
    axes.axhline(0.5, color=INK, linewidth=0.6, alpha=0.5)
    axes.set(xlim=(0, min(top, 0.75)), ylim=(-0.05, 1.15), title=f"{way.capitalize()}; bands hold 95 %")
    axes.set(xlabel="spatial frequency (cy/px)", ylabel="MTF (1)")
    axes.legend(loc="upper right")


def _arms(m: Measurement) -> Any:
    """Return the distances to the limits of the 95 % interval, shape (2, 1)."""
    if m.interval95 is None or m.value is None:
        return None
    return np.maximum([[m.value - m.interval95[0]], [m.interval95[1] - m.value]], 0)


def _plot_curve(axes: Any, curve: Curve, colour: str, label: str) -> None:
    """Plot one curve with its 95 % band."""
    band = curve.interval95
    low, high = (curve.value, curve.value) if band is None else band
    frequency, value, low, high = subsample(curve.frequency_cy_per_px, curve.value, low, high, most=120)
    if band is not None:
        axes.fill_between(frequency, low, high, color=colour, alpha=0.22, linewidth=0)
    axes.plot(frequency, value, color=colour, label=label)


Data = Mapping[str, Any]
Array = NDArray[np.float64]


def plot_edge_spread(data: Data) -> Any:
    """Plot the edge spread function near the edge with its model, and the residual over the fitted width."""
    x, measured = first_array(data, "distance_px"), first_array(data, "value_dn")
    modelled = has_all(data, "model_dn")
    figure, grid = panels(2, 1, size=(5.6, 4.4), height_ratios=(3, 1.4)) if modelled else panels()
    near = np.abs(x - _middle(x, measured)) <= _half_range(x, measured)
    _profile(grid[0, 0], data, x, measured, near)
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


def plot_mtf_differences(data: Data) -> Any:
    """Plot MTF differences between targets at the bar frequencies with joint 95 % intervals."""
    figure, grid = panels(size=(5.6, 3.4))
    axes = grid[0, 0]
    frequency, pairs = first_array(data, "frequency_cy_per_px"), np.array(data["pair"])
    for number, (colour, pair) in enumerate(zip(COLOURS, dict.fromkeys(data["pair"]), strict=False)):
        shown = pairs == pair
        axes.errorbar(
            frequency[shown] + 0.003 * (number - 1), first_array(data, "difference")[shown],
            yerr=first_array(data, "half_width")[shown], color=colour, linestyle="", marker="o", markersize=4,
            label=pair,
        )  # fmt: skip
    axes.axhline(0, color=INK, linewidth=0.8)
    axes.set(xlabel="spatial frequency (cy/px)", ylabel="difference of MTFs, joint 95 % (1)")
    reach = float(np.max(np.abs(first_array(data, "difference")) + first_array(data, "half_width")))
    axes.set_ylim(-1.1 * reach, 1.5 * reach)
    axes.legend(ncols=3, loc="upper center")
    return figure


def _profile(axes: Any, data: Data, x: Array, measured: Array, shown: NDArray[np.bool_]) -> None:
    """Plot measured points and their model."""
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
    """Plot the residual, data minus model."""
    axes.set(xlabel=xlabel, ylabel="residual (DN)")
    axes.axhline(0, color=INK, linewidth=0.8)
    if has_all(data, "model_dn"):
        sd = first_array(data, "sd_dn") if has_all(data, "sd_dn") else None
        plot_points(axes, x, measured - first_array(data, "model_dn"), sd, color=DATA, alpha=0.7)


def _middle(x: Array, measured: Array) -> float:
    """Return the position of half the step."""
    half = (measured.min() + measured.max()) / 2
    return float(x[np.argmin(np.abs(measured - half))])


def _half_range(x: Array, measured: Array) -> float:
    """Return four times the 10-90 % width of the step, at least 8 px."""
    low, high = np.percentile(measured, [1, 99])
    inside = x[(measured > low + 0.1 * (high - low)) & (measured < high - 0.1 * (high - low))]
    return max(8.0, 4.0 * float(np.ptp(inside)) if len(inside) else 8.0)


AXES = {
    "row_px": "row of the target (px)",
    "col_px": "column of the target (px)",
    "mcp_v": "MCP voltage (V)",
    "ln_light": "ln of the light",
}


def plot_joint_mtf(data: Data) -> Any:
    """Plot the residuals of the joint MTF for each target, in standard deviations."""
    figure, grid = panels(size=(5.6, 3.2))
    axes = grid[0, 0]
    kinds = list(dict.fromkeys(data["kind"]))
    for place, (kind, own) in enumerate(zip(data["kind"], data["residuals_sd"], strict=True)):
        offsets = place + 0.12 * (np.arange(len(own)) - (len(own) - 1) / 2)
        axes.plot(offsets, own, "o", markersize=4, color=COLOURS[kinds.index(kind) % len(COLOURS)])
    axes.axhspan(-1.96, 1.96, color=INK, alpha=0.07, linewidth=0)
    axes.axhline(0, color=INK, linewidth=0.8)
    axes.set_xticks(range(len(data["target"])), data["target"], rotation=30, ha="right")
    axes.set(ylabel="target minus joint MTF\n(standard deviations)")
    return figure


def plot_mtf_uniformity(data: Data) -> Any:
    """Plot the MTF50 of the targets against each varied setting, with 95 % intervals and mean."""
    keys = list(data["slopes"])
    figure, grid = panels(1, len(keys), size=(max(3.4, 2.4 * len(keys)), 3.0), sharey=True)
    value, half = first_array(data, "mtf50_cy_per_px"), 1.96 * first_array(data, "sd_cy_per_px")
    for axes, key in zip(grid[0], keys, strict=True):
        axes.errorbar(first_array(data, key), value, yerr=half, fmt="o", markersize=4, color=COLOURS[0], linewidth=1)
        axes.axhline(data["mean_mtf50_cy_per_px"], color=INK, linewidth=0.8)
        axes.set(xlabel=AXES[key])
    grid[0, 0].set(ylabel="MTF50 (cy/px)")
    return figure


# Colour of each stage, the same in every report.
STAGES = dict(
    zip(
        ("lens", "halo", "tube before the gain", "tube after the gain", "taper", "pixel", "video"),
        (COLOURS[2], COLOURS[3], COLOURS[4], COLOURS[1], COLOURS[6], COLOURS[5], COLOURS[0]),
        strict=True,
    )
)
DIRECTIONS = {"horizontal": "Along rows", "vertical": "Along columns"}
# Points of a measured curve per marker.
EACH = 8
LINES = "solid: identified or known; dashed: from the description, or only as a product; bands: 95 %"


def plot_mtf_budget(data: Data) -> Any:
    """Plot the MTF of every stage with 95 % bands, their product, and the measured curves with error bars."""
    figure, grid = panels(2, 1, size=(5.6, 7.4), sharex=True)
    solid = {*data["identified"], *data["known"]}
    handles = {}
    for axes, (direction, title) in zip(grid[:, 0], DIRECTIONS.items(), strict=True):
        _plot_direction(axes, data[direction], solid)
        axes.set_title(title, loc="left")
        handles.update(dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True)))
    _at_the_cathode(grid[0, 0], data["horizontal"])
    grid[1, 0].set(xlabel="frequency (cycles per column pitch)")
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
    """Plot one direction: identified and known stages solid, those from the description dashed."""
    frequency = first_array(panel, "frequency_cy_per_column")
    for stage, band in panel["stages"].items():
        # A stage whose MTF stays above this is not shown.
        if np.min(first_array(band, "value")) < 0.9995:
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
    """Add an axis with frequencies at the photocathode."""
    scale = float(first_array(panel, "cathode_lp_per_mm")[-1] / first_array(panel, "frequency_cy_per_column")[-1])
    above = axes.secondary_xaxis("top", functions=(lambda x: x * scale, lambda x: x / scale))
    above.set_xlabel("at the photocathode (lp/mm)")


def _plot_band(axes: Any, frequency: Any, band: Data, colour: str) -> None:
    """Plot a transparent band with thin borders; bands overlap."""
    low, high = first_array(band, "low95"), first_array(band, "high95")
    # A narrower band is shown as a line.
    if np.max(high - low) > 1e-3:
        axes.fill_between(frequency, low, high, facecolor=(colour, 0.1), edgecolor=(colour, 0.45), linewidth=0.5)


def _plot_measured(axes: Any, frequency: Any, band: Data, marker: str, label: str) -> None:
    """Plot a measured curve as points with 95 % error bars."""
    value, low, high = (first_array(band, name)[EACH::EACH] for name in ("value", "low95", "high95"))
    arms = np.maximum([value - low, high - value], 0.0)
    axes.errorbar(
        frequency[EACH::EACH], value, yerr=arms, fmt=marker, markersize=3.6, elinewidth=0.9, color=INK,
        markerfacecolor="none" if marker == "s" else INK, label=label,
    )  # fmt: skip


def plot_bar_groups(data: Data) -> Any:
    """Plot the MTF of several bar groups and the curve through them with its 95 % band."""
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
    axes.plot(frequency, first_array(data, "curve"), color=COLOURS[0], label="curve through the groups, 95 %")
    axes.errorbar(
        first_array(data, "frequency_cy_per_px"), first_array(data, "mtf"), yerr=1.96 * first_array(data, "sd"),
        fmt="s", markersize=4,
        elinewidth=1, capsize=2.5, color=INK, label="bar groups, 95 %",
    )  # fmt: skip
    axes.axhline(0.5, color=INK, linewidth=0.6, alpha=0.5)
    axes.set(xlim=(0, frequency[-1]), ylim=(-0.02, 1.05), xlabel="frequency (cycles per column pitch)")
    axes.set(ylabel="MTF (1)")
    axes.legend(loc="upper right")
    return figure
