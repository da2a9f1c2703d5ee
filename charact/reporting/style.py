"""Style and plot functions common to all figures."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata.errors import BadInput
from labdata.file_io import require_folder_of

# Placeholder of the page's text colour, so that figures suit light and dark backgrounds.
INK = "#123457"
PAPER_INK = "#1b1f24"
# Colours differ in lightness and hue, and are visible on white and black.
DATA, MODEL, THIRD, FOURTH, WARN = "#2b83ba", "#e0701a", "#2a9d6f", "#a06cd5", "#d7263d"
COLOURS = (DATA, MODEL, THIRD, FOURTH, "#b8860b", "#17a2b8", "#c2557a", "#7a8b2f")
SETTINGS: dict[str, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "charact",
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.12,
    "lines.linewidth": 1.4,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    **dict.fromkeys(
        (
            "text.color",
            "axes.labelcolor",
            "axes.edgecolor",
            "xtick.color",
            "ytick.color",
            "grid.color",
            "axes.titlecolor",
        ),
        INK,
    ),
}


@contextmanager
def report_style() -> Iterator[None]:
    """Plot in the report's style, independent of the user's matplotlib settings."""
    from matplotlib import rcParams, style

    if rcParams["text.color"] == INK:  # A page sets the style once for all of its figures.
        yield
        return
    with style.context(["default", SETTINGS]):
        yield


@contextmanager
def white_style() -> Iterator[None]:
    """Plot in the report's style on white, for a separate file."""
    from matplotlib import style

    inks = [name for name, value in SETTINGS.items() if value == INK]
    white = dict.fromkeys(("figure.facecolor", "axes.facecolor", "savefig.facecolor"), "white")
    with style.context(["default", SETTINGS, {**dict.fromkeys(inks, PAPER_INK), **white}]):
        yield


FIGURE_FILES = (".png", ".svg", ".pdf")


def require_figure_file(path: str | Path) -> Path:
    """Return the path of a figure; an ending other than `FIGURE_FILES`, or a folder that does not
    exist, is BadInput.
    """
    path = Path(path)
    if path.suffix.lower() not in FIGURE_FILES:
        raise BadInput(f"a figure must be a file in {', '.join(FIGURE_FILES)}, got {path.name!r}")
    return require_folder_of(path)


def save_figure(figure: Any, path: str | Path) -> None:
    """Save a figure as a file of its own."""
    figure.savefig(require_figure_file(path), dpi=130)


def panels(
    rows: int = 1, cols: int = 1, *, size: tuple[float, float] = (5.6, 3.4), **options: Any
) -> tuple[Any, NDArray[Any]]:
    """Return a figure and its axes, shape (rows, cols), without global state."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasSVG(figure)
    return figure, figure.subplots(rows, cols, squeeze=False, **options)


def panel(size: tuple[float, float] = (5.6, 3.4), **labels: Any) -> tuple[Any, Any]:
    """Return a figure and its only axes, with labels and limits."""
    figure, grid = panels(size=size)
    grid[0, 0].set(**labels)
    return figure, grid[0, 0]


def subsample(*columns: ArrayLike, max_points: int = 300) -> tuple[NDArray[np.float64], ...]:
    """Return arrays of equal length with at most `max_points` points at equal intervals."""
    arrays = [np.asarray(column, float) for column in columns]
    length = min(len(array) for array in arrays)
    keep = (
        np.unique(np.linspace(0, length - 1, min(length, max_points)).round().astype(int))
        if length
        else np.arange(0)
    )
    return tuple(array[keep] for array in arrays)


def write_note(axes: Any, sentence: str) -> None:
    """Write a sentence in an empty panel."""
    axes.text(0.5, 0.5, sentence, ha="center", va="center", transform=axes.transAxes, wrap=True)
    axes.grid(False)


def first_array(data: Mapping[str, Any], *names: str) -> NDArray[np.float64]:
    """Return the first array found under one of the names; KeyError if there is none."""
    for name in names:
        if data.get(name) is not None:
            return np.asarray(data[name], float)
    raise KeyError(" or ".join(names))


def has_all(data: Mapping[str, Any], *names: str) -> bool:
    """Whether all names have data."""
    return all(data.get(name) is not None and np.size(data[name]) > 0 for name in names)


def plot_line(axes: Any, x: ArrayLike, y: ArrayLike, **options: Any) -> None:
    """Plot a line of at most 300 points."""
    axes.plot(*subsample(x, y), **options)


def plot_points(
    axes: Any, x: ArrayLike, y: ArrayLike, sd: ArrayLike | None = None, **options: Any
) -> None:
    """Plot points with error bars of one standard uncertainty."""
    options = {"markersize": 2.8, "linestyle": "", "marker": "o", **options}
    if sd is None:
        axes.plot(*subsample(x, y, max_points=160), **options)
        return
    horizontal, vertical, arm = subsample(x, y, sd, max_points=160)
    axes.errorbar(horizontal, vertical, yerr=np.abs(arm), elinewidth=0.8, **options)


def plot_band(
    axes: Any, x: ArrayLike, low: ArrayLike, high: ArrayLike, colour: str, alpha: float = 0.25
) -> None:
    """Plot an interval as a transparent band."""
    axes.fill_between(x, low, high, color=colour, alpha=alpha, linewidth=0)


def arms(value: ArrayLike, low: ArrayLike, high: ArrayLike) -> NDArray[np.float64]:
    """Return the distances to the limits of an interval, shape (2, n), for error bars."""
    middle, bottom, top = (np.atleast_1d(np.asarray(part, float)) for part in (value, low, high))
    return np.maximum([middle - bottom, top - middle], 0.0)


def zero_line(axes: Any) -> None:
    """Mark the value zero."""
    axes.axhline(0, color=INK, linewidth=0.8)
