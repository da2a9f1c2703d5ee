"""Fit of a point source to core pixels and ring means, with pulse noise and quantisation."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.mtf.image_lag import ImageLagModel, image_lag_model
from charact.mtf.point.forward_model import NAMES, KnownPointOptics, PointModel, PointPrior, priors_of
from charact.mtf.point.source_window import Window
from charact.mtf.point.thresholds import ACCURACY, LIMITS
from charact.posterior import find_maximum

Array = NDArray[np.float64]

FRACTIONS_AFTER_GAIN = (0.4, 0.6, 0.8, 1.0)
# Trial gains, relative to the variance of a dark pixel.
GAINS = np.exp(np.linspace(np.log(1e-3), np.log(1e5), 200))


@dataclass(frozen=True, kw_only=True)
class PulseNoise:
    """Noise of the core's pixels.

    Parameters
    ----------
    pulse
        Covariance of one frame per unit light and unit gain, without image lag, shape (pixel, pixel).
    gain
        Covariance per light, DN px^2.
    share
        Fraction of the blur after the gain; None: independent pixels, as in ordinary cameras.
    sharpness
        Mean square of a pulse of unit light over its area, 1/px^2.
    """

    pulse: Array
    gain: float
    share: float | None
    sharpness: float


def pulse_covariance(model: PointModel, point: Array, share: float) -> Array:
    """Return the covariance of unit light at unit gain for a fraction of blur after the gain, shape (pixel, pixel)."""
    fx, fy = model.grid
    p = {name: float(value[0]) for name, value in model.prior.values_by_name(point[None]).items()}
    square = fx**2 + fy**2
    tube = np.exp(p["exponent"] * (0.5 * np.log(square) - p["ln_cut_off"]))
    gauss = (np.pi * p["blur_px"]) ** 2 * square
    behind = np.exp(-share * tube - gauss) * model.aperture_on_grid
    before = np.exp(-(1.0 - share) * tube - gauss) * model.spread(point[None], model.halo_table)[0]
    out = np.zeros((model.x.size * model.y.size,) * 2)
    for (step, reach), inner in (
        (ACCURACY.near_landing_px, 0.0),
        (ACCURACY.far_landing_px, ACCURACY.near_landing_px[1]),
    ):
        positions = np.arange(-reach, reach + 1e-9, step)
        cell = np.sinc(fx * step) * np.sinc(fy * step)
        along, down = (np.cos(2 * np.pi * np.outer(positions, f)) for f in (fx, fy))
        density = down @ (before * cell) @ along.T * (4.0 / ACCURACY.image_period_px**2)
        weight = np.maximum(density, 0.0) * step**2
        keep = np.maximum(*np.broadcast_arrays(np.abs(positions)[:, None], np.abs(positions))) > inner - 1e-9
        keep = keep if inner else np.ones_like(keep)
        shapes = _shapes(model, point, behind, positions, keep)
        out += (shapes * weight[keep][:, None]).T @ shapes
    return out


def shot_covariance(model: PointModel, point: Array) -> Array:
    """Return the covariance of unit light at unit gain for independent pixels, shape (pixel, pixel)."""
    return np.diag(np.maximum(model.core(point[None])[0].ravel(), 0.0))


def _shapes(model: PointModel, point: Array, transfer: Array, places: Array, keep: NDArray[np.bool_]) -> Array:
    """Return pulses at positions around the source, shape (position, pixel)."""
    rows, cols = np.nonzero(keep)
    shifted = np.repeat(point[None], rows.size, axis=0)
    x, y = (model.prior.free.index(name) for name in ("x_px", "y_px"))
    shifted[:, x] += places[cols]
    shifted[:, y] += places[rows]
    return model.image(shifted, transfer).reshape(rows.size, -1)


def near_pixels(model: PointModel, point: Array) -> NDArray[np.int64]:
    """Return the pixels near the source, which have nearly all of its noise."""
    p = model.prior.values_by_name(point[None])
    x, y = np.broadcast_arrays(model.x - p["x_px"], (model.y - p["y_px"])[:, None])
    return np.flatnonzero((np.hypot(x, y) < ACCURACY.noise_radius_px).ravel())


def fit_pulse_noise(
    model: PointModel,
    point: Array,
    light: float,
    deviations: Array,
    floor: float,
    parity: NDArray[np.bool_],
    memory: ImageLagModel,
    shares: tuple[float | None, ...] = FRACTIONS_AFTER_GAIN,
) -> PulseNoise:
    """Return the noise that makes the frame differences most probable.

    Parameters
    ----------
    light
        Light of the source, DN px^2.
    deviations
        Frames less their mean, shape (frame, pixel), DN.
    floor
        Variance of a pixel far from the source, DN^2.
    parity
        Field of each pixel, shape (pixel,).
    shares
        Candidate fractions of blur after the gain; None: independent pixels.
    """
    near = near_pixels(model, point)
    deviations, parity = deviations[:, near], parity[near]
    factor = memory.between_rows(parity)
    best: tuple[float, PulseNoise] | None = None
    area = float(np.diff(model.y[:2])[0] * np.diff(model.x[:2])[0])
    freedom = len(deviations) - 1
    for fraction in shares:
        pulse = shot_covariance(model, point) if fraction is None else pulse_covariance(model, point, fraction)
        sharp = float(np.trace(pulse)) * area
        values, vectors = np.linalg.eigh(pulse[np.ix_(near, near)] * factor * light)
        gains = GAINS * floor / max(float(values.mean()), 1e-300)
        power = ((deviations @ vectors) ** 2).sum(axis=0)
        variance = gains[:, None] * np.maximum(values, 0.0) + floor
        fit = -0.5 * (freedom * np.log(variance) + power / variance).sum(axis=1)
        top = int(np.argmax(fit))
        if best is None or fit[top] > best[0]:
            best = float(fit[top]), PulseNoise(pulse=pulse, gain=float(gains[top]), share=fraction, sharpness=sharp)
    assert best is not None
    return best[1]


@dataclass(frozen=True, kw_only=True)
class PointFit:
    """Most probable transfer of a point source.

    Parameters
    ----------
    model
        The forward model.
    data, white, rounding
        Values used, shape (value,), the matrix that whitens them, and the covariance of their quantisation.
    keep
        Core pixels used, shape (row, col).
    point, covariance
        Optimum of the posterior and inverse curvature.
    light, pedestal
        Best light, DN px^2, and level, DN.
    light_sd
        Standard uncertainty of the light.
    chi2, free
        At the optimum, and its degrees of freedom.
    noise
        Noise of the core.
    """

    model: PointModel
    data: Array
    white: Array
    rounding: Array
    keep: NDArray[np.bool_]
    point: Array = field(default_factory=lambda: np.empty(0))
    covariance: Array = field(default_factory=lambda: np.empty(0))
    light: float = 0.0
    pedestal: float = 0.0
    light_sd: float = 0.0
    chi2: float = 0.0
    free: int = 1
    noise: PulseNoise | None = None

    def shapes(self, theta: Array) -> Array:
        """Return the values at unit light, shape (n, value)."""
        core = self.model.core(theta)[:, self.keep]
        return np.concatenate([core, self.model.rings(theta)], axis=1) if self.model.ring_px.size else core

    @cached_property
    def _white_level_and_data(self) -> tuple[Array, Array]:
        """A level of one and the data, whitened, shape (value,) each."""
        return self.white.sum(axis=1), self.white @ self.data

    def linear(self, theta: Array) -> tuple[Array, Array, Array]:
        """Return chi squared, best light and pedestal (n, 2), and their normal matrix (n, 2, 2)."""
        unit = self.shapes(theta) @ self.white.T
        flat, data = self._white_level_and_data
        normal = np.empty((len(theta), 2, 2))
        normal[:, 0, 0] = np.einsum("nv,nv->n", unit, unit)
        normal[:, 0, 1] = normal[:, 1, 0] = unit @ flat
        normal[:, 1, 1] = flat @ flat
        right = np.stack([unit @ data, np.full(len(theta), flat @ data)], axis=1)
        best = np.linalg.solve(normal, right[..., None])[..., 0]
        chi2 = data @ data - (best * right).sum(axis=1)
        return np.asarray(chi2, np.float64), np.asarray(best, np.float64), normal

    def shift_of_rounding(self) -> Array:
        """Return the most probable quantisation shift of the values at the optimum, shape (value,), DN."""
        left = self.data - self.pedestal - self.light * self.shapes(self.point[None])[0]
        return self.rounding @ (self.white.T @ (self.white @ left))

    def log_probability(self, theta: Array) -> Array:
        """Return ln posterior with light and pedestal marginalised, shape (n,)."""
        value = self.model.prior.log_density(theta)
        inside = np.isfinite(value)
        within, at_once = np.flatnonzero(inside), max(ACCURACY.batch_size // self.model.aperture_on_grid.size, 1)
        for begin in range(0, within.size, at_once):
            part = within[begin : begin + at_once]
            chi2, _, normal = self.linear(theta[part])
            height = -0.5 * chi2 - 0.5 * np.log(normal[:, 0, 0] * normal[:, 1, 1] - normal[:, 0, 1] ** 2)
            value[part] += np.where(np.isfinite(height), height, -np.inf)
        return value


def fit(window: Window, context: Context, optics: KnownPointOptics) -> PointFit | None:
    """Fit a window with the most probable kind of prior; None where no transfer is possible."""
    first, *others = priors_of(context, halo_seen=window.holds_halo)
    found = _fit(window, context, optics, first)
    for prior in others:
        if found is not None and _evidence(_fit_other_prior(found, prior)) > _evidence(found):
            found = _fit(window, context, optics, prior) or found
    return found


def _fit_other_prior(found: PointFit, prior: PointPrior) -> PointFit:
    """Return the optimum under another prior with the weights of a fit, for comparison."""
    at = {name: float(value[0]) for name, value in found.model.prior.values_by_name(found.point[None]).items()}
    other = replace(found, model=replace(found.model, prior=prior))
    centre: dict[str, float] = dict(zip(NAMES, prior.centre, strict=True))
    fitted = found.model.prior.free
    starts = np.array(
        [
            [at[name] if name in fitted else fraction * centre[name] for name in prior.free]
            for fraction in (0.3, 1.0, 2.0)
        ]
    )
    start = starts[int(np.argmax(other.log_probability(starts)))]
    point, covariance = find_maximum(other.log_probability, start, prior.bounds[prior.free_index])
    return _fit_at(other, point, covariance, found.noise)


def _evidence(found: PointFit) -> float:
    """Return ln evidence by Laplace's approximation, up to a constant common to fits of the same weights."""
    prior = found.model.prior
    spread = prior.spread[prior.free_index]
    known = np.isfinite(spread)
    height = float(found.log_probability(found.point[None])[0])
    volume = 0.5 * float(np.linalg.slogdet(2.0 * np.pi * found.covariance)[1])
    return height + volume - float(np.sum(np.log(np.sqrt(2.0 * np.pi) * spread[known])))


def _fit(window: Window, context: Context, optics: KnownPointOptics, prior: PointPrior) -> PointFit | None:
    """Fit a window, noise and transfer in turn; None where no transfer is possible."""
    model = PointModel(optics=optics, prior=prior, x=window.x, y=window.y, ring_px=window.ring_px)
    image_lag = image_lag_model(context, window.frames)
    point = _first(model, window)
    noise = None
    found = _apply_weights(model, window, point, None, image_lag)
    for turn in range(ACCURACY.noise_turns):
        if not np.isfinite(found.log_probability(point[None])[0]):
            return None
        point, covariance = find_maximum(found.log_probability, point, prior.bounds[prior.free_index])
        found = _fit_at(found, point, covariance, noise)
        if found.light <= 0:
            return None
        if turn == ACCURACY.noise_turns - 1:
            break
        if window.frames > 2:
            shares = _shares(context, turn)
            noise = fit_pulse_noise(model, point, max(found.light, 1e-9), window.deviations, window.floor,
                             window.parity, image_lag, shares)  # fmt: skip
        # Pulses are narrower than the image: their noise needs all frequencies.
        found = _apply_weights(
            model.restrict_frequencies(point, covariance), window, point, noise, image_lag, light=found.light
        )
    return found


def _shares(context: Context, turn: int) -> tuple[float | None, ...]:
    """Return the candidate fractions of blur after the gain; first the described tube's."""
    if context.sensor is None:
        return None, *FRACTIONS_AFTER_GAIN
    return (float(context.sensor.tube.post_gain_share),) if turn == 0 else FRACTIONS_AFTER_GAIN


def _first(model: PointModel, window: Window) -> Array:
    """Return the starting point: the centre of light."""
    start = model.prior.centre[model.prior.free_index].copy()
    start[0], start[1] = window.centre
    return start


def _apply_weights(
    model, window: Window, point: Array, noise: PulseNoise | None, memory, light: float = 0.0
) -> PointFit:
    """Return a fit whose weights follow from noise, phosphor pattern and quantisation at a point."""
    keep = window.keep.ravel()
    core = light * model.core(point[None])[0] if light else np.maximum(window.core - np.median(window.core), 0.0)
    rings = light * model.rings(point[None])[0] if light and window.ring_dn.size else np.zeros(window.ring_dn.size)
    bright = core.ravel()
    covariance = _core_covariance(window, bright, noise, memory, light)[np.ix_(keep, keep)]
    size = len(covariance)
    whole = np.zeros((size + rings.size,) * 2)
    whole[:size, :size] = covariance
    whole[size:, size:] = window.ring_covariance(window.ring_variance)
    pulse = np.zeros(bright.size) if noise is None else noise.gain * light * np.diag(noise.pulse) * memory.frame_same
    scatter = np.append(pulse[keep], np.full(rings.size, np.inf))
    rounding = np.zeros_like(whole)
    if window.quiet_sd < LIMITS.max_rounded_sd:
        pulses = (
            ACCURACY.pulses_per_dn if noise is None else ACCURACY.pulse_height_square / (noise.gain * noise.sharpness)
        )
        rounding = rounding_covariance(np.append(bright[keep], rings), scatter, window.quiet_sd, pulses)
    whole += rounding
    root = np.asarray(np.linalg.inv(np.linalg.cholesky(whole)), np.float64)
    return PointFit(model=model, data=np.concatenate([window.core.ravel()[keep], window.ring_dn]), white=root,
                    rounding=rounding, keep=window.keep)  # fmt: skip


def _core_covariance(window: Window, bright: Array, noise: PulseNoise | None, memory, light: float) -> Array:
    """Return the covariance of the core's mean: pulses, pixel noise and phosphor pattern."""
    count = window.frames
    if noise is None:
        # A band-limited model can be negative.
        covariance = np.diag(0.02 * np.maximum(bright, 0.0) * max(float(bright.max()), 1.0)) / count
    else:
        same = window.parity[:, None] == window.parity[None, :]
        covariance = noise.gain * light * noise.pulse * np.where(same, memory.mean_same, memory.mean_other) / count
    pattern = np.exp(-0.5 * window.distances**2 / ACCURACY.phosphor_pattern_px**2)
    return (
        covariance
        + np.eye(bright.size) * window.floor / count
        + ACCURACY.phosphor_pattern**2 * np.outer(bright, bright) * pattern
    )


def rounding_covariance(height: Array, pulse_variance: Array, quiet_sd: float, pulses_per_dn: float) -> Array:
    """Return the covariance of mean values by quantisation, shape (value, value).

    Parameters
    ----------
    height
        Values above the pedestal, shape (value,), DN.
    pulse_variance
        Variance of one frame by pulses, shape (value,), DN^2.
    quiet_sd
        Noise of a pixel without light, DN.
    pulses_per_dn
        Number of pulses per DN.

    Notes
    -----
    Quantisation of a value x with Gaussian noise sd adds -exp(-2 (pi sd)^2) sin(2 pi x) / pi to its mean (first term of
    the sawtooth's series). The fractional part of the pedestal is unknown, so that x = pedestal + height has any phase
    and the errors of two values covary as the cosine of their difference. With few pulses the factor is at least
    exp(-their number): some frames have none.
    """
    damping = np.minimum(2.0 * np.pi**2 * pulse_variance, pulses_per_dn * np.maximum(height, 0.0))
    size = np.exp(-2.0 * np.pi**2 * quiet_sd**2 - damping) / np.pi
    phase = 2.0 * np.pi * height
    return 0.5 * np.outer(size, size) * np.cos(phase[:, None] - phase)


def _fit_at(found: PointFit, point: Array, covariance: Array, noise: PulseNoise | None) -> PointFit:
    """Return the fit at an optimum."""
    chi2, best, normal = found.linear(point[None])
    return PointFit(
        model=found.model,
        data=found.data,
        white=found.white,
        rounding=found.rounding,
        keep=found.keep,
        point=point,
        covariance=covariance,
        light=float(best[0, 0]),
        pedestal=float(best[0, 1]),
        light_sd=float(np.sqrt(np.linalg.inv(normal[0])[0, 0])),
        chi2=float(chi2[0]),
        free=max(found.data.size - 2 - min(point.size, 5), 1),
        noise=noise,
    )
