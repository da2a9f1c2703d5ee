"""What the codes themselves give away: clipping at an end of the scale, and steps too coarse for the noise."""

import numpy as np
from numpy.typing import NDArray

# Share of the pixels at one extreme code that makes it a pile-up, and how much it must exceed the code beside it.
PILE_UP_FRACTION = 0.002
PILE_UP_RATIO = 3.0
FLOORS = (0, 16)
# The same ratio where noise is seen beside the pile, codes that only noise crosses at once, and of a pile's pixels the
# least share that crosses them, the least that stays, as 1.6 deviations below a plateau, and the least of either.
NOISY_RATIO, CROSSED, MIN_CROSSING, MIN_STAYING, MIN_PIXELS = 1.5, 3, 0.005, 0.05, 10
# Share of the brighter half of the pixels at one value from which the plateau is that value: of normal noise of one
# step 38 % are.
ONE_VALUE = 0.6
# Noise that counts, share of the range: below are the roundings of float and the slopes of noise-free plateaus.
MIN_NOISE = 1e-5


def clipping_flags(data: NDArray, full_scale_dn: float | None) -> tuple[str, ...]:
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
    share and that is several times as frequent as the one beside it. Light brings noise: a bright plateau of one value
    beside a darker side whose noise spreads over several is clipped, wherever that value lies. Where nothing shows
    noise, as in pictures that were drawn or averaged, a flat plateau is just flat. Pixels of a quiet plateau are
    still, those of a clipped one come and go, over several codes at once: where they do, an outermost code even as
    frequent as the next is clipped.
    """
    if not _has_pile_up(data):
        return ()
    values, counts = _histogram(data)
    if values.size < 3:
        return ("clipped",) if data.size > 64 else ()
    share = counts / data.size
    clipped = full_scale_dn is not None and bool(values[-1] >= full_scale_dn and share[-1] > PILE_UP_FRACTION)
    noise, step = _noise_below(data, 0.5 * (float(values[0]) + float(values[-1]))), float(np.diff(values).min())
    noisy = noise > MIN_NOISE * float(values[-1] - values[0]) and values.size > 12
    top = share[-1] > 2 * PILE_UP_FRACTION and counts[-1] > PILE_UP_RATIO * counts[-2]
    bottom = share[0] > 2 * PILE_UP_FRACTION and counts[0] > PILE_UP_RATIO * counts[1]
    brighter = np.count_nonzero(data > 0.5 * (float(values[0]) + float(values[-1])))
    clipped |= bool(top and noisy and noise >= step and counts[-1] > ONE_VALUE * brighter)
    # Black clips at the converter's or the video range's floor; a quiet plateau above it is just quiet.
    clipped |= bool(bottom and values[0] in FLOORS and values.size > 12 and _shows_noise(data, values))
    clipped |= bool(top and not bottom and noisy and share[-2] > 1e-4)
    clipped = clipped or any(_cuts_noise(data, values, counts, end=end) for end in (0, -1))
    return ("clipped",) if clipped else ()


def _noise_below(data: NDArray, level: float) -> float:
    """Return the noise of the pixels below a level, DN: from the differences of neighbours along rows."""
    frame = np.asarray(data[0], np.float64)
    dark = (frame[..., 1:] <= level) & (frame[..., :-1] <= level)
    apart = np.abs(np.diff(frame, axis=-1))[dark]
    return 1.05 * float(np.median(apart)) if apart.size else 0.0


def _shows_noise(data: NDArray, values: NDArray) -> bool:
    """Tell whether the brighter half of the pixels scatters from neighbour to neighbour."""
    noise = _noise_below(-np.asarray(data[:1], np.float64), -0.5 * (float(values[0]) + float(values[-1])))
    return noise > MIN_NOISE * float(values[-1] - values[0])


def _cuts_noise(data: NDArray, values: NDArray, counts: NDArray, *, end: int) -> bool:
    """Tell whether the lowest (end 0) or highest (-1) code is where noise was cut off.

    Noise takes a pixel of the pile several codes away from one frame to the next; of a single frame between two
    neighbours that stay.
    """
    inwards = values[::-1] if end else values
    own, beside = counts[[-1, -2]] if end else counts[:2]
    if own < max(MIN_PIXELS, 2 * PILE_UP_FRACTION * data.size, NOISY_RATIO * beside) or values.size <= 12:
        return False
    piled = data == inwards[0]
    away = data <= inwards[CROSSED] if end else data >= inwards[CROSSED]
    if len(data) > 1:
        crossing = np.count_nonzero(piled[:-1] & away[1:])
        staying = np.count_nonzero(piled[:-1] & piled[1:])
    else:
        crossing = np.count_nonzero(piled[..., :-2] & away[..., 1:-1] & piled[..., 2:])
        staying = np.count_nonzero(piled[..., :-1] & piled[..., 1:])
    return bool(crossing > max(MIN_PIXELS, MIN_CROSSING * own) and staying > max(MIN_PIXELS, MIN_STAYING * own))


def _has_pile_up(data: NDArray) -> bool:
    """Tell whether either extreme value is frequent enough to be a pile-up, before all values are counted."""
    extremes = np.count_nonzero(data == data.max()), np.count_nonzero(data == data.min())
    return bool(max(extremes) > PILE_UP_FRACTION * data.size)


def _histogram(data: NDArray) -> tuple[NDArray, NDArray]:
    """Return the values that occur and how often."""
    if data.dtype.kind == "u" and data.dtype.itemsize <= 2:
        counts = np.bincount(data.ravel())
        values = np.flatnonzero(counts)
        return values, counts[values]
    return np.unique(data, return_counts=True)
