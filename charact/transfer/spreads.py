"""Transfer functions of spreads in two dimensions, scaled in px, and their radial profiles.

Frequencies have shape (frequency,), parameters (draw,), transfer functions (draw, frequency).
"""

from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from charact.transfer.form import MIN_LN
from charact.transfer.stages import image_tube
from charact.transfer.tables import disc, moffat_table, sine_integral
from labdata import Array

# Fractions of the halo's light with the densities 1/sqrt(1 - x^2) (rim), arccos(x)/x (central
# peak), x^2 and x^12 (rim of finite width), with x the radius over the disc's radius; half of the
# highest power.
PROFILE = ("elastic_share", "even_share", "rising_share", "rim_share")
RIM = 6
# Arguments of the table of the powers: 160 px at 1.25 cy/px.
POWER_ARGUMENTS = np.arange(0.0, 650.0, 0.04)
# Substitute for frequency 0 in denominators.
LEAST_CY_PER_PX = 1e-9


def pixel_of_all_directions(frequency: Array, pitch_ratio: float) -> Array:
    """Transfer function of the pixel aperture, averaged over all directions, shape (frequency,)."""
    angle = (np.arange(64) + 0.5) * (np.pi / 128)
    across, along = (
        np.cos(angle)[:, None] * frequency,
        pitch_ratio * np.sin(angle)[:, None] * frequency,
    )
    return (np.sinc(across) * np.sinc(along)).mean(axis=0)


def gaussian(frequency: Array, variance_px2: Array) -> Array:
    """exp(-2 pi^2 s^2 f^2)."""
    return np.exp(-2.0 * np.pi**2 * variance_px2[:, None] * frequency**2)


def tube(frequency: Array, cut_off: Array, exponent: Array) -> Array:
    """`image_tube` of draws."""
    return image_tube(frequency, cut_off[:, None], exponent[:, None])


def moffat(frequency: Array, radius_px: Array, exponent: Array) -> Array:
    """Transform of (1 + (r/a)^2)^-b, see `charact.transfer.cores.Moffat`; frequencies from 0 on."""
    ln_ratios, inverse, ln, scales = moffat_table()
    row, weight = cubic_weights(inverse, 1.0 / exponent)
    lines = np.einsum("dr,dra->da", weight, ln[row])
    ln_half = np.log(2.0) + np.sum(weight * scales[row], axis=1) / (exponent - 1.0)
    ln_scale = np.log(2.0 * np.pi * radius_px) - ln_half
    ln_ratio = ln_scale[:, None] + np.log(np.maximum(frequency, LEAST_CY_PER_PX))
    positions, weights = cubic_weights(ln_ratios, np.clip(ln_ratio, ln_ratios[0], ln_ratios[-1]))
    out = sum(
        weights[..., node] * np.take_along_axis(lines, positions[..., node], axis=1)
        for node in range(4)
    )
    return np.where(frequency > 0.0, np.exp(np.maximum(out, MIN_LN)), 1.0)


def matern(frequency: Array, sd_px: Array, peak: Array) -> Array:
    """(1 + p (2 pi f s)^2/2)^(-1/p): variance s^2 along each axis, Gaussian at p = 0, exp(-r/L) at
    2/3, s^2 = 3 L^2.
    """
    power = np.maximum(peak, 1e-6)[:, None]
    return np.exp(-np.log1p(0.5 * power * (2.0 * np.pi * sd_px[:, None] * frequency) ** 2) / power)


def mix(of: Array | float, fraction: Array, part: Array) -> Array:
    """Replace a fraction, shape (draw,), of a transfer function by another one, shape (draw,
    frequency).
    """
    return of * (1.0 - fraction[:, None]) + fraction[:, None] * part


def halo_disc(frequency: Array, diameter_px: Array, profile: Array) -> Array:
    """Transfer function of a halo disc of finite diameter and any smooth profile.

    `profile`: fractions of its light with
    the radial densities of `PROFILE`, shape (draw, fraction); the rest is flat. With x the radius
    over that of the disc and u = pi f D: elastically backscattered electrons have the density
    1/sqrt(1 - x^2), those with uniformly distributed energies arccos(x)/x (range 2 d e sin 2t in
    the gap, cosine law), with the transforms sin(u)/u and Si(u)/u. Powers of x are sums of (1 -
    x^2)^k, with Sonine's transforms Gamma(k + 2) (2/u)^(k + 1) J_(k+1)(u).
    """
    u = np.pi * diameter_px[:, None] * np.maximum(frequency, LEAST_CY_PER_PX)
    first, weight = cubic_weights(POWER_ARGUMENTS, np.minimum(u, POWER_ARGUMENTS[-1]))
    powers = (
        sum(weight[..., node] * power[first[..., node]] for node in range(4))
        for power in _power_table()
    )
    flat = disc(u)[0]
    parts = np.stack([np.sin(u) / u, sine_integral(u) / u, *powers])
    return flat + np.einsum("dp,pdf->df", profile, parts - flat)


@lru_cache(maxsize=1)
def _power_table() -> tuple[Array, ...]:
    """Transfer functions of the densities x^2 and x^12 at `POWER_ARGUMENTS`."""
    from scipy.special import comb, gamma, jv

    u = np.maximum(POWER_ARGUMENTS, LEAST_CY_PER_PX)
    sonine = [gamma(k + 2) * (2.0 / u) ** (k + 1) * jv(k + 1, u) for k in range(RIM + 1)]

    def power(n: int) -> Array:
        weight = np.array([(-1) ** k * comb(n, k) / (k + 1) for k in range(n + 1)])
        return (n + 1) * (weight @ np.array(sonine[: n + 1]))

    return power(1), power(RIM)


def cubic_weights(grid: Array, value: Array) -> tuple[NDArray[np.intp], Array]:
    """Four neighbours on a uniform grid and their cubic interpolation weights, shape (.., 4)."""
    at = (value - grid[0]) / (grid[1] - grid[0])
    first = np.clip(at.astype(np.intp) - 1, 0, len(grid) - 4)
    t = at - first
    weight = np.stack(
        [
            -(t - 1) * (t - 2) * (t - 3) / 6,
            t * (t - 2) * (t - 3) / 2,
            -t * (t - 1) * (t - 3) / 2,
            t * (t - 1) * (t - 2) / 6,
        ],
        axis=-1,
    )
    return first[..., None] + np.arange(4), weight


@cache
def quadrature(highest_cy_per_px: float, count: int) -> tuple[Array, Array]:
    """Return frequencies, cy/px, and weights of the integral over a transfer function
    (Gauss-Legendre).
    """
    node, weight = np.polynomial.legendre.leggauss(count)
    return 0.5 * highest_cy_per_px * (node + 1.0), 0.5 * highest_cy_per_px * weight


def hankel_matrix(nodes: tuple[Array, Array], radius_px: Array) -> Array:
    """Matrix from a transfer function at quadrature nodes to light at radii, 1/px^2, shape (node,
    radius).
    """
    from scipy.special import j0

    frequency, weight = (node_values[:, None] for node_values in nodes)
    return 2.0 * np.pi * frequency * weight * j0(2.0 * np.pi * frequency * radius_px)
