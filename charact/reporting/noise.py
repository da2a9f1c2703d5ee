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
    radius, angle = first_array(data, "radius_cy_per_px"), np.abs(first_array(data, "angle_deg"))
    power, sd, model = (first_array(data, name) for name in ("power_dn", "power_sd_dn", "model_dn"))
    fitted = first_array(data, "used").astype(bool)
    for colour, in_sector, label in (
        (DATA, fitted & (angle < 30), "near horizontal frequency"),
        (THIRD, fitted & (angle > 60), "near vertical frequency"),
    ):
        if in_sector.any():
            plot_points(
                axes,
                radius[in_sector],
                power[in_sector],
                sd[in_sector],
                color=colour,
                alpha=0.6,
                label=f"{label}, ± 1 sd",
            )
            order = np.argsort(radius[in_sector])
            plot_line(axes, radius[in_sector][order], model[in_sector][order], color=colour)
    if not fitted.all():
        plot_points(
            axes,
            radius[~fitted],
            power[~fitted],
            color=INK,
            alpha=0.25,
            markersize=1.8,
            label="not fitted",
        )
    axes.axhline(
        float(data["variance_over_signal_dn"]),
        color=MODEL,
        linestyle="--",
        label="variance over signal",
    )
    axes.set(
        xlabel="spatial frequency (cycles per column pitch)",
        ylabel="noise power over signal (DN)",
        ylim=(0, None),
    )
    axes.legend()
    return figure


def plot_post_gain_noise(data: Data) -> Any:
    """Plot the noise power spectrum along rows and columns with its fit."""
    figure, axes = panel((5.6, 3.8))
    column, row = (
        np.abs(first_array(data, "column_cy_per_px")),
        np.abs(first_array(data, "row_cy_per_px")),
    )
    radius, power = (
        np.hypot(column, row),
        first_array(data, "power_dn2") - first_array(data, "dark_dn2"),
    )
    model = first_array(data, "white_dn2") + first_array(data, "pulses_dn2")
    for colour, in_sector, label in (
        (DATA, row < 0.27 * column, "near horizontal frequency"),
        (THIRD, column < 0.27 * row, "near vertical frequency"),
    ):
        plot_points(
            axes,
            radius[in_sector],
            power[in_sector],
            color=colour,
            alpha=0.4,
            markersize=2.0,
            label=label,
        )
    label = "fitted: white floor and blurred pulses"
    axes.plot(radius, model, ".", color=MODEL, markersize=1.5, alpha=0.5, label=label)
    axes.set(
        xlabel="spatial frequency (cycles per column pitch)",
        ylabel="noise power above the dark (DN²)",
        ylim=(0, None),
    )
    axes.legend()
    return figure


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
