"""Figures of curves that several measurements of a session make together."""

from collections.abc import Mapping
from typing import Any

from charact.reporting.curves import half_line
from charact.reporting.style import DATA, MODEL, first_array, panel, plot_line

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
