"""Figures of halo and blooming: radial profiles with fits, diameters against light."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from charact.reporting.style import (
    COLOURS,
    DATA,
    FOURTH,
    INK,
    MODEL,
    THIRD,
    WARN,
    arms,
    first_array,
    panel,
    panels,
    plot_line,
    plot_points,
    write_note,
)

Data = Mapping[str, Any]
DASHED: dict[str, Any] = {"color": INK, "linestyle": "--", "linewidth": 0.9}
# Error bars of 95 %.
BARS: dict[str, Any] = {"fmt": "o", "color": DATA, "markersize": 4.5, "linewidth": 1}


def _draw_levels(data: Data, abscissa: str, upper: Any, lower: Any) -> float:
    """Draw means and model of each level, and below them the residuals; return the largest of these
    in standard errors.
    """
    largest = 0.0
    for colour, number in zip(COLOURS * 2, pick_levels(len(data["label"])), strict=False):
        x, mean, sd, model = (
            np.asarray(data[key][number], float)
            for key in (abscissa, "mean_dn", "sd_dn", "model_dn")
        )
        used, label = np.asarray(data["used"][number], bool), str(data["label"][number])
        plot_points(upper, x[used], mean[used], sd[used], color=colour, label=label, alpha=0.8)
        plot_points(upper, x[~used], mean[~used], color=colour, alpha=0.3, marker="x")
        plot_line(upper, x, model, color=colour, linewidth=1)
        residuals = ((mean - model) / np.maximum(sd, 1e-9))[used]
        plot_points(lower, x[used], residuals, color=colour, alpha=0.8)
        largest = max(largest, float(np.abs(residuals).max(initial=0.0)))
    lower.axhline(0.0, color=INK, linewidth=0.7)
    lower.axhspan(-2.0, 2.0, color=INK, alpha=0.08, linewidth=0)
    lower.set(ylabel="data - model\n(standard errors)")
    return largest


def plot_point_profile(data: Data) -> Any:
    """Plot the radial profiles of a point series with the joint fit, and the residuals in standard
    errors.

    Reads `label`, and for each of these a list per level: `radius_px`, `mean_dn`, `sd_dn`, `used`
    (fitted rings) and `model_dn`. `halo_diameter_px` and `full_scale_dn` are marked.
    """
    figure, grid = panels(2, 1, size=(5.8, 5.2), sharex=True, height_ratios=(2.2, 1.0))
    axes, residual_axes = grid[:, 0]
    limit = max(4.0, 1.1 * min(_draw_levels(data, "radius_px", axes, residual_axes), 12.0))
    if data.get("halo_diameter_px") is not None:
        for plot_axes in (axes, residual_axes):
            plot_axes.axvline(data["halo_diameter_px"] / 2, label="halo radius", **DASHED)
    if data.get("full_scale_dn"):
        axes.axhline(
            data["full_scale_dn"], color=WARN, linestyle=":", linewidth=0.9, label="full scale"
        )
    means = np.concatenate([np.asarray(mean, float) for mean in data["mean_dn"]])
    low, high = float(np.nanmin(means)), float(np.nanmax(means))
    # A halo is a small step on a long slope; a logarithmic scale shows both.
    axes.set(
        ylabel="mean of the ring (DN)",
        yscale="log" if low > 0 else "linear",
        ylim=(0.93 * low if low > 0 else low - 0.05 * high, 1.3 * high),
    )
    axes.legend(ncols=2)
    residual_axes.set(xlabel="distance from the source (column pitches, px)", ylim=(-limit, limit))
    return figure


def plot_point_spread(data: Data) -> Any:
    """Plot the profiles of a point source along row and column and its rings, with the model."""
    figure, grid = panels(1, 2, size=(5.8, 3.4), width_ratios=(1.2, 1))
    core, rings = grid[0]
    for colour, way, distance_key in ((DATA, "row", "column_px"), (THIRD, "column", "row_px")):
        x = first_array(data, distance_key)
        plot_points(
            core,
            x,
            first_array(data, f"along_{way}_dn"),
            color=colour,
            label=f"along the {way}",
            markersize=4,
        )
        plot_line(core, x, first_array(data, f"along_{way}_model_dn"), color=colour)
    core.set(xlabel="distance from the source (px)", ylabel="signal (DN)")
    low, high = core.get_ylim()
    core.set(ylim=(low, high + 0.2 * (high - low)))
    core.legend(loc="upper right")
    radius, mean = first_array(data, "ring_px"), first_array(data, "ring_dn")
    plot_points(
        rings, radius, mean, first_array(data, "ring_sd_dn"), color=DATA, label="rings, ± 1 sd"
    )
    plot_line(
        rings, radius, first_array(data, "ring_model_dn"), color=MODEL, label="model", zorder=3
    )
    rings.set(xlabel="radius (column pitches, px)", ylabel="mean of the ring (DN)")
    rings.legend()
    return figure


def pick_levels(count: int) -> list[int]:
    """Return at most six level indices at equal intervals."""
    return sorted({int(n) for n in np.linspace(0, count - 1, min(count, 6)).round()})


def exposure(data: Data) -> tuple[np.ndarray, str]:
    """Return the abscissa of a point series and its label: overload, else light dose, else the
    stack number.
    """
    if data.get("overload_known"):
        return first_array(data, "overload"), "overload: signal over full scale (1)"
    gate = [1.0 if value is None else value for value in data.get("gate_ns", [])]
    light = [None if value is None else value for value in data.get("illuminance_lux", [])]
    if light and all(value is not None and value > 0 for value in light):
        return np.asarray(light, float) * np.asarray(
            gate, float
        ) * 1e-9, "light dose on the photocathode (lux s)"
    return np.arange(1, len(data["label"]) + 1, dtype=float), "stack, in order (1)"


def plot_illuminated_edge(data: Data) -> Any:
    """Plot the profile across the edge of an illuminated area at every source level, with the model
    and the halo end.

    Reads `label`, and for each of these a list per level: `distance_px`, `mean_dn`, `sd_dn`,
    `used` (fitted strips), `model_dn`; `edge_px`, the true edge on the scale of the distances, and
    `halo_diameter_px`.
    """
    figure, grid = panels(2, 1, size=(5.8, 4.8), sharex=True, height_ratios=(2.2, 1.0))
    upper, lower = grid[:, 0]
    _draw_levels(data, "distance_px", upper, lower)
    end = data["edge_px"] + data["halo_diameter_px"] / 2.0
    for axes in (upper, lower):
        axes.axvline(data["edge_px"], color=INK, linewidth=0.9, label="edge")
        axes.axvline(end, label="end of the halo", **DASHED)
    upper.set(ylabel="mean of the strip (DN)", yscale="log")
    upper.legend(ncols=2)
    lower.set(xlabel="distance from the edge (column pitches, px)")
    return figure


# Quantity: threshold, colour and marker.
EXTENTS = {
    "bloom_diameter": ("half of full scale", DATA, "o"),
    "bloom_diameter_background": ("twice the background", FOURTH, "^"),
    "bloom_diameter_clip": ("full scale", THIRD, "v"),
    "streak_length": ("streak", MODEL, "s"),
}


def plot_bloom_series(data: Data) -> Any:
    """Plot bloom diameters at three thresholds, streak length and halo diameter against light, with
    95 % intervals.

    Reads `label` and the data of `exposure`; `measured`, by quantity and label [value, low, high]
    of 95 %, and without it the lists `bloom_diameter_px` and `streak_length_px`; `halo_px` [value,
    low, high]; `foretold`, the diameters predicted by the
    fitted spread: `overload`, and by quantity [low, median, high] lists, shown as lines; `truth`,
    by quantity a list for the stacks.
    """
    figure, axes = panel((5.8, 4.2))
    x, label = exposure(data)
    predicted = data.get("foretold") if data.get("overload_known") else None
    shown = [_extent(axes, data, x, quantity, predicted) for quantity in EXTENTS]
    if data.get("halo_px"):
        value, low, high = data["halo_px"]
        axes.axhspan(low, high, color=INK, alpha=0.15, linewidth=0)
        axes.axhline(value, label=f"halo, {value:.1f} px", **DASHED)
    if not any(shown):
        write_note(axes, "No stack exceeds any of the thresholds.")
    if not label.startswith("stack"):
        axes.set_xscale("log")
    axes.set(xlabel=label, ylabel="diameter or length (column pitches, rows; px)")
    # A logarithmic ordinate where one diameter is far larger than the others.
    measured = data.get("measured", {})
    values = [estimate[0] for quantity in measured.values() for estimate in quantity.values()]
    halves = [estimate[0] for estimate in measured.get("bloom_diameter", {}).values()]
    if values and max(values) > 2.0 * max(*halves, (data.get("halo_px") or [0.0])[0], 0.0):
        axes.set(yscale="log", ylim=(2.0, 1.3 * max(values)))
    else:
        axes.set_ylim(bottom=0.0)
    lines = ", lines: predicted by the fit" if predicted else ""
    axes.legend(title=f"diameter at{lines}" if any(shown) else None, alignment="left")
    return figure


def _extent(axes: Any, data: Data, x: np.ndarray, quantity: str, predicted: Any) -> bool:
    """Plot one quantity of every stack, its prediction by the fit, and its truth; return whether it
    has points.
    """
    words, colour, marker = EXTENTS[quantity]
    measured = data.get("measured", {}).get(quantity, {})
    points = [
        (at, *measured[label])
        for at, label in zip(x, data["label"], strict=True)
        if measured.get(label)
    ]
    if not measured and f"{quantity}_px" in data:
        points = [
            (at, d, d, d)
            for at, d in zip(x, first_array(data, f"{quantity}_px"), strict=True)
            if d > 0
        ]
    if predicted is not None and quantity in predicted and points:
        low, middle, high = (np.asarray(column, float) for column in predicted[quantity])
        at = np.asarray(predicted["overload"], float)
        axes.fill_between(at, low, high, color=colour, alpha=0.2, linewidth=0)
        axes.plot(at, middle, color=colour, linewidth=1)
    if points:
        at, *interval = np.array(points, float).T
        style = BARS | {"fmt": marker, "color": colour, "label": words}
        axes.errorbar(at, interval[0], yerr=arms(*interval), **style)
    truth = data.get("truth", {}).get(quantity)
    if truth is not None:
        axes.plot(
            x,
            truth,
            "_",
            color=INK,
            markersize=12,
            label="truth" if quantity == "bloom_diameter" else None,
        )
    return bool(points)


def plot_spread_models(data: Data) -> Any:
    """Plot the BIC of every halo model above that of the best one, the best at the top.

    Reads `table`, a list of rows with `form`, `parameters` and `bic_over_best`.
    """
    table = data["table"]
    figure, axes = panel((5.8, 0.9 + 0.34 * len(table)))
    positions = np.arange(len(table))[::-1]
    over = np.array([row["bic_over_best"] for row in table], float)
    axes.barh(positions, over + 1.0, left=0.0, color=DATA, height=0.6, alpha=0.7)
    axes.set_xscale("symlog", linthresh=10)
    axes.set_xlim(0.0, 2.0 * max(10.0, float(over.max())))
    axes.set_yticks(positions, [str(row["form"]) for row in table])
    axes.set(xlabel="BIC above that of the best model (1):\nmodels beyond 10 are excluded")
    axes.grid(axis="y", alpha=0)
    criteria = axes.secondary_yaxis("right")
    labels = [f"{row['bic_over_best']:.0f}; parameters: {row['parameters']}" for row in table]
    criteria.set_yticks(positions, labels, fontsize=7.0)
    criteria.tick_params(length=0)
    return figure


def plot_smear(data: Data) -> Any:
    """Plot the uniform signal of the source's columns against their collected light; the slope is
    the smear.

    Reads `light_per_row_dn`, `level_dn`, `level_sd_dn` and `label`, a list per stack.
    """
    figure, axes = panel((5.6, 3.2))
    light, level, sd = (
        first_array(data, key) for key in ("light_per_row_dn", "level_dn", "level_sd_dn")
    )
    axes.errorbar(light, level, yerr=1.96 * sd, label="stack, 95 %", **BARS)
    smear = float((light * level / sd**2).sum() / (light**2 / sd**2).sum())
    ends = np.geomspace(light.min(), light.max(), 50)
    axes.plot(ends, smear * ends, color=MODEL, label=f"smear {smear:.2g} of the column's light")
    axes.set(
        xscale="log",
        xlabel="light of the columns per row (DN)",
        ylabel="uniform signal of the columns (DN)",
    )
    # Smear rises with the light, so this corner is free.
    axes.legend(loc="upper left")
    return figure


def plot_halo_uniformity(data: Data) -> Any:
    """Plot the halo diameter of every source level with 95 % intervals; geometry requires it to be
    constant.
    """
    figure, axes = panel((5.6, 3.2))
    measured = [n for n, diameter in enumerate(data["halo_diameter_px"]) if diameter is not None]
    diameter = [data["halo_diameter_px"][n] for n in measured]
    ends = np.array([data["interval95_px"][n] for n in measured], float).reshape(-1, 2).T
    axes.errorbar(measured, diameter, yerr=arms(diameter, *ends), label="one level, 95 %", **BARS)
    if data.get("joint_px") is not None:
        axes.axhline(data["joint_px"], label="all levels together", **DASHED)
    axes.set_xticks(
        range(len(data["label"])), [str(label) for label in data["label"]], rotation=30, ha="right"
    )
    axes.set(xlabel="stack", ylabel="halo diameter (px)", xlim=(-0.5, len(data["label"]) - 0.5))
    axes.legend()
    return figure


def plot_series_stability(data: Data) -> Any:
    """Plot the background of every stack with 95 % intervals, and the source position frame by
    frame.

    Reads `label`, `background_dn`, `background_sd_dn`, and `row_px` and `col_px`, a list per stack
    by frame.
    """
    figure, grid = panels(1, 2, size=(6.4, 3.0))
    level, position_axes = grid[0]
    numbers = np.arange(len(data["label"]))
    background, sd = first_array(data, "background_dn"), first_array(data, "background_sd_dn")
    level.errorbar(numbers, background, yerr=1.96 * sd, label="stack, 95 %", **BARS)
    level.set_xticks(numbers, [str(label) for label in data["label"]], rotation=40, ha="right")
    level.set(xlabel="stack", ylabel="background over dark (DN)")
    level.legend()
    for colour, (label, rows, cols) in zip(
        COLOURS * 4, zip(data["label"], data["row_px"], data["col_px"], strict=True), strict=False
    ):
        positions = np.array(
            [(r, c) for r, c in zip(rows, cols, strict=True) if r is not None and c is not None],
            float,
        )
        if len(positions) > 1:
            position_axes.plot(
                *(positions - positions.mean(axis=0)).T[::-1],
                marker=".",
                color=colour,
                linewidth=0.8,
                label=str(label),
            )
    position_axes.axhline(0.0, color=INK, linewidth=0.6)
    position_axes.axvline(0.0, color=INK, linewidth=0.6)
    position_axes.set(xlabel="source, frame by frame: column (px)", ylabel="row (px)")
    return figure
