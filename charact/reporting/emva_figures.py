"""Figures of a data sheet of EMVA 1288: linearity, signal-to-noise ratio, dark current,
spectrograms, profiles and histograms.
"""

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
    plot_line,
    plot_points,
    zero_line,
)

Data = Mapping[str, Any]
# Figure of the dark and of the response: unit of its data, name of its number, and axis.
KINDS = (("dn", "DSNU", "DN"), ("percent", "PRNU", "%"))


def plot_linearity(data: Data) -> Any:
    """Plot the signal with the fitted line, and the deviation from it."""
    figure, grid = panels(1, 2, size=(6.4, 3.0))
    light, fitted = first_array(data, "photons"), first_array(data, "fitted_photons")
    plot_points(grid[0, 0], light, first_array(data, "signal_dn"), color=DATA, label="levels")
    line = first_array(data, "line_dn")
    plot_line(grid[0, 0], fitted, line, color=MODEL, label="line, 5 to 95 %")
    grid[0, 0].set(ylabel="signal above the dark (DN)")
    grid[0, 0].legend(loc="lower right", fontsize=7)
    deviation = first_array(data, "deviation_percent")
    grid[0, 1].plot(fitted, deviation, "o-", color=DATA, markersize=3, linewidth=0.8)
    zero_line(grid[0, 1])
    grid[0, 1].set(ylabel="deviation from the line (%)")
    for axes in grid[0]:
        axes.set(xlabel="photons per pixel")
    return figure


def plot_signal_to_noise_ratio(data: Data) -> Any:
    """Plot the signal-to-noise ratio of the levels, of the linear camera model without and with
    nonuniformity, and of an ideal camera.

        SNR = eta p/(s_d^2 + s_q^2/K^2 + eta p + DSNU^2 + (PRNU eta p)^2)^(1/2)   (eq. 21, 69)
    """
    figure, grid = panels(1, 1, size=(6.4, 3.6))
    axes = grid[0, 0]
    low, high = float(data["threshold_photons"]), float(data["saturation_photons"])
    light = np.geomspace(low, high, 100)
    electrons = float(data["electrons_per_photon"]) * light
    noise_e2 = float(data["dark_e2"]) + electrons
    pattern_e2 = float(data["dsnu_e"]) ** 2 + (float(data["prnu"]) * electrons) ** 2
    names = ("photons", "snr")
    plot_points(axes, *(first_array(data, name) for name in names), color=DATA, label="levels")
    for label, snr, colour, style in (
        ("linear model, eq. 21", electrons / np.sqrt(noise_e2), MODEL, "-"),
        ("with nonuniformity, eq. 69", electrons / np.sqrt(noise_e2 + pattern_e2), THIRD, "--"),
        ("ideal camera", np.sqrt(light), INK, ":"),
    ):
        plot_line(axes, light, snr, color=colour, linestyle=style, label=label)
    for end, label in ((low, "threshold and saturation"), (high, None)):
        axes.axvline(end, color=WARN, linewidth=0.8, label=label)
    axes.set(xscale="log", yscale="log", xlabel="photons per pixel", ylabel="signal over noise (1)")
    axes.legend()
    return figure


def plot_dark_current(data: Data) -> Any:
    """Plot mean and temporal variance of the darks against their exposure."""
    figure, grid = panels(1, 2, size=(6.4, 2.8))
    for axes, name, unit in (
        (grid[0, 0], "mean", "dn"),
        (grid[0, 1], "variance", "dn2"),
    ):
        numbers = (first_array(data, f"{name}_{part}{unit}") for part in ("", "sd_"))
        plot_points(axes, first_array(data, "exposure_s"), *numbers, color=DATA)
        shown = "(DN)" if unit == "dn" else "(DN²)"
        axes.set(xlabel="exposure (s)", ylabel=f"{name} of the dark {shown}")
    return figure


def plot_spectrograms(data: Data) -> Any:
    """Plot the spectrograms of dark and response along rows and columns, with temporal and spatial
    noise.
    """
    figure, grid = panels(2, 2, size=(6.4, 5.2), sharex=True)
    for column, (unit, name, shown) in zip(grid.T, KINDS, strict=True):
        for axes, way in zip(column, ("horizontal", "vertical"), strict=True):
            spectrum = first_array(data, f"{way}_{unit}")
            frequency = 0.5 * np.arange(1, len(spectrum) + 1) / len(spectrum)
            plot_line(axes, frequency, spectrum, color=DATA, linewidth=0.9)
            for mark, colour, label in (
                ("temporal", MODEL, "temporal noise of a frame"),
                ("measured", INK, "spatial, as measured"),
                ("1288", WARN, "nonuniformity of EMVA 1288"),
            ):
                if (level := float(data[f"{mark}_{unit}"])) > 0.0:
                    axes.axhline(level, color=colour, linewidth=0.9, linestyle="--", label=label)
            axes.set(yscale="log", ylabel=f"{way}, {name} ({shown})")
        column[-1].set(xlabel="frequency (cycles per pixel)")
    handles, labels = grid[0, 1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=7)
    return figure


def plot_profiles(data: Data) -> Any:
    """Plot profiles of dark and response: middle line, mean, least and largest value."""
    figure, grid = panels(2, 2, size=(6.4, 5.0))
    for column, stack, title in zip(grid.T, ("dark", "bright"), ("dark", "response"), strict=True):
        for axes, way in zip(column, ("horizontal", "vertical"), strict=True):
            for name, colour in zip(("largest", "least", "middle", "mean"), COLOURS, strict=False):
                line = first_array(data, f"{stack}_{way}_{name}_dn")
                place = np.linspace(0.0, float(data[f"{way}_px"]), len(line), endpoint=False)
                colour = INK if name == "mean" else colour
                plot_line(axes, place, line, color=colour, linewidth=0.8, label=name)
            axes.set(xlabel=f"{'column' if way == 'horizontal' else 'row'} (px)")
            axes.set(ylabel=f"{title} (DN)")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=7)
    return figure


def plot_defect_histograms(data: Data) -> Any:
    """Plot logarithmic and accumulated histograms of the deviation of pixels from their mean."""
    figure, grid = panels(2, 2, size=(6.4, 5.0))
    for column, (unit, name, shown) in zip(grid.T, KINDS, strict=True):
        deviation, pixels, normal, rarer = (
            first_array(data, key)
            for key in (
                f"deviation_{unit}",
                *(f"{of}_of_{name.lower()}" for of in ("pixels", "normal", "share")),
            )
        )
        column[0].step(deviation, np.maximum(pixels, 0.1), where="mid", color=DATA, label="pixels")
        plot_line(column[0], deviation, normal, color=MODEL, linestyle="--", label="normal")
        column[0].set(ylim=(0.5, 2.0 * pixels.max()), ylabel=f"{name}: pixels in a bin")
        steps = np.linspace(0.0, np.abs(deviation).max(), len(rarer))
        plot_line(column[1], steps, np.maximum(rarer, 1e-12), color=DATA)
        rarest = rarer[rarer > 0.0].min()
        column[1].set(ylim=(0.5 * rarest, 200.0), ylabel=f"{name}: pixels beyond (%)")
        for axes, words in zip(column, ("deviation", "least deviation"), strict=True):
            axes.set(yscale="log", xlabel=f"{words} ({shown})")
    grid[0, 0].legend(fontsize=7)
    return figure
