"""Figures behind gain and noise: variance and covariance sum against the mean, and how far noise is shared."""

from collections.abc import Mapping
from typing import Any

from charact.report.generic import array, dots, has, line
from charact.report.style import COLOURS, INK, panels

Data = Mapping[str, Any]
TRANSFERS = (("variance_dn2", "variance"), ("covariance_sum_dn2", "covariance sum"))


def photon_transfer(data: Data) -> Any:
    """Temporal variance and covariance sum against the mean signal, with their fits."""
    figure, grid = panels(size=(5.6, 3.8))
    axes = grid[0, 0]
    mean = array(data, "mean_dn", "signal_dn")
    for colour, (key, label) in zip(COLOURS, TRANSFERS, strict=False):
        if has(data, key):
            sd = array(data, f"{key}_sd") if has(data, f"{key}_sd") else None
            dots(axes, mean, array(data, key), sd, color=colour, label=label, markersize=4)
        if has(data, f"{key}_model"):
            line(axes, mean, array(data, f"{key}_model"), color=colour)
    axes.set(xlabel="mean (DN)", ylabel="temporal variance (DN²)")
    axes.legend()
    return figure


def autocorrelation(data: Data) -> Any:
    """Correlation of the noise of two pixels against their distance, along rows and columns."""
    figure, grid = panels(size=(5.6, 3.4))
    axes = grid[0, 0]
    lag = array(data, "lag_px")
    for colour, (key, label) in zip(
        COLOURS, (("horizontal", "along rows"), ("vertical", "along columns")), strict=False
    ):
        if has(data, key):
            axes.plot(lag, array(data, key), "o-", markersize=3.5, color=colour, label=label)
    axes.axhline(0, color=INK, linewidth=0.8)
    axes.set(xlabel="distance (px)", ylabel="correlation of the noise (1)")
    axes.legend()
    return figure
