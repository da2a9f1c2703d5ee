"""Figure of the resolution of a tube: limiting resolution against light, and minimum resolvable
contrast.
"""

from collections.abc import Mapping
from typing import Any

from charact.reporting.style import COLOURS, arms, first_array, panels, plot_line

DIRECTIONS = {0.0: "along rows", 90.0: "along columns"}
# Lights whose contrast is drawn, from the dimmest on.
MOST_LIGHTS = 4


def plot_resolution(data: Mapping[str, Any]) -> Any:
    """Plot limiting resolution against light in each direction, and the least contrast along the
    first one.
    """
    from matplotlib.ticker import NullFormatter

    figure, grid = panels(1, 2, size=(6.4, 3.4))
    limit_axes, contrast_axes = grid[0]
    light = first_array(data, "illuminance_lux")
    for colour, direction in zip(COLOURS, data["directions"], strict=False):
        known = [
            (lux, limit, *interval)
            for lux, limit, interval in zip(
                light, direction["limit_lp_per_mm"], direction["limit_interval95"], strict=True
            )
            if limit is not None
        ]
        lux, limit, low, high = zip(*known, strict=True)
        limit_axes.errorbar(
            lux,
            limit,
            yerr=arms(limit, low, high),
            color=colour,
            marker="o",
            markersize=3.5,
            label=DIRECTIONS[direction["orientation_deg"]],
        )
    limit_axes.set(
        xscale="log",
        xlabel="illuminance on the photocathode (lux)",
        ylabel="limiting resolution (lp/mm)",
    )
    limit_axes.xaxis.set_minor_formatter(NullFormatter())
    limit_axes.legend(fontsize=7)
    first = data["directions"][0]
    step = -(-len(light) // MOST_LIGHTS)
    for colour, lux, contrast in zip(
        COLOURS, light[::step], first["contrast"][::step], strict=False
    ):
        plot_line(
            contrast_axes,
            first["frequency_lp_per_mm"],
            contrast,
            color=colour,
            label=f"{lux:.2g} lux",
        )
    contrast_axes.set(
        yscale="log",
        ylim=(None, 1.0),
        xlabel=f"frequency {DIRECTIONS[first['orientation_deg']]} (lp/mm)",
        ylabel="least resolvable contrast (1)",
    )
    contrast_axes.legend(fontsize=7)
    return figure
