"""Pictures of docs/night-scenes.md: shipped scenes as radiance in three bands and as the default camera takes them."""

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from charact.cli.simulated_conditions import conditions_of
from charact.cli.simulating import Asked, described, shot_of
from simulate.radiance.cube import RadianceCube, band_widths

FOLDER = Path(__file__).resolve().parent / "night-scenes"
CAMERA = "pulnix-ag5745ef3"
SCENES = ("airfield", "hangar", "road")
# Gates, ns, where the whole field would be too long.
GATES_NS = {"road": 1.5e6}
# Bands of blue, green and red in the pictures of radiance, nm.
COLOURS = ((450.0, 530.0), (530.0, 620.0), (620.0, 950.0))
SHOWN_PERCENT = 0.5, 99.5
# Coarser than usual, so that all are drawn within minutes.
TOLERANCE = 0.3
SEED = 4
# Frames of video that the eye sees as one, about a quarter of a second.
AS_SEEN = 8


def main() -> None:
    """Draw the scenes asked for, all by default."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", default=SCENES)
    FOLDER.mkdir(exist_ok=True)
    for name in parser.parse_args().scenes:
        start = time.monotonic()
        draw(name, FOLDER / f"{name}.png")
        print(f"{name}: {time.monotonic() - start:.0f} s")


def draw(name: str, path: Path) -> None:
    """Draw a scene: its radiance above, the mean of a few frames below."""
    camera = described(CAMERA, None)
    conditions = conditions_of(camera, gate_ns=GATES_NS.get(name))
    shot = shot_of(Asked(source=Path(name), tolerance=TOLERANCE, seed=SEED), camera, conditions)
    assert shot.view is not None
    frames = shot.frames(seed=SEED)
    seen = np.mean([next(frames) for _ in range(AS_SEEN)], axis=0)
    figure = Figure(figsize=(9.0, 11.6), layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subplots(2)
    image, label = in_colours(shot.view.picture.cube)
    above.imshow(image, interpolation="nearest")
    above.set_title(f"{shot.view.title}\nradiance, {label}", fontsize=10)
    drawn: Any = below.imshow(seen, cmap="gray", interpolation="nearest")
    figure.colorbar(drawn, ax=below, label="DN", shrink=0.8)
    below.set_title(f"{camera.name}, mean of {AS_SEEN} frames", fontsize=10)
    for axes in (above, below):
        axes.set_xlabel("column, px")
        axes.set_ylabel("row, px")
    figure.savefig(path, dpi=110, pil_kwargs={"optimize": True})


def in_colours(cube: RadianceCube) -> tuple[np.ndarray, str]:
    """Return radiance in three bands as a picture on one logarithmic scale, and what its ends are."""
    width = band_widths(cube.wavelength_nm)
    sums = np.stack([cube.weighted(width * _within(cube.wavelength_nm, band)) for band in COLOURS], axis=-1)
    low, high = np.percentile(sums[sums > 0.0], SHOWN_PERCENT)
    scaled = np.log(np.maximum(sums, low) / low) / np.log(high / low)
    ends = f"{low:.1e} to {high:.1e} W m$^{{-2}}$ sr$^{{-1}}$ in each, logarithmic"
    bands = ", ".join(f"{one:.0f}-{other:.0f}" for one, other in COLOURS)
    return np.clip(scaled, 0.0, 1.0)[..., ::-1], f"bands {bands} nm as blue, green, red; {ends}"


def _within(wavelength_nm: np.ndarray, band: tuple[float, float]) -> np.ndarray:
    return (wavelength_nm >= band[0]) & (wavelength_nm < band[1])


if __name__ == "__main__":
    main()
