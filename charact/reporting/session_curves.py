"""Figures of curves that several measurements of a session make together."""

from collections.abc import Mapping
from typing import Any

from charact.reporting.curves import half_line
from charact.reporting.style import (
    DATA,
    MODEL,
    first_array,
    panel,
    plot_band,
    plot_line,
    plot_points,
)

Data = Mapping[str, Any]


def plot_sfr(data: Data) -> Any:
    """Plot the conventional SFR of an edge and its MTF by another method."""
    figure, axes = panel((5.6, 3.4))
    frequency = first_array(data, "frequency_cy_per_px")
    plot_line(axes, frequency, data["mtf"], color=MODEL, label=f"MTF, {data['method']}")
    plot_line(axes, frequency, data["sfr"], color=DATA, label="SFR, ISO 12233")
    half_line(axes)
    axes.set(xlabel="spatial frequency (cy/px)", ylabel="MTF and SFR (1)", ylim=(0.0, 1.1))
    axes.legend()
    return figure


def plot_neq(data: Data) -> Any:
    """Plot noise-equivalent quanta against frequency with their 95 % band."""
    figure, axes = panel((5.6, 3.4))
    frequency = first_array(data, "frequency_cy_per_px")
    low, high = data["interval95"]
    plot_band(axes, frequency, low, high, MODEL)
    plot_line(axes, frequency, data["neq_per_px"], color=MODEL)
    axes.set(xlabel="spatial frequency (cy/px)", ylabel="noise-equivalent quanta (1/px)")
    axes.set_ylim(0.0)
    return figure


def plot_through_focus(data: Data) -> Any:
    """Plot MTF50 of targets against the focus, with the fitted curve and its 95 % band."""
    figure, axes = panel((5.6, 3.4))
    if "grid_mm" in data:
        low, high = data["interval95"]
        plot_band(axes, data["grid_mm"], low, high, MODEL)
        plot_line(axes, data["grid_mm"], data["value"], color=MODEL, label="fitted")
    plot_points(axes, data["focus_mm"], data["mtf50_cy_per_px"], data["sd_cy_per_px"], color=DATA)
    axes.set(xlabel="focus (mm)", ylabel="MTF50 (cy/px)")
    return figure
