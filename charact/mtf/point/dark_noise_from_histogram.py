"""Noise of a pixel without light, told by the codes below the commonest one, and whether these were cut off."""

import numpy as np
from numpy.typing import NDArray

# So many values must lie below the lower of two codes.
MIN_VALUES_BELOW = 16
# Taken where they do not, and more is not seen: what rounding hides, DN.
HIDDEN_SD = 0.2
# Share of the noise below the lowest code from which what is cut off there matters: there MTF50 comes out half a
# standard error high.
CUT_OFF = 0.04
# Shares of the values above the lowest code that lie above two higher ones, how many at least, and by what factor the
# standard deviations between them may differ: those of pulses of light grow the further up.
HIGHER, FURTHER, MIN_VALUES_ABOVE, ALIKE = 0.5, 0.05, 20, 1.25


def dark_sd_from_histogram(codes: NDArray[np.integer]) -> float:
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
    commonest, lower = int(np.argmax(number)), int(np.searchsorted(below, MIN_VALUES_BELOW))
    if lower >= commonest:
        return HIDDEN_SD
    near, far = (float(ndtri(below[one] / codes.size)) for one in (commonest, lower))
    return float(code[commonest] - code[lower]) / max(near - far, 1e-9)


def is_clipped_at_black(codes: NDArray) -> bool:
    """Tell whether what noise takes below the lowest code was cut off there.

    Parameters
    ----------
    codes
        Values around a source, any shape.

    Notes
    -----
    The upper side of normal noise tells its lower one: a share above a code stands z(share) standard deviations off
    the mean, and three codes, the lowest among them, must agree on the standard deviation. What it puts below the
    lowest code ought to be there. A pixel quieter than a code leaves nothing above the code beside it, and few pulses
    of light on quiet pixels reach far further than normal noise does.
    """
    from scipy.special import ndtr, ndtri

    code, number = np.unique(codes, return_counts=True)
    above = codes.size - np.cumsum(number)
    near = int(np.argmax(above <= HIGHER * above[0]))
    far = max(int(np.argmax(above <= FURTHER * above[0])), near + 1)
    if near == 0 or far >= code.size or above[far] < MIN_VALUES_ABOVE:
        return False
    at, z = code[[0, near, far]].astype(float), ndtri(1.0 - above[[0, near, far]] / codes.size)
    lower, upper = np.diff(at) / np.diff(z)
    missing = float(ndtr(z[0] - float(np.diff(code).min()) / lower))
    return bool(missing > CUT_OFF and max(lower / upper, upper / lower) < ALIKE)
