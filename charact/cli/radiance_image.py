"""A picture of a scene's radiance, with a scale in units: what lies before the lens, before any camera."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from simulate.radiance.cube import RadianceCube

# Per cent of the pixels between which the grey scale runs, in decades of at least so many.
SHOWN_PERCENT, LEAST_DECADES = (1.0, 99.8), 1.0
WIDTH_INCHES, DPI = 9.0, 120


def save_radiance(cube: "RadianceCube", title: str, path: Path) -> None:
    """Draw the radiance summed over bands, on a logarithmic scale.

    Parameters
    ----------
    cube
        Spectral radiance, W m-2 sr-1 nm-1.
    title
        What it shows.
    path
        The .png.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

    from simulate.radiance.cube import band_widths

    image = cube.sum_bands(band_widths(cube.wavelength_nm))
    low, high = _ends(image)
    rows, columns = image.shape
    figure = Figure(figsize=(WIDTH_INCHES, WIDTH_INCHES * rows / columns * 0.87 + 0.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    drawn: Any = axes.imshow(np.maximum(image, low), cmap="gray", norm=LogNorm(low, high), interpolation="nearest")
    extend = (
        ("both" if image.max() > high else "min") if image.min() < low else ("max" if image.max() > high else "neither")
    )
    bar = figure.colorbar(drawn, ax=axes, extend=extend, shrink=0.9, pad=0.02)
    first, last = cube.wavelength_nm[0], cube.wavelength_nm[-1]
    bar.set_label(f"radiance from {first:.0f} to {last:.0f} nm, W m$^{{-2}}$ sr$^{{-1}}$")
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_xlabel("column, px")
    axes.set_ylabel("row, px")
    figure.savefig(path, dpi=DPI)


def _ends(image: np.ndarray) -> tuple[float, float]:
    """Ends of the grey scale; a picture of nothing gets one all the same."""
    lit = image[image > 0.0]
    if not lit.size:
        return 1e-12, 1e-11
    low, high = (float(end) for end in np.percentile(lit, SHOWN_PERCENT))
    return low, max(high, low * 10.0**LEAST_DECADES)
