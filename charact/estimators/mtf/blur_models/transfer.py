"""Transfer functions along one direction, as the likelihoods know them: aperture, tube, halo, video
filter.

Frequencies are cycles per pixel along the direction measured, the pixel being the pitch of the grid
axis nearest to it. Parameters may carry leading axes; the frequency is the last axis of what comes
out.
"""

from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

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


def aperture(
    frequency: Array, angle_rad: float, along_px: float = 1.0, across_px: float = 1.0
) -> Array:
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
    Cosine emission with energy share e lands at r = e R sin(2 t): that is the shadow of a spherical
    shell, whose line spread is a box of half width e R (Archimedes), transfer sinc(2 e R f).
    Uniform e: Si(2 pi R f) / (2 pi R f).
    """
    x = np.pi * np.asarray(diameter_px, float)[..., None] * frequency
    fraction = np.broadcast_to(np.asarray(elastic_share, float), x.shape[:-1])
    flat = _halos_from_table(
        x.reshape(-1, x.shape[-1]), np.ascontiguousarray(fraction.ravel()), sine_table()
    )
    return flat.reshape(x.shape)


def disc(frequency: Array, diameter_px: ArrayLike) -> Array:
    """Return the transfer 2 J1(x)/x, x = pi D f, of light spread evenly over a disc."""
    x = np.pi * np.asarray(diameter_px, float)[..., None] * frequency
    return _discs_from_table(np.ravel(x), disc_table()).reshape(x.shape)


def glare(frequency: Array, length_px: ArrayLike) -> Array:
    """Return the transfer 1/(1 + (2 pi f l)^2) of light scattered with the line spread exp(-|d|/l)
    / (2 l).
    """
    return 1.0 / (1.0 + (2.0 * np.pi * np.asarray(length_px, float)[..., None] * frequency) ** 2)


MoffatTable = tuple[Array, Array, Array]

# Exponent b of a Moffat spread (1 + r^2/a^2)^-b: 3/2 is a Lorentzian whose transfer is exp(-f),
# infinity a Gaussian.
MOFFAT_EXPONENT = (1.2, 8.0)


def moffat(frequency: Array, half_frequency: Array, exponent: Array) -> Array:
    """Return ln of the transfer of a Moffat spread, shape (f,) or (n, f), (n,), (n,) -> (n, f).

    Notes
    -----
    The two-dimensional transform of (1 + r^2/a^2)^-b is 2^(2-b)/Gamma(b-1) x^(b-1) K_(b-1)(x), x =
    2 pi a f.
    """
    ratio = np.log(np.maximum(frequency, 1e-12)) - np.log(half_frequency)[:, None]
    return _moffats_from_table(ratio, np.ascontiguousarray(exponent, float), moffat_table())


@lru_cache(maxsize=1)
def moffat_table() -> MoffatTable:
    """Return ln(f/f2), 1/b and ln of the transfer at them, shape (1/b, ln(f/f2))."""
    from scipy.special import gammaln, kve

    ln_ratios = np.linspace(np.log(1e-5), np.log(300.0), 1400)
    inverse = np.linspace(1.0 / (MOFFAT_EXPONENT[1] + 0.5), 1.0 / (MOFFAT_EXPONENT[0] - 0.05), 80)
    argument = np.exp(np.linspace(np.log(1e-7), np.log(1e4), 6000))
    rows = []
    for order in 1.0 / inverse - 1.0:
        log = (1.0 - order) * np.log(2.0) - gammaln(order) + order * np.log(argument)
        log = np.minimum(log + np.log(kve(order, argument)) - argument, 0.0)
        half = np.exp(np.interp(np.log(2.0), -log, np.log(argument)))
        rows.append(np.interp(ln_ratios + np.log(half), np.log(argument), log))
    return ln_ratios, inverse, np.ascontiguousarray(rows)


@njit(cache=True)
def _moffats_from_table(ratio: Array, exponent: Array, table: MoffatTable) -> Array:
    out = np.empty(ratio.shape)
    for i in range(ratio.shape[0]):
        for j in range(ratio.shape[1]):
            out[i, j] = moffat_at(ratio[i, j], exponent[i], table)[0]
    return out


@njit(cache=True)
def moffat_at(ratio: float, exponent: float, table: MoffatTable) -> tuple[float, float, float]:
    """Return ln of the transfer at ln(f/f2), and its slopes with ln(f/f2) and with the exponent.

    Far below f2 it is too small for the table's first column to matter.
    """
    ln_ratios, inverse, ln = table
    row = min(
        max((1.0 / exponent - inverse[0]) / (inverse[1] - inverse[0]), 0.0), inverse.size - 1.0
    )
    low = min(int(row), inverse.size - 2)
    step = ln_ratios[1] - ln_ratios[0]
    column = min(max((ratio - ln_ratios[0]) / step, 0.0), ln_ratios.size - 1.001)
    node = int(column)
    row_part, column_part = row - low, column - node
    lower_row = ln[low, node] * (1.0 - column_part) + ln[low, node + 1] * column_part
    upper_row = ln[low + 1, node] * (1.0 - column_part) + ln[low + 1, node + 1] * column_part
    rise = (ln[low, node + 1] - ln[low, node]) * (1.0 - row_part) + (
        ln[low + 1, node + 1] - ln[low + 1, node]
    ) * row_part
    by_exponent = (lower_row - upper_row) / (exponent**2 * (inverse[1] - inverse[0]))
    return lower_row * (1.0 - row_part) + upper_row * row_part, rise / step, by_exponent


# Places of the table of Si in a unit, and where it ends.
SINE_PER_UNIT, SINE_END = 100, 400.0
# Step and end of the table of a disc's transfer; beyond it Hankel's expansion is off by less than
# 1e-6.
DISC_STEP, DISC_END = 0.02, 400.0


@lru_cache(maxsize=1)
def sine_table() -> Array:
    """Return Si by Simpson's rule at places from 0 on, 1/`SINE_PER_UNIT` apart."""
    x = np.linspace(0.0, SINE_END, int(SINE_END) * SINE_PER_UNIT + 1)
    middle = 0.5 * (x[1:] + x[:-1])
    step = x[1] - x[0]
    ends, inner = np.sinc(x / np.pi), np.sinc(middle / np.pi)
    return np.concatenate([[0.0], np.cumsum((ends[1:] + 4.0 * inner + ends[:-1]) * step / 6.0)])


@lru_cache(maxsize=1)
def disc_table() -> Array:
    """Return 2 J1(x)/x and its slope -2 J2(x)/x at places from 0 on, `DISC_STEP` apart, shape
    (place, 2).
    """
    from scipy.special import j1, jn

    x = np.maximum(np.arange(0.0, DISC_END + 2.0 * DISC_STEP, DISC_STEP), 1e-9)
    return np.stack([2.0 * j1(x) / x, -2.0 * jn(2, x) / x], axis=1)


@njit(cache=True)
def _halos_from_table(x: Array, elastic_share: Array, table: Array) -> Array:
    out = np.empty(x.shape)
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            argument = x[i, j]
            out[i, j] = (
                elastic_share[i] * np.sin(argument)
                + (1.0 - elastic_share[i]) * sine_integral_at(argument, table)
            ) / argument
    return out


@njit(cache=True)
def _discs_from_table(x: Array, table: Array) -> Array:
    out = np.empty(x.size)
    for i in range(x.size):
        out[i] = disc_at(x[i], table)[0]
    return out


@njit(cache=True)
def sine_integral_at(x: float, table: Array) -> float:
    """Return Si(x), linear between places of the table."""
    position = x * SINE_PER_UNIT
    if position >= table.size - 1:
        return np.pi / 2 - np.cos(x) / x
    node = int(position)
    return table[node] + (table[node + 1] - table[node]) * (position - node)


@njit(cache=True)
def disc_at(x: float, table: Array) -> tuple[float, float]:
    """Return 2 J1(x)/x and its slope -2 J2(x)/x, cubic between places of the table."""
    if x >= DISC_END:
        scale = np.sqrt(2.0 / (np.pi * x)) * 2.0 / x
        zero_phase, first_phase = x - 0.75 * np.pi, x - 1.25 * np.pi
        value = scale * (np.cos(zero_phase) - 0.375 / x * np.sin(zero_phase))
        return value, -scale * (np.cos(first_phase) - 1.875 / x * np.sin(first_phase))
    position = x / DISC_STEP
    node = int(position)
    t = position - node
    low, high = table[node, 0], table[node + 1, 0]
    rise, last = table[node, 1] * DISC_STEP, table[node + 1, 1] * DISC_STEP
    bend, twist = 3.0 * (high - low) - 2.0 * rise - last, rise + last - 2.0 * (high - low)
    value = low + t * (rise + t * (bend + t * twist))
    return value, (rise + t * (2.0 * bend + 3.0 * t * twist)) / DISC_STEP
