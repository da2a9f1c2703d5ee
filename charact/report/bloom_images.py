"""Pictures of blooming: frames of a point series with what was measured drawn in, and the bloom map of a frame."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.report.style import DATA, MODEL, THIRD, WARN, panels

Data = Mapping[str, Any]

MOST_FRAMES = 6
# Room around the halo, or around the largest bloom, as a multiple of its diameter.
ROOM = 1.5
LEAST_SIDE_PX = 40


def plot_bloom_frames(data: Data) -> Any:
    """Frames of up to six levels around the source: bloom, halo and streak drawn in, pixels at the highest code tinted.

    Reads `label`, and per stack: `frame_dn` (row, col) over which `row`, `col` of the source are given, `dark_dn`,
    `full_scale_dn`, `bloom_diameter_px` and `streak_length_px` (None where there is none); `halo_diameter_px`, one for
    all or None; `aspect`, row pitch over column pitch.
    """
    count = len(data["label"])
    shown = sorted({int(n) for n in np.linspace(0, count - 1, min(count, MOST_FRAMES)).round()})
    cols = min(3, len(shown))
    rows = -(-len(shown) // cols)
    figure, grid = panels(rows, cols, size=(2.15 * cols + 0.3, 2.25 * rows + 0.5))
    half = _half_side(data)
    for axes, number in zip(grid.ravel(), shown, strict=False):
        _frame(axes, data, number, half)
    for axes in grid.ravel()[len(shown) :]:
        axes.set_axis_off()
    for axes in grid[-1, :]:
        axes.set_xlabel("column (px)")
    for axes in grid[:, 0]:
        axes.set_ylabel("row (px)")
    figure.legend(handles=_handles(data), loc="outside lower center", ncols=4)
    return figure


def _half_side(data: Data) -> float:
    """Half the side of what is shown, column pitches."""
    largest = [float(d) for d in (*data["bloom_diameter_px"], data.get("halo_diameter_px")) if d]
    return 0.5 * max(LEAST_SIDE_PX, ROOM * max(largest, default=0.0))


def _frame(axes: Any, data: Data, number: int, half: float) -> None:
    from matplotlib.patches import Ellipse

    row, col, dark, full = (float(data[key][number]) for key in ("row", "col", "dark_dn", "full_scale_dn"))
    aspect = float(data.get("aspect") or 1.0)
    frame, extent = _cut(np.asarray(data["frame_dn"][number], float), row, col, half / aspect, half)
    limits = (0.0, np.log10(max(full - dark, 2.0)))
    axes.imshow(np.log10(np.maximum(frame - dark, 1.0)), cmap="gray", vmin=limits[0], vmax=limits[1], extent=extent,
                interpolation="nearest")  # fmt: skip
    _tint(axes, frame >= full - 0.5, extent)
    axes.set_aspect(aspect)
    for diameter, colour, style in (
        (data.get("halo_diameter_px"), THIRD, "--"),
        (data["bloom_diameter_px"][number], DATA, "-"),
    ):
        if diameter:
            axes.add_patch(Ellipse((col, row), diameter, diameter / aspect, fill=False, color=colour, linestyle=style,
                                   linewidth=1.3))  # fmt: skip
    if length := data["streak_length_px"][number]:
        axes.plot([col, col], [row - length / 2, row + length / 2], color=MODEL, linewidth=1.3)
    axes.set_xlim(col - half, col + half)
    axes.set_ylim(row + half / aspect, row - half / aspect)
    axes.set_title(str(data["label"][number]))
    axes.grid(False)


def _cut(
    frame: NDArray, row: float, col: float, down: float, across: float
) -> tuple[NDArray, tuple[float, float, float, float]]:
    """Return the part of a frame around a place, and its edges: left, right, bottom, top, px."""
    first = max(0, int(row - down) - 1), max(0, int(col - across) - 1)
    cut = frame[first[0] : int(row + down) + 3, first[1] : int(col + across) + 3]
    top, left = first[0] - 0.5, first[1] - 0.5
    return cut, (left, left + cut.shape[1], top + cut.shape[0], top)


def _tint(axes: Any, mask: NDArray, extent: tuple[float, float, float, float]) -> None:
    """Lay a colour over some pixels."""
    from matplotlib.colors import to_rgba

    layer = np.zeros((*mask.shape, 4))
    layer[mask] = to_rgba(WARN, 0.45)
    axes.imshow(layer, extent=extent, interpolation="nearest")


def _handles(data: Data) -> list[Any]:
    """What the lines and the tint mean."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    halo = [Line2D([], [], color=THIRD, linestyle="--", label="halo")] if data.get("halo_diameter_px") else []
    return [
        Line2D([], [], color=DATA, label="bloom, half of full scale"),
        *halo,
        Line2D([], [], color=MODEL, label="streak"),
        Patch(facecolor=WARN, alpha=0.45, label="highest code"),
    ]


def plot_bloom_map(data: Data) -> Any:
    """A frame, the share of every pixel's signal that is blooming, and that share's standard deviation.

    Reads `signal_dn`, `fraction`, `sd` (row, col), NaN where nothing is said, `near_px`, `sources` (mappings with
    `row`, `col`, `known`), `aspect`, row pitch over column pitch, and `truth` (row, col) where the true share is known.
    """
    signal, sd = np.asarray(data["signal_dn"], float), np.asarray(data["sd"], float)
    aspect = float(data.get("aspect") or 1.0)
    finite = np.isfinite(sd)
    most = max(0.02, float(np.quantile(sd[finite], 0.99)) if finite.any() else 1.0)
    share = f"share that entered farther than {data['near_px']:g} px away (1)"
    shown = [
        ("frame", np.log10(np.maximum(signal, 1.0)), "gray", None, "log10 of the signal over dark (DN)"),
        ("blooming (grey: unknown)", data["fraction"], "magma", 1.0, share),
        ("how well it is known", sd, "magma", most, "standard deviation of the share (1)"),
    ]
    if data.get("truth") is not None:
        shown.insert(2, ("true share", data["truth"], "magma", 1.0, share))
    cols = 2 if len(shown) == 4 else 3
    rows = -(-len(shown) // cols)
    tall = 4.4 * min(1.3, max(0.5, signal.shape[0] * aspect / signal.shape[1])) + 0.4
    figure, grid = panels(rows, cols, size=(4.6 * cols, tall * rows))
    for axes, (title, image, colours, top, words) in zip(grid.ravel(), shown, strict=True):
        axes.set_facecolor("#9a9a9a")
        low = None if top is None else 0.0
        drawn = axes.imshow(np.asarray(image, float), cmap=colours, vmin=low, vmax=top, aspect=aspect)
        figure.colorbar(drawn, ax=axes, shrink=0.8, label=words)
        axes.set(title=title, xlabel="column (px)", ylabel="row (px)")
        axes.grid(False)
    for source in data.get("sources", ()):
        mark, colour = ("+", THIRD) if source["known"] else ("x", WARN)
        grid[0, 0].plot(source["col"], source["row"], mark, color=colour, markersize=9, markeredgewidth=1.6)
    return figure
