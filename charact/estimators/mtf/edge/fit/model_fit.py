"""Fits of blur models to an edge profile: optimum, covariance and evidence (Laplace).

-2 ln P(theta, a | y) = |W (y - A(theta) a)|^2 + sum p (m - (theta, a))^2 + constant: y bin means, W
their whitening root, a step, level and slopes, A the edge spread, a constant and the slopes of the
light at the bins, m and p mean and precision of the Gaussian part of the prior. With a marginalised
ln Z = ln P(theta*) + 1/2 ln |2 pi C|, C the covariance of theta (MacKay, Neural Computation 4,
1992, 415).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numba import njit

from charact.estimators.mtf.edge.checks import FittedProfile
from charact.estimators.mtf.edge.fit.edge_form import EdgeForm
from charact.estimators.mtf.edge.fit.edge_maps import EdgeMaps, Marginal, apply_phases
from charact.estimators.mtf.edge.nonlinearity import CurvatureEstimate
from charact.estimators.mtf.edge.pixels.profile import EdgeProfile
from charact.estimators.mtf.edge.thresholds import ACCURACY
from charact.estimators.mtf.known_transfer import KnownTransfer
from charact.inference import find_maximum
from charact.inference.gauss_newton import (
    Linearisation,
    Optimum,
    covariance_at,
    least_squares,
    ln_evidence,
)
from charact.transfer.blur_model import BlurModel
from labdata import Array

LINEAR = 4  # step, level and two slopes
# Half frequencies among which the first guess is taken, cy/px.
GUESSES = np.exp(np.linspace(np.log(0.01), np.log(1.8), 40))
# Points of a likelihood at a time: transfers of more do not stay in the processor's cache.
BLOCK = 512


@dataclass(frozen=True)
class LinearisedProfile:
    """A profile's model made linear at a point, whitened: linear amplitudes follow the parameters.

    Residual, shape (bin,), design, shape (parameter + 4, bin), step, level and slopes, DN, and mean
    of the Gaussian part of each prior less the parameter with its precision.
    """

    residual: Array
    design: Array
    amplitude: Array
    off: Array
    precision: Array


@dataclass(frozen=True, kw_only=True)
class EdgeFit:
    """A form fitted to a profile.

    Parameters
    ----------
    form
        The form.
    point, covariance
        Parameters at the optimum of the posterior and their covariance; step, level and slopes
        marginalised.
    log_evidence
        ln of the evidence by Laplace's approximation, up to what all forms share.
    cost
        -2 ln of likelihood and Gaussian priors at the optimum.
    chi2, free
        Chi squared there, and the bins less the parameters.
    slope_sd_per_px
        Prior of the illumination's slopes, fraction of the step per px.
    linear
        The model made linear there; None for a form with departures.
    ln_weight
        ln of the form's prior probability over that of a core alone; part of the evidence.
    """

    form: EdgeForm
    point: Array
    covariance: Array
    log_evidence: float
    cost: float
    chi2: float
    free: int
    slope_sd_per_px: float
    linear: LinearisedProfile | None = None
    ln_weight: float = 0.0

    @property
    def family(self) -> BlurModel:
        """The blur model of the form."""
        return self.form.family

    @property
    def at(self) -> LinearisedProfile:
        """The model made linear at the optimum."""
        assert self.linear is not None, (
            "a blur model without departures is made linear where it is fitted"
        )
        return self.linear

    @property
    def noise_scale(self) -> float:
        """Reduced chi squared, at least 1: intervals widen by its root (Birge 1932, doi
        10.1103/PhysRev.40.207).
        """
        return max(1.0, self.chi2 / self.free)


class EdgeFitter:
    """Fits forms to one profile; what all fits share is made once.

    Parameters
    ----------
    profile, known, fine
        As of `EdgeMaps`.
    """

    def __init__(
        self, profile: EdgeProfile, known: KnownTransfer, *, fine: bool | None = None
    ) -> None:
        self.profile = profile
        self.maps = EdgeMaps(profile, known, fine=fine)

    def guess(self) -> float:
        """Return the half frequency at which a form between lens and tube fits best."""
        points = np.stack([np.log(GUESSES), np.full_like(GUESSES, 1.6)], axis=1)
        modulus = BlurModel(core="exponential").modulus(points, self.maps.grid)
        white = self.maps.transfers(modulus, 0.0) @ self.maps.white
        level = self.maps.levels[0] / np.linalg.norm(self.maps.levels[0])
        white = white - np.outer(white @ level, level)
        return float(
            GUESSES[int(np.argmax((white @ self.maps.data) ** 2 / np.sum(white**2, axis=1)))]
        )

    def fit(
        self, family: BlurModel, start: Array, slope_sd_per_px: float, ln_weight: float = 0.0
    ) -> EdgeFit:
        """Fit a blur model by least squares from a starting point: shift, then the model's
        parameters.
        """
        point, at = self.optimise(family, start, slope_sd_per_px, ACCURACY.fit_iterations)
        linear: LinearisedProfile = at.model
        form, size = form_of(family), point.size
        covariance = covariance_at(at.normal, form.bounds)
        volume = np.linalg.slogdet(at.normal[size:, size:])[1] - np.sum(
            np.log(linear.precision[-2:])
        )
        ln_height = -0.5 * (at.cost + volume)
        return EdgeFit(
            form=form,
            point=point,
            covariance=covariance,
            log_evidence=ln_evidence(
                ln_height + _flat(family) + ln_weight, covariance, point, form.bounds
            ),
            cost=at.cost,
            chi2=float(linear.residual @ linear.residual),
            free=max(linear.residual.size - size - 2, 1),
            slope_sd_per_px=slope_sd_per_px,
            linear=linear,
            ln_weight=ln_weight,
        )

    def optimise(
        self, family: BlurModel, start: Array, slope_sd_per_px: float, iterations: int
    ) -> Optimum:
        """Return where so many steps lead from a starting point, and the model there."""
        mean, precision = self.prior(family, slope_sd_per_px)
        maps = self.maps

        def linearise(point: Array) -> Linearisation:
            maps.rebuild_for(float(point[0]))
            blur = family.derivatives(point[1:], maps.grid)
            transfers = _shift_derivatives(
                blur, float(point[0]) - maps.centre_px, maps.grid, maps.fixed
            )
            cost, gradient, normal, *model = _linearise(
                transfers, point, maps.white, maps.levels, maps.data, mean, precision
            )
            residual, design, amplitude, off = model
            linear = LinearisedProfile(residual, design, amplitude, off, precision)
            return Linearisation(cost, gradient, normal, linear)

        bounds = form_of(family).bounds
        return least_squares(
            linearise, start, bounds, iterations=iterations, tolerance=2e-3, grow=30.0
        )

    def fit_departures(self, form: EdgeForm, start: Array, slope_sd_per_px: float) -> EdgeFit:
        """Fit a form with departures from a starting point.

        Nearly noiseless data make narrow ridges: the first steps maximise a tempered posterior.
        """
        marginal = self._marginal(slope_sd_per_px)
        for power in (1e6, 1e8):
            if marginal.power > 30.0 * power:
                tempered = self.log_probability(form, slope_sd_per_px, power / marginal.power)
                start, _ = find_maximum(tempered, start, form.bounds)
        log_probability = self.log_probability(form, slope_sd_per_px)
        point, covariance = find_maximum(log_probability, start, form.bounds)
        ln_height = float(log_probability(point[None])[0]) + self.maps.ln_level_volume(
            self._level_precision(slope_sd_per_px)
        )
        chi2 = float(marginal.chi2(self.transfers(form, point[None], self.maps.centre_px))[0])
        return EdgeFit(
            form=form,
            point=point,
            covariance=covariance,
            log_evidence=ln_evidence(ln_height, covariance, point, form.bounds),
            cost=chi2,
            chi2=chi2,
            free=max(len(self.profile.value) - 3 - 6, 1),
            slope_sd_per_px=slope_sd_per_px,
        )

    def transfers(self, form: EdgeForm, theta: Array, centre_px: float) -> Array:
        """Return the transfers of points at the nodes, on maps around a shift, shape (n, 2
        node).
        """
        delay = form.delay(theta, self.maps.grid, centre_px)
        return apply_phases(form.modulus(theta, self.maps.grid), delay, self.maps.fixed)

    def _transfers_near(self, fit: EdgeFit, theta: Array) -> Array:
        """Return the transfers of points near a fit, on maps that serve there; departures carry any
        shift.
        """
        if fit.linear is not None:
            self.maps.rebuild_for(float(fit.point[0]))
        return self.transfers(fit.form, theta, self.maps.centre_px)

    def prior(self, family: BlurModel, slope_sd_per_px: float) -> tuple[Array, Array]:
        """Return mean and precision of the Gaussian part of every parameter's prior, linear ones
        last.
        """
        mean, precision = family.prior_precision
        levels = self._level_precision(slope_sd_per_px)
        return np.array([0.0, *mean, *[0.0] * LINEAR]), np.array([0.0, *precision, 0.0, *levels])

    def _level_precision(self, slope_sd_per_px: float) -> Array:
        """Return the precision of the priors of level and slopes."""
        return np.array([0.0, *self.profile.slopes_sd(slope_sd_per_px) ** -2.0])

    def _marginal(self, slope_sd_per_px: float) -> Marginal:
        maps = self.maps
        return Marginal(
            maps.white,
            maps.levels,
            maps.data,
            self._level_precision(slope_sd_per_px),
            self.profile.step,
        )

    def chi2_without_edge(self, slope_sd_per_px: float) -> float:
        """Return chi squared of level and slopes alone."""
        return self._marginal(slope_sd_per_px).power

    def under(self, fit: EdgeFit, slope_sd_per_px: float) -> EdgeFit:
        """Return a fit under another prior of the slopes of the light, its evidence to first order,
        its point as is.
        """
        if slope_sd_per_px == fit.slope_sd_per_px:
            return fit
        _, precision = self.prior(fit.family, slope_sd_per_px)
        gained = ln_evidence_nearby(fit.at, precision) - ln_evidence_nearby(
            fit.at, fit.at.precision
        )
        return replace(
            fit,
            linear=replace(fit.at, precision=precision),
            slope_sd_per_px=slope_sd_per_px,
            log_evidence=fit.log_evidence + gained,
        )

    def fitted(self, fit: EdgeFit) -> FittedProfile:
        """Return the fitted profile."""
        transfer = self._transfers_near(fit, fit.point[None])[0]
        model, amplitude = self.maps.best_profile(
            transfer, self._level_precision(fit.slope_sd_per_px)
        )
        return FittedProfile(model=model, amplitude=amplitude, chi2=fit.chi2, free=fit.free)

    def side_slopes(self, fit: EdgeFit) -> Array:
        """Return the fitted slopes of the light on the bright and on the dark side, DN per px."""
        return fit.at.amplitude[-2:] @ self.profile.gradient_ways

    def response_curvature(self, fit: EdgeFit) -> CurvatureEstimate:
        """Return the curvature of the response that the profile requires if its blur is symmetric,
        and its uncertainty.

        Every parameter of the blur but its phases, which stay at the camera's known filter, may
        move by five of its standard deviations.

        Notes
        -----
        A response y = u + c u (1 - u) of the edge spread u; a power law of exponent g over levels a
        to b has about c = -g (g - 1) m^(g - 2) (b - a)^2 / 2 / (b^g - a^g), m their middle. First
        order in c and in every parameter of a symmetric blur; an asymmetric blur looks the same on
        one edge.
        """
        form, centre, profile = fit.form, fit.point.copy(), self.profile
        centre[form.phase_index] = 0.0
        free = np.delete(np.arange(centre.size), form.phase_index)
        sd = np.sqrt(np.diag(fit.covariance))[free]
        step = np.eye(centre.size)[free] * 0.1 * sd[:, None]
        points = np.clip(centre + np.concatenate([step, -step]), *form.bounds.T)
        step_sizes = np.abs(points[: free.size] - points[free.size :]).sum(axis=1)
        spreads = (
            self._transfers_near(fit, np.concatenate([centre[None], points])) @ self.maps.plain
        )
        max_moves = (
            5.0 * sd if fit.linear is None else np.append(ACCURACY.max_shift_px, 5.0 * sd[1:])
        )
        tangents = (spreads[1 : 1 + free.size] - spreads[1 + free.size :]) * (
            max_moves / step_sizes * abs(profile.step)
        )[:, None]
        level = np.clip(spreads[0] + 0.5, 0.0, 1.0)
        design = np.concatenate([spreads[:1], [level * (1.0 - level)], tangents, profile.levels.T])
        white = self.maps.root @ design.T
        prior = np.concatenate(
            [[0.0, 0.0], np.ones(free.size), self._level_precision(fit.slope_sd_per_px)]
        )
        scale = np.sqrt(np.maximum(np.sum(white**2, axis=0) + prior, 1e-300))
        normal = (white.T @ white + np.diag(prior)) / np.outer(scale, scale)
        inverse = np.linalg.pinv(normal, rcond=1e-13, hermitian=True) / np.outer(scale, scale)
        amplitudes = inverse @ (white.T @ self.maps.data)
        return float(amplitudes[1] / amplitudes[0]), float(
            np.sqrt(max(inverse[1, 1], 0.0)) / abs(amplitudes[0])
        )

    def log_probability(
        self, form: EdgeForm, slope_sd_per_px: float, power: float = 1.0
    ) -> Callable[[Array], Array]:
        """Return the log-probability of a form's parameters, vectorised, the likelihood to a
        power.
        """
        marginal, centre_px = self._marginal(slope_sd_per_px), self.maps.centre_px

        def of_block(theta: Array) -> Array:
            value = form.log_prior(theta)
            possible = np.isfinite(value)
            if possible.any():
                value[possible] += power * marginal.log_likelihood(
                    self.transfers(form, theta[possible], centre_px)
                )
            return value

        def log_probability(theta: Array) -> Array:
            blocks = [theta[first : first + BLOCK] for first in range(0, max(len(theta), 1), BLOCK)]
            return np.concatenate([of_block(block) for block in blocks])

        return log_probability


@lru_cache(maxsize=256)
def form_of(family: BlurModel) -> EdgeForm:
    """Return a blur model as a form without departures."""
    return EdgeForm(family=family)


@lru_cache(maxsize=256)
def _flat(family: BlurModel) -> float:
    """Return ln of the prior's density less its Gaussian part, the same wherever the bounds
    allow.
    """
    middle = np.clip(family.prior_precision[0], *family.bounds.T)
    return float(family.log_prior(middle[None])[0])


@njit(cache=True)
def _shift_derivatives(blur: Array, shift_px: float, grid: Array, fixed: Array) -> Array:
    """Return the transfer of a blur at a shift and its slopes with shift and parameters, shape
    (parameter + 1, 2 node), from `BlurModel.derivatives`.
    """
    size = grid.size
    out = np.empty((blur.shape[0] + 1, 2 * size))
    for j in range(size):
        turn = 2.0 * np.pi * shift_px * grid[j]
        cosine, sine = np.cos(turn), np.sin(turn)
        real = fixed[0, j] * cosine + fixed[1, j] * sine
        imaginary = fixed[1, j] * cosine - fixed[0, j] * sine
        out[0, j], out[0, size + j] = blur[0, j] * real, blur[0, j] * imaginary
        out[1, j] = 2.0 * np.pi * grid[j] * out[0, size + j]
        out[1, size + j] = -2.0 * np.pi * grid[j] * out[0, j]
        for k in range(1, blur.shape[0]):
            out[k + 1, j], out[k + 1, size + j] = blur[k, j] * real, blur[k, j] * imaginary
    return out


@njit(cache=True)
def _linearise(
    transfers: Array,
    point: Array,
    white: Array,
    levels: Array,
    data: Array,
    mean: Array,
    precision: Array,
) -> tuple[float, Array, Array, Array, Array, Array, Array]:
    """Return cost, gradient, normal matrix, residual, design, best linear amplitudes, and prior
    mean less parameters.

    Maps and priors as of `EdgeMaps` and `EdgeFitter.prior`, transfers as `_shift_derivatives`
    gives them.
    """
    size = point.size
    shapes = np.dot(transfers, white)
    design = np.empty((size + LINEAR, data.size))
    design[size] = shapes[0]
    design[size + 1 :] = levels
    linear = design[size:]
    normal = np.dot(linear, linear.T)
    for k in range(LINEAR):
        normal[k, k] += precision[size + k]
    amplitude = np.linalg.solve(normal, np.dot(linear, data))
    residual = data - np.dot(amplitude, linear)
    design[:size] = shapes[1:] * amplitude[0]
    off = mean - np.concatenate((point, amplitude))
    curvature = np.dot(design, design.T)
    for k in range(off.size):
        curvature[k, k] += precision[k]
    cost = np.dot(residual, residual) + np.sum(off * off * precision)
    return (
        cost,
        np.dot(design, residual) + off * precision,
        curvature,
        residual,
        design,
        amplitude,
        off,
    )


def scaled_normal(design: Array, precision: Array, ridge: float) -> tuple[Array, Array]:
    """Return the normal matrix of all parameters in units of its roots, raised by a ridge, and
    these roots.
    """
    normal = design @ design.T + np.diag(precision)
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    return normal / np.outer(scale, scale) + ridge * np.eye(scale.size), scale


def ln_evidence_nearby(at: LinearisedProfile, precision: Array) -> float:
    """Return ln of the evidence of a linear model under another prior of the slopes, up to what all
    priors share.
    """
    normal, scale = scaled_normal(at.design, precision, 1e-9)
    pull = (at.design @ at.residual + precision * at.off) / scale
    cost = at.residual @ at.residual + precision @ at.off**2 - pull @ np.linalg.solve(normal, pull)
    volume = np.linalg.slogdet(normal)[1] + 2.0 * np.sum(np.log(scale))
    return float(-0.5 * (cost + volume - np.sum(np.log(precision[-2:]))))


def chi2_explained(at: LinearisedProfile, more: Array | None = None) -> float:
    """Return how much of chi squared a linear model explains, with further whitened shapes if any,
    (shape, bin).
    """
    more = np.zeros((0, at.residual.size)) if more is None else more
    none, design = np.zeros(len(more)), np.concatenate([at.design, more])
    off, precision = np.concatenate([at.off, none]), np.concatenate([at.precision, none])
    normal, scale = scaled_normal(design, precision, 1e-12)
    pull = (design @ at.residual + precision * off) / scale
    return float(pull @ np.linalg.solve(normal, pull))
