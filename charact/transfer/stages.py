"""Transfers of a camera's stages: pixel aperture, lens, image tube, fibres.

Shapes of frequencies and parameters broadcast.
"""

import numpy as np
from numpy.typing import ArrayLike

from labdata import Array


def aperture(
    frequency: Array, angle_rad: float, along_px: float = 1.0, across_px: float = 1.0
) -> Array:
    """Return sinc(f w cos a) sinc(f h sin a), a rectangular pixel along a direction.

    Parameters
    ----------
    frequency
        f, cycles per pixel along the direction.
    angle_rad
        Angle a of the direction to the grid axis nearest to it, rad.
    along_px, across_px
        Extent w along that axis and h across it, both in pitches of that axis.
    """
    along, across = along_px * np.cos(angle_rad), across_px * np.sin(angle_rad)
    return np.sinc(frequency * along) * np.sinc(frequency * across)


def slit(frequency_cy_per_width: Array) -> Array:
    """Return |sinc f|, an aperture of uniform sensitivity; f in cycles per its width."""
    return np.abs(np.sinc(frequency_cy_per_width))


def clear_pupil(v: Array) -> Array:
    """Return 2/pi (acos v - v sqrt(1 - v^2)), a round pupil in focus at v times its cut-off
    (Goodman, Fourier Optics, 6.3).
    """
    v = np.minimum(v, 1.0)
    return (np.arccos(v) - v * np.sqrt(1.0 - v**2)) * (2.0 / np.pi)


def lens(
    frequency_per_mm: Array, blur_um: ArrayLike, f_number: ArrayLike, wavelength_nm: float
) -> Array:
    """Return diffraction times exp(-2 (pi f s)^2), a lens with Gaussian aberration blur of width s.

    The cut-off of diffraction is 1 / (wavelength N). It falls as 1 - 4v/pi: by 3 % for a fast lens
    at the central wavelength of the photocathode.
    """
    v = frequency_per_mm * 1e-6 * wavelength_nm * np.asarray(f_number)
    blur = np.exp(-2.0 * (np.pi * frequency_per_mm * np.asarray(blur_um) * 1e-3) ** 2)
    return clear_pupil(v) * blur


def image_tube(
    frequency: Array, cut_off: ArrayLike, exponent: ArrayLike, fraction: ArrayLike = 1.0
) -> Array:
    """Return exp(-q (f/fc)^n), the part q (`fraction`) of an image tube's transfer (Johnson, Proc.
    SPIE 1979).
    """
    logarithm = exponent * np.log(np.maximum(frequency / np.asarray(cut_off), 1e-9))
    return np.exp(-np.asarray(fraction) * np.exp(np.minimum(logarithm, 700.0)))


def fibres(frequency: Array, pitch: ArrayLike, interface: ArrayLike) -> Array:
    """Return |2 J1(pi p f)/(pi p f)| exp(-(f/f0)^2), a fibre taper of pitch p with its interfaces
    f0; f at the detector.
    """
    from charact.transfer.tables import disc

    return np.abs(disc(np.pi * np.asarray(pitch) * frequency)[0]) * np.exp(
        -((frequency / np.asarray(interface)) ** 2)
    )
