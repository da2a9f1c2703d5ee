"""The transfer of a circular pupil, clear or with a central obscuration, in focus or out of it, compiled."""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# Diameter of the obscuration over that of the pupil: telescopes have up to about a half.
OBSCURATION = (0.0, 0.8)
# Defocus up to which `NODES` integrate to 1e-7, waves.
DEFOCUS_WAVES = (0.0, 3.0)
NODES = 16
_AT, _WEIGHT = np.polynomial.legendre.leggauss(NODES)


def pupil(frequency: Array, cut_off: ArrayLike, obscuration: ArrayLike = 0.0, defocus: ArrayLike = 0.0) -> Array:
    """Return the transfer of a pupil in incoherent light of one wavelength, shape (f,), (n,), (n,), (n,) -> (n, f).

    Parameters
    ----------
    frequency
        Shape (f,), cycles per pixel.
    cut_off
        Frequency from which on nothing passes, 1 / (wavelength x f-number), shape (n,) or one number, cycles per pixel.
    obscuration
        Diameter of the obscuration over that of the pupil, 0: none.
    defocus
        Optical path by which the pupil's border is off, W020, waves; its sign does not matter.

    Returns
    -------
    array
        1 at frequency 0; negative where defocus turns bright and dark around.

    Notes
    -----
    The transfer is the pupil's autocorrelation (Hopkins, Proc. R. Soc. A 231, 91, 1955): with v = f / cut-off,

        T(v) = integral of cos(8 pi W v x) over the overlap of two pupils with centres at x = -v and v / pupil's area.

    A pupil with a hole is a disc less a disc, so the overlap is that of two outer discs, less twice that of an outer
    with an inner one, plus that of two inner ones; each is made of segments of circles. In focus a clear pupil has
    2/pi (acos v - v sqrt(1 - v^2)); with a hole the sum is that of O'Neill (J. Opt. Soc. Am. 46, 285, 1956).
    """
    parameters = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(one, float)) for one in (cut_off, obscuration, defocus))
    )
    return _all_pupils(np.asarray(frequency, float), *(np.ascontiguousarray(one) for one in parameters))


@njit(cache=True)
def _all_pupils(frequency: Array, cut_off: Array, obscuration: Array, defocus: Array) -> Array:
    out = np.empty((cut_off.size, frequency.size))
    for i in range(cut_off.size):
        for j in range(frequency.size):
            out[i, j] = pupil_at(frequency[j] / cut_off[i], obscuration[i], defocus[i])
    return out


@njit(cache=True)
def pupil_at(ratio: float, obscuration: float, defocus: float) -> float:
    """Return the transfer at a frequency over the cut-off, of a hole and a defocus as `pupil` has them."""
    v = abs(ratio)
    if v >= 1.0:
        return 0.0
    wave = 8.0 * np.pi * defocus * v
    overlap = _common(v, 1.0, 1.0, wave)
    if obscuration > 0.0:
        overlap += _common(v, obscuration, obscuration, wave) - 2.0 * _common(v, 1.0, obscuration, wave)
    return overlap / (np.pi * (1.0 - obscuration**2))


@njit(cache=True)
def _common(v: float, left: float, right: float, wave: float) -> float:
    """Return the integral of cos(wave x) over what a disc about -v and a disc about v, not larger, share."""
    if 2.0 * v >= left + right:
        return 0.0
    if 2.0 * v <= left - right:
        return _segment(v, right, 0.0, np.pi, wave)
    # Where the circles cross: to the left of it the right one is the border, and to the right of it the left one.
    x = (left**2 - right**2) / (4.0 * v)
    to_left = _segment(v, right, np.arccos(min(max((x - v) / right, -1.0), 1.0)), np.pi, wave)
    return to_left + _segment(-v, left, 0.0, np.arccos(min(max((x + v) / left, -1.0), 1.0)), wave)


@njit(cache=True)
def _segment(middle: float, radius: float, low: float, high: float, wave: float) -> float:
    """Return the integral of cos(wave x) over a disc between two angles, x = middle + radius cos(angle)."""
    if wave == 0.0:
        return radius**2 * ((high - low) - 0.5 * (np.sin(2.0 * high) - np.sin(2.0 * low)))
    half, total = 0.5 * (high - low), 0.0
    for k in range(NODES):
        cosine = np.cos(low + half * (1.0 + _AT[k]))
        total += _WEIGHT[k] * (1.0 - cosine * cosine) * np.cos(wave * (middle + radius * cosine))
    return 2.0 * radius**2 * half * total
