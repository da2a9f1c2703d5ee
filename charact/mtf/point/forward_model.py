"""Forward model of a point source: transfer and priors, core pixels and rings.

The two-dimensional transfer is exp(-(f/fc)^n - 2 (pi f s)^2), which represents tubes, lenses and fibres, times the
halo, the known pixel and, along rows, the known causal video filter. All lengths are column pitches, also vertical
ones.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.mtf.blur_models.extended_component_tables import sine_integral
from charact.mtf.point.forward_prior import PointPrior
from charact.posterior.laplace import covariance_root
from charact.video_filter import NODES_SD, VideoFilter, powers

Array = NDArray[np.float64]

# Spacing of the frequencies: copies of the source then lie this far apart, beyond core and halo, px.
PERIOD_PX = 40.0
RING_STEP, RING_TOP = 1.0 / 160.0, 0.5
# Rings are wide: smoothing by this much changes nothing and ends the integral gently.
RING_SMOOTHING_PX = 1.0
# Frequencies up along columns over those along rows.
UP = 0.85
# Share of a picture's light amplitude that frequencies left out may hold, and how far from a fit it may, in standard
# deviations.
NEGLIGIBLE, MARGIN_SD = 1e-6, 5.0


@dataclass(frozen=True, kw_only=True)
class KnownPointOptics:
    """Known optics of the camera.

    Parameters
    ----------
    width_px, height_px
        Extent of a pixel as read, column pitches.
    video
        Video filter along rows, or None.
    pinhole_px
        Diameter of the source's image, column pitches; 0: a point.
    top
        Highest frequency with contrast, cycles per column pitch.
    """

    width_px: float
    height_px: float
    video: VideoFilter | None
    pinhole_px: float
    top: float

    def fixed(self, fx: Array, fy: Array) -> Array:
        """Return the transfer of pixel and pinhole at frequencies along rows and columns, real."""
        return np.sinc(fx * self.width_px) * np.sinc(fy * self.height_px) * pinhole(np.hypot(fx, fy), self.pinhole_px)

    def filtered(self, frequency: Array) -> NDArray[np.complex128]:
        """Return the described video filter without its delay, shape (frequency,), complex."""
        return np.ones(frequency.shape, complex) if self.video is None else self.video(frequency)

    def bend(self, frequency: Array) -> NDArray[np.complex128]:
        """Return the derivatives of the ln video filter by ln bandwidth, see `VideoFilter.bend`."""
        if self.video is None:
            return np.zeros((len(NODES_SD), frequency.size), complex)
        return self.video.bend(frequency)


def pinhole(frequency: Array, diameter_px: float) -> Array:
    """Return 2 J1(u)/u, u = pi d f, the transfer of a uniform disc."""
    if diameter_px <= 0:
        return np.ones_like(frequency)
    from scipy.special import j1

    u = np.maximum(np.pi * diameter_px * frequency, 1e-9)
    return 2.0 * j1(u) / u


@dataclass(frozen=True, kw_only=True)
class PointModel:
    """Pixels and rings of a point source of unit light.

    Parameters
    ----------
    optics
        Known optics.
    prior
        Names, bounds and prior of the parameters.
    x, y
        Positions of the core's columns and rows, px from the first estimate of the source, shape (col,) and (row,).
    ring_px
        Distances of sample pixels of every ring, shape (ring, pixel), px.
    """

    optics: KnownPointOptics
    prior: PointPrior
    x: Array
    y: Array
    ring_px: Array

    @cached_property
    def grid(self) -> tuple[Array, Array]:
        """Frequencies along rows (fx,) and along columns (fy, 1), cycles per column pitch."""
        step = 1.0 / PERIOD_PX
        return np.arange(step / 2, self.optics.top, step), np.arange(step / 2, UP * self.optics.top, step)[:, None]

    @cached_property
    def _video_lines(self) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """The video filter at the columns' frequencies, and its derivatives by ln bandwidth."""
        at = self.grid[0]
        return self.optics.filtered(at), self.optics.bend(at)

    @cached_property
    def _waves(self) -> tuple[Array, Array, Array, Array]:
        """Cosine and sine of every column's phase, shape (fx, col), and of every row's, shape (row, fy)."""
        fx, fy = self.grid
        along, down = 2.0 * np.pi * fx[:, None] * self.x, 2.0 * np.pi * self.y[:, None] * fy[:, 0]
        return np.cos(along), np.sin(along), np.cos(down), np.sin(down)

    @cached_property
    def halo_table(self) -> "HaloTable":
        """The halo at the grid's frequencies."""
        fx, fy = self.grid
        return HaloTable.of(np.hypot(fx, fy), self.prior.halo_px)

    @cached_property
    def aperture_on_grid(self) -> Array:
        """Pixel and pinhole at the grid's frequencies, with the integration weights, shape (fy, fx)."""
        fx, fy = self.grid
        return 4.0 / PERIOD_PX**2 * self.optics.fixed(fx, fy)

    @cached_property
    def _rings(self) -> tuple[Array, "HaloTable", Array]:
        """Frequencies, halo and the Hankel transform onto the rings, shape (frequency, ring)."""
        from scipy.special import j0

        f = np.arange(RING_STEP / 2, RING_TOP, RING_STEP)
        kernel = j0(2 * np.pi * f[:, None, None] * self.ring_px).mean(axis=2)
        return f, HaloTable.of(f, self.prior.halo_px), kernel * (2 * np.pi * RING_STEP * f)[:, None]

    def modulus(self, theta: Array, fx: Array, fy: Array, halo: "HaloTable | None" = None) -> Array:
        """Return the transfer without pixel and video filter at frequencies (...), shape (n, ...)."""
        p = self.prior.named(theta)
        shape = (slice(None), *(None,) * np.broadcast(fx, fy).ndim)
        stretch = np.exp(p["stretch"])[shape]
        square = fx**2 * stretch + fy**2 / stretch
        core = np.log(square)
        core *= 0.5 * p["exponent"][shape]
        core -= (p["exponent"] * p["ln_cut_off"])[shape]
        np.exp(core, out=core)
        square *= 2.0 * (np.pi * p["blur_px"][shape]) ** 2
        core += square
        np.negative(core, out=core)
        np.exp(core, out=core)
        if self.prior.halo_px is None:
            return core
        return core * self.spread(theta, halo or HaloTable.of(np.hypot(fx, fy), self.prior.halo_px))

    def spread(self, theta: Array, table: "HaloTable") -> Array:
        """Return the transfer of direct and scattered photoelectrons, shape (n, ...) as the table's."""
        if self.prior.halo_px is None:
            return np.ones((len(theta), *(1,) * (table.elastic.ndim - 1)))
        p = self.prior.named(theta)
        share = self.prior.halo_fraction(p["halo_deviate"])
        return table(share, p["halo_diameter_px"], p["halo_elastic_share"])

    def core(self, theta: Array) -> Array:
        """Return the core's pixels per unit light, shape (n, row, col), 1/px^2."""
        fx, fy = self.grid
        return self.image(theta, self.modulus(theta, fx, fy, self.halo_table) * self.aperture_on_grid)

    def image(self, theta: Array, transfer: Array) -> Array:
        """Return the image of transfers given at the grid's frequencies with its weights, shape (n, row, col)."""
        p = self.prior.named(theta)
        line, lines = self.grid[0], self.grid[1][:, 0]
        described, bend = self._video_lines
        filtered = described * np.exp(powers(p["ln_bandwidth"]) @ bend)
        left, up = 2.0 * np.pi * p["x_px"][:, None] * line, 2.0 * np.pi * p["y_px"][:, None] * lines
        along = filtered * (np.cos(left) - 1j * np.sin(left))
        cosine_x, sine_x, cosine_y, sine_y = self._waves
        columns = along.real[:, :, None] * cosine_x - along.imag[:, :, None] * sine_x
        rows = np.cos(up)[:, None] * cosine_y + np.sin(up)[:, None] * sine_y
        return rows @ transfer @ columns

    def restrict_frequencies(self, point: Array, covariance: Array) -> "PointModel":
        """Return the model without frequencies that are negligible near an optimum.

        The omitted frequencies hold less than `NEGLIGIBLE` of the image's height along every axis of the posterior, out
        to `MARGIN_SD`.
        """
        walls = self.prior.bounds[self.prior.chosen]
        away = MARGIN_SD * covariance_root(covariance).T
        places = np.clip(np.concatenate([point[None], point + away, point - away]), walls[:, 0], walls[:, 1])
        fx, fy = self.grid
        height = np.abs(self.modulus(places, fx, fy, self.halo_table) * self.aperture_on_grid)
        # Height beyond each frequency; the ends of both axes move together.
        beyond = np.maximum(np.broadcast_to(fx, height.shape[1:]), np.broadcast_to(fy / UP, height.shape[1:])).ravel()
        order = np.argsort(beyond)
        lost = np.cumsum(height.reshape(len(places), -1)[:, order][:, ::-1], axis=1)
        clear = np.all(lost <= NEGLIGIBLE * lost[:, -1:], axis=0)
        top = float(beyond[order][::-1][int(np.argmin(clear))]) + 1e-9
        return self if top >= beyond.max() else replace(self, optics=replace(self.optics, top=top))

    def rings(self, theta: Array) -> Array:
        """Return the rings' means per unit light, shape (n, ring), 1/px^2."""
        f, table, kernel = self._rings
        along = self.optics.width_px / 2.0 + self.optics.height_px / 2.0
        radial = self.modulus(theta, f / np.sqrt(2), f / np.sqrt(2), table)
        return (radial * np.sinc(f * along / 2) * np.exp(-2.0 * (np.pi * f * RING_SMOOTHING_PX) ** 2)) @ kernel

    def mtf(self, theta: Array, frequency: Array, *, vertical: bool) -> Array:
        """Return the camera's MTF along rows or along columns, without pinhole, shape (n, frequency)."""
        p = self.prior.named(theta)
        f = np.maximum(frequency, 1e-7)
        none = np.zeros_like(f)
        if vertical:
            return self.modulus(theta, none, f) * np.abs(np.sinc(f * self.optics.height_px))
        video = np.abs(self.optics.filtered(f)) * np.exp(powers(p["ln_bandwidth"]) @ self.optics.bend(f).real)
        return self.modulus(theta, f, none) * np.abs(np.sinc(f * self.optics.width_px)) * video


@dataclass(frozen=True, kw_only=True)
class HaloTable:
    """Transfer of the halo at fixed frequencies, quadratic in ln of its diameter between its bounds."""

    middle: float
    half: float
    elastic: Array
    uniform: Array

    @classmethod
    def of(cls, frequency: Array, halo_px: tuple[float, float] | None) -> "HaloTable":
        """Return the table for a range of diameters, px."""
        low, high = np.log(halo_px or (1.0, 2.0))
        u = np.pi * frequency * np.exp(np.array([low, 0.5 * (low + high), high]).reshape(-1, *(1,) * frequency.ndim))
        return cls(
            middle=0.5 * (low + high),
            half=0.5 * (high - low),
            elastic=_bend(np.sinc(u / np.pi)),
            uniform=_bend(sine_integral(u) / u),
        )

    def __call__(self, fraction: Array, diameter_px: Array, elastic_share: Array) -> Array:
        """Return 1 - q + q H for the halo fraction q, shape (n, frequency...)."""
        x = (np.log(diameter_px) - self.middle) / self.half
        weight = fraction * np.stack([np.ones_like(x), x, x * x])
        both = np.concatenate([weight * elastic_share, weight * (1.0 - elastic_share)]).T
        parts = np.concatenate([self.elastic, self.uniform]).reshape(6, -1)
        scattered = (both @ parts).reshape(-1, *self.elastic.shape[1:])
        scattered += (1.0 - fraction)[(slice(None), *(None,) * (self.elastic.ndim - 1))]
        return scattered


def _bend(values: Array) -> Array:
    """Return constant, slope and curvature of the parabola through values at -1, 0 and 1."""
    return np.stack([values[1], 0.5 * (values[2] - values[0]), 0.5 * (values[2] + values[0]) - values[1]])
