"""Fitting forms of the point spread to an edge's profile: each form by Gauss-Newton, all weighed by their evidence."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.mtf.edge_checks import response_curvature
from charact.mtf.edge_maps import EdgeMaps
from charact.mtf.edge_profile import Profile
from charact.mtf.evidence import Evidence
from charact.mtf.families import Family, Wide
from charact.mtf.optics import Known

Array = NDArray[np.float64]

Departures = Callable[[Array, float], NDArray[np.complex128]]

SHIFT_PX = 6.0
# Half frequencies among which the first guess is taken, cycles per pixel.
GUESSES = np.exp(np.linspace(np.log(0.01), np.log(1.8), 40))
ITERATIONS = 30
# Steps after which one of several starts is chosen.
FIRST_ITERATIONS = 5
# Gain in -2 ln of the posterior from which on a step is not worth another.
SETTLED = 2e-3
# A parameter's finite difference, share of the width of its bounds.
DIFFERENCE = 1e-5
LINEAR = 4  # step, level and a slope on either side


@dataclass(frozen=True, kw_only=True)
class FamilyFit:
    """A form fitted to a profile.

    Parameters
    ----------
    family
        The form.
    point, covariance
        Shift of the edge, px, and the form's parameters at the peak of the posterior; the inverse of the curvature
        there, levels, step and slopes marginalised.
    amplitude
        Step, level and slopes at the peak, DN and DN per px.
    model
        Profile at the bins, DN.
    tangents
        Change of the profile with each parameter, shape (parameter, bin), DN.
    residual, design
        What is left of the data and the change of the model with every parameter and level, both whitened,
        shape (bin,) and (bin, parameter + level).
    log_evidence
        ln of the evidence by Laplace's approximation, up to what all forms share.
    cost
        -2 ln of likelihood and Gaussian priors at the peak.
    chi2, free
        Chi squared at the peak, and the bins less the parameters.
    slope_sd_per_px
        Prior of the illumination's slopes, share of the step per px.
    """

    family: Family
    point: Array
    covariance: Array
    amplitude: Array
    model: Array
    tangents: Array
    residual: Array
    design: Array
    log_evidence: float
    cost: float
    chi2: float
    free: int
    slope_sd_per_px: float

    @property
    def noise_scale(self) -> float:
        """Variance that the bins show over what their noise was estimated to be, at least 1.

        Both the noise and the form are known imperfectly; intervals widen by the root of it (Birge 1932,
        doi 10.1103/PhysRev.40.207).
        """
        return max(1.0, self.chi2 / self.free)


class FamilyFitter:
    """Fits forms to one profile; what all fits share is made once.

    Parameters
    ----------
    profile
        The measured profile with the covariance of its bins.
    known
        Known part of the transfer: aperture and video filter.
    """

    def __init__(self, profile: Profile, known: Known) -> None:
        self.profile = profile
        self.maps = EdgeMaps(profile, known)
        self._evidences: dict[float, Evidence] = {}

    @property
    def power(self) -> float:
        """Chi squared of a level alone."""
        return self.maps.power

    def guess(self) -> float:
        """Return the half frequency at which a form between lens and tube fits best."""
        family = Family(core="exponential")
        points = np.stack([np.zeros_like(GUESSES), np.log(GUESSES), np.full_like(GUESSES, 1.6)], axis=1)
        white = self.maps.white(self.maps.shifted(family.modulus(points[:, 1:], self.maps.grid), 0.0))
        level = self.maps.white_levels[:, 0] / np.linalg.norm(self.maps.white_levels[:, 0])
        white = white - np.outer(white @ level, level)
        overlap = white @ self.maps.data
        return float(GUESSES[int(np.argmax(overlap**2 / np.sum(white**2, axis=1)))])

    def fit(self, family: Family, start: Array, slope_sd_per_px: float) -> FamilyFit:
        """Fit a form from a starting point (shift and the form's parameters)."""
        point, here = self._climbed(family, start, slope_sd_per_px, ITERATIONS)
        return self._fitted(family, point, here, self.bounds(family), slope_sd_per_px)

    def _climbed(
        self, family: Family, start: Array, slope_sd_per_px: float, iterations: int
    ) -> tuple[Array, "_Linearised"]:
        """Return where so many steps lead from a starting point, and the model there."""
        bounds = self.bounds(family)
        prior = self._prior(family, slope_sd_per_px)
        point, damping = np.clip(start, bounds[:, 0], bounds[:, 1]), 1e-3
        here = self._linearised(family, point, bounds, prior)
        for _ in range(iterations):
            step = _solved(here, point, bounds, damping)
            trial = np.clip(point + step, bounds[:, 0], bounds[:, 1])
            there = self._linearised(family, trial, bounds, prior)
            gain = here.cost - there.cost
            if gain >= 0:
                point, here, damping = trial, there, max(damping * 0.1, 1e-9)
                if gain < SETTLED:
                    break
            else:
                damping = damping * 30.0
                if damping > 1e9:
                    break
        return point, here

    def _prior(self, family: Family, slope_sd_per_px: float) -> tuple[Array, Array]:
        """Return mean and precision of the Gaussian part of every parameter's prior, linear ones last."""
        mean, precision = family.prior_precision()
        scale = max(abs(self.profile.step), 1e-300)
        slopes = np.full(2, 1.0 / (slope_sd_per_px * scale) ** 2)
        return (
            np.concatenate([[0.0], mean, np.zeros(LINEAR)]),
            np.concatenate([[0.0], precision, [0.0, 0.0], slopes]),
        )

    def _transfers(self, family: Family, point: Array, bounds: Array) -> NDArray[np.complex128]:
        """Return the transfer at a point, its change with each of the form's parameters, and with the shift."""
        # Differences run inwards, so that they stay within the bounds.
        sign = np.where(point[1:] > bounds[1:].mean(axis=1), -1.0, 1.0)
        moves = sign * DIFFERENCE * (bounds[1:, 1] - bounds[1:, 0])
        forms = np.concatenate([point[None, 1:], point[1:] + np.diag(moves)])
        transfer = self.maps.shifted(family.modulus(forms, self.maps.grid), float(point[0]))
        transfer[1:] = (transfer[1:] - transfer[:1]) / moves[:, None]
        return self.maps.with_shift_slope(transfer)

    def _linearised(self, family: Family, point: Array, bounds: Array, prior: tuple[Array, Array]) -> "_Linearised":
        """Return the model at a point with the best linear parameters, and its tangents, whitened."""
        transfer = self._transfers(family, point, bounds)
        white = self.maps.white(transfer).T
        linear = np.concatenate([white[:, :1], self.maps.white_levels], axis=1)
        tangents = np.concatenate([white[:, -1:], white[:, 1:-1]], axis=1)
        mean, precision = prior
        normal = linear.T @ linear
        normal.flat[:: LINEAR + 1] += precision[-LINEAR:]
        amplitude = np.asarray(np.linalg.solve(normal, linear.T @ self.maps.data), float)
        residual = self.maps.data - linear @ amplitude
        off = point - mean[: point.size]
        cost = float(residual @ residual + off**2 @ precision[: point.size] + amplitude**2 @ precision[-LINEAR:])
        return _Linearised(
            residual=residual,
            design=np.concatenate([tangents * amplitude[0], linear], axis=1),
            transfer=transfer,
            amplitude=amplitude,
            pull=-np.concatenate([off, amplitude]) * precision,
            precision=precision,
            cost=cost,
        )

    def _fitted(self, family: Family, point: Array, here: "_Linearised", bounds: Array, slope: float) -> FamilyFit:
        normal = here.design.T @ here.design + np.diag(here.precision)
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        inverse = np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-12, hermitian=True) / np.outer(scale, scale)
        covariance = inverse[: point.size, : point.size]
        # A parameter that the data do not feel spreads over its bounds.
        widest = (bounds[:, 1] - bounds[:, 0]) / np.sqrt(12.0)
        shrink = np.minimum(1.0, widest / np.sqrt(np.maximum(np.diag(covariance), 1e-300)))
        covariance = covariance * np.outer(shrink, shrink)
        log_linear = -0.5 * np.linalg.slogdet(normal[point.size :, point.size :])[1]
        log_linear += 0.5 * np.sum(np.log(here.precision[-2:]))
        log_volume = 0.5 * np.linalg.slogdet(2.0 * np.pi * covariance)[1] + np.log(_inside(point, covariance, bounds))
        mean, precision = family.prior_precision()
        flat = float(family.log_prior(point[None, 1:])[0]) + 0.5 * float((point[1:] - mean) ** 2 @ precision)
        chi2 = float(here.residual @ here.residual)
        plain = self.maps.plain(here.transfer)
        return FamilyFit(
            family=family,
            point=point,
            covariance=covariance,
            amplitude=here.amplitude,
            model=plain[0] * here.amplitude[0] + self.maps.levels @ here.amplitude[1:],
            tangents=np.concatenate([plain[-1:], plain[1:-1]]) * here.amplitude[0],
            residual=here.residual,
            design=here.design,
            log_evidence=float(-0.5 * here.cost + flat + log_linear + log_volume),
            cost=here.cost,
            chi2=chi2,
            free=max(len(self.maps.data) - point.size - 2, 1),
            slope_sd_per_px=slope,
        )

    def bounds(self, family: Family) -> Array:
        """Return the bounds of shift and form, shape (parameter, 2)."""
        return np.concatenate([[[-SHIFT_PX, SHIFT_PX]], family.bounds])

    def slope_gain(self, fit: FamilyFit, slope_sd_per_px: float) -> float:
        """Return what ln of the evidence gains from another prior of the illumination's slopes, to first order."""
        return self._nearby(fit, slope_sd_per_px) - self._nearby(fit, fit.slope_sd_per_px)

    def _nearby(self, fit: FamilyFit, slope_sd_per_px: float) -> float:
        """Return ln of the evidence of the model made linear at a fit, up to what all priors of the slopes share."""
        mean, precision = self._prior(fit.family, slope_sd_per_px)
        off = mean - np.concatenate([fit.point, fit.amplitude])
        normal = fit.design.T @ fit.design + np.diag(precision)
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        normal = normal / np.outer(scale, scale) + 1e-9 * np.eye(scale.size)
        pull = (fit.design.T @ fit.residual + precision * off) / scale
        cost = fit.residual @ fit.residual + precision @ off**2 - pull @ np.linalg.solve(normal, pull)
        volume = np.linalg.slogdet(normal)[1] + 2.0 * np.sum(np.log(scale))
        return float(-0.5 * (cost + volume - np.sum(np.log(precision[-2:]))))

    def fit_wide(self, core: FamilyFit, wide: Wide, worth_chi2: float, hopeless_cost: float) -> FamilyFit | None:
        """Fit a core with light beyond it, from several sizes.

        Parameters
        ----------
        worth_chi2
            Gain in chi squared, to first order, below which no fit is tried.
        hopeless_cost
            Cost of a fit begun beyond which it is given up.

        Returns
        -------
        FamilyFit or None
            The best fit; None where it was not tried or given up.
        """
        gains, starts = self._wide_starts(core, wide)
        order = np.argsort(-gains)
        if gains[order[0]] < worth_chi2:
            return None
        family, slope = Family(core=core.family.core, wide=wide), core.slope_sd_per_px
        # The best size, and the best of those that are far from it.
        apart = [
            i for i in order if abs(np.log(starts[i][-wide.after_size] / starts[order[0]][-wide.after_size])) > 0.5
        ]
        begun = [self._climbed(family, starts[i], slope, FIRST_ITERATIONS) for i in (order[0], *apart[:1])]
        point, reached = min(begun, key=lambda one: one[1].cost)
        return None if reached.cost > hopeless_cost else self.fit(family, point, slope)

    def _wide_starts(self, fit: FamilyFit, wide: Wide) -> tuple[Array, Array]:
        """Return gains in chi squared from light beyond the core, to first order, and where to begin its fits.

        Light that would have to be taken away gains nothing.
        """
        bounds = np.array([bound for _, bound in wide.parameters.values()])
        sizes = bounds[1, 0] * (bounds[1, 1] / bounds[1, 0]) ** np.linspace(0.05, 0.95, 9)
        others = np.array([[0.1], [0.9]]) if len(bounds) > 2 else np.zeros((1, 0))
        shapes = np.array([[size, *other] for other in others for size in sizes])
        core = self.maps.shifted(fit.family.modulus(fit.point[None, 1:], self.maps.grid), float(fit.point[0]))
        away = self.maps.white(core * (wide.transfer(self.maps.grid, shapes) - 1.0))
        gains, amplitudes, change = self._gains(fit, away)
        share = np.clip(amplitudes * abs(self.profile.step) / fit.amplitude[0], 0.02, 0.3)
        share = np.minimum(share / wide.share_unit(shapes)[:, 0], bounds[0, 1])
        limits = self.bounds(fit.family)
        # Half a step of the core: what the light beyond it changes is not small.
        cores = np.clip(fit.point + 0.5 * change, limits[:, 0], limits[:, 1])
        return np.where(amplitudes * fit.amplitude[0] > 0, gains, 0.0), np.concatenate(
            [cores, share[:, None], shapes], axis=1
        )

    def departure_gain(self, fit: FamilyFit, shapes_at: Departures) -> tuple[float, int]:
        """Return the gain in chi squared from smooth departures of modulus and phase, to first order, and how many.

        Parameters
        ----------
        shapes_at
            Departures of the transfer's logarithm, complex, from frequencies and the half frequency.
        """
        transfer = self.maps.shifted(fit.family.modulus(fit.point[None, 1:], self.maps.grid), float(fit.point[0]))
        moved = self.maps.white(transfer * shapes_at(self.maps.grid, float(np.exp(fit.point[1]))))
        residual, old, new = self._whitened(fit, moved)
        both = np.linalg.qr(np.concatenate([old, new], axis=1))[0]
        return float(np.sum((residual @ both) ** 2) - np.sum((residual @ np.linalg.qr(old)[0]) ** 2)), len(moved)

    def _gains(self, fit: FamilyFit, shapes: Array) -> tuple[Array, Array, Array]:
        """Return the gain in chi squared from adding each whitened shape (shape, bin) to a fit alone, to first order.

        Also its amplitude, steps, and what it moves of the parameters, shape (shape, parameter).
        """
        residual, old, new = self._whitened(fit, shapes)
        basis, upper = np.linalg.qr(old)
        left = residual - basis @ (basis.T @ residual)
        away = new - basis @ (basis.T @ new)
        power, overlap = np.maximum(np.sum(away**2, axis=0), 1e-300), left @ away
        amplitude = overlap / power
        moved = np.linalg.solve(upper, basis.T @ (residual[:, None] - new * amplitude))
        return overlap * amplitude, amplitude, moved[: fit.point.size].T

    def _whitened(self, fit: FamilyFit, shapes: Array) -> tuple[Array, Array, Array]:
        """Return residual, columns of a fit and of whitened shapes (shape, bin) in steps, priors as further data."""
        mean, precision = self._prior(fit.family, fit.slope_sd_per_px)
        firm = np.sqrt(precision)
        off = mean - np.concatenate([fit.point, fit.amplitude])
        residual = np.concatenate([fit.residual, firm * off])
        # A parameter that the data do not feel keeps the columns apart by a trifle.
        old = np.concatenate([fit.design, np.diag(firm + 1e-9 * np.abs(fit.design).max(axis=0))])
        new = np.concatenate([shapes.T * abs(self.profile.step), np.zeros((firm.size, len(shapes)))])
        return residual, old, new

    def spread_of(self, fit: FamilyFit) -> Array:
        """Return the fitted edge spread less one half at the bins."""
        return (fit.model - self.maps.levels @ fit.amplitude[1:]) / fit.amplitude[0]

    def response_curvature(self, fit: FamilyFit) -> tuple[float, float]:
        """Return the curvature of the response that the profile asks for, and its error.

        Every parameter of the form may move by five of its deviations.
        """
        sd = np.sqrt(np.diag(fit.covariance))[1:, None]
        tangents = np.concatenate([fit.tangents[:1] * SHIFT_PX, fit.tangents[1:] * 5.0 * sd]) / fit.amplitude[0]
        scale = max(abs(self.profile.step), 1e-300)
        shape_sd = np.array([np.inf, fit.slope_sd_per_px * scale, fit.slope_sd_per_px * scale])
        spread, levels = self.spread_of(fit), self.maps.levels
        return response_curvature(self.profile, self.maps.root, spread, tangents, levels, shape_sd)

    def _evidence(self, slope_sd_per_px: float) -> Evidence:
        """Return what the data say under a prior of the slopes, made once for all forms."""
        if slope_sd_per_px not in self._evidences:
            self._evidences[slope_sd_per_px] = self.profile.evidence(self.maps.grid, slope_sd_per_px)
        return self._evidences[slope_sd_per_px]

    def log_probability(self, family: Family, slope_sd_per_px: float) -> Callable[[Array], Array]:
        """Return the log-probability of shift and form, vectorised, from the data kept as a few matrices."""
        evidence = self._evidence(slope_sd_per_px)
        bounds, grid, fixed = self.bounds(family), self.maps.grid, self.maps.fixed

        def log_probability(theta: Array) -> Array:
            value = family.log_prior(theta[:, 1:])
            inside = np.isfinite(value) & (theta[:, 0] >= bounds[0, 0]) & (theta[:, 0] <= bounds[0, 1])
            value[~inside] = -np.inf
            if inside.any():
                used = theta[inside]
                turned = np.exp(-2j * np.pi * used[:, :1] * grid) * fixed
                value[inside] += evidence.log_likelihood(family.modulus(used[:, 1:], grid) * turned)
            return value

        return log_probability


@dataclass(frozen=True, kw_only=True)
class _Linearised:
    residual: Array
    design: Array
    transfer: NDArray[np.complex128]
    amplitude: Array
    pull: Array
    precision: Array
    cost: float


def _solved(here: _Linearised, point: Array, bounds: Array, damping: float) -> Array:
    """Return the damped Gauss-Newton step of the parameters that are not linear, those held by a bound left out."""
    size = point.size
    gradient = here.design.T @ here.residual + here.pull
    blocked = ((point <= bounds[:, 0]) & (gradient[:size] < 0)) | ((point >= bounds[:, 1]) & (gradient[:size] > 0))
    free = np.concatenate([np.flatnonzero(~blocked), np.arange(size, size + LINEAR)])
    normal = (here.design.T @ here.design + np.diag(here.precision))[np.ix_(free, free)]
    diagonal = np.maximum(np.diag(normal), 1e-300)
    normal = normal + np.diag(damping * diagonal)
    scale = np.sqrt(diagonal)
    step = np.zeros(size + LINEAR)
    step[free] = np.linalg.solve(normal / np.outer(scale, scale) + 1e-12 * np.eye(free.size), gradient[free] / scale)
    step[free] /= scale
    return np.clip(step[:size], -0.25 * (bounds[:, 1] - bounds[:, 0]), 0.25 * (bounds[:, 1] - bounds[:, 0]))


def _inside(point: Array, covariance: Array, bounds: Array) -> float:
    """Return about the share of the Gaussian at the peak that lies inside the bounds: the rest is no evidence."""
    sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    share = _normal((bounds[:, 1] - point) / sd) - _normal((bounds[:, 0] - point) / sd)
    return float(np.prod(np.maximum(share, 1e-3)))


def _normal(z: Array) -> Array:
    """Return about the normal distribution function, within 2e-4."""
    return 1.0 / (1.0 + np.exp(-np.clip(1.5976 * z + 0.07056 * z**3, -500.0, 500.0)))
