"""Figure of the edge methods beside other programs: errors of MTF50 and of the MTF against the noise."""

from collections.abc import Mapping
from itertools import cycle
from pathlib import Path
from typing import Any

from charact.study.study_figures import COLOURS, _pyplot, plain_numbers

THEIRS = ("#333333", "#777777", "#aaaaaa")
PANELS = (
    ("rms_percent", "RMS error of MTF50 (% of the truth)"),
    ("rms_mtf", "RMS error of the MTF below 0.5 cy/px (1)"),
)
# Share of frames with a number from which a mark is full.
MOSTLY = 0.95


def plot_peers(found: Mapping[str, Any], path: Path) -> Path:
    """Draw the table of `charact.study.edge.peers.study`; other programs are dashed.

    Parameters
    ----------
    found
        The table.
    path
        Where the PNG goes.
    """
    figure, panels = _pyplot().subplots(1, 2, figsize=(11.0, 4.6), layout="constrained")
    for panel, (quantity, label) in zip(panels, PANELS, strict=True):
        _draw_panel(panel, found, quantity)
        panel.set(xscale="log", yscale="log", xlabel="step / standard deviation of the noise (1)", ylabel=label)
        plain_numbers(panel.xaxis, panel.yaxis)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right center", frameon=False, fontsize=8)
    figure.suptitle(f"{found['edge']}\nopen marks: fewer than {MOSTLY:.0%} of the frames gave a number", fontsize=9)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    _pyplot().close(figure)
    return path


def _draw_panel(panel: Any, found: Mapping[str, Any], quantity: str) -> None:
    """One quantity: our methods, the other programs and the bound."""
    methods = list(dict.fromkeys(row["method"] for row in found["ours"]))
    for method, colour in zip(methods, cycle(COLOURS), strict=False):
        rows = [row for row in found["ours"] if row["method"] == method and row[quantity] is not None]
        panel.plot([row["snr"] for row in rows], [row[quantity] for row in rows], color=colour, label=method)
        for row in rows:
            full = row["numbers"] >= MOSTLY * row["frames"]
            panel.plot(
                row["snr"],
                row[quantity],
                "o",
                color=colour,
                markerfacecolor=colour if full else "white",
                markersize=4.5,
            )
    for peer, colour, mark in zip(found["peers"], THEIRS, ("s", "D", "^"), strict=True):
        # Keys of JSON objects are text.
        points = {float(snr): value for snr, value in peer[quantity].items()}
        panel.plot(points.keys(), points.values(), f"{mark}--", color=colour, markersize=4.5, label=peer["name"])
        for snr in points.keys() & peer["seldom"]:
            panel.plot(snr, points[snr], mark, color=colour, markerfacecolor="white", markersize=4.5)
    panel.plot(
        [row["snr"] for row in found["bound"]], [row[quantity] for row in found["bound"]], ":", color="black",
        linewidth=1.8, label="Cramer-Rao bound",
    )  # fmt: skip
