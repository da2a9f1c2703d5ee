"""Noise of pixels without light from a histogram of grey values, and its clipping at black."""

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
    """Return the standard deviation of a pixel without light, DN; a default where quantisation hides it.

    Parameters
    ----------
    codes
        Values around a source, any shape.

    Notes
    -----
    For normal noise the fractions of values below two grey values lie z(fraction) standard deviations below the mean:
    the difference of the grey values over that of z is one standard deviation. Light pulses raise values and hardly
    change the lower tail.
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
    """Return whether the noise is clipped at the lowest grey value.

    Parameters
    ----------
    codes
        Values around a source, any shape.

    Notes
    -----
    The upper half of a normal distribution predicts the lower one: the fraction above a grey value gives z(fraction)
    standard deviations. Three grey values, including the lowest, must agree on the standard deviation; the predicted
    fraction below the lowest must not be missing. Quiet pixels, and pulses on quiet pixels, are not normal and do not
    count.
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
