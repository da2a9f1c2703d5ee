"""Matrix from a transfer at a few directions to the pixels and rings of a point's image.

pixel(x, y) = integral T(f) V(fx) exp(2 pi i f.x) over both frequencies, in polar coordinates by
Gaussian quadrature, so that there are no periodic copies. The known aperture and video filter are
part of the matrix.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from charact.transfer.video_filter import VideoFilter
from labdata import Array

# Radial panels, cycles per column pitch: dense where the halo's transfer oscillates.
BORDERS = np.array(
    [
        0.0,
        0.004,
        0.012,
        *np.arange(0.025, 0.3, 0.025),
        *np.arange(0.3, 0.6, 0.05),
        0.6,
        0.7,
        0.8,
        0.9,
        *np.arange(1.0, 2.01, 0.25),
    ]
)
NODES, DIRECTIONS = 4, 5
GAUSS, WEIGHTS = np.polynomial.legendre.leggauss(NODES)
# Radial nodes, cycles per column pitch, at which transfers are kept, and the cosines of twice the
# angle of their directions: Chebyshev's, rows to columns.
FREQUENCIES = (
    0.5 * (BORDERS[1:] + BORDERS[:-1])[:, None] + 0.5 * np.diff(BORDERS)[:, None] * GAUSS
).ravel()
COSINES = np.cos(np.pi * np.arange(DIRECTIONS) / (DIRECTIONS - 1))
# Nodes of a panel for the rings, and distances per ring.
FINE, PER_RING = 12, 12
# Directions of the integral at zero frequency, and their increase per cycle per pixel.
TURNS, TURNS_PER_CYCLE = 12, 36


@dataclass(frozen=True, kw_only=True)
class Aperture:
    """Known part of the camera's transfer."""

    height_px: float = 1.0  # Height of a pixel as read, column pitches; its width is one
    video: VideoFilter | None = None  # Video filter along rows, or None
    # Side of the squares that the pixels of the fit are means of, px: its pitch and unit of length
    summed_px: int = 1
    orders: int = 1  # Powers of ln bandwidth, from 0, for which matrices have columns

    def horizontal(self, frequency: Array, order: int = 0) -> NDArray[np.complex128]:
        """Return aperture and video filter along rows, as the coefficient of a power of ln
        bandwidth, at most 2.
        """
        plain = np.sinc(frequency).astype(complex)
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


def _lagrange(nodes: Array, at: Array) -> Array:
    """Return the polynomials that are one at one node and none at the others, shape (at, node)."""
    out = np.ones((at.size, nodes.size))
    for index, node in enumerate(nodes):
        other_nodes = np.delete(nodes, index)
        out[:, index] = np.prod((at[:, None] - other_nodes) / (node - other_nodes), axis=1)
    return out


@dataclass(frozen=True)
class _Panel:
    """Nodes of one panel and all directions of the integral, flattened (radius, direction)."""

    fx: Array
    fy: Array
    weight: NDArray[np.complex128]
    interpolation: Array


@lru_cache(maxsize=24)
def _panels(aperture: Aperture, order: int = 0) -> list[_Panel]:
    panels = []
    for (low, high), f in zip(pairwise(BORDERS), FREQUENCIES.reshape(-1, NODES), strict=True):
        turn, weights = np.polynomial.legendre.leggauss(int(TURNS + TURNS_PER_CYCLE * high))
        turn, weights = 0.25 * np.pi * (turn + 1.0), 0.25 * np.pi * weights
        fx, fy = f[:, None] * np.cos(turn), f[:, None] * np.sin(turn)
        # Four quadrants of the plane.
        area = 4.0 * (0.5 * (high - low) * WEIGHTS * f)[:, None] * weights
        known = aperture.horizontal(fx.ravel(), order).reshape(fx.shape) * aperture.vertical(fy)
        panels.append(
            _Panel(
                fx.ravel(),
                fy.ravel(),
                (area * known).ravel(),
                _lagrange(COSINES, np.cos(2.0 * turn)),
            )
        )
    return panels


def pixel_matrix(aperture: Aperture, x: Array, y: Array) -> Array:
    """Return the matrix from a transfer (order x direction x frequency) to pixels of unit light,
    (pixel, node), 1/px^2.

    `x`, `y`: positions of columns and rows from the source, column pitches, shape (col,) and
    (row,).
    """
    down = [np.cos(2.0 * np.pi * panel.fy[:, None] * y) for panel in _panels(aperture)]
    parts = []
    for order in range(aperture.orders):
        columns = []
        for panel, fall in zip(_panels(aperture, order), down, strict=True):
            phase = 2.0 * np.pi * panel.fx[:, None] * x
            along = panel.weight.real[:, None] * np.cos(phase)
            if aperture.video is not None:
                along = along - panel.weight.imag[:, None] * np.sin(phase)
            products = (fall[:, :, None] * along[:, None, :]).reshape(NODES, -1, x.size * y.size)
            columns.append(panel.interpolation.T @ products)
        parts.append(np.concatenate(columns).transpose(2, 1, 0).reshape(x.size * y.size, -1))
    return np.concatenate(parts, axis=1)


def pictures(aperture: Aperture, transfer: Array, x: Array, y: Array) -> Array:
    """Return image, its slopes along x and y, and their product's, shape (4, row x col), 1/px^2 and
    so on.

    `transfer`: shape (direction, frequency).
    """
    out = np.zeros((4, y.size, x.size))
    for number, panel in enumerate(_panels(aperture)):
        panel_transfer = transfer[:, number * NODES : (number + 1) * NODES]
        weight = (
            panel.weight.reshape(NODES, -1) * (panel_transfer.T @ panel.interpolation.T)
        ).ravel()
        phase = 2.0 * np.pi * panel.fx[:, None] * x
        turned = weight[:, None] * np.exp(1j * phase)
        along, slope = turned.real, -2.0 * np.pi * panel.fx[:, None] * turned.imag
        phase = 2.0 * np.pi * panel.fy[:, None] * y
        down, fall = np.cos(phase), -2.0 * np.pi * panel.fy[:, None] * np.sin(phase)
        out += np.stack([down.T @ along, down.T @ slope, fall.T @ along, fall.T @ slope])
    return out.reshape(4, -1)


def ring_matrix(aperture: Aperture, ring_px: Array) -> Array:
    """Return the matrix from a transfer (direction x frequency) to the means of rings, shape (ring,
    node), 1/px^2.

    `ring_px`: distances of some pixels of every ring, shape (ring, pixel), column pitches.
    """
    from scipy.special import j0

    out = np.zeros((len(ring_px), aperture.orders * DIRECTIONS * FREQUENCIES.size))
    if not len(ring_px):
        return out
    some = ring_px[:, np.linspace(0, ring_px.shape[1] - 1, PER_RING).round().astype(int)]
    at, weight = np.polynomial.legendre.leggauss(FINE)
    interpolation = _lagrange(GAUSS, at)
    half = 0.5 * np.diff(BORDERS)
    f = 0.5 * (BORDERS[1:] + BORDERS[:-1])[:, None] + half[:, None] * at
    pixel = np.sinc(f / np.sqrt(2.0)) * np.sinc(f * aperture.height_px / np.sqrt(2.0))
    kernel = (
        j0(2.0 * np.pi * f[..., None, None] * some).mean(axis=-1)
        * (2.0 * np.pi * f * pixel)[..., None]
    )
    radially = np.einsum("pfr,pf,fn->rpn", kernel, half[:, None] * weight, interpolation).reshape(
        len(ring_px), -1
    )
    turns = np.cos(np.pi * (np.arange(64) + 0.5) / 64)
    round_about = _lagrange(COSINES, turns).mean(axis=0)
    # The video filter moves hardly any light between rings.
    out[:, : DIRECTIONS * FREQUENCIES.size] = (
        round_about[None, :, None] * radially[:, None, :]
    ).reshape(len(ring_px), -1)
    return out
