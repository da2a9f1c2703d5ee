"""Figures behind an MTF: edge spread with its model and what is left over, and bars with theirs."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from charact.report.generic import array, dots, has, line
from charact.report.style import DATA, INK, MODEL, panels

Data = Mapping[str, Any]


def profile_with_residual(data: Data, x: Any, measured: Any, xlabel: str, ylabel: str) -> Any:
    """Measured points and model above, their difference below, in the same unit."""
    figure, grid = panels(2, 1, size=(5.6, 4.2), sharex=True, height_ratios=(3, 1.2))
    upper, lower = grid[:, 0]
    sd = array(data, "sd_dn", "sd") if has(data, "sd_dn") or has(data, "sd") else None
    dots(upper, x, measured, sd, color=DATA, alpha=0.7, label="measured" if sd is None else "measured, ± 1 sd")
    upper.set_ylabel(ylabel)
    lower.set(xlabel=xlabel, ylabel="residual (DN)")
    lower.axhline(0, color=INK, linewidth=0.8)
    if has(data, "model_dn") or has(data, "model"):
        model = array(data, "model_dn", "model")
        line(upper, x, model, color=MODEL, label="model")
        dots(lower, x, np.asarray(measured, float) - model, sd, color=DATA, alpha=0.7)
    upper.legend()
    return figure


def edge_spread(data: Data) -> Any:
    """Edge spread against the distance from the edge."""
    x = array(data, "distance_px", "position_px")
    return profile_with_residual(data, x, array(data, "value_dn", "measured_dn", "edge_spread_dn"),
                                 "distance from the edge (px)", "signal (DN)")  # fmt: skip


def bars(data: Data) -> Any:
    """Profile across the bars."""
    x = array(data, "distance_px", "position_px")
    return profile_with_residual(
        data, x, array(data, "value_dn", "measured_dn"), "distance across the bars (px)", "signal (DN)"
    )
