"""What the codes themselves give away: clipping at an end of the scale, and steps too coarse for the noise."""

import numpy as np
from numpy.typing import NDArray

# Share of the pixels at one extreme code that makes it a pile-up, and how much it must exceed the code beside it.
PILE_UP_SHARE = 0.002
PILE_UP_RATIO = 3.0
FLOORS = (0, 16)
# The same ratio where noise is seen beside the pile, codes that only noise crosses at once, and of a pile's pixels the
# least share that crosses them, the least that stays, as 1.6 deviations below a plateau, and the least of either.
NOISY_RATIO, CROSSED, LEAST_CROSSING, LEAST_STAYING, LEAST_PIXELS = 1.5, 3, 0.005, 0.05, 10


def code_flags(data: NDArray, full_scale_dn: float | None) -> tuple[str, ...]:
    """Return `clipped` where pixels pile up at an end of the scale.

    Parameters
    ----------
    data
        Pixel values, shape (frame, ...): the last axis along rows.
    full_scale_dn
        Highest code, None: unknown; any highest value is then suspected.

    Notes
    -----
    Noise spreads over several codes with the outermost the rarest. A pile-up is an outermost value that many pixels
    share and that is several times as frequent as the one beside it. Where the values are so still that the next
    code hardly occurs on either end, nothing can be said but from a known full scale, or where noise is seen: pixels
    of a quiet plateau are still, those of a clipped one come and go, over several codes at once. Where they do, an
    outermost code even as frequent as the next is clipped, wherever it lies.
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
    clipped = clipped or any(_cuts_noise(data, values, counts, end=end) for end in (0, -1))
    return ("clipped",) if clipped else ()


def _cuts_noise(data: NDArray, values: NDArray, counts: NDArray, *, end: int) -> bool:
    """Tell whether the lowest (end 0) or highest (-1) code is where noise was cut off.

    Noise takes a pixel of the pile several codes away from one frame to the next; of a single frame between two
    neighbours that stay.
    """
    inwards = values[::-1] if end else values
    own, beside = counts[[-1, -2]] if end else counts[:2]
    if own < max(LEAST_PIXELS, 2 * PILE_UP_SHARE * data.size, NOISY_RATIO * beside) or values.size <= 12:
        return False
    piled = data == inwards[0]
    away = data <= inwards[CROSSED] if end else data >= inwards[CROSSED]
    if len(data) > 1:
        crossing = np.count_nonzero(piled[:-1] & away[1:])
        staying = np.count_nonzero(piled[:-1] & piled[1:])
    else:
        crossing = np.count_nonzero(piled[..., :-2] & away[..., 1:-1] & piled[..., 2:])
        staying = np.count_nonzero(piled[..., :-1] & piled[..., 1:])
    return bool(crossing > max(LEAST_PIXELS, LEAST_CROSSING * own) and staying > max(LEAST_PIXELS, LEAST_STAYING * own))


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
