"""What the codes themselves give away: clipping at an end of the scale, and steps too coarse for the noise."""

import numpy as np
from numpy.typing import NDArray

# Share of the pixels at one extreme code that makes it a pile-up, and how much it must exceed the code beside it.
PILE_UP_SHARE = 0.002
PILE_UP_RATIO = 3.0
FLOORS = (0, 16)


def code_flags(data: NDArray, full_scale_dn: float | None) -> tuple[str, ...]:
    """Return `clipped` where pixels pile up at an end of the scale.

    Parameters
    ----------
    data
        Pixel values, any shape.
    full_scale_dn
        Highest code, None: unknown; any highest value is then suspected.

    Notes
    -----
    Noise spreads over several codes with the outermost the rarest. A pile-up is an outermost value that many pixels
    share and that is several times as frequent as the one beside it. Where the values are so still that the next
    code hardly occurs on either end, nothing can be said but from a known full scale.
    """
    if not _piled(data):
        return ()
    values, counts = _histogram(data)
    if values.size < 3:
        return ("clipped",) if data.size > 64 else ()
    share = counts / data.size
    clipped = False
    if full_scale_dn is not None and values[-1] >= full_scale_dn:
        clipped |= bool(share[-1] > PILE_UP_SHARE)
    top = share[-1] > 2 * PILE_UP_SHARE and counts[-1] > PILE_UP_RATIO * counts[-2]
    bottom = share[0] > 2 * PILE_UP_SHARE and counts[0] > PILE_UP_RATIO * counts[1]
    # Black clips at the converter's or the video range's floor; a quiet plateau above it is just quiet. At the top,
    # where light brings noise, a plateau quieter than the dark one is clipped, wherever it lies.
    clipped |= bool(bottom and values[0] in FLOORS and values.size > 12)
    clipped |= bool(top and not bottom and share[-2] > 1e-4 and values.size > 12)
    return ("clipped",) if clipped else ()


def _piled(data: NDArray) -> bool:
    """Tell whether either extreme value is frequent enough to be a pile-up, before all values are counted."""
    extremes = np.count_nonzero(data == data.max()), np.count_nonzero(data == data.min())
    return bool(max(extremes) > PILE_UP_SHARE * data.size)


def _histogram(data: NDArray) -> tuple[NDArray, NDArray]:
    """Return the values that occur and how often."""
    if data.dtype.kind == "u" and data.dtype.itemsize <= 2:
        counts = np.bincount(data.ravel())
        values = np.flatnonzero(counts)
        return values, counts[values]
    return np.unique(data, return_counts=True)
