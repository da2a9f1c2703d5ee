"""Forward model of a point source: transfer and priors, core pixels and rings.

The two-dimensional transfer is exp(-(f/fc)^n - 2 (pi f s)^2), which represents tubes, lenses and fibres, times the
halo, the known pixel and, along rows, the known causal video filter. All lengths are column pitches, also vertical
ones.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.mtf.blur_models.transfer import sine_integral
from charact.mtf.known_transfer import halo_diameters_px
from charact.mtf.point.thresholds import ACCURACY
from charact.posterior.laplace import covariance_root
from charact.video_filter import NODES_SD, VideoFilter, powers
from labdata.camera_description import Parameter

Array = NDArray[np.float64]

NAMES = (
    "x_px",
    "y_px",
    "ln_cut_off",
    "exponent",
    "blur_px",
    "stretch",
    "ln_bandwidth",
    "halo_deviate",
    "halo_diameter_px",
    "halo_elastic_share",
)
UNITS = ("px", "px", "ln(cy/px)", "1", "px", "1", "1", "1", "px", "1")
# Standard deviations of a camera about its description: ln cut-off, exponent, ln aspect.
CUT_OFF_SD, EXPONENT_SD, STRETCH_SD = 0.12, 0.08, 0.03
ANY_STRETCH_SD = 0.15
# Gaussian blur of a generic camera: mode and spread, px.
ANY_BLUR_PX = 0.4
# Exponent of a single-component blur, and of a tube's tails (physics reference 1.12: 1.1 to 2) next to a Gaussian core.
# Wider tails are indistinguishable from a background.
FREE, FREE_SD = 1.6, 0.6
TAIL, TAIL_SD, MIN_TAIL = 1.3, 0.25, 1.0
TWO_SIDED_95 = 1.959964
# Relative range of a halo diameter without a stated range, and smallest relative standard deviation.
OPEN_DIAMETER, MIN_DIAMETER_SD = 0.15, 0.02
NO_HALO = (-30.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class PointPrior:
    """Bounded priors: halves of two normal distributions that meet at the described value.

    Parameters
    ----------
    free
        Fitted parameters, of `NAMES`.
    centre, below, above, bounds
        Mode, standard deviations below and above it, and bounds of all, shape (name,) and (name, 2); a parameter that
        is not fitted stays at its mode.
    halo_px
        Bounds of the halo's diameter, px; None: no halo is fitted.
    halo_fraction_bend
        (a, b, c) of ln fraction = a + b z + c z^2, z the halo's standard normal deviate.
    """

    free: tuple[str, ...]
    centre: Array
    below: Array
    above: Array
    bounds: Array
    halo_px: tuple[float, float] | None
    halo_fraction_bend: tuple[float, float, float]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fitted parameters."""
        return self.free

    @property
    def units(self) -> tuple[str, ...]:
        """Their units."""
        return tuple(UNITS[NAMES.index(name)] for name in self.free)

    @property
    def spread(self) -> Array:
        """Mean of both standard deviations: the normal distribution of equal height, shape (name,)."""
        return 0.5 * (self.below + self.above)

    @property
    def free_index(self) -> NDArray[np.int64]:
        """Indices of the fitted parameters among all."""
        return np.array([NAMES.index(name) for name in self.free])

    def values_by_name(self, theta: Array) -> dict[str, Array]:
        """Return every parameter by name, shape (n,) each, fixed ones (1,)."""
        held = {name: self.centre[index : index + 1] for index, name in enumerate(NAMES)}
        return held | {name: theta[:, index] for index, name in enumerate(self.free)}

    def halo_fraction(self, deviate: Array) -> Array:
        """Return the halo's fraction of the photoelectrons."""
        a, b, c = self.halo_fraction_bend
        return np.exp(a + b * deviate + c * deviate**2)

    def log_density(self, theta: Array) -> Array:
        """Return ln of the density, -inf outside the bounds, shape (n,)."""
        chosen = self.free_index
        low, high = self.bounds[chosen].T
        inside = np.all((theta >= low) & (theta <= high), axis=1)
        away = theta - self.centre[chosen]
        normal = -0.5 * np.sum((away / np.where(away < 0.0, self.below[chosen], self.above[chosen])) ** 2, axis=1)
        return np.where(inside, normal, -np.inf)


def priors_of(context: Context, *, halo_seen: bool) -> tuple[PointPrior, ...]:
    """Return the candidate priors: of the described camera, or two kinds of generic cameras.

    `halo_seen` states whether the region contains the halo.
    """
    if context.sensor is None:
        return _generic_prior(0.0), _generic_prior(ANY_BLUR_PX)
    return (_sensor_prior(context, halo_seen),)


def _generic_prior(blur_px: float) -> PointPrior:
    """Any camera: exp(-(f/fc)^n), of which n = 2 is a Gaussian, alone or with a Gaussian core."""
    free = (*NAMES[:4], *(("blur_px",) if blur_px else ()), "stretch")
    core, core_sd = (
        (np.log(0.4), TAIL if blur_px else FREE, blur_px),
        (1.0, TAIL_SD if blur_px else FREE_SD, ANY_BLUR_PX),
    )
    prior = _prior(free, core, core_sd, (1e-3, np.ones(3)), None, NO_HALO)
    spread = np.where(np.array(NAMES) == "stretch", ANY_STRETCH_SD, prior.spread)
    least = np.where(np.array(NAMES) == "exponent", MIN_TAIL if blur_px else 0.5, prior.bounds[:, 0])
    return replace(prior, below=spread, above=spread, bounds=np.stack([least, prior.bounds[:, 1]], axis=1))


def _sensor_prior(context: Context, halo_seen: bool) -> PointPrior:
    """The described intensifier: exponential tube, Gaussian lens and fibres."""
    sensor = context.sensor
    assert sensor is not None
    pitch_um = float(sensor.ccd.pitch_x_um)
    demagnification = float(sensor.taper.demagnification)
    cut_off = float(sensor.tube.mtf_frequency_lp_per_mm) * pitch_um * demagnification * 1e-3
    lens = float(sensor.optics.aberration_blur_um) / (pitch_um * demagnification)
    fibres = float(sensor.taper.fibre_pitch_um) / (4.0 * pitch_um)
    faces = 1e3 / (np.pi * np.sqrt(2.0) * float(sensor.taper.interface_mtf_lp_per_mm) * pitch_um)
    blur = float(np.sqrt(lens**2 + fibres**2 + faces**2))
    fraction = sensor.photocathode.halo_fraction
    halo = halo_diameters_px(context, transposed=False) if halo_seen else None
    bend = _ln_parabola(float(fraction), fraction.low, fraction.high) if halo_seen else NO_HALO
    gap = sensor.photocathode.gap_mm
    px_per_mm = 4e3 / (pitch_um * demagnification)
    diameter = px_per_mm * np.array([float(gap), *_sides(gap)])
    video = VideoFilter.of(sensor)
    bandwidth_sd = video.ln_bandwidth_sd if video else 0.0
    free = (*NAMES[:7], *(NAMES[7:] if halo_seen else ()))
    core = (np.log(cut_off), float(sensor.tube.mtf_exponent), blur)
    return _prior(free, core, (CUT_OFF_SD, EXPONENT_SD, 0.25 * blur), (bandwidth_sd, diameter), halo, bend)


def _prior(free, core, core_sd, tail, halo, bend) -> PointPrior:
    """Assemble a prior."""
    bandwidth_sd, diameter = tail
    centre = np.array([0.0, 0.0, *core, 0.0, 0.0, 0.0, diameter[0], 0.5])
    below, above = (
        np.array([np.inf, np.inf, *core_sd, STRETCH_SD, max(bandwidth_sd, 1e-3), 1.0, side, 1e3])
        for side in diameter[1:]
    )
    low, high = halo or (1.0, 2.0)
    bounds = np.array([
        (-3.0, 3.0), (-3.0, 3.0), (np.log(0.02), np.log(3.0)), (0.5, 4.0), (0.0, 3.0), (-0.3, 0.3), (-0.2, 0.2),
        (-3.0, 3.0), (low, high), (0.0, 1.0),
    ])  # fmt: skip
    return PointPrior(
        free=tuple(free), centre=centre, below=below, above=above, bounds=bounds, halo_px=halo, halo_fraction_bend=bend
    )


def _sides(known: Parameter) -> tuple[float, float]:
    """Return standard deviations below and above a described value, whose range contains 95 %."""
    value = float(known)
    low = (1.0 - OPEN_DIAMETER) * value if known.low is None else known.low
    high = (1.0 + OPEN_DIAMETER) * value if known.high is None else known.high
    least = MIN_DIAMETER_SD * value
    return max((value - low) / TWO_SIDED_95, least), max((high - value) / TWO_SIDED_95, least)


def _ln_parabola(value: float, low: float | None, high: float | None) -> tuple[float, float, float]:
    """Return the parabola of ln through the 95 % bounds and the value, the median."""
    low, high = low or 0.3 * value, high or 2.0 * value
    centre, down, up = np.log([value, low, high])
    return float(centre), float((up - down) / (2 * TWO_SIDED_95)), float((up + down - 2 * centre) / (2 * 3.841459))


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

    def aperture_transfer(self, fx: Array, fy: Array) -> Array:
        """Return the transfer of pixel and pinhole at frequencies along rows and columns, real."""
        return np.sinc(fx * self.width_px) * np.sinc(fy * self.height_px) * pinhole(np.hypot(fx, fy), self.pinhole_px)

    def video_transfer(self, frequency: Array) -> NDArray[np.complex128]:
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
        step = 1.0 / ACCURACY.image_period_px
        return np.arange(step / 2, self.optics.top, step), np.arange(
            step / 2, ACCURACY.frequency_aspect * self.optics.top, step
        )[:, None]

    @cached_property
    def _video_lines(self) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """The video filter at the columns' frequencies, and its derivatives by ln bandwidth."""
        at = self.grid[0]
        return self.optics.video_transfer(at), self.optics.bend(at)

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
        return 4.0 / ACCURACY.image_period_px**2 * self.optics.aperture_transfer(fx, fy)

    @cached_property
    def _rings(self) -> tuple[Array, "HaloTable", Array]:
        """Frequencies, halo and the Hankel transform onto the rings, shape (frequency, ring)."""
        from scipy.special import j0

        f = np.arange(ACCURACY.ring_frequency_step / 2, ACCURACY.ring_max_frequency, ACCURACY.ring_frequency_step)
        kernel = j0(2 * np.pi * f[:, None, None] * self.ring_px).mean(axis=2)
        return f, HaloTable.of(f, self.prior.halo_px), kernel * (2 * np.pi * ACCURACY.ring_frequency_step * f)[:, None]

    def modulus(self, theta: Array, fx: Array, fy: Array, halo: "HaloTable | None" = None) -> Array:
        """Return the transfer without pixel and video filter at frequencies (...), shape (n, ...)."""
        p = self.prior.values_by_name(theta)
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
        p = self.prior.values_by_name(theta)
        fraction = self.prior.halo_fraction(p["halo_deviate"])
        return table(fraction, p["halo_diameter_px"], p["halo_elastic_share"])

    def core(self, theta: Array) -> Array:
        """Return the core's pixels per unit light, shape (n, row, col), 1/px^2."""
        fx, fy = self.grid
        return self.image(theta, self.modulus(theta, fx, fy, self.halo_table) * self.aperture_on_grid)

    def image(self, theta: Array, transfer: Array) -> Array:
        """Return the image of transfers given at the grid's frequencies with its weights, shape (n, row, col)."""
        p = self.prior.values_by_name(theta)
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
        walls = self.prior.bounds[self.prior.free_index]
        away = ACCURACY.frequency_margin_sd * covariance_root(covariance).T
        positions = np.clip(np.concatenate([point[None], point + away, point - away]), walls[:, 0], walls[:, 1])
        fx, fy = self.grid
        height = np.abs(self.modulus(positions, fx, fy, self.halo_table) * self.aperture_on_grid)
        # Height beyond each frequency; the ends of both axes move together.
        beyond = np.maximum(
            np.broadcast_to(fx, height.shape[1:]), np.broadcast_to(fy / ACCURACY.frequency_aspect, height.shape[1:])
        ).ravel()
        order = np.argsort(beyond)
        lost = np.cumsum(height.reshape(len(positions), -1)[:, order][:, ::-1], axis=1)
        clear = np.all(lost <= ACCURACY.negligible_amplitude * lost[:, -1:], axis=0)
        top = float(beyond[order][::-1][int(np.argmin(clear))]) + 1e-9
        return self if top >= beyond.max() else replace(self, optics=replace(self.optics, top=top))

    def rings(self, theta: Array) -> Array:
        """Return the rings' means per unit light, shape (n, ring), 1/px^2."""
        f, table, kernel = self._rings
        along = self.optics.width_px / 2.0 + self.optics.height_px / 2.0
        radial = self.modulus(theta, f / np.sqrt(2), f / np.sqrt(2), table)
        return (radial * np.sinc(f * along / 2) * np.exp(-2.0 * (np.pi * f * ACCURACY.ring_smoothing_px) ** 2)) @ kernel

    def mtf(self, theta: Array, frequency: Array, *, vertical: bool) -> Array:
        """Return the camera's MTF along rows or along columns, without pinhole, shape (n, frequency)."""
        p = self.prior.values_by_name(theta)
        f = np.maximum(frequency, 1e-7)
        none = np.zeros_like(f)
        if vertical:
            return self.modulus(theta, none, f) * np.abs(np.sinc(f * self.optics.height_px))
        video = np.abs(self.optics.video_transfer(f)) * np.exp(powers(p["ln_bandwidth"]) @ self.optics.bend(f).real)
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
            elastic=_parabola(np.sinc(u / np.pi)),
            uniform=_parabola(sine_integral(u) / u),
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


def _parabola(values: Array) -> Array:
    """Return constant, slope and curvature of the parabola through values at -1, 0 and 1."""
    return np.stack([values[1], 0.5 * (values[2] - values[0]), 0.5 * (values[2] + values[0]) - values[1]])
