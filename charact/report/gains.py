"""Figures of noise against gain: gain and read noise along what sets it, and noise against signal at every gain."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from charact.report.plot_helpers import first_array, plot_line, plot_points
from charact.report.style import COLOURS, DATA, INK, MODEL, THIRD, WARN, panels

Data = Mapping[str, Any]


def plot_noise_against_gain(data: Data) -> Any:
    """Covariance gain with its law, noise of darks, and scintillation and read noise at a stated signal: the knee."""
    figure, grid = panels(1, 2, size=(7.2, 3.8))
    gains, noises = grid[0]
    setting, gain = first_array(data, "setting"), first_array(data, "gain_dn")
    law, middle = first_array(data, "law_setting"), first_array(data, "law_gain_dn")
    low, high = np.asarray(data["law_interval95_dn"], float)
    gains.fill_between(law, low, high, color=MODEL, alpha=0.25, linewidth=0)
    plot_line(gains, law, middle, color=MODEL, label="law, 95 %")
    plot_points(
        gains,
        setting,
        gain,
        gain * first_array(data, "gain_relative_sd"),
        color=DATA,
        markersize=4.5,
        label="each, ± 1 sd",
    )
    joint = np.asarray(data["joint_interval95_dn"], float)
    gains.vlines(setting, joint[0], joint[1], color=INK, linewidth=2.2, alpha=0.5, label="by all settings, 95 %")
    gains.set(ylabel="covariance gain (DN)")
    scintillation = np.asarray(data["stated_noise_dn"], float)
    noises.fill_between(law, scintillation[0], scintillation[2], color=MODEL, alpha=0.25, linewidth=0)
    pe = float(data["stated_signal_pe"])
    plot_line(noises, law, scintillation[1], color=MODEL, label=f"light's noise at {pe:g} photoelectron/px")
    dark = [(s, d) for s, d in zip(setting, data["dark_noise_dn"], strict=True) if d is not None]
    if dark:
        plot_points(noises, *np.array(dark).T, color=THIRD, marker="s", markersize=4.5, label="dark frames")
    _knee(noises, data)
    noises.set(ylabel="noise of a pixel (DN)")
    unit = "" if data["knob_unit"] == "1" else data["knob_unit"]
    for axes in (gains, noises):
        axes.set(yscale="log", xlabel=f"{data['knob']} ({unit or '1'})")
        if data["logarithmic"]:
            axes.set_xscale("log")
            _few_ticks(axes, setting)
        axes.legend(fontsize=7)
    return figure


def _few_ticks(axes: Any, places: Any) -> None:
    """Ticks at places of data, written as they are; a logarithmic axis of less than a decade has none to speak of."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    axes.xaxis.set_major_locator(FixedLocator(places[:: max(1, -(-len(places) // 5))]))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))


def _knee(axes: Any, data: Data) -> None:
    """Read noise without scintillation, and where the light's noise is as large."""
    if data.get("read_noise_dn") is None:
        return
    read = float(data["read_noise_dn"])
    axes.axhline(read, color=INK, linewidth=0.9, linestyle=":", label=f"read noise {read:.3g} DN")
    low, middle, high = data["knee_setting"]
    if not min(data["law_setting"]) <= middle <= max(data["law_setting"]):
        return
    axes.errorbar([middle], [read], xerr=[[middle - low], [high - middle]], color=WARN, marker="D", mfc="none",
                  markersize=6, linestyle="", label="knee, 95 %")  # fmt: skip


def plot_noise_by_gain(data: Data) -> Any:
    """Noise of a pixel against the signal, and signal against light where it is known: one colour for each setting."""
    lights = [light for light in data["light"] if light is not None]
    figure, grid = panels(1, 2 if lights else 1, size=(7.2 if lights else 5.0, 3.8))
    for number, name in enumerate(data["setting"]):
        colour = COLOURS[number % len(COLOURS)]
        signal, noise = np.asarray(data["signal_dn"][number], float), np.asarray(data["noise_dn"][number], float)
        own = {"color": colour, "marker": "o", "markersize": 3.5, "linewidth": 0.9}
        grid[0, 0].plot(signal, noise, label=name, **own)
        if lights and data["light"][number] is not None:
            grid[0, 1].plot(np.asarray(data["light"][number], float), signal, **own)
    grid[0, 0].set(xscale="log", yscale="log", xlabel="signal above the dark (DN)", ylabel="noise of a pixel (DN)")
    grid[0, 0].legend(fontsize=7)
    if lights:
        unit = {"photon": "photons/px"}.get(data["light_unit"], data["light_unit"])
        grid[0, 1].set(xscale="log", yscale="log", xlabel=f"light ({unit})", ylabel="signal above the dark (DN)")
        _few_ticks(grid[0, 1], np.unique(np.concatenate([np.asarray(light, float) for light in lights])))
    return figure
