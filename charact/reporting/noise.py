"""Figures of gain and noise: photon transfer, noise power, correlation, SNR, and pulse heights."""

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

Data = Mapping[str, Any]


def plot_photon_transfer(data: Data) -> Any:
    """Plot temporal variance and summed covariance against signal, all above dark."""
    figure, axes = panel(
        (5.6, 3.8), xlabel="signal above the dark (DN)", ylabel="variance above the dark (DN²)"
    )
    signal = first_array(data, "signal_dn")
    dark = np.zeros(len(signal))
    if has_all(data, "dark_variance_dn2") and len(data["dark_variance_dn2"]) == len(signal):
        dark = first_array(data, "dark_variance_dn2")
    fitted = (
        first_array(data, "fitted").astype(bool)
        if has_all(data, "fitted")
        else np.ones(len(signal), bool)
    )
    series = [
        (first_array(data, "variance_dn2") - dark, data.get("variance_sd_dn2"), DATA, "variance")
    ]
    if has_all(data, "covariance_dn2"):
        covariance = first_array(data, "covariance_dn2")
        series.append((covariance, data.get("covariance_sd_dn2"), MODEL, "covariance sum"))
    for value, sd, colour, label in series:
        sd = np.zeros(len(signal)) if sd is None else np.asarray(sd, float)
        names = (f"{label}, ± 1 sd", f"{label}, not fitted")
        _plot_fitted(axes, signal, value, sd, fitted, names, color=colour, markersize=4.5)
    _slopes(axes, data, signal)
    axes.legend()
    return figure


def _plot_fitted(
    axes: Any, x: Any, y: Any, sd: Any, fitted: Any, labels: tuple, **options: Any
) -> None:
    """Plot points with error bars: filled if fitted, else hollow."""
    plot_points(axes, x[fitted], y[fitted], sd[fitted], label=labels[0], **options)
    if not fitted.all():
        plot_points(
            axes, x[~fitted], y[~fitted], sd[~fitted], mfc="none", label=labels[1], **options
        )


def _slopes(axes: Any, data: Data, signal: Any) -> None:
    """Plot lines of the measured gains."""
    signal_range = np.array([0.0, float(np.max(signal))])
    covariance, blur = data.get("covariance_gain_dn"), data.get("blur_factor")
    if covariance is not None:
        plot_line(
            axes,
            signal_range,
            covariance * signal_range,
            color=MODEL,
            label=f"covariance gain {covariance:.4g} DN",
        )
        if blur is not None:
            lag = data.get("lag_factor") or 1.0
            label = f"× blur factor {blur:.3g}" + (
                f" / lag factor {lag:.3g}" if lag > 1.001 else ""
            )
            plot_line(
                axes,
                signal_range,
                covariance * blur / lag * signal_range,
                color=DATA,
                linestyle="--",
                label=label,
            )
    if (gain := data.get("system_gain_dn_per_e")) is not None:
        plot_line(
            axes,
            signal_range,
            gain * signal_range,
            color=THIRD,
            label=f"system gain {gain:.4g} DN/e-",
        )


def plot_noise_spectrum(data: Data) -> Any:
    """Plot noise power over signal against frequency; its limit at frequency 0 is the covariance
    gain.
    """
    figure, axes = panel((5.6, 3.8))
    angle = np.abs(first_array(data, "angle_deg"))
    names = "radius_cy_per_px", "power_dn", "power_sd_dn", "model_dn"
    spectrum = np.stack([first_array(data, name) for name in names])
    fitted = first_array(data, "used").astype(bool)
    sectors = fitted & (angle < 30), fitted & (angle > 60)
    _plot_sectors(axes, sectors, spectrum, label="{}, ± 1 sd", alpha=0.6)
    if not fitted.all():
        hollow = {"color": INK, "alpha": 0.25, "markersize": 1.8, "label": "not fitted"}
        plot_points(axes, *spectrum[:2, ~fitted], **hollow)
    variance, label = float(data["variance_over_signal_dn"]), "variance over signal"
    axes.axhline(variance, color=MODEL, linestyle="--", label=label)
    _label_power(axes, "noise power over signal (DN)")
    return figure


def plot_post_gain_noise(data: Data) -> Any:
    """Plot the noise power spectrum along rows and columns with its fit."""
    figure, axes = panel((5.6, 3.8))
    column, row = (np.abs(first_array(data, f"{name}_cy_per_px")) for name in ("column", "row"))
    power, dark, white, pulses = (
        first_array(data, f"{name}_dn2") for name in ("power", "dark", "white", "pulses")
    )
    spectrum = np.stack([np.hypot(column, row), power - dark])
    sectors = row < 0.27 * column, column < 0.27 * row
    _plot_sectors(axes, sectors, spectrum, label="{}", alpha=0.4, markersize=2.0)
    label = "fitted: white floor and blurred pulses"
    dots = {"color": MODEL, "markersize": 1.5, "alpha": 0.5, "label": label}
    axes.plot(spectrum[0], white + pulses, ".", **dots)
    _label_power(axes, "noise power above the dark (DN²)")
    return figure


def _plot_sectors(axes: Any, sectors: Any, spectrum: Any, *, label: str, **options: Any) -> None:
    """Plot powers near horizontal and near vertical frequencies.

    `spectrum`: radial frequency and power, and where known its error and its model, shape
    (2 or 4, bin).
    """
    names = ("near horizontal frequency", "near vertical frequency")
    for colour, in_sector, name in zip((DATA, THIRD), sectors, names, strict=True):
        radius, *powers = spectrum[:, in_sector]
        if radius.size:
            plot_points(
                axes, radius, *powers[:2], color=colour, label=label.format(name), **options
            )
        if radius.size and len(powers) > 2:
            order = np.argsort(radius)
            plot_line(axes, radius[order], powers[2][order], color=colour)


def _label_power(axes: Any, ylabel: str) -> None:
    """Label the axes of noise power against spatial frequency."""
    xlabel = "spatial frequency (cycles per column pitch)"
    axes.set(xlabel=xlabel, ylabel=ylabel, ylim=(0, None))
    axes.legend()


def plot_autocorrelation(data: Data) -> Any:
    """Plot the correlation of neighbouring pixels in each flat, and of successive exposures."""
    figure, grid = panels(1, 2, size=(5.8, 3.2))
    pixels, exposures = grid[0]
    value, sd = first_array(data, "neighbour_correlation"), first_array(data, "neighbour_sd")
    plot_points(pixels, np.arange(1, len(value) + 1), value, sd, color=DATA, markersize=4)
    pixels.set(xlabel="flat stack, in order (1)", ylabel="correlation of neighbours in a row (1)")
    lag, value = first_array(data, "lag_exposures"), first_array(data, "lag_correlation")
    if len(lag):
        plot_points(
            exposures,
            lag,
            value,
            first_array(data, "lag_correlation_sd"),
            color=THIRD,
            markersize=4,
        )
    exposures.set(xlabel="correlation lag (exposures)", ylabel="correlation in time (1)")
    for axes in (pixels, exposures):
        zero_line(axes)
    return figure


def plot_three_dimensional_noise(data: Data) -> Any:
    """Plot the means of frames, rows and columns about their mean, and the spectrum of the frame
    means.
    """
    figure, grid = panels(2, 2, size=(5.8, 4.6))
    for axes, what in ((grid[0, 0], "exposure"), (grid[1, 0], "row"), (grid[1, 1], "column")):
        mean = first_array(data, f"{what}_mean_dn")
        plot_line(axes, np.arange(len(mean)), mean - mean.mean(), color=DATA)
        axes.set(xlabel=what, ylabel=f"mean of each {what}\n(DN)")
    period = data.get("exposure_period_s")
    frequency = first_array(data, "frequency_cy_per_exposure") / (period or 1.0)
    plot_line(grid[0, 1], frequency, first_array(data, "power_dn2"), color=THIRD)
    unit = "Hz" if period else "cycles per exposure"
    grid[0, 1].set(xlabel=f"temporal frequency\n({unit})", ylabel="power of the means (DN²)")
    return figure


def plot_signal_transfer(data: Data) -> Any:
    """Plot the mean of each black-body level against its temperature, and its departure from the
    law.
    """
    figure, grid = panels(2, 1, size=(5.6, 4.4), height_ratios=(3, 1.4), sharex=True)
    warm, mean, sd = (first_array(data, name) for name in ("blackbody_c", "mean_dn", "mean_sd_dn"))
    plot_points(grid[0, 0], warm, mean, sd, color=DATA, markersize=4.5, label="levels, ± 1 sd")
    plot_line(
        grid[0, 0],
        first_array(data, "law_c"),
        first_array(data, "law_mean_dn"),
        color=MODEL,
        label=data["law"],
    )
    grid[0, 0].axvline(
        float(data["background_c"]), color=INK, linewidth=0.8, linestyle=":", label="background"
    )
    grid[0, 0].set(ylabel="mean signal (DN)")
    grid[0, 0].legend()
    plot_points(grid[1, 0], warm, first_array(data, "residual_k"), color=DATA, markersize=4.5)
    zero_line(grid[1, 0])
    grid[1, 0].set(xlabel="temperature of the black body (°C)", ylabel="residual (K)")
    return figure


def plot_predictive_checks(data: Data) -> Any:
    """Plot posterior predictive checks: each statistic of the flats minus its prediction, in
    standard deviations.
    """
    figure, axes = panel((5.8, 3.6))
    signs = list(dict.fromkeys(data["sign"]))
    deviations = (first_array(data, "measured") - first_array(data, "expected")) / first_array(
        data, "sd"
    )
    row = np.array([signs.index(sign) for sign in data["sign"]], float)
    axes.axvspan(-2.0, 2.0, color=MODEL, alpha=0.15, linewidth=0, label="95 % of predicted frames")
    stacks = list(dict.fromkeys(data["stack"]))
    for number, stack in enumerate(stacks):
        of_stack = np.array([label == stack for label in data["stack"]])
        positions = row[of_stack] + 0.16 * (number - 0.5 * (len(stacks) - 1))
        plot_points(
            axes,
            deviations[of_stack],
            positions,
            color=COLOURS[number % len(COLOURS)],
            markersize=4.5,
            label=stack,
        )
    axes.set_xscale("symlog", linthresh=3.0)
    largest = float(np.abs(deviations).max())
    ticks = [tick for tick in (1, 3, 10, 30, 100, 300) if tick < 2.0 * largest or tick <= 3]
    axes.set_xticks([-tick for tick in ticks[::-1]] + [0, *ticks])
    axes.set(xlim=(-1.3 * max(largest, 3.0), 1.3 * max(largest, 3.0)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_yticks(range(len(signs)), signs)
    axes.set(xlabel="measured minus expected (standard deviations)", ylim=(len(signs) - 0.5, -0.5))
    axes.axvline(0, color=INK, linewidth=0.8)
    axes.legend(fontsize=7)
    return figure


LIGHT_AXES = {
    "lux": "illuminance as recorded (lux)",
    "photons/px": "photons as recorded (1/px)",
    "DN": "signal (DN)",
}


def plot_snr(data: Data) -> Any:
    """Plot the SNR of a pixel and of an area against light; dashed: a pixel with fixed-pattern
    noise.
    """
    names = [scope["name"] for scope in data["gains"][0]["scopes"]]
    figure, grid = panels(1, len(names), size=(5.8, 3.9), sharex=True)
    level, several = float(data["least_snr"]), len(data["gains"]) > 1
    for axes, name in zip(grid[0], names, strict=True):
        for number, gain in enumerate(data["gains"]):
            for scope in (scope for scope in gain["scopes"] if scope["name"] == name):
                _plot_snr_law(
                    axes, gain, scope, level, COLOURS[number % len(COLOURS)], named=several
                )
        axes.axhline(level, color=INK, linewidth=0.8, linestyle=":")
        unit = data["gains"][0]["unit"] if data["unit"] else "each in its unit"
        axes.set(
            xscale="log",
            yscale="log",
            xlabel=LIGHT_AXES.get(unit, unit),
            ylabel=f"signal over noise, {name} (1)",
        )
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=7)
    return figure


def _plot_snr_law(
    axes: Any, gain: Data, scope: Data, level: float, colour: str, *, named: bool
) -> None:
    """Plot the SNR of the stacks, the fit with its 95 % band, and the minimum illumination."""

    def label(text: str) -> str | None:
        return None if named else text

    amount, fitted = first_array(gain, "amount"), np.asarray(gain["fitted"], bool)
    labels = (gain["gain"] if named else "levels, ± 1 sd", None)
    snr, sd = first_array(scope, "snr"), first_array(scope, "snr_sd")
    _plot_fitted(axes, amount, snr, sd, fitted, labels, color=colour, markersize=3.5)
    light = first_array(scope, "law_amount")
    plot_band(axes, light, first_array(scope, "law_low"), first_array(scope, "law_high"), colour)
    plot_line(
        axes, light, first_array(scope, "law_snr"), color=colour, label=label("read and shot noise")
    )
    if scope["name"] == "pixel":
        pattern = first_array(scope, "law_with_pattern")
        plot_line(
            axes,
            light,
            pattern,
            color=colour,
            linestyle="--",
            linewidth=0.9,
            label=label("with fixed-pattern noise"),
        )
    if scope.get("minimum") is not None:
        middle = float(scope["minimum"])
        axes.errorbar(
            [middle],
            [level],
            xerr=arms(middle, *scope["minimum_interval95"]),
            color=colour,
            marker="D",
            markersize=5,
            mfc="none",
            linestyle="",
            label=label("minimum illumination, 95 %"),
        )


def plot_pulse_heights(data: Data) -> Any:
    """Plot the distribution of filtered dark pixels: measured, fitted pulse-height distribution,
    and noise only.
    """
    figure, axes = panel((5.8, 3.8))
    edge, measured = first_array(data, "edge_dn"), first_array(data, "density_per_dn")
    occupied = measured > 0
    middle = 0.5 * (edge[1:] + edge[:-1])
    axes.plot(middle[occupied], measured[occupied], ".", color=DATA, markersize=4, label="measured")
    value = first_array(data, "value_dn")
    law, noise = first_array(data, "law_per_dn"), first_array(data, "noise_per_dn")
    plot_line(axes, value, law, color=MODEL, label="fitted pulse-height distribution")
    plot_line(axes, value, noise, color=INK, linestyle="--", label="noise only")
    response = float(data["response_to_mean_pulse_dn"])
    axes.axvline(
        response, color=WARN, linewidth=0.9, linestyle=":", label="mean pulse, centred on its pixel"
    )
    # Lower limit: a tenth of one counted value.
    lowest_density = 0.1 / float(data["values"]) / float(edge[1] - edge[0])
    high, broad = (int(size) for size in np.asarray(data["filter_px"]))
    axes.set(
        yscale="log",
        ylim=(lowest_density, 5.0 * float(measured.max())),
        ylabel="density of the values (1/DN)",
        xlabel=f"sum of {high} x {broad} px minus the row level (DN)",
    )
    axes.legend()
    return figure
