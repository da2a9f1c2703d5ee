"""Fits of blur models to an edge profile by Gauss-Newton, with their evidence (Laplace)."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dtrmm  # pyright: ignore[reportAttributeAccessIssue]
from scipy.linalg.lapack import dpotrf, dtrtri  # pyright: ignore[reportAttributeAccessIssue]

from charact.mtf.blur_models.model_jacobian import Tables, kind_of, tables
from charact.mtf.blur_models.one_dimensional import BlurModel
from charact.mtf.edge.checks import FittedProfile
from charact.mtf.edge.fit.esf_from_mtf import edge_weights, nodes
from charact.mtf.edge.fit.gauss_newton import (
    LARGEST_TURN_PX,
    LINEAR,
    covariance_and_ln_volume,
    gauss_newton,
    linearise,
    ln_evidence_nearby,
    transfer_and_jacobian,
)
from charact.mtf.edge.fit.sufficient_statistics import Marginal, apply_phases
from charact.mtf.edge.nonlinearity import CurvatureEstimate, response_curvature
from charact.mtf.edge.pixels.profile import EdgeProfile
from charact.mtf.edge.thresholds import ACCURACY
from charact.mtf.known_transfer import KnownTransfer

Array = NDArray[np.float64]

Complex = NDArray[np.complex128]


class EdgeMaps:
    """Linear maps from a transfer at the nodes to the bins of a profile.

    Parameters
    ----------
    profile
        The measured profile with the covariance of its bins.
    known
        Known part of the transfer: aperture and video filter.
    """

    def __init__(self, profile: EdgeProfile, known: KnownTransfer) -> None:
        self.grid = nodes(fine=profile.gathered.half_width_px > 24.0)
        self.fixed = known(self.grid)
        self.root = _inverse_root(profile.covariance)
        self.data = self.root @ profile.value
        self.white_levels = self.root @ profile.levels
        self._profile = profile
        self._build_around(0.0)

    def _build_around(self, shift_px: float) -> None:
        self._centre = shift_px
        even, odd = edge_weights(self.grid, self._profile.distance - shift_px, self._profile.spread_px)
        plain = np.concatenate([even, odd], axis=1)
        self.plain_map = np.ascontiguousarray(plain.T)
        # Half the work of a product: the root is a triangle.
        self._white = np.ascontiguousarray(dtrmm(1.0, self.root, plain.T, side=1, lower=1, trans_a=1))
        fixed = np.stack([self.fixed.real, self.fixed.imag])
        levels = np.ascontiguousarray(self.white_levels.T)
        self.compiled = (self.grid, fixed, shift_px, self._white, levels, self.data)

    def rebuild_for(self, shift_px: float) -> None:
        """Make the maps anew where they do not serve a shift."""
        if abs(shift_px - self._centre) > LARGEST_TURN_PX:
            self._build_around(shift_px)

    @cached_property
    def power(self) -> float:
        """Chi squared of a level alone."""
        level = self.white_levels[:, :1]
        return float(self.data @ self.data - (level[:, 0] @ self.data) ** 2 / (level[:, 0] @ level[:, 0]))

    def shift_transfers(self, modulus: Array, shift_px: float) -> Complex:
        """Return transfers of spreads at a shift, shape (n, node), their known part included."""
        self.rebuild_for(shift_px)
        return modulus * (self.fixed * np.exp(-2j * np.pi * (shift_px - self._centre) * self.grid))

    def likelihood(self, level_precision: Array) -> Callable[[Array, Array], Array]:
        """Return ln of the likelihood of transfers, shape (n, node), and shifts, shape (n,), px.

        Parameters
        ----------
        level_precision
            Precision of the priors of level and slopes, which are marginalised, DN^-2; 0 for a free one.
        """
        grid, fixed, centre_px, white, levels, data = self.compiled
        marginal = Marginal(white, levels, data, level_precision, self._profile.step)

        def likelihood(modulus: Array, shift_px: Array) -> Array:
            return marginal.log_likelihood(apply_phases(modulus, np.multiply.outer(shift_px - centre_px, grid), fixed))

        return likelihood

    def white(self, transfer: Complex) -> Array:
        """Return whitened edge spreads less one half, shape (n, node) -> (n, bin)."""
        return _real_and_imaginary(transfer) @ self._white


def _inverse_root(covariance: Array) -> Array:
    """Return the inverse of the Cholesky root, a lower triangle."""
    root, failed = dpotrf(covariance.T, lower=1, clean=1)
    if failed:
        raise np.linalg.LinAlgError("the covariance of the bins is not positive definite")
    return dtrtri(root, lower=1)[0]


def _real_and_imaginary(transfer: Complex) -> Array:
    return np.concatenate([transfer.real, transfer.imag], axis=1)


# Half frequencies among which the first guess is taken, cycles per pixel.
GUESSES = np.exp(np.linspace(np.log(0.01), np.log(1.8), 40))
# So many points at a time: transfers of more do not stay in the processor's cache, and take twice as long.
BLOCK = 512


@dataclass(frozen=True, kw_only=True)
class BlurModelFit:
    """A form fitted to a profile.

    Parameters
    ----------
    family
        The form.
    point, covariance
        Shift of the edge, px, and the form's parameters at the peak of the posterior; the inverse of the curvature
        there, levels, step and slopes marginalised.
    amplitude
        Step, level and both ways of slopes at the peak, DN and DN per px.
    residual, design
        What is left of the data and the change of the model with every parameter and level, both whitened,
        shape (bin,) and (parameter + level, bin).
    off, precision
        Mean of the Gaussian part of every parameter's prior less the parameter, and its precision; levels last.
    log_evidence
        ln of the evidence by Laplace's approximation, up to what all forms share.
    cost
        -2 ln of likelihood and Gaussian priors at the peak.
    chi2, free
        Chi squared at the peak, and the bins less the parameters.
    slope_sd_per_px
        Prior of the illumination's slopes, share of the step per px.
    ln_weight
        ln of the form's probability before the data over that of a core alone; part of the evidence.
    """

    family: BlurModel
    point: Array
    covariance: Array
    amplitude: Array
    residual: Array
    design: Array
    off: Array
    precision: Array
    log_evidence: float
    cost: float
    chi2: float
    free: int
    slope_sd_per_px: float
    ln_weight: float

    @property
    def noise_scale(self) -> float:
        """Variance that the bins show over what their noise was estimated to be, at least 1.

        Both the noise and the form are known imperfectly; intervals widen by the root of it (Birge 1932,
        doi 10.1103/PhysRev.40.207).
        """
        return max(1.0, self.chi2 / self.free)


# Point, and the model there as `linearised` gives it.
Reached = tuple[Array, tuple]


class BlurModelFitter:
    """Fits forms to one profile; what all fits share is made once.

    Parameters
    ----------
    profile
        The measured profile with the covariance of its bins.
    known
        Known part of the transfer: aperture and video filter.
    """

    def __init__(self, profile: EdgeProfile, known: KnownTransfer) -> None:
        self.profile = profile
        self.maps = EdgeMaps(profile, known)
        self._priors: dict[tuple[BlurModel, float], tuple[Array, Array]] = {}

    @property
    def power(self) -> float:
        """Chi squared of a level alone."""
        return self.maps.power

    def guess(self) -> float:
        """Return the half frequency at which a form between lens and tube fits best."""
        family = BlurModel(core="exponential")
        points = np.stack([np.zeros_like(GUESSES), np.log(GUESSES), np.full_like(GUESSES, 1.6)], axis=1)
        white = self.maps.white(self.maps.shift_transfers(family.modulus(points[:, 1:], self.maps.grid), 0.0))
        level = self.maps.white_levels[:, 0] / np.linalg.norm(self.maps.white_levels[:, 0])
        white = white - np.outer(white @ level, level)
        overlap = white @ self.maps.data
        return float(GUESSES[int(np.argmax(overlap**2 / np.sum(white**2, axis=1)))])

    def fit(self, family: BlurModel, start: Array, slope_sd_per_px: float, ln_weight: float = 0.0) -> BlurModelFit:
        """Fit a form from a starting point (shift and the form's parameters)."""
        point, here = self.optimise(family, start, slope_sd_per_px, ACCURACY.fit_iterations)
        return self._fit_at(family, point, here, slope_sd_per_px, ln_weight)

    def optimise(self, family: BlurModel, start: Array, slope_sd_per_px: float, iterations: int) -> Reached:
        """Return where so many steps lead from a starting point, and the model there."""
        kind, bounds, prior = kind_of(family), self.bounds(family), self._prior(family, slope_sd_per_px)
        point, damping = np.clip(start, bounds[:, 0], bounds[:, 1]), ACCURACY.first_damping
        while True:
            self.maps.rebuild_for(float(point[0]))
            point, damping, iterations, here, beyond = gauss_newton(
                kind, point, damping, iterations, bounds, prior, self.maps.compiled, _tables(family)
            )
            if not beyond.size or iterations <= 0:
                return point, here
            # The next step leaves the maps: it is tried on others.
            iterations -= 1
            better = self._linearise(family, beyond, prior)[-1] <= here[-1]
            point, damping = (beyond, 0.1 * damping) if better else (point, 30.0 * damping)

    def _linearise(self, family: BlurModel, point: Array, prior: tuple[Array, Array]) -> tuple:
        """Return the model at a point, on maps that serve there."""
        _, _, _, white, levels, data = self.maps.compiled
        return linearise(self._transfer_and_jacobian(family, point), point, white, levels, data, *prior)

    def _transfer_and_jacobian(self, family: BlurModel, point: Array) -> Array:
        """Return the transfer at a point and its slopes, real and imaginary parts side by side."""
        self.maps.rebuild_for(float(point[0]))
        grid, fixed, centre_px, *_ = self.maps.compiled
        return transfer_and_jacobian(kind_of(family), point, centre_px, grid, fixed, _tables(family))

    def _prior(self, family: BlurModel, slope_sd_per_px: float) -> tuple[Array, Array]:
        """Return mean and precision of the Gaussian part of every parameter's prior, linear ones last."""
        if (family, slope_sd_per_px) not in self._priors:
            mean, precision = family.prior_precision()
            slopes = 1.0 / self.profile.slopes_sd(slope_sd_per_px) ** 2
            self._priors[family, slope_sd_per_px] = (
                np.concatenate([[0.0], mean, np.zeros(LINEAR)]),
                np.concatenate([[0.0], precision, [0.0, 0.0], slopes]),
            )
        return self._priors[family, slope_sd_per_px]

    def _fit_at(
        self, family: BlurModel, point: Array, here: tuple, slope_sd_per_px: float, ln_weight: float
    ) -> BlurModelFit:
        residual, design, amplitude, _, cost = here
        mean, precision = self._prior(family, slope_sd_per_px)
        off = mean - np.concatenate([point, amplitude])
        covariance, log_volume = covariance_and_ln_volume(design, precision, point, self.bounds(family))
        return BlurModelFit(
            family=family,
            point=point,
            covariance=covariance,
            amplitude=amplitude,
            residual=residual,
            design=design,
            off=off,
            precision=precision,
            log_evidence=-0.5 * cost + _flat(family) + log_volume + ln_weight,
            cost=cost,
            chi2=float(residual @ residual),
            free=max(residual.size - point.size - 2, 1),
            slope_sd_per_px=slope_sd_per_px,
            ln_weight=ln_weight,
        )

    def bounds(self, family: BlurModel) -> Array:
        """Return the bounds of shift and form, shape (parameter, 2)."""
        return _bounds(family)

    def under(self, fit: BlurModelFit, slope_sd_per_px: float) -> BlurModelFit:
        """Return a fit under another prior of the slopes of the light, its evidence to first order, its point as is."""
        if slope_sd_per_px == fit.slope_sd_per_px:
            return fit
        _, precision = self._prior(fit.family, slope_sd_per_px)
        other, own = (ln_evidence_nearby(fit.residual, fit.design, fit.off, one) for one in (precision, fit.precision))
        return replace(
            fit,
            precision=precision,
            slope_sd_per_px=slope_sd_per_px,
            log_evidence=fit.log_evidence + other - own,
        )

    def spread_of(self, fit: BlurModelFit) -> Array:
        """Return the fitted edge spread less one half at the bins, and its change with each parameter, those after."""
        return self._transfer_and_jacobian(fit.family, fit.point) @ self.maps.plain_map

    def model_of(self, fit: BlurModelFit) -> Array:
        """Return the fitted profile at the bins, DN."""
        return self.spread_of(fit)[0] * fit.amplitude[0] + self.profile.levels @ fit.amplitude[1:]

    def side_slopes(self, fit: BlurModelFit) -> Array:
        """Return the fitted slopes of the light on the bright and on the dark side, DN per px."""
        return self.profile.light.by_side(fit.amplitude)[-2:]

    def fitted(self, fit: BlurModelFit) -> FittedProfile:
        """Return a fit as the checks of edges look at it."""
        return FittedProfile(model=self.model_of(fit), amplitude=fit.amplitude, chi2=fit.chi2, free=fit.free)

    def response_curvature(self, fit: BlurModelFit) -> CurvatureEstimate:
        """Return the curvature of the response that the profile asks for, and its error.

        Every parameter of the form may move by five of its deviations.
        """
        spread, *changes = self.spread_of(fit)
        sd = np.sqrt(np.diag(fit.covariance))
        most = np.concatenate([[ACCURACY.max_shift_px], 5.0 * sd[1:]])
        shape_sd = np.array([np.inf, *self.profile.slopes_sd(fit.slope_sd_per_px)])
        tangents = np.array(changes) * most[:, None]
        return response_curvature(self.profile, self.maps.root, spread, tangents, self.profile.levels, shape_sd)

    def log_probability(self, family: BlurModel, slope_sd_per_px: float) -> Callable[[Array], Array]:
        """Return the log-probability of shift and form, vectorised, step, levels and slopes marginalised."""
        low, high = self.bounds(family)[0]
        likelihood = self.maps.likelihood(self._prior(family, slope_sd_per_px)[1][-LINEAR + 1 :])

        def of_block(theta: Array) -> Array:
            value = family.log_prior(theta[:, 1:])
            inside = np.isfinite(value) & (theta[:, 0] >= low) & (theta[:, 0] <= high)
            value[~inside] = -np.inf
            if inside.any():
                used = theta[inside]
                value[inside] += likelihood(family.modulus(used[:, 1:], self.maps.grid), used[:, 0])
            return value

        def log_probability(theta: Array) -> Array:
            blocks = [theta[first : first + BLOCK] for first in range(0, max(len(theta), 1), BLOCK)]
            return np.concatenate([of_block(block) for block in blocks])

        return log_probability


def _tables(family: BlurModel) -> Tables:
    return tables(pupils=family.core == "pupil")


@lru_cache(maxsize=256)
def _bounds(family: BlurModel) -> Array:
    bounds = np.concatenate([[[-ACCURACY.max_shift_px, ACCURACY.max_shift_px]], family.bounds])
    bounds.flags.writeable = False
    return bounds


@lru_cache(maxsize=256)
def _flat(family: BlurModel) -> float:
    """Return ln of the prior's density less its Gaussian part, the same wherever the bounds allow."""
    middle = np.clip(family.prior_precision()[0], *family.bounds.T)
    return float(family.log_prior(middle[None])[0])
