"""A run that compiles the passes draws the frames that runs after it draw, which take them from the
cache.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

DRAW = """
from dataclasses import replace
from hashlib import sha256
from itertools import islice
import numpy as np
from labdata import Conditions
from labdata import load_sensor
from simulate.camera import CameraModel
from simulate.camera import mcp_input_from_photoelectrons
from simulate.camera.fast_sampler.phosphor_rows import glow_rows
sheet = load_sensor("gen3-digital-iccd")
camera = CameraModel(replace(sheet, ccd=replace(sheet.ccd, rows=200, columns=256)))
row, col = np.mgrid[:200, :256]
conditions = Conditions(mcp_v=730.0)
picture = 3.0 + 1.5 * np.sin(col / 9) * np.cos(row / 7)
light = mcp_input_from_photoelectrons(camera, picture, conditions)
frames = np.stack(list(islice(camera.frames(light, conditions, seed=5), 6)))
print(sha256(frames.tobytes()).hexdigest(), sum(glow_rows.stats.cache_hits.values()))
"""


@pytest.fixture
def drawn(tmp_path: Path):
    """Digest of frames drawn by a process of its own, and how many times it took a pass from the
    cache.
    """

    def draw() -> list[str]:
        known = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "OPENBLAS_NUM_THREADS": "1"}
        done = subprocess.run(
            [sys.executable, "-c", DRAW], env=known, capture_output=True, text=True, check=True
        )
        return done.stdout.split()

    return draw


def test_a_first_run_draws_the_frames_of_the_next(drawn):
    """Twelve bits, 300,000 pixels: passes whose parts were functions of their own differed in four
    of them.
    """
    (first, compiled), (second, cached) = drawn(), drawn()
    assert (compiled, cached) == ("0", "1")
    assert first == second
