"""One point source for the parametric fit: position, noise covariance, whitening."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.point.blur_models_2d import BlurModel2D
from charact.estimators.mtf.point.model_fit import BlurModelFit2D, Censored, WhitenedPixels
from charact.estimators.mtf.point.parametric_noise import (
    GAINS,
    Pulses,
    fit_pulses,
    pulse_covariances,
)
from charact.estimators.mtf.point.source_window import Window
from charact.estimators.mtf.point.spot_image_matrix import (
    COSINES,
    FREQUENCIES,
    Aperture,
    pictures,
    pixel_matrix,
    ring_matrix,
)
from charact.estimators.mtf.point.spot_light import SpotLight
from charact.estimators.mtf.point.thresholds import ACCURACY, LIMITS
from charact.frames.image_lag import ImageLagModel
from charact.frames.noise_law import NoiseLaw
from charact.frames.thresholds import CLIPPING
from labdata import Array, Mask

# Trial half frequencies of the first estimate, cycles per column pitch.
GUESSES = np.exp(np.linspace(np.log(0.03), np.log(0.8), 14))
GUESSED = BlurModel2D(core="exponential")


@dataclass(frozen=True, kw_only=True)
class SourcePixels:
    """A source in its window."""

    window: Window  # Its pixels and rings
    aperture: Aperture  # Known part of the camera's transfer
    dark: NoiseLaw  # Noise of its surroundings
    memory: ImageLagModel  # Image lag
    full_scale_dn: float | None  # Full scale, DN; None: unknown
    screen: bool  # Whether a phosphor pattern makes pixels unequal
    # Column and row of the source from the centre of the window, column pitches
    position: tuple[float, float] = (0.0, 0.0)
    pulses: Pulses | None = None  # Noise of its light; None before it is estimated
    # Its light without a form of the blur; None where it is not that of the blur alone
    spot: SpotLight | None = None
    # Chance that a linear camera has lit pixels as quiet as these
    noise_chance: float = 1.0

    @property
    def axes(self) -> tuple[Array, Array]:
        """Positions of columns and rows from the source, column pitches."""
        return self.window.x - self.position[0], self.window.y - self.position[1]

    @property
    def near(self) -> NDArray[np.int64]:
        """Valid core pixels near the source."""
        x, y = self.axes
        return np.flatnonzero((np.hypot(x, y[:, None]) < 5.0).ravel() & self.window.keep.ravel())

    @property
    def value_mask(self) -> Mask:
        """Valid values among core pixels and rings, shape (value,)."""
        return np.append(self.window.keep.ravel(), np.ones(self.window.ring_dn.size, bool))

    @property
    def values(self) -> Array:
        """Core pixels and rings, DN."""
        return np.append(self.window.core.ravel(), self.window.ring_dn)

    @property
    def frames(self) -> Array:
        """Single frames of the core, shape (frame, pixel), DN."""
        return self.window.deviations + self.window.core.ravel()

    @property
    def cut(self) -> Mask:
        """Values of the frames at full scale, shape (frame, pixel)."""
        if self.full_scale_dn is None:
            return np.zeros(self.window.deviations.shape, bool)
        return np.asarray(self.frames >= CLIPPING.full_fraction * self.full_scale_dn)

    def ring_variance(self) -> Array:
        """Return the variance of the rings' means: from the scatter of their sectors, at least the
        dark noise.
        """
        ring = self.window.ring_px
        if not len(ring):
            return np.empty(0)
        area = np.pi * (ring[:, -1] ** 2 - ring[:, 0] ** 2) / float(np.diff(self.window.y[:2])[0])
        noise_floor = (
            self.dark.variance(0.0)
            * self.dark.correlation_factor
            / self.window.frames
            / np.maximum(area, 1.0)
        )
        # Student's t of an estimate from 12 sectors.
        return 11.0 / 9.0 * np.maximum(self.window.ring_variance, noise_floor)

    def matrix(self) -> Array:
        """Return the matrix from a transfer to core pixels and rings of unit light, shape (value,
        node).
        """
        return np.concatenate(
            [
                pixel_matrix(self.aperture, *self.axes),
                ring_matrix(self.aperture, self.window.ring_px),
            ]
        )

    def background(self) -> Array:
        """Return level and slopes at core pixels and rings, shape (value, 3)."""
        x, y = (part.ravel() for part in np.broadcast_arrays(self.window.x, self.window.y[:, None]))
        core = np.stack([np.ones(x.size), x, y], axis=1)
        return np.concatenate([core, np.tile([1.0, 0.0, 0.0], (self.window.ring_dn.size, 1))])


def position_source(site: SourcePixels) -> tuple[SourcePixels, float]:
    """Return a source at its position, and its approximate half frequency."""
    height = np.maximum(site.window.core.ravel() - np.median(site.window.core), 0.0)
    top = max(float(height.max()), 1e-12)
    variance = (
        site.dark.variance(0.0)
        + ACCURACY.first_relative_sd * height * top
        + (ACCURACY.first_relative_sd * top) ** 2
    )
    sd = np.append(np.sqrt(variance / site.window.frames), np.sqrt(site.ring_variance()))
    mask = site.value_mask
    site = replace(site, position=site.window.centre)
    flat = site.background()[mask] / sd[mask, None]
    data = site.values[mask] / sd[mask]
    thetas = np.stack([np.log(GUESSES), np.full_like(GUESSES, 1.5), np.zeros_like(GUESSES)], axis=1)
    transfers = GUESSED.transfer(thetas)
    described = replace(site.aperture, orders=1)
    shapes = (
        transfers.reshape(len(thetas), -1)
        @ replace(site, aperture=described).matrix()[mask].T
        / sd[mask]
    )
    basis = np.linalg.qr(flat)[0]
    free, residual = shapes - (shapes @ basis) @ basis.T, data - basis @ (basis.T @ data)
    best = int(np.argmax((free @ residual) * np.abs(free @ residual) / np.sum(free**2, axis=1)))
    for _ in range(3):
        site, move = _reposition(site, transfers[best], sd[: height.size])
        if move < 0.01:
            break
    return site, float(GUESSES[best])


@dataclass(frozen=True, kw_only=True)
class _CoreResidual:
    """Residual of the core's pixels for a fixed transfer."""

    coefficients: Array  # Light, light times the shift along rows and columns, level and slopes
    design: Array  # Their images, shape (pixel, coefficient)
    residual: Array  # Shape (pixel,), DN


def _core_residual(site: SourcePixels, transfer: Array, sd: Array) -> _CoreResidual:
    """Return the residual of the core's pixels, weighted by their standard deviations (pixel,)."""
    core = site.window.keep.ravel()
    shown = pictures(site.aperture, transfer, *site.axes)[:3].T
    design = np.concatenate([shown, site.background()[: core.size]], axis=1)
    coefficients = np.linalg.lstsq(
        design[core] / sd[core, None], site.window.core.ravel()[core] / sd[core], rcond=None
    )[0]
    return _CoreResidual(
        coefficients=np.asarray(coefficients, np.float64),
        design=design,
        residual=site.window.core.ravel() - design @ coefficients,
    )


def _reposition(site: SourcePixels, transfer: Array, sd: Array) -> tuple[SourcePixels, float]:
    """Return a source at the position that fits a transfer best, to first order, and its shift,
    px.
    """
    coefficients = _core_residual(site, transfer, sd).coefficients
    move = np.clip(-coefficients[1:3] / max(float(coefficients[0]), 1e-300), -1.0, 1.0)
    position = (site.position[0] + float(move[0]), site.position[1] + float(move[1]))
    return replace(site, position=position), float(np.abs(move).max())


def _sd(site: SourcePixels) -> Array:
    """Return standard deviations of the core's pixels with the noise known so far, shape
    (pixel,).
    """
    height = np.maximum(site.window.core.ravel() - np.median(site.window.core), 0.0)
    light = (
        ACCURACY.first_relative_sd * height * height.max()
        if site.pulses is None
        else np.diag(site.pulses.covariance)
    )
    return np.sqrt(
        site.dark.variance(0.0) + light + (ACCURACY.model_relative_sd * height.max()) ** 2
    )


def noise_likelihood(site: SourcePixels, fit: BlurModelFit2D) -> float:
    """Return ln likelihood of one frame's residuals under the likeliest noise of independent
    pixels.

    It compares models before the noise is known: a model that does not fit takes its misfit for
    noise.
    """
    transfer = fit.form.transfer(fit.point[None])[0]
    core, near_pixels = _core_residual(site, transfer, _sd(site)), site.near
    light = np.maximum(core.coefficients[0] * core.design[near_pixels, 0], 0.0)
    still = site.dark.variance(0.0) + _rounding_variance(site)
    variance = still + GAINS[:, None] * still / max(float(light.mean()), 1e-300) * light
    return float(
        np.max(-0.5 * np.sum(np.log(variance) + core.residual[near_pixels] ** 2 / variance, axis=1))
    )


def add_noise(site: SourcePixels, fit: BlurModelFit2D, *, lower: float = 1.0) -> SourcePixels:
    """Return a source at the position of a fitted model, with the noise of its light.

    The noise is estimated from frame differences, or in a single frame from the residuals, reduced
    by the factor `lower`.
    """
    transfer = fit.form.transfer(fit.point[None])[0]
    site, _ = _reposition(site, transfer, _sd(site))
    x, y = site.axes
    mean = fit.light * pictures(site.aperture, transfer, x, y)[0]
    near_pixels = site.near
    if near_pixels.size < 9:
        return site
    blur = fit.form.camera(fit.point[None], FREQUENCIES, COSINES)[0].mean(axis=0)
    units = pulse_covariances((FREQUENCIES, blur), mean, x, y)
    factor = site.memory.between_rows(site.window.parity)
    if site.window.frames > 1:
        return replace(
            site,
            pulses=fit_pulses(site.window.contrasts, dark_noise(site), units, factor, near_pixels),
        )
    # One frame tells pulses from a white scatter only where they are much likelier.
    correlated = site.screen or site.dark.correlation.size > 1
    core = _core_residual(site, transfer, _sd(site))
    fitted = np.concatenate([core.design, _slopes(site, fit)], axis=1)
    still = dark_noise(site) + _rounding_variance(site) * np.eye(mean.size)
    pulses = fit_pulses(
        core.residual[None],
        still,
        units,
        factor,
        near_pixels,
        fitted,
        ln_odds=0.0 if correlated else ACCURACY.ln_white_odds,
    )
    return replace(site, pulses=replace(pulses, gain=lower * pulses.gain))


def _rounding_variance(site: SourcePixels) -> float:
    """Return the variance that quantisation adds to the quietest pixels, DN^2."""
    return float(np.exp(-4.0 * np.pi**2 * min(site.window.quiet_sd, 9.0) ** 2)) / 12.0


def _slopes(site: SourcePixels, fit: BlurModelFit2D) -> Array:
    """Return the derivatives of the core's pixels at unit light by a model's parameters, shape
    (pixel, parameter).
    """
    bounds = fit.form.bounds
    moves = np.where(fit.point > bounds.mean(axis=1), -1e-4, 1e-4) * (bounds[:, 1] - bounds[:, 0])
    nodes = fit.form.nodes(np.concatenate([fit.point[None], fit.point + np.diag(moves)]))
    return pixel_matrix(site.aperture, *site.axes) @ ((nodes[1:] - nodes[0]) / moves[:, None]).T


def dark_noise(site: SourcePixels) -> Array:
    """Return the covariance of the core's pixels without light, shape (pixel, pixel), DN^2."""
    rows, cols = np.indices(site.window.core.shape).reshape(2, -1)
    return site.dark.covariance(rows, cols)


def covariance(site: SourcePixels, mean: Array, light: float) -> Array:
    """Return the covariance of the mean frame's core pixels and rings, shape (value, value),
    DN^2.
    """
    window, count, size = site.window, site.window.frames, site.window.core.size
    out = np.zeros((mean.size, mean.size))
    if site.pulses is None:
        core = np.diag(
            ACCURACY.first_relative_sd
            * np.maximum(mean[:size], 0.0)
            * max(float(mean[:size].max()), 0.0)
        )
    else:
        same = window.parity[:, None] == window.parity[None, :]
        core = site.pulses.covariance * np.where(
            same, site.memory.mean_same, site.memory.mean_other
        )
    out[:size, :size] = (core + dark_noise(site)) / count
    if site.screen:
        pattern = np.exp(-0.5 * window.distances**2 / ACCURACY.phosphor_pattern_px**2)
        out[:size, :size] += (
            ACCURACY.phosphor_pattern**2 * np.outer(mean[:size], mean[:size]) * pattern
        )
    ring_sd = np.sqrt(site.ring_variance())
    out[size:, size:] = window.ring_correlation * np.outer(ring_sd, ring_sd)
    out += np.diag((ACCURACY.model_relative_sd * (mean + 0.1 * float(mean.max()))) ** 2)
    return out + rounding(site, mean)


def rounding(site: SourcePixels, mean: Array) -> Array:
    """Return the covariance of core pixels and rings by quantisation, shape (value, value),
    DN^2.
    """
    window, size = site.window, site.window.core.size
    if window.quiet_sd >= LIMITS.max_rounded_sd:
        return np.zeros((mean.size, mean.size))
    pulse = np.zeros(size)
    if site.pulses is not None:
        pulse = np.diag(site.pulses.covariance) * site.memory.frame_same
    gain = 0.0 if site.pulses is None else site.pulses.gain
    scatter = np.append(pulse, np.full(mean.size - size, np.inf))
    common = _rounding_covariance(
        mean,
        scatter,
        window.quiet_sd,
        ACCURACY.pulse_height_square / gain if gain > 0 else ACCURACY.pulses_per_dn,
    )
    # A height is known to a fraction of a step only where it is small: otherwise quantisation
    # errors are independent.
    lit = np.append(np.clip(2.0 * np.abs(mean[:size]), 0.0, 1.0), np.zeros(mean.size - size))
    return common + np.diag(
        lit * _rounding_variance(site) * np.exp(-4.0 * np.pi**2 * np.minimum(scatter, 9.0))
    )


def whiten_source(site: SourcePixels, transfer: Array, light: float) -> WhitenedPixels:
    """Return the whitened pixels of a source, its position and background marginalised.

    `transfer`: approximate transfer, shape (direction, frequency), for weights and the effect of a
    shift; `light`: approximate light, DN px^2.
    """
    mask, size = site.value_mask, site.window.core.size
    matrix, level = site.matrix(), site.background()
    mean = light * (matrix[:, : transfer.size] @ transfer.ravel())
    slopes = np.zeros((mask.size, 2))
    slopes[:size] = light * pictures(site.aperture, transfer, *site.axes)[1:3].T
    nuisance = np.concatenate([level, slopes, _neighbours(site, transfer)], axis=1)
    pixel_covariance = covariance(site, mean, light)
    root = np.asarray(
        np.linalg.inv(np.linalg.cholesky(pixel_covariance[np.ix_(mask, mask)])), np.float64
    )
    white = root @ nuisance[mask]
    basis, upper = np.linalg.qr(white / np.linalg.norm(white, axis=0))
    raw, data = root @ matrix[mask], root @ site.values[mask]
    hidden = np.asarray(site.cut.any(axis=0), np.bool_)
    back = np.linalg.solve(upper, basis.T) / np.linalg.norm(white, axis=0)[:, None]
    return WhitenedPixels(
        data=data - basis @ (basis.T @ data),
        matrix=raw - basis @ (basis.T @ raw),
        free=int(mask.sum()) - nuisance.shape[1],
        root=root,
        basis=basis,
        rounding=rounding(site, mean)[np.ix_(mask, mask)],
        censored=_pixels_at_full_scale(
            site, hidden, matrix, nuisance, back, raw, data, pixel_covariance
        )
        if hidden.any()
        else None,
    )


def _neighbours(site: SourcePixels, transfer: Array) -> Array:
    """Return images of neighbouring sources and their derivatives by position, shape (value, 3
    each).
    """
    window, columns = site.window, []
    for at, ring_px in zip(window.neighbours, window.neighbour_ring_px, strict=True):
        if np.hypot(*at) > LIMITS.max_neighbour_px:
            continue
        core = pictures(site.aperture, transfer, window.x - at[0], window.y - at[1])[:3]
        rings = ring_matrix(site.aperture, ring_px)[:, : transfer.size] @ transfer.ravel()
        columns += [
            np.append(core[0], rings),
            *(np.append(slope, np.zeros(rings.size)) for slope in core[1:]),
        ]
    return np.stack(columns, axis=1) if columns else np.empty((site.value_mask.size, 0))


def _pixels_at_full_scale(
    site: SourcePixels,
    hidden: Mask,
    matrix: Array,
    nuisance: Array,
    back: Array,
    raw: Array,
    data: Array,
    pixel_covariance: Array,
) -> Censored:
    """Return the clipped pixels, with the background and position of the others."""
    size = hidden.size
    linear = nuisance[:size][hidden]
    level = linear @ (back @ data)
    cut = site.cut[:, hidden]
    n_unclipped = np.sum(~cut, axis=0)
    mean = np.sum(np.where(cut, 0.0, site.frames[:, hidden]), axis=0) / np.maximum(n_unclipped, 1)
    assert site.full_scale_dn is not None
    return Censored(
        matrix=matrix[:size][hidden] - linear @ (back @ raw),
        limit=CLIPPING.full_fraction * site.full_scale_dn - level,
        sd=np.sqrt(np.diag(pixel_covariance)[:size][hidden] * site.window.frames),
        cut=cut.sum(axis=0).astype(float),
        n_unclipped=n_unclipped.astype(float),
        mean=mean - level,
    )


def _rounding_covariance(
    height: Array, pulse_variance: Array, quiet_sd: float, pulses_per_dn: float
) -> Array:
    """Return the covariance of mean values by quantisation, shape (value, value).

    `height`: values above the pedestal, shape (value,), DN; `pulse_variance`: variance of one frame
    by pulses, shape (value,), DN^2; `quiet_sd`: noise of a pixel without light, DN;
    `pulses_per_dn`: number of pulses per DN.

    Notes
    -----
    Quantisation of a value x with Gaussian noise sd adds -exp(-2 (pi sd)^2) sin(2 pi x) / pi to its
    mean (first term of the sawtooth's series). The fractional part of the pedestal is unknown, so
    that x = pedestal + height has any phase and the errors of two values covary as the cosine of
    their difference. With few pulses the factor is at least exp(-their number): some frames have
    none.
    """
    damping = np.minimum(2.0 * np.pi**2 * pulse_variance, pulses_per_dn * np.maximum(height, 0.0))
    size = np.exp(-2.0 * np.pi**2 * quiet_sd**2 - damping) / np.pi
    phase = 2.0 * np.pi * height
    return 0.5 * np.outer(size, size) * np.cos(phase[:, None] - phase)
