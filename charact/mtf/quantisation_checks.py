"""Checks of grey values: clipping, and the effect of quantisation on mean frames."""

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
        Pixel values, shape (frame, ..., col), DN.
    full_scale_dn
        Full scale, DN; None: unknown, and the highest value may be full scale.

    Notes
    -----
    Noise spreads over several grey values, of which the outermost are the rarest. A pile-up is an extreme value that
    many pixels have and that is several times as frequent as the adjacent value. A bright plateau of a single value is
    clipped if the darker side shows noise. Data without noise, such as rendered or averaged frames, are not clipped for
    having a flat plateau. Clipped pixels alternate between the extreme value and values several steps away; where they
    do, the extreme value may be as rare as the adjacent one.
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
    # Black clips at zero or at the floor of the video range; a quiet plateau above either is not clipped.
    clipped |= bool(bottom and values[0] in FLOORS and values.size > 12 and _shows_noise(data, values))
    clipped |= bool(top and not bottom and noisy and share[-2] > 1e-4)
    clipped = clipped or any(_cuts_noise(data, values, counts, end=end) for end in (0, -1))
    return ("clipped",) if clipped else ()


def _noise_below(data: NDArray, level: float) -> float:
    """Return the noise of the pixels below a level, DN, from differences of neighbours along rows."""
    frame = np.asarray(data[0], np.float64)
    dark = (frame[..., 1:] <= level) & (frame[..., :-1] <= level)
    apart = np.abs(np.diff(frame, axis=-1))[dark]
    return 1.05 * float(np.median(apart)) if apart.size else 0.0


def _shows_noise(data: NDArray, values: NDArray) -> bool:
    """Return whether the brighter half of the pixels has noise."""
    noise = _noise_below(-np.asarray(data[:1], np.float64), -0.5 * (float(values[0]) + float(values[-1])))
    return noise > MIN_NOISE * float(values[-1] - values[0])


def _cuts_noise(data: NDArray, values: NDArray, counts: NDArray, *, end: int) -> bool:
    """Return whether noise is clipped at the lowest (end 0) or highest (end -1) value.

    Noise moves a pixel of the pile several steps from one frame to the next, or in a single frame between two
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
    """Return whether an extreme value is frequent enough to be a pile-up; avoids a histogram of all values."""
    extremes = np.count_nonzero(data == data.max()), np.count_nonzero(data == data.min())
    return bool(max(extremes) > PILE_UP_FRACTION * data.size)


def _histogram(data: NDArray) -> tuple[NDArray, NDArray]:
    """Return the values that occur and their counts."""
    if data.dtype.kind == "u" and data.dtype.itemsize <= 2:
        counts = np.bincount(data.ravel())
        values = np.flatnonzero(counts)
        return values, counts[values]
    return np.unique(data, return_counts=True)
