"""The scene that simulators are timed on: uneven light of a given mean, the same for ours and for
peers.
"""

import numpy as np
from numpy.typing import NDArray

ROWS, COLUMNS = 493, 768


def uneven(mean: float) -> NDArray[np.floating]:
    """Return mean photoelectrons per pixel of a smoothly uneven scene with two edges, shape (row,
    col).
    """
    row, col = np.mgrid[:ROWS, :COLUMNS]
    scene = 1.0 + 0.5 * np.sin(col / 40.0) * np.cos(row / 60.0)
    scene[ROWS // 3 : 2 * ROWS // 3, COLUMNS // 3 : 2 * COLUMNS // 3] *= 0.4
    return mean * scene / scene.mean()
