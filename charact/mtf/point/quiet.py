"""Noise of a pixel without light, told by the codes below the commonest one: light only lifts them."""

import numpy as np
from numpy.typing import NDArray

# So many values must lie below the lower of two codes.
ENOUGH = 16
# Taken where they do not, and more is not seen: what rounding hides, DN.
HIDDEN_SD = 0.2


def quiet_sd(codes: NDArray[np.integer]) -> float:
    """Return the standard deviation of a pixel without light, DN, or what may be hidden by rounding where none is seen.

    Parameters
    ----------
    codes
        Values around a source, any shape.

    Notes
    -----
    Of normal noise the shares of values below two codes lie z(share) standard deviations below the mean, which may
    stand anywhere between codes: the codes' distance over that of the two z is one standard deviation. Pulses of light
    lift values, and hardly change how many lie so far below.
    """
    from scipy.special import ndtri

    code, number = np.unique(codes, return_counts=True)
    below = np.cumsum(number) - number
    commonest, lower = int(np.argmax(number)), int(np.searchsorted(below, ENOUGH))
    if lower >= commonest:
        return HIDDEN_SD
    near, far = (float(ndtri(below[one] / codes.size)) for one in (commonest, lower))
    return float(code[commonest] - code[lower]) / max(near - far, 1e-9)
