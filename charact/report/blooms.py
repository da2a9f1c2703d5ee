"""Figures behind halo and blooming: radial profiles with their fit, diameters against the light."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from charact.report.generic import array, dots, has, line
from charact.report.style import COLOURS, DATA, INK, MODEL, THIRD, panels

Data = Mapping[str, Any]
MOST_PROFILES = 6


def point_profile(data: Data) -> Any:
    """Radial profiles of a point series with the joint fit; the halo's radius marked."""
    figure, grid = panels(size=(5.6, 4.0))
    axes = grid[0, 0]
    for colour, number in zip(COLOURS * 2, _spaced(len(data["label"])), strict=False):
        radius, mean, sd = (np.asarray(data[key][number], float) for key in ("radius_px", "mean_dn", "sd_dn"))
        used = np.asarray(data["used"][number], bool)
        dots(axes, radius[used], mean[used], sd[used], color=colour, label=str(data["label"][number]), alpha=0.8)
        dots(axes, radius[~used], mean[~used], color=colour, alpha=0.25)
        if has(data, "model_dn"):
            line(axes, radius, np.asarray(data["model_dn"][number], float), color=colour, linewidth=1)
    if data.get("halo_diameter_px") is not None:
        axes.axvline(data["halo_diameter_px"] / 2, color=INK, linestyle="--", linewidth=0.9, label="halo radius")
    means = np.concatenate([np.asarray(mean, float) for mean in data["mean_dn"]])
    low, high = float(means.min()), float(means.max())
    axes.set(xlabel="distance from the source (column pitches, px)", ylabel="mean of the ring (DN)")
    # A halo is a small step on a long slope: a logarithmic scale shows both.
    axes.set_yscale("log" if low > 0 else "linear")
    axes.set_ylim(0.93 * low if low > 0 else low - 0.05 * high, 1.2 * high)
    axes.legend(ncols=2)
    return figure


def point_spread(data: Data) -> Any:
    """A point source along its row and column and its rings further out, with the model."""
    figure, grid = panels(1, 2, size=(5.8, 3.4), width_ratios=(1.2, 1))
    core, rings = grid[0]
    for colour, way, place in ((DATA, "row", "column_px"), (THIRD, "column", "row_px")):
        x = array(data, place)
        dots(core, x, array(data, f"along_{way}_dn"), color=colour, label=f"along the {way}", markersize=4)
        line(core, x, array(data, f"along_{way}_model_dn"), color=colour)
    core.set(xlabel="distance from the source (px)", ylabel="signal (DN)")
    core.legend()
    radius, mean = array(data, "ring_px"), array(data, "ring_dn")
    dots(rings, radius, mean, array(data, "ring_sd_dn"), color=DATA, label="rings, ± 1 sd")
    line(rings, radius, array(data, "ring_model_dn"), color=MODEL, label="model", zorder=3)
    rings.set(xlabel="radius (column pitches, px)", ylabel="mean of the ring (DN)")
    rings.legend()
    return figure


def _spaced(count: int) -> list[int]:
    """At most six levels, evenly chosen."""
    return sorted({int(n) for n in np.linspace(0, count - 1, min(count, MOST_PROFILES)).round()})


def exposure(data: Data) -> tuple[np.ndarray, str]:
    """What rises from stack to stack: the overload where it is known, else the light dose, else the stack's number."""
    if data.get("overload_known"):
        return array(data, "overload"), "overload: light over what meets full scale (1)"
    gate = [1.0 if value is None else value for value in data.get("gate_ns", [])]
    light = [None if value is None else value for value in data.get("illuminance_lux", [])]
    if light and all(value is not None and value > 0 for value in light):
        return np.asarray(light, float) * np.asarray(gate, float) * 1e-9, "light dose on the photocathode (lux s)"
    return np.arange(1, len(data["label"]) + 1, dtype=float), "stack, in order (1)"


def bloom_series(data: Data) -> Any:
    """Bloom diameter and streak length against the light."""
    figure, grid = panels(size=(5.6, 3.6))
    axes = grid[0, 0]
    x, label = exposure(data)
    dots(axes, x, array(data, "bloom_diameter_px"), color=DATA, markersize=5, label="bloom diameter")
    dots(axes, x, array(data, "streak_length_px"), color=MODEL, markersize=5, marker="s", label="streak length")
    halo = [(at, diameter) for at, diameter in zip(x, data.get("halo_diameter_px", []), strict=False) if diameter]
    if halo:
        dots(
            axes,
            *zip(*halo, strict=True),
            color=THIRD,
            markersize=5,
            marker="D",
            mfc="none",
            label="halo, edge before blur",
        )
    if not label.startswith("stack"):
        axes.set_xscale("log")
    axes.set(xlabel=label, ylabel="diameter or length at half of full scale (px)")
    axes.legend()
    return figure


def halo_constancy(data: Data) -> Any:
    """Halo diameter of every level on its own, with 95 %: geometry fixes it, so it must not change with the light."""
    figure, grid = panels(size=(5.6, 3.2))
    axes = grid[0, 0]
    seen = [n for n, diameter in enumerate(data["halo_diameter_px"]) if diameter is not None]
    diameter = np.array([data["halo_diameter_px"][n] for n in seen], float)
    ends = np.array([data["interval95_px"][n] for n in seen], float).reshape(-1, 2)
    arms = np.maximum([diameter - ends[:, 0], ends[:, 1] - diameter], 0)
    axes.errorbar(seen, diameter, yerr=arms, fmt="o", color=DATA, markersize=4.5, linewidth=1, label="one level, 95 %")
    axes.set_xticks(range(len(data["label"])), [str(label) for label in data["label"]], rotation=30, ha="right")
    axes.set(xlabel="stack", ylabel="halo diameter (px)", xlim=(-0.5, len(data["label"]) - 0.5))
    axes.legend()
    return figure
