"""Figure behind single photoelectrons: filtered pixels as often as they came, with the law of the pulses."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from charact.report.plot_helpers import first_array, plot_line
from charact.report.style import DATA, INK, MODEL, WARN, panels

Data = Mapping[str, Any]


def plot_pulse_heights(data: Data) -> Any:
    """How often filtered pixels of darks come by their value, measured, by the fitted law and by the noise alone."""
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
        label="law of the pulses, fitted",
    )
    plot_line(
        axes,
        first_array(data, "value_dn"),
        first_array(data, "noise_per_dn"),
        color=INK,
        linestyle="--",
        label="noise alone",
    )
    response = float(data["response_to_mean_pulse_dn"])
    axes.axvline(response, color=WARN, linewidth=0.9, linestyle=":", label="mean pulse, amid its pixel")
    # Below one value in ten of all that were counted the law says nothing that could be seen.
    least = 0.1 / float(data["values"]) / float(edge[1] - edge[0])
    high, broad = (int(size) for size in np.asarray(data["filter_px"]))
    axes.set(yscale="log", ylim=(least, 5.0 * float(measured.max())), ylabel="share of the values per DN (1/DN)",
             xlabel=f"sum of {high} x {broad} px less the rows' own level (DN)")  # fmt: skip
    axes.legend()
    return figure
