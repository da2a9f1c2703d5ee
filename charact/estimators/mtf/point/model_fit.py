"""Fit of blur models to a point, with their evidence."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import erfcx, log_ndtr

from charact.estimators.mtf.point.blur_models_2d import BlurModel2D
from charact.inference.gauss_newton import (
    Linearisation,
    covariance_at,
    least_squares,
    linearise_residual,
    ln_evidence,
)
from labdata import Array


@dataclass(frozen=True, kw_only=True)
class Censored:
    """Pixels that are clipped in at least one frame."""

    # From a transfer at the nodes to their height at unit light, background and position at their
    # optimum for the other pixels, shape (pixel, node)
    matrix: Array
    limit: Array  # Full scale above the background, shape (pixel,), DN
    sd: Array  # Standard deviation of one frame, shape (pixel,), DN
    # cut, left: number of frames in which the pixel is clipped, and is not, shape (pixel,)
    cut: Array
    n_unclipped: Array
    mean: Array  # Mean of the latter above the background, shape (pixel,), DN

    def terms(self, height: Array) -> tuple[Array, Array, Array]:
        """Return slope and minus curvature of ln likelihood, each pixel's, and its sum, for heights
        (n, pixel).

        Notes
        -----
        ln L = k ln Phi((h - c)/s) - (n - k) (v - h)^2 / (2 s^2): k of n frames are clipped at c,
        the mean of the others is v.
        """
        z = (height - self.limit) / self.sd
        log_tail = log_ndtr(z)
        # Inverse Mills ratio phi/Phi, about -z far below the limit, where its curvature is 1 to
        # rounding.
        mills = np.sqrt(2.0 / np.pi) / erfcx(-z / np.sqrt(2.0))
        bend = np.where(z < -1e4, 1.0, mills * (mills + z))
        off = (self.mean - height) / self.sd
        slope = (self.cut * mills + self.n_unclipped * off) / self.sd
        curvature = (self.cut * bend + self.n_unclipped) / self.sd**2
        return (
            slope,
            curvature,
            np.sum(self.cut * log_tail - 0.5 * self.n_unclipped * off**2, axis=-1),
        )

    def lights(
        self, overlap: Array, curvature: Array, hidden: Array, start: Array
    ) -> tuple[Array, Array]:
        """Return the most probable lights by Newton's method, and the curvature there, shape (n,).

        `overlap`, `curvature`: of the other pixels' images with their values and with themselves;
        `hidden`: image of the clipped ones, shape (n, pixel).
        """
        light = np.maximum(start, 1e-12)
        bend = curvature
        for _ in range(25):
            slope, weight, _ = self.terms(light[:, None] * hidden)
            bend = curvature + np.sum(weight * hidden**2, axis=1)
            step = (overlap - light * curvature + np.sum(slope * hidden, axis=1)) / np.maximum(
                bend, 1e-300
            )
            # The logarithm is concave: long steps are only shortened.
            light = light + np.clip(step, -0.5 * light, light)
            if np.all(np.abs(step) < 1e-9 * light):
                break
        return light, bend


@dataclass(frozen=True, kw_only=True)
class WhitenedPixels:
    """Whitened pixels of one source, position and other linear parameters but the light
    marginalised.
    """

    data: Array  # Whitened values, shape (value,)
    matrix: Array  # From a transfer at the nodes to them at unit light, shape (value, node)
    free: int  # Values less linear parameters
    # root, basis: inverse root of the covariance, and marginalised whitened directions, shape
    # (value, direction)
    root: Array
    basis: Array
    rounding: Array  # Part of the covariance by quantisation, shape (value, value), DN^2
    censored: Censored | None = None  # Clipped pixels; None: none

    def whiten(self, columns: Array) -> Array:
        """Return columns (value, column) whitened, without the marginalised directions."""
        white = self.root @ columns
        return white - self.basis @ (self.basis.T @ white)


@dataclass(frozen=True, kw_only=True)
class BlurModelFit2D:
    """A blur model fitted to a point."""

    form: BlurModel2D  # The blur model
    # point, covariance: optimum of the posterior and the inverse curvature there; light, position
    # and background marginalised
    point: Array
    covariance: Array
    light: float  # Light of the source, DN px^2
    # ln evidence by Laplace's approximation, up to a constant common to all models
    log_evidence: float
    cost: float  # -2 ln of likelihood and Gaussian priors at the optimum
    # chi2, free: chi squared of the pixels below full scale, and its degrees of freedom
    chi2: float
    free: int


class _Source(NamedTuple):
    """One source at its most probable light; clipped pixels enter as weighted pseudo-residuals."""

    light: float
    unit: Array
    slopes: Array
    residual: Array
    chi2: float
    cost: float

    @property
    def curvature(self) -> float:
        return max(float(self.unit @ self.unit), 1e-300)


class PointFitter:
    """Fits blur models to the pixels of a point."""

    def __init__(self, pixels: WhitenedPixels) -> None:
        self.pixels = pixels

    def fit(self, form: BlurModel2D, start: Array, *, iterations: int = 40) -> BlurModelFit2D:
        """Fit a model from starting values."""
        bounds = form.bounds
        point, optimum = least_squares(
            lambda theta: self._linearise(form, theta),
            start,
            bounds,
            iterations=iterations,
            relative_tolerance=1e-8,
        )
        source: _Source = optimum.model
        covariance = covariance_at(optimum.normal, bounds)
        height = -0.5 * optimum.cost + form.ln_volume - 0.5 * float(np.log(source.curvature))
        return BlurModelFit2D(
            form=form,
            point=point,
            covariance=covariance,
            light=source.light,
            log_evidence=ln_evidence(height, covariance, point, bounds, optimum.gradient),
            cost=optimum.cost,
            chi2=source.chi2,
            free=max(self.pixels.free - point.size - 1, 1),
        )

    def _linearise(self, form: BlurModel2D, point: Array) -> Linearisation:
        """Return cost, gradient and curvature at a point, the light at its optimum."""
        source = _source(self.pixels, *_moved_nodes(form, point))
        mean, precision = form.prior_precision
        fitted = np.outer(source.unit, source.unit @ source.slopes) / source.curvature
        design = source.light * (source.slopes - fitted)
        model = linearise_residual(source.residual, design.T, mean - point, precision, source)
        pull = float((point - mean) ** 2 @ precision)
        return model._replace(cost=pull + source.cost)

    def beyond(self, fit: BlurModelFit2D, columns: Array) -> tuple[Array, Array]:
        """Return the residual, shape (value,), and further whitened columns of unit length, shape
        (value, column), without the directions that light and parameters of a fit take.
        """
        unit, slopes = _unit_and_slopes(self.pixels.matrix, *_moved_nodes(fit.form, fit.point))
        basis = orthonormal(_of_unit_length(np.concatenate([unit[:, None], slopes], axis=1)))
        residual, more = self.pixels.data - fit.light * unit, _of_unit_length(columns)
        return residual - basis @ (basis.T @ residual), more - basis @ (basis.T @ more)

    def log_probability(self, form: BlurModel2D, theta: Array) -> Array:
        """Return ln posterior with light, position and background marginalised, shape (n,)."""
        value = form.log_prior(theta)
        in_bounds = np.isfinite(value)
        if in_bounds.any():
            value[in_bounds] += _log_likelihood(self.pixels, form.nodes(theta[in_bounds]))
        return value


def _log_likelihood(pixels: WhitenedPixels, nodes: Array) -> Array:
    """Return ln likelihood of one source for transfers (n, node), its light marginalised, shape
    (n,).
    """
    unit = nodes @ pixels.matrix[:, : nodes.shape[1]].T
    overlap, curvature = unit @ pixels.data, np.maximum(np.einsum("nv,nv->n", unit, unit), 1e-300)
    if pixels.censored is None:
        return 0.5 * overlap**2 / curvature - 0.5 * np.log(curvature)
    hidden = nodes @ pixels.censored.matrix[:, : nodes.shape[1]].T
    light, bend = pixels.censored.lights(overlap, curvature, hidden, overlap / curvature)
    # The light is marginalised by Laplace's approximation.
    value = pixels.censored.terms(light[:, None] * hidden)[2] - 0.5 * np.log(
        np.maximum(bend, 1e-300)
    )
    return overlap * light - 0.5 * curvature * light**2 + value


def _source(pixels: WhitenedPixels, nodes: Array, moves: Array) -> _Source:
    """Return a source from transfers at a point and displaced by each parameter, shape (1 +
    parameter, node).
    """
    data, censored = pixels.data, pixels.censored
    unit, slopes = _unit_and_slopes(pixels.matrix, nodes, moves)
    light = float(data @ unit) / max(float(unit @ unit), 1e-300)
    if censored is None:
        chi2 = float((data - light * unit) @ (data - light * unit))
        return _Source(light, unit, slopes, data - light * unit, chi2, chi2)
    hidden, hidden_slopes = _unit_and_slopes(censored.matrix, nodes, moves)
    start, overlap, curvature = np.array([[light], [unit @ data], [unit @ unit]])
    light = float(censored.lights(overlap, curvature, hidden[None], start)[0][0])
    residual = data - light * unit
    pull, weight, height = (part[0] for part in censored.terms(light * hidden[None]))
    weight = np.maximum(weight, 1e-12 / censored.sd**2)
    root, chi2 = np.sqrt(weight), float(residual @ residual)
    return _Source(
        light=light,
        unit=np.append(unit, root * hidden),
        slopes=np.concatenate([slopes, root[:, None] * hidden_slopes]),
        residual=np.append(residual, pull / root),
        chi2=chi2,
        cost=chi2 - 2.0 * float(height),
    )


def orthonormal(columns: Array) -> Array:
    """Return an orthonormal basis of columns of like lengths, (value, column) -> (value,
    direction).
    """
    basis, values, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(basis[:, values > 1e-6 * values[0]], np.float64)


def _of_unit_length(columns: Array) -> Array:
    return columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)


def _moved_nodes(form: BlurModel2D, point: Array) -> tuple[Array, Array]:
    """Return transfers at a point and displaced by each parameter, shape (1 + parameter, node), and
    the displacements: inwards, to stay within the bounds.
    """
    bounds = form.bounds
    moves = np.where(point > bounds.mean(axis=1), -1.0, 1.0) * 1e-5 * np.ptp(bounds, axis=1)
    return form.nodes(np.concatenate([point[None], point + np.diag(moves)])), moves


def _unit_and_slopes(matrix: Array, nodes: Array, moves: Array) -> tuple[Array, Array]:
    """Return pixels at unit light and their derivatives, shapes (pixel,) and (pixel, parameter)."""
    shapes = matrix[:, : nodes.shape[1]] @ nodes.T
    return shapes[:, 0], (shapes[:, 1:] - shapes[:, :1]) / moves
