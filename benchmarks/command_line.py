"""How long a user waits for the command line, against starting Python with what any such tool
imports.
"""

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.row import Row, best_seconds

CHARACT = Path(sys.executable).with_name("charact")


def _run(*command: str | Path) -> None:
    subprocess.run(command, check=True, capture_output=True)


def rows() -> Iterator[Row]:
    """The two promises of the command line."""
    start = best_seconds(lambda: _run(sys.executable, "-c", "import numpy, typer"))
    yield Row(
        name="charact --help",
        seconds=best_seconds(lambda: _run(CHARACT, "--help")),
        peer="python importing numpy and typer",
        peer_seconds=start,
        limit_seconds=0.4,
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "edge.npy"
        np.save(path, slanted_edge())
        yield Row(
            name="charact mtf edge FILE --quick",
            seconds=best_seconds(lambda: _run(CHARACT, "mtf", "edge", path, "--quick")),
            peer="python importing numpy and typer",
            peer_seconds=start,
            limit_seconds=1.5,
        )


def slanted_edge(rows: int = 125, cols: int = 300) -> np.ndarray:
    """An edge at 5 degrees with a blur of 1 px and read noise of 1 DN, uint8."""
    from scipy.special import erf

    row, col = np.mgrid[:rows, :cols]
    distance = (col - cols / 2) * np.cos(np.radians(5)) + (row - rows / 2) * np.sin(np.radians(5))
    noise = np.random.default_rng(1).normal(0.0, 1.0, distance.shape)
    return np.round(60 + 70 * (1 + erf(distance / np.sqrt(2))) + noise).astype(np.uint8)
