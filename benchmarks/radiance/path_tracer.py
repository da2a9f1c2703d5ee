"""Mitsuba in a process of its own, asked for pictures of exported scenes."""

import json
import os
import subprocess
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

PYTHON = Path(".venv-mitsuba/bin/python")
PROGRAM = Path(__file__).parents[1] / "peers" / "mitsuba_pictures.py"


@dataclass(frozen=True)
class Timed:
    """A picture, shape (row, col), W m-2 sr-1 nm-1, and what it took on the clock and of the
    processors, s.
    """

    image: NDArray[np.floating]
    seconds: float
    core_seconds: float


class PathTracer:
    """Mitsuba with scenes at hand.

    Parameters
    ----------
    folder
        Exported scenes, and room for pictures.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.version = ""

    def __enter__(self) -> Self:
        command = [str(PYTHON), "-u", str(PROGRAM), str(self._folder)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=os.environ
        )
        told = self._answer("mitsuba")
        self.version = f"Mitsuba {told['mitsuba']}, {told['variant']}"
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(timeout=60)

    def picture(self, scene: str, samples: int, seed: int, **how: str | int) -> Timed:
        """Return a picture of a scene by so many samples a pixel; how: `lights`, `by` and `depth`,
        see its program.
        """
        assert self._process.stdin is not None
        path = self._folder / f"{scene}.npy"
        asked = {"scene": scene, "samples": samples, "seed": seed, "path": str(path), **how}
        self._process.stdin.write(json.dumps(asked) + "\n")
        self._process.stdin.flush()
        told = self._answer("seconds")
        return Timed(np.load(path), told["seconds"], told["core_seconds"])

    def _answer(self, key: str) -> dict:
        """Read lines until one is an answer: the libraries print as well."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith("{"):
                told = json.loads(line)
                if key in told:
                    return told
        raise RuntimeError(
            f"Mitsuba must answer, but ended with code {self._process.wait()}; see "
            f"DRJIT_LIBLLVM_PATH"
        )
