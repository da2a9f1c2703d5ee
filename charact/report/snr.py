"""Figure of the signal-to-noise ratio against the light: every gain of a session, its law and its minimum."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from charact.report.plot_helpers import first_array, plot_line, plot_points
from charact.report.style import COLOURS, INK, panels

LIGHT_AXES = {"lux": "illuminance as recorded (lux)", "photons/px": "photons as recorded (1/px)", "DN": "signal (DN)"}
Data = Mapping[str, Any]


def plot_snr(data: Data) -> Any:
    """Ratio of a pixel and of an area against the light; dashed, a pixel with what does not change in time."""
    names = [scope["name"] for scope in data["gains"][0]["scopes"]]
    figure, grid = panels(1, len(names), size=(5.8, 3.9), sharex=True)
    level, several = float(data["least_snr"]), len(data["gains"]) > 1
    for axes, name in zip(grid[0], names, strict=True):
        for number, gain in enumerate(data["gains"]):
            colour = COLOURS[number % len(COLOURS)]
            for scope in gain["scopes"]:
                if scope["name"] == name:
                    _plot_snr_law(axes, gain, scope, level, colour, named=several)
        axes.axhline(level, color=INK, linewidth=0.8, linestyle=":")
        unit = data["gains"][0]["unit"] if data["unit"] else "each in its unit"
        axes.set(xscale="log", yscale="log", xlabel=LIGHT_AXES.get(unit, unit), ylabel=f"signal over noise, {name} (1)")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=7)
    return figure


def _plot_snr_law(axes: Any, gain: Data, scope: Data, level: float, colour: str, *, named: bool) -> None:
    """Levels with their errors, the law with its 95 % band, and the minimum with its interval."""
    amount, fitted = first_array(gain, "amount"), np.asarray(gain["fitted"], bool)
    snr, sd = first_array(scope, "snr"), first_array(scope, "snr_sd")
    label = gain["gain"] if named else "levels, ± 1 sd"
    plot_points(axes, amount[fitted], snr[fitted], sd[fitted], color=colour, label=label, markersize=3.5)
    if not fitted.all():
        plot_points(axes, amount[~fitted], snr[~fitted], sd[~fitted], color=colour, mfc="none", markersize=3.5)
    light = first_array(scope, "law_amount")
    axes.fill_between(
        light, first_array(scope, "law_low"), first_array(scope, "law_high"), color=colour, alpha=0.25, linewidth=0
    )
    plot_line(axes, light, first_array(scope, "law_snr"), color=colour, label=None if named else "read and shot noise")
    if scope["name"] == "pixel":
        label = None if named else "with unequal pixels"
        plot_line(
            axes,
            light,
            first_array(scope, "law_with_pattern"),
            color=colour,
            linestyle="--",
            linewidth=0.9,
            label=label,
        )
    if scope.get("minimum") is not None:
        _minimum(axes, scope, level, colour, named)


def _minimum(axes: Any, scope: Data, level: float, colour: str, named: bool) -> None:
    low, high = scope["minimum_interval95"]
    middle = float(scope["minimum"])
    label = None if named else "minimum illumination, 95 %"
    axes.errorbar([middle], [level], xerr=[[middle - low], [high - middle]], color=colour, marker="D", markersize=5,
                  mfc="none", linestyle="", label=label)  # fmt: skip
