"""A small DNG file written by hand: an RGGB mosaic with margins and four black levels."""

from pathlib import Path

import numpy as np
import tifffile

BLACK = (64, 65, 66, 67)
WHITE = 4095
TOP, LEFT, BOTTOM, RIGHT = 2, 4, 38, 56


def write(path: Path, data: np.ndarray) -> None:
    """Write a mosaic of the shape (40, 60) whose active area is rows 2 to 38 and columns 4 to
    56.
    """
    tags = [
        (50706, "B", 4, (1, 4, 0, 0), True),  # DNG version
        (50707, "B", 4, (1, 1, 0, 0), True),
        (271, "s", 0, "charact", True),
        (272, "s", 0, "bench", True),
        (50708, "s", 0, "charact bench", True),
        (33421, "H", 2, (2, 2), True),  # mosaic
        (33422, "B", 4, (0, 1, 1, 2), True),
        (50710, "B", 3, (0, 1, 2), True),
        (50711, "H", 1, 1, True),
        (50713, "H", 2, (2, 2), True),
        (50714, "H", 4, BLACK, True),
        (50717, "H", 1, WHITE, True),
        (50721, "2i", 9, (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1), True),
        (50728, "2I", 3, (1, 1, 1, 1, 1, 1), True),
        (50778, "H", 1, 21, True),
        (50829, "I", 4, (TOP, LEFT, BOTTOM, RIGHT), True),  # active area
    ]
    tifffile.imwrite(
        path, data, photometric=32803, planarconfig=1, extratags=tags, metadata=None, subfiletype=0
    )
