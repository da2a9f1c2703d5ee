"""Matrix from a transfer at a few directions to the pixels and rings of a point's image.

pixel(x, y) = integral T(f) V(fx) exp(2 pi i f.x) over both frequencies, in polar coordinates by Gaussian quadrature, so
that there are no periodic copies. The known aperture and video filter are part of the matrix.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from charact.video_filter import VideoFilter

Array = NDArray[np.float64]

# Radial panels, cycles per column pitch: dense where the halo's transfer oscillates.
PANELS = (0.0, 0.004, 0.012, *np.arange(0.025, 0.3, 0.025), *np.arange(0.3, 0.6, 0.05), 0.6, 0.7, 0.8, 0.9, 1.0)
BEYOND = 0.25
NODES = 4
DIRECTIONS = 5
# Nodes of a panel for the rings, and distances per ring.
FINE, PER_RING = 12, 12
# Directions of the integral at zero frequency, and their increase per cycle per pixel.
TURNS, TURNS_PER_CYCLE = 12, 36


@dataclass(frozen=True, kw_only=True)
class Aperture:
    """Known part of the camera's transfer."""

    # width_px, height_px: extent of a pixel as read, column pitches
    width_px: float = 1.0
    height_px: float = 1.0
    video: VideoFilter | None = None  # Video filter along rows, or None
    top: float = 2.0  # Highest frequency with contrast, cycles per column pitch
    orders: int = 1  # Powers of ln bandwidth, from 0, for which matrices have columns

    def horizontal(self, frequency: Array, order: int = 0) -> NDArray[np.complex128]:
        """Return aperture and video filter along rows, as the coefficient of a power of ln bandwidth, at most 2."""
        plain = np.sinc(frequency * self.width_px).astype(complex)
        if self.video is None:
            return plain if order == 0 else np.zeros_like(plain)
        plain *= self.video(frequency)
        if order == 0:
            return plain
        first, second = self.video.bend(frequency)[:2]
        return plain * (first if order == 1 else second + 0.5 * first**2)

    def vertical(self, frequency: Array) -> Array:
        """Return the aperture along columns."""
        return np.sinc(frequency * self.height_px)


@lru_cache(maxsize=8)
def radial(top: float) -> tuple[Array, Array]:
    """Return borders of the panels and the radial nodes."""
    borders = np.array([*(b for b in PANELS if b < top), *np.arange(1.0 + BEYOND, top + 1e-9, BEYOND)])
    at = np.polynomial.legendre.leggauss(NODES)[0]
    middle, half = 0.5 * (borders[1:] + borders[:-1]), 0.5 * np.diff(borders)
    return borders, (middle[:, None] + half[:, None] * at).ravel()


@lru_cache(maxsize=1)
def cosines() -> Array:
    """Cosines of twice the angle of the directions at which transfers are kept: Chebyshev's, rows to columns."""
    return np.cos(np.pi * np.arange(DIRECTIONS) / (DIRECTIONS - 1))


def _lagrange(nodes: Array, at: Array) -> Array:
    """Return the polynomials that are one at one node and none at the others, shape (at, node)."""
    out = np.ones((at.size, nodes.size))
    for index, node in enumerate(nodes):
        others = np.delete(nodes, index)
        out[:, index] = np.prod((at[:, None] - others) / (node - others), axis=1)
    return out


@dataclass(frozen=True)
class _Panel:
    """Nodes of one panel and all directions of the integral, flattened (radius, direction)."""

    fx: Array
    fy: Array
    weight: NDArray[np.complex128]
    between: Array


@lru_cache(maxsize=24)
def _panels(aperture: Aperture, order: int = 0) -> list[_Panel]:
    borders, nodes = radial(aperture.top)
    weights = np.polynomial.legendre.leggauss(NODES)[1]
    panels = []
    for number, (low, high) in enumerate(pairwise(borders)):
        f = nodes[number * NODES : (number + 1) * NODES]
        turn, share = np.polynomial.legendre.leggauss(int(TURNS + TURNS_PER_CYCLE * high))
        turn, share = 0.25 * np.pi * (turn + 1.0), 0.25 * np.pi * share
        fx, fy = f[:, None] * np.cos(turn), f[:, None] * np.sin(turn)
        # Four quadrants of the plane.
        area = 4.0 * (0.5 * (high - low) * weights * f)[:, None] * share
        known = aperture.horizontal(fx.ravel(), order).reshape(fx.shape) * aperture.vertical(fy)
        panels.append(_Panel(fx.ravel(), fy.ravel(), (area * known).ravel(), _lagrange(cosines(), np.cos(2.0 * turn))))
    return panels


def pixel_matrix(aperture: Aperture, x: Array, y: Array) -> Array:
    """Return the matrix from a transfer (order x direction x frequency) to pixels of unit light, (pixel, node), 1/px^2.

    `x`, `y`: positions of columns and rows from the source, column pitches, shape (col,) and (row,).
    """
    return np.concatenate([_pixel_matrix(aperture, order, x, y) for order in range(aperture.orders)], axis=1)


def _pixel_matrix(aperture: Aperture, order: int, x: Array, y: Array) -> Array:
    """Return the matrix's columns of one power of ln bandwidth."""
    parts = []
    for panel in _panels(aperture, order):
        phase = 2.0 * np.pi * panel.fx[:, None] * x
        along = panel.weight.real[:, None] * np.cos(phase)
        if aperture.video is not None:
            along = along - panel.weight.imag[:, None] * np.sin(phase)
        down = np.cos(2.0 * np.pi * panel.fy[:, None] * y)
        both = (down[:, :, None] * along[:, None, :]).reshape(NODES, -1, x.size * y.size)
        parts.append(panel.between.T @ both)
    return np.concatenate(parts).transpose(2, 1, 0).reshape(x.size * y.size, -1)


def pictures(aperture: Aperture, transfer: Array, x: Array, y: Array) -> Array:
    """Return image, its slopes along x and y, and their product's, shape (4, row x col), 1/px^2 and so on.

    `transfer`: shape (direction, frequency).
    """
    out = np.zeros((4, y.size, x.size))
    for number, panel in enumerate(_panels(aperture)):
        here = transfer[:, number * NODES : (number + 1) * NODES]
        weight = (panel.weight.reshape(NODES, -1) * (here.T @ panel.between.T)).ravel()
        phase = 2.0 * np.pi * panel.fx[:, None] * x
        turned = weight[:, None] * np.exp(1j * phase)
        along, slope = turned.real, -2.0 * np.pi * panel.fx[:, None] * turned.imag
        phase = 2.0 * np.pi * panel.fy[:, None] * y
        down, fall = np.cos(phase), -2.0 * np.pi * panel.fy[:, None] * np.sin(phase)
        out += np.stack([down.T @ along, down.T @ slope, fall.T @ along, fall.T @ slope])
    return out.reshape(4, -1)


def ring_matrix(aperture: Aperture, ring_px: Array) -> Array:
    """Return the matrix from a transfer (direction x frequency) to the means of rings, shape (ring, node), 1/px^2.

    `ring_px`: distances of some pixels of every ring, shape (ring, pixel), column pitches.
    """
    from scipy.special import j0

    borders, nodes = radial(aperture.top)
    out = np.zeros((len(ring_px), aperture.orders * DIRECTIONS * nodes.size))
    if not len(ring_px):
        return out
    some = ring_px[:, np.linspace(0, ring_px.shape[1] - 1, PER_RING).round().astype(int)]
    at, weight = np.polynomial.legendre.leggauss(FINE)
    between = _lagrange(np.polynomial.legendre.leggauss(NODES)[0], at)
    half = 0.5 * np.diff(borders)
    f = 0.5 * (borders[1:] + borders[:-1])[:, None] + half[:, None] * at
    pixel = np.sinc(f * aperture.width_px / np.sqrt(2.0)) * np.sinc(f * aperture.height_px / np.sqrt(2.0))
    kernel = j0(2.0 * np.pi * f[..., None, None] * some).mean(axis=-1) * (2.0 * np.pi * f * pixel)[..., None]
    radially = np.einsum("pfr,pf,fn->rpn", kernel, half[:, None] * weight, between).reshape(len(ring_px), -1)
    turns = np.cos(np.pi * (np.arange(64) + 0.5) / 64)
    round_about = _lagrange(cosines(), turns).mean(axis=0)
    # The video filter moves hardly any light between rings.
    out[:, : DIRECTIONS * nodes.size] = (round_about[None, :, None] * radially[:, None, :]).reshape(len(ring_px), -1)
    return out
