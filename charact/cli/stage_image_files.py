"""The image after each stage of a camera as files: one float TIFF a stage and a contact sheet with scales and units."""

import math
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Stage = tuple[str, str, NDArray[Any]]  # name, quantity with unit, image (row, col)

SHEET = "stages.png"
PANEL_INCHES = 3.4
LABEL_LETTERS = 36
# A panel has about so many dots along its longer side; finer images are averaged, for a skipped cell is a lost pulse.
PANEL_DOTS = 420
# The brightest few in a thousand may be single pulses: the scale ends below them and says so.
SHOWN_PERCENT = (0.1, 99.7)


def save_stages(stages: Iterable[Stage], folder: Path, title: str) -> int:
    """Write every stage's image, numbered in the order of the light, and the contact sheet; return how many.

    Parameters
    ----------
    stages
        Name, quantity with unit, and image (row, col) of each stage; taken one at a time.
    folder
        Where the files go; made where it is missing.
    title
        What the sheet shows.
    """
    import tifffile

    folder.mkdir(parents=True, exist_ok=True)
    shown = []
    for number, (name, quantity, image) in enumerate(stages, 1):
        values = np.asarray(image, np.float32)
        file = folder / f"{number:02d}-{name.replace(' ', '-')}.tif"
        tifffile.imwrite(file, values, description=f"{name}: {quantity}", software="charact", metadata=None)
        shown.append((f"{number} {name}", quantity, values))
    sheet(shown, title).savefig(folder / SHEET, dpi=110)
    return len(shown)


def sheet(stages: list[Stage], title: str) -> Any:
    """Return the contact sheet as a figure: a panel per stage, each with a bar of its own scale and unit."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = min(4, math.ceil(len(stages) ** 0.5))
    rows = -(-len(stages) // columns)
    aspect = max(image.shape[0] / image.shape[1] for _, _, image in stages)
    figure = Figure(
        figsize=(columns * PANEL_INCHES * 1.25, rows * (PANEL_INCHES * aspect + 0.65) + 0.4), layout="constrained"
    )
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11)
    for axes, stage in zip(figure.subplots(rows, columns, squeeze=False).flat, stages, strict=False):
        _panel(figure, axes, *stage)
    for axes in figure.axes:
        axes.set_visible(bool(axes.images) or axes.get_label() == "<colorbar>")
    return figure


def _panel(figure: Any, axes: Any, name: str, quantity: str, image: NDArray[np.float32]) -> None:
    block = max(1, math.ceil(max(image.shape) / PANEL_DOTS))
    size, image = image.shape, block_means(image, block)
    low, high = (float(end) for end in np.percentile(image, SHOWN_PERCENT))
    if not high > low:
        low, high = float(image.min()), float(max(image.max(), image.min() + 1e-6))
    drawn = axes.imshow(image, cmap="gray", vmin=low, vmax=high, interpolation="nearest")
    ends = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}
    beyond = ends[bool(image.min() < low), bool(image.max() > high)]
    bar = figure.colorbar(drawn, ax=axes, extend=beyond, shrink=0.9, pad=0.02)
    bar.set_label(textwrap.fill(quantity, LABEL_LETTERS), fontsize=8)
    bar.ax.tick_params(labelsize=7)
    bar.formatter.set_powerlimits((-3, 4))
    bar.formatter.set_useMathText(True)
    bar.ax.yaxis.offsetText.set_fontsize(7)
    axes.set_title(name, fontsize=9.5, loc="left")
    means = "" if block == 1 else f", shown as means of {block} x {block}"
    axes.set_xlabel(f"{size[0]} rows x {size[1]} columns{means}", fontsize=7)
    axes.set_xticks([])
    axes.set_yticks([])


def block_means(image: NDArray[np.float32], block: int) -> NDArray[np.float32]:
    """Return means over square blocks, those that the last rows and columns do not fill left out."""
    rows, cols = image.shape[0] // block, image.shape[1] // block
    if block == 1 or not rows or not cols:
        return image
    return image[: rows * block, : cols * block].reshape(rows, block, cols, block).mean(axis=(1, 3), dtype=np.float32)
