"""Figures behind halo and blooming: radial profiles of point sources, and diameter against overload."""

from collections.abc import Mapping
from typing import Any

from charact.report.edges import profile_with_residual
from charact.report.generic import array, dots, has
from charact.report.style import DATA, MODEL, panels

Data = Mapping[str, Any]


def point_profile(data: Data) -> Any:
    """Radial profile of a point source."""
    x = array(data, "radius_px", "distance_px")
    return profile_with_residual(data, x, array(data, "value_dn", "measured_dn"), "radius (px)", "signal (DN)")


def bloom_series(data: Data) -> Any:
    """Bloom diameter and halo diameter against overload."""
    figure, grid = panels(size=(5.6, 3.6))
    axes = grid[0, 0]
    x = array(data, "overload", "exposure")
    dots(axes, x, array(data, "diameter_px", "bloom_diameter_px"), color=DATA, markersize=5, label="bloom diameter")
    if has(data, "halo_diameter_px"):
        dots(axes, x, array(data, "halo_diameter_px"), color=MODEL, markersize=5, label="halo diameter")
    axes.set(xscale="log", xlabel="overload (1)", ylabel="diameter (px)")
    axes.legend()
    return figure
