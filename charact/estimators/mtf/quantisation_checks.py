"""Checks of grey values: clipping, and the effect of quantisation on mean frames."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.thresholds import ACCURACY, LIMITS

Array = NDArray[np.float64]

# Variance that quantisation adds where noise spreads over several steps, DN^2.
QUANTISATION_DN2 = 1.0 / 12.0


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
    Noise spreads over several grey values, of which the outermost are the rarest. A pile-up is an
    extreme value that many pixels have and that is several times as frequent as the adjacent value.
    A bright plateau of a single value is clipped if the darker side shows noise. Data without
    noise, such as rendered or averaged frames, are not clipped for having a flat plateau. Clipped
    pixels alternate between the extreme value and values several steps away; where they do, the
    extreme value may be as rare as the adjacent one.
    """
    # Without a pile-up the histogram of all values is not needed.
    extremes = np.count_nonzero(data == data.max()), np.count_nonzero(data == data.min())
    if not max(extremes) > LIMITS.pile_up_fraction * data.size:
        return ()
    if data.dtype.kind == "u" and data.dtype.itemsize <= 2:
        counts = np.bincount(data.ravel())
        values = np.flatnonzero(counts)
        counts = counts[values]
    else:
        values, counts = np.unique(data, return_counts=True)
    if values.size < 3:
        return ("clipped",) if data.size > 64 else ()
    fraction, middle = counts / data.size, 0.5 * (float(values[0]) + float(values[-1]))
    least_noise = LIMITS.min_relative_noise * float(values[-1] - values[0])
    clipped = full_scale_dn is not None and bool(
        values[-1] >= full_scale_dn and fraction[-1] > LIMITS.pile_up_fraction
    )
    noise, step = _noise_below(data[0], middle), float(np.diff(values).min())
    noisy = noise > least_noise and values.size > 12
    top = (
        fraction[-1] > 2 * LIMITS.pile_up_fraction
        and counts[-1] > LIMITS.pile_up_ratio * counts[-2]
    )
    bottom = (
        fraction[0] > 2 * LIMITS.pile_up_fraction and counts[0] > LIMITS.pile_up_ratio * counts[1]
    )
    brighter = np.count_nonzero(data > middle)
    clipped |= bool(
        top and noisy and noise >= step and counts[-1] > LIMITS.plateau_fraction * brighter
    )
    # Black clips at zero or at the floor of the video range; a quiet plateau above either is not
    # clipped.
    if bottom and values[0] in ACCURACY.video_floors_dn and values.size > 12:
        clipped |= _noise_below(-np.asarray(data[0], np.float64), -middle) > least_noise
    clipped |= bool(top and not bottom and noisy and fraction[-2] > 1e-4)
    clipped = clipped or any(_cuts_noise(data, values, counts, end=end) for end in (0, -1))
    return ("clipped",) if clipped else ()


def _noise_below(frame: NDArray, level: float) -> float:
    """Return the noise of the pixels below a level, DN, from differences of neighbours along
    rows.
    """
    frame = np.asarray(frame, np.float64)
    dark = (frame[..., 1:] <= level) & (frame[..., :-1] <= level)
    differences = np.abs(np.diff(frame, axis=-1))[dark]
    return 1.05 * float(np.median(differences)) if differences.size else 0.0


def _cuts_noise(data: NDArray, values: NDArray, counts: NDArray, *, end: int) -> bool:
    """Return whether noise is clipped at the lowest (end 0) or highest (end -1) value.

    Noise moves a pixel of the pile several steps from one frame to the next, or in a single frame
    between two neighbours that stay.
    """
    inwards = values[::-1] if end else values
    piled_up, adjacent = counts[[-1, -2]] if end else counts[:2]
    min_count = max(
        LIMITS.min_pile_pixels,
        2 * LIMITS.pile_up_fraction * data.size,
        LIMITS.noisy_pile_up_ratio * adjacent,
    )
    if piled_up < min_count or values.size <= 12:
        return False
    piled = data == inwards[0]
    is_far = data <= inwards[LIMITS.clipped_steps] if end else data >= inwards[LIMITS.clipped_steps]
    if len(data) > 1:
        crossing = np.count_nonzero(piled[:-1] & is_far[1:])
        staying = np.count_nonzero(piled[:-1] & piled[1:])
    else:
        crossing = np.count_nonzero(piled[..., :-2] & is_far[..., 1:-1] & piled[..., 2:])
        staying = np.count_nonzero(piled[..., :-1] & piled[..., 1:])
    return bool(
        crossing > max(LIMITS.min_pile_pixels, LIMITS.min_crossing * piled_up)
        and staying > max(LIMITS.min_pile_pixels, LIMITS.min_staying * piled_up)
    )


def rounding_shifts(level_dn: Array, variance_dn2: Array) -> Array:
    """Return the possible shifts of mean values by quantisation, shape (offset, pixel), DN; no rows
    if negligible.

    Parameters
    ----------
    level_dn
        Means without quantisation, shape (pixel,).
    variance_dn2
        Variances of single quantised values, shape (pixel,).

    Notes
    -----
    The mean of a value x with normal noise of standard deviation s is shifted by sum_k (-1)^k sin(2
    pi k x) exp(-2 (pi k s)^2) / (pi k), the Fourier series of the sawtooth (Widrow & Kollar,
    Quantization Noise, 2008). The fractional part of x is unknown: the black level is placed at
    several equally likely offsets between two steps. The noise is the smallest that is consistent
    with the variance.
    """
    from charact.estimators.noise.rounding import EVEN_DN2

    min_noise = np.interp(variance_dn2, *_least_noise())
    noise = np.where(variance_dn2 > EVEN_DN2, variance_dn2 - QUANTISATION_DN2, min_noise)
    if np.exp(-2.0 * np.pi**2 * float(noise.min())) / np.pi < LIMITS.min_rounding_shift_dn:
        return np.empty((0, level_dn.size))
    out = np.zeros((ACCURACY.rounding_offsets, level_dn.size))
    for term in range(1, ACCURACY.sawtooth_terms + 1):
        size = (-1.0) ** term * np.exp(-2.0 * (np.pi * term) ** 2 * noise) / (np.pi * term)
        turns = term * (
            level_dn + np.arange(ACCURACY.rounding_offsets)[:, None] / ACCURACY.rounding_offsets
        )
        out += size * np.sin(2.0 * np.pi * turns)
    return out


@cache
def _least_noise() -> tuple[Array, Array]:
    """Return variances after quantisation and the smallest variances before it, DN^2."""
    from charact.estimators.noise.rounding import EVEN_DN2, variance_range_before_rounding

    rounded = np.linspace(0.0, EVEN_DN2, 91)
    return rounded, np.array(
        [variance_range_before_rounding(float(variance))[0] for variance in rounded]
    )
