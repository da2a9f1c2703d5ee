"""Figures that verbs write: scene radiance, the image after each stage, surface temperatures, and
the chart of methods.
"""

import io
import math
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from charact.method.stopwatch import time_text
from charact.reporting.figure_svg import Label, path_svg, svg_head
from charact.reporting.style import COLOURS, PAPER_INK
from labdata.file_io import write_atomically

if TYPE_CHECKING:
    from simulate.radiance.cube import RadianceCube
    from simulate.surface_temperatures import SurfaceTemperatures

WIDTH_INCHES, PANEL_INCHES = 9.0, 3.4
SHEET = "stages.png"
# Size of the chart of methods, points.
WIDTH, HEIGHT = 404.0, 274.0
Row = Mapping[str, Any]


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


def temperature_curves(warm: "SurfaceTemperatures", title: str) -> Any:
    """Plot temperatures of the air and of each material against hours before the scene's time."""
    hours = range(-24, 1)
    figure = new_figure(WIDTH_INCHES, 0.6 * WIDTH_INCHES)
    axes = figure.subplots()
    ordered = sorted(warm.surfaces_c.items(), key=lambda item: -item[1][-1])
    for number, (name, values) in enumerate(ordered):
        style = ("-", "--", ":")[number // 10 % 3]
        axes.plot(
            hours,
            values,
            style,
            color=f"C{number % 10}",
            lw=1.3,
            label=f"{name}  {values[-1]:.1f} C",
        )
    axes.plot(hours, warm.air_c, color="black", lw=2.0, label=f"air  {warm.air_c[-1]:.1f} C")
    axes.set(
        xlabel="hours before the scene's time",
        ylabel="temperature, C",
        xlim=(-24, 0),
        xticks=range(-24, 1, 3),
    )
    axes.set_title(title, fontsize=10, loc="left")
    axes.grid(alpha=0.3)
    axes.legend(
        loc="center left",
        bbox_to_anchor=(1.0, 0.5),
        fontsize=7,
        frameon=False,
        title="mean at that time",
    )
    return figure


def temperature_map(kelvin: NDArray, title: str) -> Any:
    """Plot the surface temperatures in the camera's view; the sky has none."""
    celsius = kelvin - 273.15
    seen = celsius[np.isfinite(celsius)]
    # Percentiles of the map's pixels at the ends of its scale.
    low, high = np.percentile(seen, (0.5, 99.5)) if seen.size else (0.0, 1.0)
    label = "surface temperature, C (sky: grey)"
    figure = frame_figure(celsius, title, low, max(high, low + 1.0), label, cmap="inferno")
    figure.axes[0].set_facecolor("lightgrey")
    return figure


def chart_lines(quantity: str, rows: Sequence[Row]) -> Iterator[str]:
    """Yield the table of a chart, the fastest method first."""
    yield (
        f"{quantity}: error of values on {rows[0]['cases']} cases of known truth, and computing "
        f"time"
    )
    yield f"{'method':20} {'95th percentile':>16} {'upper limit':>12} {'median time':>12}"
    for row in sorted(rows, key=lambda row: row["seconds"]):
        limit = row.get("error_limit_percent")
        limit_text = "" if limit is None else f"{limit:.3g} %"
        yield (
            f"{row['method']:20} {row['error_percent']:14.3g} % {limit_text:>12} "
            f"{time_text(row['seconds']):>12}"
        )


def failure_lines(quantity: str, rows: Sequence[Row]) -> Iterator[str]:
    """Yield how often each method was ok, suspect, refused and silently wrong on the cases of the
    chart.
    """
    yield (
        f"{quantity}: outcome on the cases of the chart; silent: ok, and off by over twice the "
        f"interval"
    )
    names = ("cases", "ok", "suspect", "refused", "silent")
    yield f"{'method':20}" + "".join(f"{name:>9}" for name in (*names, "missed"))
    for row in rows:
        missed = row.get("missed_fraction")
        missed_text = "" if missed is None else f"{100 * missed:.1f} %"
        yield (
            f"{row['method']:20}"
            + "".join(f"{row.get(name, 0):9d}" for name in names)
            + f"{missed_text:>9}"
        )


def write_chart(quantity: str, rows: Sequence[Row], out: Path) -> Path:
    """Plot error against time of each method into a folder, and return the file, an SVG.

    It is written without matplotlib, whose import takes longer than all else that this verb does.
    """
    limits = [row.get("error_limit_percent", row["error_percent"]) for row in rows]
    times, errors = [row["seconds"] for row in rows], [row["error_percent"] for row in rows]
    # Room for the names at the right.
    across = _LogScale(min(times) / 2.0, max(times) * 6.0, 44.0, WIDTH - 6.0)
    up = _LogScale(min(errors) / 1.2, max(limits) * 1.2, 36.0, HEIGHT - 22.0)
    low, high = (across.start, up.start), (across.end, up.end)
    grid = [
        step
        for x in across.ticks
        for step in (("M", across(x), HEIGHT - low[1]), ("V", HEIGHT - high[1]))
    ]
    grid += [step for y in up.ticks for step in (("M", low[0], HEIGHT - up(y)), ("H", high[0]))]
    frame = (("M", low[0], HEIGHT - high[1]), ("V", HEIGHT - low[1]), ("H", high[0]))
    texts = [Label(f"{x:g}", across(x), low[1] - 10.0, 9.0) for x in across.ticks]
    texts += [Label(f"{y:g}", low[0] - 5.0, up(y), 9.0, "end") for y in up.ticks]
    texts += [
        Label("median computing time (s)", 0.5 * (low[0] + high[0]), 9.0, 9.0),
        Label(
            f"error of {quantity}, 95th percentile (%)",
            10.0,
            0.5 * (low[1] + high[1]),
            9.0,
            angle=90.0,
        ),
        Label(
            "bars: to the upper 95 % confidence limit", 0.5 * (low[0] + high[0]), HEIGHT - 11.0, 9.5
        ),
    ]
    parts = [path_svg(grid, 'stroke="#ddd"'), path_svg(frame, f'fill="none" stroke="{PAPER_INK}"')]
    parts += (text.svg(HEIGHT) for text in texts)
    for colour, row, limit in zip(COLOURS * 2, rows, limits, strict=False):
        x, y, top = across(row["seconds"]), HEIGHT - up(row["error_percent"]), HEIGHT - up(limit)
        bar = (("M", x, y), ("V", top), ("M", x - 3.0, top), ("H", x + 3.0))
        mark = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3"/>' + path_svg(
            bar, f'stroke="{colour}" stroke-width="1.4"'
        )
        name = Label(row["method"], x + 6.0, HEIGHT - y + 6.0, 8.0, "start").svg(HEIGHT)
        parts.append(f'<g fill="{colour}">{mark}{name}</g>')
    box = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {HEIGHT:g}"'
    head = svg_head(box, f"Error against computing time of the methods of {quantity}")
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"chart-{quantity}.svg"
    body = (
        '<rect width="100%" height="100%" fill="white"/><g '
        f'fill="{PAPER_INK}">{"".join(parts)}</g></svg>'
    )
    write_atomically(path, (head + body).encode())
    return path


@dataclass(frozen=True)
class _LogScale:
    """Logarithmic scale of values `low` to `high` on places `start` to `end`, points."""

    low: float
    high: float
    start: float
    end: float

    def __call__(self, value: float) -> float:
        return self.start + (self.end - self.start) * math.log(value / self.low) / math.log(
            self.high / self.low
        )

    @property
    def ticks(self) -> list[float]:
        """Return 1, 2 and 5 of each decade within the scale; at the rim a label would be cut."""
        decades = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)))
        values = [factor * 10.0**decade for decade in decades for factor in (1.0, 2.0, 5.0)]
        return [value for value in values if 1.02 * self.low < value < self.high / 1.02]
