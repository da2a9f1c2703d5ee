"""Figures of a gain sweep: gain and noise against the setting, noise against signal."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from charact.reporting.style import (
    COLOURS,
    DATA,
    INK,
    MODEL,
    THIRD,
    WARN,
    first_array,
    panels,
    plot_band,
    plot_line,
    plot_points,
)

Data = Mapping[str, Any]


def plot_noise_against_gain(data: Data) -> Any:
    """Plot covariance gain, and scintillation and read noise at a stated signal, against the gain
    setting.
    """
    figure, grid = panels(1, 2, size=(7.2, 3.8))
    gains, noises = grid[0]
    setting, gain, law = (first_array(data, name) for name in ("setting", "gain_dn", "law_setting"))
    low, high = np.asarray(data["law_interval95_dn"], float)
    plot_band(gains, law, low, high, MODEL)
    plot_line(gains, law, first_array(data, "law_gain_dn"), color=MODEL, label="fit, 95 %")
    sd = gain * first_array(data, "gain_relative_sd")
    plot_points(gains, setting, gain, sd, color=DATA, markersize=4.5, label="each, ± 1 sd")
    joint = np.asarray(data["joint_interval95_dn"], float)
    gains.vlines(
        setting,
        joint[0],
        joint[1],
        color=INK,
        linewidth=2.2,
        alpha=0.5,
        label="by all settings, 95 %",
    )
    gains.set(ylabel="covariance gain (DN)")
    low, middle, high = np.asarray(data["stated_noise_dn"], float)
    plot_band(noises, law, low, high, MODEL)
    pe = float(data["stated_signal_pe"])
    plot_line(
        noises, law, middle, color=MODEL, label=f"scintillation noise at {pe:g} photoelectron/px"
    )
    dark = [(s, d) for s, d in zip(setting, data["dark_noise_dn"], strict=True) if d is not None]
    if dark:
        plot_points(
            noises, *np.array(dark).T, color=THIRD, marker="s", markersize=4.5, label="dark frames"
        )
    if data.get("read_noise_dn") is not None:
        read = float(data["read_noise_dn"])
        noises.axhline(
            read, color=INK, linewidth=0.9, linestyle=":", label=f"read noise {read:.3g} DN"
        )
        low, middle, high = data["knee_setting"]
        if law.min() <= middle <= law.max():
            noises.errorbar(
                [middle],
                [read],
                xerr=[[middle - low], [high - middle]],
                color=WARN,
                marker="D",
                mfc="none",
                markersize=6,
                linestyle="",
                label="knee, 95 %",
            )
    noises.set(ylabel="temporal noise (DN)")
    for axes in (gains, noises):
        axes.set(yscale="log", xlabel=f"{data['knob']} ({data['knob_unit'] or '1'})")
        if data["logarithmic"]:
            axes.set_xscale("log")
            _few_ticks(axes, setting)
        axes.legend(fontsize=7)
    return figure


def _few_ticks(axes: Any, positions: Any) -> None:
    """Set ticks at data positions; a logarithmic axis of less than a decade has too few."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    axes.xaxis.set_major_locator(FixedLocator(positions[:: max(1, -(-len(positions) // 5))]))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))


def plot_noise_by_gain(data: Data) -> Any:
    """Plot noise against signal and, if the light is known, signal against light; one colour for
    each setting.
    """
    lights = [light for light in data["light"] if light is not None]
    figure, grid = panels(1, 2 if lights else 1, size=(7.2 if lights else 5.0, 3.8))
    for number, name in enumerate(data["setting"]):
        signal, noise = (
            np.asarray(data["signal_dn"][number], float),
            np.asarray(data["noise_dn"][number], float),
        )
        line_style = {
            "color": COLOURS[number % len(COLOURS)],
            "marker": "o",
            "markersize": 3.5,
            "linewidth": 0.9,
        }
        grid[0, 0].plot(signal, noise, label=name, **line_style)
        if lights and data["light"][number] is not None:
            grid[0, 1].plot(np.asarray(data["light"][number], float), signal, **line_style)
    grid[0, 0].set(
        xscale="log",
        yscale="log",
        xlabel="signal above the dark (DN)",
        ylabel="temporal noise (DN)",
    )
    grid[0, 0].legend(fontsize=7)
    if lights:
        unit = {"photon": "photons/px"}.get(data["light_unit"], data["light_unit"])
        grid[0, 1].set(
            xscale="log",
            yscale="log",
            xlabel=f"light ({unit})",
            ylabel="signal above the dark (DN)",
        )
        _few_ticks(
            grid[0, 1], np.unique(np.concatenate([np.asarray(light, float) for light in lights]))
        )
    return figure
