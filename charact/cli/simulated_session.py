"""Files of a simulation: session of frames, scene radiance, and the image after each stage."""

import json
import math
import textwrap
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from charact import __version__
from charact.cli.simulation_sources import Shot, SimulationRequest, night_of
from labdata.conditions import Conditions

if TYPE_CHECKING:
    from charact.cli.simulation_sources import Description
    from simulate.outdoor_rendering import RenderedView
    from simulate.radiance.cube import RadianceCube


def preview_into(
    out: Path, request: SimulationRequest, description: "Description", conditions: Conditions, *, explain: bool
) -> tuple[str, ...]:
    """Keep what a scene out of doors shows in seconds, print its plan if request for, and return what it leaves out."""
    view = night_of(request, description, conditions).render(
        tolerance=request.tolerance, seed=request.seed, preview=True
    )
    if explain:
        print(view.plan.text())
    _save_view(view, out)
    return view.left_out


def save_frames(
    shot: Shot,
    description: "Description",
    out: Path,
    *,
    frames: int,
    seed: int,
    notes: tuple[str, ...] = (),
    progress: Callable[[str, float], None] = lambda sentence, share: None,
) -> None:
    """Simulate frames and store them as a session, one frame at a time."""
    from labdata.file_io import write_atomically
    from labdata.sensors import save_sensor
    from labdata.store import SessionWriter

    stream = shot.frames(seed=seed)
    first, video = next(stream), description.video
    with SessionWriter.create(
        out, name=f"simulated {shot.kind}", sensor="sensor.toml", bit_depth=video.bit_depth, interlaced=video.interlaced
    ) as writer:
        save_sensor(description, out / "sensor.toml")
        kind, pixel = shot.kind, first.dtype
        with writer.begin_stack(kind, kind, first.shape, pixel, shot.conditions, target=shot.target) as stack:
            stack.append(first, 0.0, 0)
            for number, frame in enumerate(islice(stream, frames - 1), 1):
                stack.append(frame, number * shot.camera.frame_s, number)
                progress(f"frame {number + 1} of {frames}", (number + 1) / frames)
            stack.finish(
                notes=(f"simulated by charact {__version__}, seed {seed}", *shot.notes, *_economy(shot), *notes)
            )
        if shot.view is not None:
            _save_view(shot.view, out)
        if shot.plan is not None:
            write_atomically(out / "economy.json", json.dumps(shot.plan.document(), indent=1).encode())


def _save_view(view: "RenderedView", out: Path) -> None:
    """Save the rendering of an outdoor scene: radiance image, auxiliary layers and selected effects."""
    from labdata.file_io import write_atomically

    out.mkdir(parents=True, exist_ok=True)
    save_radiance(view.picture.cube, view.title, out / "radiance.png")
    view.picture.truth.save(out / "truth.npz")
    write_atomically(out / "light.json", view.document())


def _economy(shot: Shot) -> tuple[str, ...]:
    """Return the note of a session on neglected effects."""
    if shot.plan is None or shot.exact:
        return ("nothing left out",)
    names = ", ".join(effect.name for effect in shot.plan.left_out) or "nothing"
    share = f"{100.0 * shot.plan.influence:.2g} % of the temporal noise, of {100.0 * shot.plan.tolerance:g} % allowed"
    return (f"left out, together at most {share}: {names}; see economy.json",)


def save_stage_images(shot: Shot, description: "Description", folder: Path, *, seed: int) -> int:
    """Save the image after each stage; return the number of stages."""

    title = f"{description.name}, one frame through the chain, seed {seed}"
    return save_stages(_stages(shot, seed), folder, title)


def _stages(shot: Shot, seed: int) -> "Iterator[Stage]":
    """Yield the input and the expected photoelectrons (or the radiance behind the lens), then every stage's image."""
    from simulate.iiccd.stage_images import stage_images
    from simulate.radiance.cube import RadianceCube

    if isinstance(shot.seen, RadianceCube):
        yield from stage_images(shot.camera, shot.seen, shot.conditions, seed)
        return
    if shot.seen is not None:
        yield "picture", "photoelectrons per exposure and pixel, expected", shot.seen
    place = "at the plate" if shot.camera.has_tube else "in the chip"
    yield f"photoelectrons {place}", "photoelectrons per exposure and cell, expected", _inside(shot.light)
    yield from stage_images(shot.camera, shot.light, shot.conditions, seed)


def _inside(light: Any) -> Any:
    """Return the cells of the frame without its margin."""
    return light.values[(..., *light.grid.inside)]


WIDTH_INCHES = 9.0


def save_radiance(cube: "RadianceCube", title: str, path: Path) -> None:
    """Plot the radiance summed over bands, on a logarithmic scale.

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
    figure.savefig(path, dpi=120)


def _ends(image: np.ndarray) -> tuple[float, float]:
    """Return the limits of the grey scale, also of an image without light."""
    lit = image[image > 0.0]
    if not lit.size:
        return 1e-12, 1e-11
    low, high = (float(end) for end in np.percentile(lit, (1.0, 99.8)))
    return low, max(high, 10.0 * low)


Stage = tuple[str, str, NDArray[Any]]  # name, quantity with unit, image (row, col)

SHEET = "stages.png"
PANEL_INCHES = 3.4


def save_stages(stages: Iterable[Stage], folder: Path, title: str) -> int:
    """Write every stage's image, numbered in order, and the contact sheet; return the number of stages.

    Parameters
    ----------
    stages
        Name, quantity with unit, and image (row, col) of each stage.
    folder
        Output folder; created if missing.
    title
        Title of the sheet.
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
    """Return the contact sheet: one panel per stage with its own scale and unit."""
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
    # Pixels along the longer side of a panel; finer images are averaged, so that no pulse is lost.
    block = max(1, math.ceil(max(image.shape) / 420))
    size, image = image.shape, block_means(image, block)
    # Percentiles at the ends of the grey scale; the brightest 0.3 % may be single pulses.
    low, high = (float(end) for end in np.percentile(image, (0.1, 99.7)))
    if not high > low:
        low, high = float(image.min()), float(max(image.max(), image.min() + 1e-6))
    drawn = axes.imshow(image, cmap="gray", vmin=low, vmax=high, interpolation="nearest")
    ends = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}
    beyond = ends[bool(image.min() < low), bool(image.max() > high)]
    bar = figure.colorbar(drawn, ax=axes, extend=beyond, shrink=0.9, pad=0.02)
    bar.set_label(textwrap.fill(quantity, 36), fontsize=8)
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
    """Return means over square blocks; incomplete blocks at the end are dropped."""
    rows, cols = image.shape[0] // block, image.shape[1] // block
    if block == 1 or not rows or not cols:
        return image
    return image[: rows * block, : cols * block].reshape(rows, block, cols, block).mean(axis=(1, 3), dtype=np.float32)
