"""Figures of docs/explanation/night-scenes.md: shipped scenes as visible radiance, and by the
default camera.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from simulate import SimulationRequest, conditions_of, load_described_camera, simulate
from simulate.radiance.cube import RadianceCube, band_widths

FOLDER = Path("docs/pictures/night-scenes")
CAMERA = "pulnix-ag5745ef3"
SCENES = ("airfield", "hangar", "road")
# Gates, ns, where the whole field would be too long.
GATES_NS = {"road": 5e4}
# Where red, green and blue of the pictures of radiance rise and fall, nm: sodium lamps come out
# orange, as to an eye.
COLOURS = ((540.0, 600.0, 680.0, 720.0), (480.0, 520.0, 540.0, 600.0), (440.0, 450.0, 480.0, 520.0))
# Share of pixels that may be brighter than white, %, and the power by which brightness is shown.
WHITE_PERCENT, POWER = 0.7, 1.0 / 2.2
# Of the camera's frames: the brightest lamps may be beyond the scale.
SHOWN_PERCENT = 0.1, 99.0
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
    camera = load_described_camera(CAMERA, None)
    conditions = conditions_of(camera, gate_ns=GATES_NS.get(name))
    shot = simulate(
        SimulationRequest(source=Path(name), tolerance=TOLERANCE, seed=SEED), camera, conditions
    )
    assert shot.view is not None
    seen = np.mean(list(shot.frames(seed=SEED, count=AS_SEEN)), axis=0)
    figure = Figure(figsize=(9.0, 11.6), layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subplots(2)
    image, label = in_colours(shot.view.picture.cube)
    above.imshow(image, interpolation="nearest")
    above.set_title(f"{shot.view.title}\n{label}", fontsize=9)
    low, high = np.percentile(seen, SHOWN_PERCENT)
    drawn: Any = below.imshow(seen, cmap="gray", vmin=low, vmax=high, interpolation="nearest")
    figure.colorbar(drawn, ax=below, label="DN", shrink=0.8, extend="both")
    below.set_title(f"{camera.name}, mean of {AS_SEEN} frames", fontsize=10)
    for axes in (above, below):
        axes.set_xlabel("column, px")
        axes.set_ylabel("row, px")
    figure.savefig(path, dpi=100, pil_kwargs={"optimize": True})


def in_colours(cube: RadianceCube) -> tuple[np.ndarray, str]:
    """Return visible radiance in red, green and blue, such that the median pixel is grey, and what
    white stands for.
    """
    width = band_widths(cube.wavelength_nm)
    shares = [np.interp(cube.wavelength_nm, ends, (0.0, 1.0, 1.0, 0.0)) for ends in COLOURS]
    sums = np.stack([cube.sum_bands(width * share) for share in shares], axis=-1)
    grey = np.median(sums.reshape(-1, 3), axis=0)
    white = grey * np.percentile(sums / grey, 100.0 - WHITE_PERCENT)
    ends = ", ".join(f"{one:.1e}" for one in white)
    crossings = " and ".join(f"{0.5 * (rise + full):.0f}" for rise, full, _, _ in COLOURS[1::-1])
    label = (
        f"visible radiance to the power 1/2.2; red, green, blue parted at {crossings} nm;\n"
        f"white: {ends} W m$^{{-2}}$ sr$^{{-1}}$"
    )
    return np.clip(sums / white, 0.0, 1.0) ** POWER, label


if __name__ == "__main__":
    main()
