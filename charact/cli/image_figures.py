"""Images of a simulation as PNG: scene radiance, the image after each stage, and surface
temperatures.
"""

import io
import math
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from labdata.file_io import write_atomically

if TYPE_CHECKING:
    from simulate.radiance.cube import RadianceCube

WIDTH_INCHES, PANEL_INCHES = 9.0, 3.4
SHEET = "stages.png"


def new_figure(width: float, height: float) -> Any:
    """Return a figure without global state, inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_png(figure: Any, path: Path, dpi: int = 120) -> None:
    """Write a figure as PNG, atomically."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=dpi)
    write_atomically(path, content.getbuffer())


def plot_image(
    figure: Any,
    axes: Any,
    image: NDArray,
    low: float,
    high: float,
    label: str,
    *,
    cmap: str = "gray",
    logarithmic: bool = False,
) -> Any:
    """Plot an image with a colour bar, whose ends show whether values lie beyond; return the
    bar.
    """
    from matplotlib.colors import LogNorm, Normalize

    norm = (LogNorm if logarithmic else Normalize)(low, high)
    shown = np.maximum(image, low) if logarithmic else image
    drawn = axes.imshow(shown, cmap=cmap, norm=norm, interpolation="nearest")
    ends = {
        (False, False): "neither",
        (True, False): "min",
        (False, True): "max",
        (True, True): "both",
    }
    extension = ends[bool(np.nanmin(image) < low), bool(np.nanmax(image) > high)]
    bar = figure.colorbar(drawn, ax=axes, extend=extension, shrink=0.9, pad=0.02)
    bar.set_label(label)
    return bar


def frame_figure(
    image: NDArray, title: str, low: float, high: float, label: str, **options: Any
) -> Any:
    """Return the figure of one image of a frame, with pixel axes."""
    rows, columns = image.shape
    figure = new_figure(WIDTH_INCHES, WIDTH_INCHES * rows / columns * 0.87 + 0.5)
    axes = figure.subplots()
    plot_image(figure, axes, image, low, high, label, **options)
    axes.set_title(title, fontsize=10, loc="left")
    axes.set(xlabel="column, px", ylabel="row, px")
    return figure


def save_radiance(cube: "RadianceCube", title: str, path: Path) -> None:
    """Plot the spectral radiance (W m-2 sr-1 nm-1) summed over bands, on a logarithmic scale."""
    from simulate.radiance.cube import band_widths

    image = cube.sum_bands(band_widths(cube.wavelength_nm))
    lit = image[image > 0.0]
    low, high = (
        (float(end) for end in np.percentile(lit, (1.0, 99.8))) if lit.size else (1e-12, 1e-11)
    )
    first, last = cube.wavelength_nm[0], cube.wavelength_nm[-1]
    label = f"radiance from {first:.0f} to {last:.0f} nm, W m$^{{-2}}$ sr$^{{-1}}$"
    path.parent.mkdir(parents=True, exist_ok=True)
    save_png(frame_figure(image, title, low, max(high, 10.0 * low), label, logarithmic=True), path)


def save_apparent_temperature(
    kelvin: NDArray, title: str, path: Path, pixel_aspect: float = 1.0
) -> None:
    """Plot apparent temperatures (row, col), K, between percentiles, with pixels of a height over
    width.
    """
    celsius = kelvin - 273.15
    low, high = (float(end) for end in np.percentile(celsius, (2.0, 99.5)))
    path.parent.mkdir(parents=True, exist_ok=True)
    figure = frame_figure(celsius, title, low, max(high, low + 0.1), "apparent temperature, C")
    rows, columns = kelvin.shape
    figure.set_size_inches(WIDTH_INCHES, WIDTH_INCHES * pixel_aspect * rows / columns * 0.87 + 0.5)
    figure.axes[0].set_aspect(pixel_aspect)
    save_png(figure, path)


def save_stages(stages: Iterable[tuple[str, str, NDArray]], folder: Path, title: str) -> int:
    """Write every stage's name, quantity and image (row, col) as a numbered TIFF, and the contact
    sheet; count them.
    """
    import tifffile

    folder.mkdir(parents=True, exist_ok=True)
    shown = []
    for number, (name, quantity, image) in enumerate(stages, 1):
        values = np.asarray(image, np.float32)
        file = folder / f"{number:02d}-{name.replace(' ', '-')}.tif"
        tifffile.imwrite(
            file, values, description=f"{name}: {quantity}", software="charact", metadata=None
        )
        shown.append((f"{number} {name}", quantity, values))
    save_png(sheet(shown, title), folder / SHEET, dpi=110)
    return len(shown)


def sheet(stages: list[tuple[str, str, NDArray[np.float32]]], title: str) -> Any:
    """Return the contact sheet: one panel per stage with its own scale and unit."""
    columns = min(4, math.ceil(len(stages) ** 0.5))
    rows = -(-len(stages) // columns)
    aspect = max(image.shape[0] / image.shape[1] for _, _, image in stages)
    figure = new_figure(columns * PANEL_INCHES * 1.25, rows * (PANEL_INCHES * aspect + 0.65) + 0.4)
    figure.suptitle(title, fontsize=11)
    grid = figure.subplots(rows, columns, squeeze=False).flat
    for axes in grid[len(stages) :]:
        axes.set_visible(False)
    for axes, (name, quantity, image) in zip(grid, stages, strict=False):
        # Finer images are averaged over blocks, so that no pulse is lost.
        block = max(1, math.ceil(max(image.shape) / 420))
        height, width = (size // block for size in image.shape)
        means = (
            image[: height * block, : width * block]
            .reshape(height, block, width, block)
            .mean(axis=(1, 3))
        )
        # The brightest 0.3 % may be single pulses.
        low, high = (float(end) for end in np.percentile(means, (0.1, 99.7)))
        if not high > low:
            low, high = float(means.min()), float(max(means.max(), means.min() + 1e-6))
        bar = plot_image(figure, axes, means, low, high, textwrap.fill(quantity, 36))
        bar.ax.yaxis.label.set_size(8)
        bar.ax.tick_params(labelsize=7)
        bar.formatter.set_powerlimits((-3, 4))
        bar.formatter.set_useMathText(True)
        bar.ax.yaxis.offsetText.set_fontsize(7)
        axes.set_title(name, fontsize=9.5, loc="left")
        shown = "" if block == 1 else f", shown as means of {block} x {block}"
        axes.set_xlabel(f"{image.shape[0]} rows x {image.shape[1]} columns{shown}", fontsize=7)
        axes.set(xticks=[], yticks=[])
    return figure
