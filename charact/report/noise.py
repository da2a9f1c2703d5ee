"""Figures of gain and noise: photon transfer, noise power, correlation, SNR, and pulse heights."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from charact.report.style import (
    COLOURS,
    DATA,
    INK,
    MODEL,
    THIRD,
    WARN,
    first_array,
    has_all,
    panels,
    plot_line,
    plot_points,
)

Data = Mapping[str, Any]


def plot_photon_transfer(data: Data) -> Any:
    """Plot temporal variance and summed covariance against signal, all above dark."""
    figure, grid = panels(size=(5.6, 3.8))
    axes = grid[0, 0]
    signal, dark = first_array(data, "signal_dn"), np.zeros(len(first_array(data, "signal_dn")))
    if has_all(data, "dark_variance_dn2") and len(data["dark_variance_dn2"]) == len(signal):
        dark = first_array(data, "dark_variance_dn2")
    fitted = first_array(data, "fitted").astype(bool) if has_all(data, "fitted") else np.ones(len(signal), bool)
    _series(
        axes, signal, first_array(data, "variance_dn2") - dark, data.get("variance_sd_dn2"), fitted, DATA, "variance"
    )
    if has_all(data, "covariance_dn2"):
        covariance = first_array(data, "covariance_dn2")
        _series(axes, signal, covariance, data.get("covariance_sd_dn2"), fitted, MODEL, "covariance sum")
    _slopes(axes, data, signal)
    axes.set(xlabel="signal above the dark (DN)", ylabel="variance above the dark (DN²)")
    axes.legend()
    return figure


def _series(axes: Any, x: Any, y: Any, sd: Any, fitted: Any, colour: str, label: str) -> None:
    """Plot points: filled if fitted, else hollow."""
    sd = np.zeros(len(x)) if sd is None else np.asarray(sd, float)
    plot_points(axes, x[fitted], y[fitted], sd[fitted], color=colour, label=f"{label}, ± 1 sd", markersize=4.5)
    if not fitted.all():
        out = ~fitted
        plot_points(
            axes, x[out], y[out], sd[out], color=colour, mfc="none", label=f"{label}, not fitted", markersize=4.5
        )


def _slopes(axes: Any, data: Data, signal: Any) -> None:
    """Plot lines of the measured gains."""
    reach = np.array([0.0, float(np.max(signal))])
    covariance, blur = data.get("covariance_gain_dn"), data.get("blur_factor")
    if covariance is not None:
        plot_line(axes, reach, covariance * reach, color=MODEL, label=f"covariance gain {covariance:.4g} DN")
        if blur is not None:
            lag = data.get("lag_factor") or 1.0
            label = f"× blur factor {blur:.3g}" + (f" / lag factor {lag:.3g}" if lag > 1.001 else "")
            plot_line(axes, reach, covariance * blur / lag * reach, color=DATA, linestyle="--", label=label)
    gain = data.get("system_gain_dn_per_e")
    if gain is not None:
        plot_line(axes, reach, gain * reach, color=THIRD, label=f"system gain {gain:.4g} DN/e-")


def plot_noise_spectrum(data: Data) -> Any:
    """Plot noise power over signal against frequency; its limit at frequency 0 is the covariance gain."""
    figure, grid = panels(size=(5.6, 3.8))
    axes = grid[0, 0]
    radius, angle = first_array(data, "radius_cy_per_px"), np.abs(first_array(data, "angle_deg"))
    power, sd, model = first_array(data, "power_dn"), first_array(data, "power_sd_dn"), first_array(data, "model_dn")
    used = first_array(data, "used").astype(bool)
    for colour, own, label in (
        (DATA, used & (angle < 30), "near horizontal frequency"),
        (THIRD, used & (angle > 60), "near vertical frequency"),
    ):
        if own.any():
            plot_points(axes, radius[own], power[own], sd[own], color=colour, alpha=0.6, label=f"{label}, ± 1 sd")
            order = np.argsort(radius[own])
            plot_line(axes, radius[own][order], model[own][order], color=colour)
    if not used.all():
        plot_points(axes, radius[~used], power[~used], color=INK, alpha=0.25, markersize=1.8, label="not fitted")
    axes.axhline(float(data["variance_over_signal_dn"]), color=MODEL, linestyle="--", label="variance over signal")
    axes.set(
        xlabel="spatial frequency (cycles per column pitch)", ylabel="noise power over signal (DN)", ylim=(0, None)
    )
    axes.legend()
    return figure


def plot_post_gain_noise(data: Data) -> Any:
    """Plot the noise power spectrum along rows and columns with its fit."""
    figure, grid = panels(size=(5.6, 3.8))
    axes = grid[0, 0]
    column, row = np.abs(first_array(data, "column_cy_per_px")), np.abs(first_array(data, "row_cy_per_px"))
    radius, power = np.hypot(column, row), first_array(data, "power_dn2") - first_array(data, "dark_dn2")
    model = first_array(data, "white_dn2") + first_array(data, "pulses_dn2")
    for colour, own, label in (
        (DATA, row < 0.27 * column, "near horizontal frequency"),
        (THIRD, column < 0.27 * row, "near vertical frequency"),
    ):
        plot_points(axes, radius[own], power[own], color=colour, alpha=0.4, markersize=2.0, label=label)
    axes.plot(
        radius, model, ".", color=MODEL, markersize=1.5, alpha=0.5, label="fitted: white floor and blurred pulses"
    )
    axes.set(xlabel="spatial frequency (cycles per column pitch)", ylabel="noise power above the dark (DN²)",
             ylim=(0, None))  # fmt: skip
    axes.legend()
    return figure


def plot_autocorrelation(data: Data) -> Any:
    """Plot the correlation of neighbouring pixels in each flat, and of successive exposures."""
    figure, grid = panels(1, 2, size=(5.8, 3.2))
    pixels, exposures = grid[0]
    neighbour = first_array(data, "neighbour_correlation")
    plot_points(
        pixels, np.arange(1, len(neighbour) + 1), neighbour, first_array(data, "neighbour_sd"), color=DATA, markersize=4
    )
    pixels.set(xlabel="flat stack, in order (1)", ylabel="correlation of neighbours in a row (1)")
    lag, value = first_array(data, "lag_exposures"), first_array(data, "lag_correlation")
    if len(lag):
        plot_points(exposures, lag, value, first_array(data, "lag_correlation_sd"), color=THIRD, markersize=4)
    exposures.set(xlabel="correlation lag (exposures)", ylabel="correlation in time (1)")
    for axes in (pixels, exposures):
        axes.axhline(0, color=INK, linewidth=0.8)
    return figure


def plot_three_dimensional_noise(data: Data) -> Any:
    """Plot the means of frames, rows and columns about their mean, and the spectrum of the frame means."""
    figure, grid = panels(2, 2, size=(5.8, 4.6))
    for axes, name, what in (
        (grid[0, 0], "exposure_mean_dn", "exposure"),
        (grid[1, 0], "row_mean_dn", "row"),
        (grid[1, 1], "column_mean_dn", "column"),
    ):
        mean = first_array(data, name)
        plot_line(axes, np.arange(len(mean)), mean - mean.mean(), color=DATA)
        axes.set(xlabel=what, ylabel=f"mean of each {what}\n(DN)")
    period = data.get("exposure_period_s")
    frequency = first_array(data, "frequency_cy_per_exposure") / (period or 1.0)
    plot_line(grid[0, 1], frequency, first_array(data, "power_dn2"), color=THIRD)
    unit = "Hz" if period else "cycles per exposure"
    grid[0, 1].set(xlabel=f"temporal frequency\n({unit})", ylabel="power of the means (DN²)")
    return figure


def plot_predictive_checks(data: Data) -> Any:
    """Plot posterior predictive checks: each statistic of the flats minus its prediction, in standard deviations."""
    figure, grid = panels(size=(5.8, 3.6))
    axes = grid[0, 0]
    signs = list(dict.fromkeys(data["sign"]))
    away = (first_array(data, "measured") - first_array(data, "expected")) / first_array(data, "sd")
    row = np.array([signs.index(sign) for sign in data["sign"]], float)
    axes.axvspan(-2.0, 2.0, color=MODEL, alpha=0.15, linewidth=0, label="95 % of predicted frames")
    stacks = list(dict.fromkeys(data["stack"]))
    for number, stack in enumerate(stacks):
        own = np.array([one == stack for one in data["stack"]])
        place = row[own] + 0.16 * (number - 0.5 * (len(stacks) - 1))
        plot_points(axes, away[own], place, color=COLOURS[number % len(COLOURS)], markersize=4.5, label=stack)
    axes.set_xscale("symlog", linthresh=3.0)
    most = float(np.abs(away).max())
    ticks = [tick for tick in (1, 3, 10, 30, 100, 300) if tick < 2.0 * most or tick <= 3]
    axes.set_xticks([-tick for tick in ticks[::-1]] + [0, *ticks])
    axes.set(xlim=(-1.3 * max(most, 3.0), 1.3 * max(most, 3.0)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_yticks(range(len(signs)), signs)
    axes.set(xlabel="measured minus expected (standard deviations)", ylim=(len(signs) - 0.5, -0.5))
    axes.axvline(0, color=INK, linewidth=0.8)
    axes.legend(fontsize=7)
    return figure


def plot_noise_against_gain(data: Data) -> Any:
    """Plot covariance gain, and scintillation and read noise at a stated signal, against the gain setting."""
    figure, grid = panels(1, 2, size=(7.2, 3.8))
    gains, noises = grid[0]
    setting, gain = first_array(data, "setting"), first_array(data, "gain_dn")
    law, middle = first_array(data, "law_setting"), first_array(data, "law_gain_dn")
    low, high = np.asarray(data["law_interval95_dn"], float)
    gains.fill_between(law, low, high, color=MODEL, alpha=0.25, linewidth=0)
    plot_line(gains, law, middle, color=MODEL, label="fit, 95 %")
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
    plot_line(noises, law, scintillation[1], color=MODEL, label=f"scintillation noise at {pe:g} photoelectron/px")
    dark = [(s, d) for s, d in zip(setting, data["dark_noise_dn"], strict=True) if d is not None]
    if dark:
        plot_points(noises, *np.array(dark).T, color=THIRD, marker="s", markersize=4.5, label="dark frames")
    _knee(noises, data)
    noises.set(ylabel="temporal noise (DN)")
    unit = "" if data["knob_unit"] == "1" else data["knob_unit"]
    for axes in (gains, noises):
        axes.set(yscale="log", xlabel=f"{data['knob']} ({unit or '1'})")
        if data["logarithmic"]:
            axes.set_xscale("log")
            _few_ticks(axes, setting)
        axes.legend(fontsize=7)
    return figure


def _few_ticks(axes: Any, places: Any) -> None:
    """Set ticks at data positions; a logarithmic axis of less than a decade has too few."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    axes.xaxis.set_major_locator(FixedLocator(places[:: max(1, -(-len(places) // 5))]))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))


def _knee(axes: Any, data: Data) -> None:
    """Plot the read noise and the setting at which the scintillation noise equals it."""
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
    """Plot noise against signal and, if the light is known, signal against light; one colour for each setting."""
    lights = [light for light in data["light"] if light is not None]
    figure, grid = panels(1, 2 if lights else 1, size=(7.2 if lights else 5.0, 3.8))
    for number, name in enumerate(data["setting"]):
        colour = COLOURS[number % len(COLOURS)]
        signal, noise = np.asarray(data["signal_dn"][number], float), np.asarray(data["noise_dn"][number], float)
        own = {"color": colour, "marker": "o", "markersize": 3.5, "linewidth": 0.9}
        grid[0, 0].plot(signal, noise, label=name, **own)
        if lights and data["light"][number] is not None:
            grid[0, 1].plot(np.asarray(data["light"][number], float), signal, **own)
    grid[0, 0].set(xscale="log", yscale="log", xlabel="signal above the dark (DN)", ylabel="temporal noise (DN)")
    grid[0, 0].legend(fontsize=7)
    if lights:
        unit = {"photon": "photons/px"}.get(data["light_unit"], data["light_unit"])
        grid[0, 1].set(xscale="log", yscale="log", xlabel=f"light ({unit})", ylabel="signal above the dark (DN)")
        _few_ticks(grid[0, 1], np.unique(np.concatenate([np.asarray(light, float) for light in lights])))
    return figure


LIGHT_AXES = {"lux": "illuminance as recorded (lux)", "photons/px": "photons as recorded (1/px)", "DN": "signal (DN)"}


def plot_snr(data: Data) -> Any:
    """Plot the SNR of a pixel and of an area against light; dashed: a pixel with fixed-pattern noise."""
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
    """Plot the SNR of the stacks, the fit with its 95 % band, and the minimum illumination."""
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
        label = None if named else "with fixed-pattern noise"
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


def plot_pulse_heights(data: Data) -> Any:
    """Plot the distribution of filtered dark pixels: measured, fitted pulse-height distribution, and noise only."""
    figure, grid = panels(1, 1, size=(5.8, 3.8))
    axes = grid[0, 0]
    edge, measured = first_array(data, "edge_dn"), first_array(data, "density_per_dn")
    seen = measured > 0
    middle = 0.5 * (edge[1:] + edge[:-1])
    axes.plot(middle[seen], measured[seen], ".", color=DATA, markersize=4, label="measured")
    plot_line(
        axes,
        first_array(data, "value_dn"),
        first_array(data, "law_per_dn"),
        color=MODEL,
        label="fitted pulse-height distribution",
    )
    plot_line(
        axes,
        first_array(data, "value_dn"),
        first_array(data, "noise_per_dn"),
        color=INK,
        linestyle="--",
        label="noise only",
    )
    response = float(data["response_to_mean_pulse_dn"])
    axes.axvline(response, color=WARN, linewidth=0.9, linestyle=":", label="mean pulse, centred on its pixel")
    # Lower limit: a tenth of one counted value.
    least = 0.1 / float(data["values"]) / float(edge[1] - edge[0])
    high, broad = (int(size) for size in np.asarray(data["filter_px"]))
    axes.set(yscale="log", ylim=(least, 5.0 * float(measured.max())), ylabel="density of the values (1/DN)",
             xlabel=f"sum of {high} x {broad} px minus the row level (DN)")  # fmt: skip
    axes.legend()
    return figure
