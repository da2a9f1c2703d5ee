"""Whether a frame taken without light is dark: a lamp left on or a door left open shows before the first light."""

import numpy as np
from numpy.typing import NDArray

from drivers.errors import BenchError

BRIGHTEST_MEAN = 0.25
MOST_SATURATED = 0.01


class NotDark(BenchError):
    """A frame taken with the light out is bright.

    Use this when somebody has to find the light before the tube is opened again.
    """


def require_dark(pixels: NDArray, full_scale_dn: float) -> None:
    """Refuse (NotDark) a frame that is too bright to have been taken without light.

    Parameters
    ----------
    pixels
        Pixel values, shape (row, col), DN.
    full_scale_dn
        Highest code of the digitiser, DN.

    Notes
    -----
    Black level, dark current and EBI together stay far below a quarter of full scale; room light through a tube at
    gain fills the frame.
    """
    mean, saturated = float(pixels.mean()), float(np.count_nonzero(pixels >= full_scale_dn)) / pixels.size
    if mean > BRIGHTEST_MEAN * full_scale_dn or saturated > MOST_SATURATED:
        raise NotDark(
            f"a frame without light must have a mean below {BRIGHTEST_MEAN:.0%} of full scale and at most "
            f"{MOST_SATURATED:.0%} of its pixels full, got {mean / full_scale_dn:.0%} and {saturated:.1%}: "
            "find the light before the gate is opened again",
            instrument="light",
        )
