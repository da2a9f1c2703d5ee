"""Transfer functions of the camera's stages as the fit understands them, one formula each.

They are written from the references named in each function and share no code with the simulator; that the two agree
is a test, not a definition. Arguments broadcast against each other, so that many parameter draws are predicted at once.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import j1, sici

Array = NDArray[np.float64]

MIDDLE_WAVELENGTH_MM = 0.7e-3
# The largest logarithm whose exponential is still a number: a climb to the peak tries any exponent once.
LARGEST_LOGARITHM = 700.0


def lens_transfer(frequency_per_mm: Array, blur_um: Array, f_number: Array) -> Array:
    """Return exp(-2 (pi f s)^2) times diffraction: a lens whose aberrations blur like a Gaussian of width s.

    Notes
    -----
    Diffraction of a round pupil, (2/pi)(acos x - x sqrt(1 - x^2)) with x = f wavelength N, falls as 1 - 4x/pi: three
    per cent where a fast lens is used, for light of the middle of the cathode's band.
    """
    x = np.minimum(frequency_per_mm * MIDDLE_WAVELENGTH_MM * f_number, 1.0)
    diffraction = (2.0 / np.pi) * (np.arccos(x) - x * np.sqrt(1.0 - x**2))
    return diffraction * np.exp(-2.0 * (np.pi * frequency_per_mm * blur_um * 1e-3) ** 2)


def tube_transfer(frequency_per_mm: Array, cut_off_per_mm: Array, exponent: Array, share: Array | float = 1.0) -> Array:
    """Return exp(-share (f/fc)^n), the part `share` of an image tube's transfer (Johnson's form)."""
    logarithm = exponent * np.log(np.maximum(frequency_per_mm / cut_off_per_mm, 1e-9))
    return np.exp(-share * np.exp(np.minimum(logarithm, LARGEST_LOGARITHM)))


def halo_transfer(frequency_per_mm: Array, gap_mm: Array, elastic_share: Array) -> Array:
    """Return the transfer of the halo of back-scattered photoelectrons.

    Notes
    -----
    An electron re-emitted under the angle t with the share e of its energy lands at r = 2 e d sin 2t. Emission by the
    cosine law makes sin^2 t uniform, so that x = r/(2 e d) has the density x/sqrt(1 - x^2) and the Hankel transform
    sin(u)/u with u = 2 pi f 2 d e. Elastic electrons have e = 1; energies spread evenly give the mean over e in 0..1,
    Si(u)/u.
    """
    argument = 4.0 * np.pi * np.asarray(frequency_per_mm * gap_mm, float)
    safe = np.maximum(argument, 1e-6)
    return elastic_share * np.sinc(argument / np.pi) + (1.0 - elastic_share) * sici(safe)[0] / safe


def fibre_transfer(frequency_per_mm: Array, pitch_um: Array, interface_per_mm: Array) -> Array:
    """Return |2 J1(pi p f)/(pi p f)| exp(-(f/f0)^2), a fibre taper with its interfaces; f at the detector."""
    argument = np.maximum(np.pi * np.asarray(frequency_per_mm * pitch_um, float) * 1e-3, 1e-9)
    return np.abs(2.0 * j1(argument) / argument) * np.exp(-((frequency_per_mm / interface_per_mm) ** 2))


def aperture_transfer(frequency_cy_per_width: Array) -> Array:
    """Return |sinc f|, an evenly sensitive aperture; f in cycles per its width."""
    return np.abs(np.sinc(frequency_cy_per_width))
