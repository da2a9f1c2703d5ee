"""Transfer functions along one direction, as the likelihoods know them: aperture, tube, halo, video filter.

Frequencies are cycles per pixel along the direction measured, the pixel being the pitch of the grid axis nearest to
it. Parameters may carry leading axes; the frequency is the last axis of what comes out.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from charact.mtf.blur_models import extended_component_tables

Array = NDArray[np.float64]


def exponential(frequency: Array, half_frequency: ArrayLike, exponent: ArrayLike) -> Array:
    """Return ln of exp(-ln 2 (f/f2)^n), the form of tubes (Johnson) and at n = 2 a Gaussian.

    Parameters
    ----------
    frequency
        Shape (f,), cycles per pixel.
    half_frequency
        Frequency f2 at which it is one half, shape (...), cycles per pixel; fc = f2 / (ln 2)^(1/n).
    exponent
        n, shape (...), dimensionless.
    """
    ratio = np.log(frequency) - np.log(np.asarray(half_frequency, float))[..., None]
    return -np.log(2.0) * np.exp(np.asarray(exponent, float)[..., None] * ratio)


def aperture(frequency: Array, angle_rad: float, along_px: float = 1.0, across_px: float = 1.0) -> Array:
    """Return the transfer of a rectangular pixel along a direction at an angle to the grid.

    Parameters
    ----------
    frequency
        Cycles per pixel along the direction.
    angle_rad
        Angle of the direction to the grid axis nearest to it, rad.
    along_px, across_px
        Extent along that axis and across it, both in pitches of that axis.
    """
    along, across = along_px * np.cos(angle_rad), across_px * np.sin(angle_rad)
    return np.sinc(frequency * along) * np.sinc(frequency * across)


def halo(frequency: Array, diameter_px: ArrayLike, elastic_share: ArrayLike) -> Array:
    """Return the transfer of a proximity gap's halo along one direction.

    Parameters
    ----------
    frequency
        Shape (f,), cycles per pixel.
    diameter_px
        Outer diameter (four gaps), shape (...), px.
    elastic_share
        Share of electrons that keep their energy, shape (...), the rest uniform in energy.

    Notes
    -----
    Cosine emission with energy share e lands at r = e R sin(2 t): that is the shadow of a spherical shell, whose line
    spread is a box of half width e R (Archimedes), transfer sinc(2 e R f). Uniform e: Si(2 pi R f) / (2 pi R f).
    """
    x = np.pi * np.asarray(diameter_px, float)[..., None] * frequency
    share = np.broadcast_to(np.asarray(elastic_share, float), x.shape[:-1])
    flat = extended_component_tables.halo_from_table(x.reshape(-1, x.shape[-1]), np.ascontiguousarray(share.ravel()))
    return flat.reshape(x.shape)


def disc(frequency: Array, diameter_px: ArrayLike) -> Array:
    """Return the transfer 2 J1(x)/x, x = pi D f, of light spread evenly over a disc."""
    return extended_component_tables.disc_from_table(np.pi * np.asarray(diameter_px, float)[..., None] * frequency)


def glare(frequency: Array, length_px: ArrayLike) -> Array:
    """Return the transfer 1/(1 + (2 pi f l)^2) of light scattered with the line spread exp(-|d|/l) / (2 l)."""
    return 1.0 / (1.0 + (2.0 * np.pi * np.asarray(length_px, float)[..., None] * frequency) ** 2)


def halo_edge(distance: Array, diameter_px: float, elastic_share: float) -> Array:
    """Return the edge spread of the halo alone: a ramp, and for uniform energies 1/2 + x (1 - ln|x|)/2, x = d/R."""
    x = np.clip(2.0 * np.asarray(distance, float) / diameter_px, -1.0, 1.0)
    magnitude = np.maximum(np.abs(x), 1e-12)
    return 0.5 + 0.5 * x * (elastic_share + (1.0 - elastic_share) * (1.0 - np.log(magnitude)))
