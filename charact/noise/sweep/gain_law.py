"""Gain law along a control: ln gain is linear, with normal deviations of settings.

Settings are exchangeable: their deviations have one unknown standard deviation, so an imprecise setting shrinks towards
the law (Gelman et al., Bayesian Data Analysis, ch. 5).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.noise.thresholds import SWEEP
from charact.posterior import find_maximum, importance_sample, sample
from labdata.measurement import Posterior

Array = NDArray[np.float64]
LOG_DEPARTURE = np.log([1e-4, 0.3])


@dataclass(frozen=True, kw_only=True)
class Axis:
    """Positions of settings along a control, scaled to unit span about the centre."""

    # middle, span: centre and span of the positions
    middle: float
    span: float
    x: Array  # shape (setting,), within -1/2 and 1/2

    @classmethod
    def of(cls, place: Array) -> "Axis":
        """Return the axis of positions."""
        middle, span = 0.5 * float(place.min() + place.max()), float(np.ptp(place))
        return cls(middle=middle, span=span, x=(place - middle) / span)


@dataclass(frozen=True, kw_only=True)
class Gains:
    """Gains of all settings from noise, shape (setting,)."""

    # covariance, covariance_sd: ln of the covariance gain in DN, and its standard error
    covariance: Array
    covariance_sd: Array
    # variance, variance_sd: the same of a pixel's variance over signal; None for white noise, where both agree
    variance: Array | None = None
    variance_sd: Array | None = None


@dataclass(frozen=True, kw_only=True)
class GainLaw:
    """Posterior of the pulse part of the covariance gain, ln P = log_gain + rise x, x along the axis."""

    # draws of `log_gain` (in the middle of the axis), `rise` (from the first setting to the last), `log_departure`;
    # `log_blur`, ln of the blur factor of pulses, if noise is not white; and `electron_share` for the noise of
    # electrons
    posterior: Posterior
    pulses: Array  # draws of the pulse part of every covariance gain from its own noise, shape (draw, setting), DN
    settings: Array  # draws of every covariance gain from its noise and the law, same shape, DN
    electron_gain_dn: Array  # draws of the electron part of every covariance gain, shape (draw,), DN


def departure_prior(log_departure: Array) -> Array:
    """Return ln of the prior density of ln departure, shape (point,)."""
    return -0.5 * ((log_departure - np.log(SWEEP.departure)) / SWEEP.departure_spread) ** 2


def draw_posterior(log_probability: Callable[[Array], Array], start: Array, bounds: Array, *, names: tuple[str, ...],
               units: tuple[str, ...], seed: int, quick: bool) -> Posterior:  # fmt: skip
    """Draw from a posterior; quick by importance sampling, as few settings leave a skewed departure."""
    point, covariance = find_maximum(log_probability, start, bounds)
    method = importance_sample if quick else sample
    return method(log_probability, names=names, units=units, start=point, covariance=covariance, seed=seed,
                  bounds=bounds)  # fmt: skip


def law_of(x: Array, gains: Gains, *, share: tuple[float, float] | None, seed: int, quick: bool) -> GainLaw:
    """Fit the gain law to the gains of settings.

    `x`: positions on the axis, shape (setting,); `gains`: gains from noise; `share`: normal prior of the electron gain
    over the smallest covariance gain, mean and standard deviation; None if the control changes it.

    Covariance gain is K + P and variance over signal K + S P, P the pulse part k F^2 and S the blur factor of pulses.
    At equal blur, variances give gain ratios ten times more precisely than covariance sums. S may differ between
    settings by `SWEEP.blur_relative_sd`. ln P = log_gain + rise x + departure.
    """
    likelihood = _GainLikelihood(gains, x, share is not None)

    def log_probability(points: Array) -> Array:
        inside = np.all((points >= bounds[:, 0]) & (points <= bounds[:, 1]), axis=1)
        safe = np.where(inside[:, None], points, start)
        value = likelihood.log_likelihood(safe) + departure_prior(safe[:, 2])
        if share is not None:
            value = value - 0.5 * ((safe[:, -1] - share[0]) / share[1]) ** 2
        return np.where(inside, value, -np.inf)

    names, units, free = ["log_gain", "rise", "log_departure"], ["log DN", "1", "1"], (-np.inf, np.inf)
    limits = [free, free, tuple(LOG_DEPARTURE)]
    first = [*line_fit(x, gains.covariance, np.hypot(gains.covariance_sd, 0.02)), np.log(0.02)]
    if gains.variance is not None:
        names, units, limits = [*names, "log_blur"], [*units, "1"], [*limits, free]
        first.append(float(np.median(gains.variance - gains.covariance)))
    if share is not None:
        names, units, limits = [*names, "electron_share"], [*units, "1"], [*limits, (0.0, likelihood.most_share)]
        first.append(min(max(share[0], 0.2 * share[1]), 0.5 * likelihood.most_share))
    bounds, start = np.array(limits, float), np.array(first, float)
    posterior = without_bound_flag(
        draw_posterior(log_probability, start, bounds, names=tuple(names), units=tuple(units), seed=seed, quick=quick)
    )
    rng = np.random.default_rng([seed, 7])
    electrons = likelihood.electrons(posterior.draws)[:, 0]
    pulses, settings = likelihood.settings(posterior.draws, rng)
    if gains.variance is not None:
        common = _common_error(settings, gains.covariance_sd, rng)
        posterior = _with_common_error(posterior, common)
        pulses, settings = pulses * np.exp(common), settings * np.exp(common)
    return GainLaw(
        posterior=posterior, pulses=pulses, settings=electrons[:, None] + settings, electron_gain_dn=electrons
    )


def _common_error(settings: Array, sd: Array, rng: np.random.Generator) -> Array:
    """Return draws of a common error of all ln covariance gains, shape (draw, 1).

    All spectra are extrapolated with one blur model, whose error is common, so the mean level is no more precise than
    the best setting. Ratios are unaffected.
    """
    level_sd = float(np.std(np.log(settings).mean(axis=1)))
    return np.sqrt(max(0.0, float(sd.min()) ** 2 - level_sd**2)) * rng.standard_normal((len(settings), 1))


def _with_common_error(posterior: Posterior, common: Array) -> Posterior:
    """Return the posterior with a common error of all covariance gains; variances are unaffected."""
    draws = posterior.draws.copy()
    for name, sign in (("log_gain", 1.0), ("log_blur", -1.0)):
        draws[:, posterior.names.index(name)] += sign * common[:, 0]
    return replace(posterior, draws=draws)


class _GainLikelihood:
    """Likelihood of covariances and variances over signal, which have the departure of each setting in common."""

    def __init__(self, gains: Gains, x: Array, electrons: bool) -> None:
        self.x, self.has_electrons = x, electrons
        self.observations = [(gains.covariance, gains.covariance_sd)]
        if gains.variance is not None and gains.variance_sd is not None:
            self.observations.append((gains.variance, np.hypot(gains.variance_sd, SWEEP.blur_relative_sd)))
        self.least = float(np.exp(gains.covariance.min()))
        # Electron noise is white: no variance is smaller.
        self.most_share = SWEEP.max_electron_fraction * min(
            1.0, float(np.exp(self.observations[-1][0].min())) / self.least
        )

    def electrons(self, points: Array) -> Array:
        """Return the electron gain, shape (point, 1), DN."""
        return self.least * points[:, -1:] if self.has_electrons else np.zeros((len(points), 1))

    def _factors(self, points: Array) -> list[Array]:
        """Return ln of the pulse fraction in covariance and variance, shape (point, 1) each."""
        return [np.zeros((len(points), 1)), points[:, 3:4]][: len(self.observations)]

    def log_likelihood(self, points: Array) -> Array:
        """Return the log-likelihood, shape (point,)."""
        law = points[:, :1] + points[:, 1:2] * self.x
        log_electrons = np.log(np.maximum(self.electrons(points), 1e-300))
        square, weight, together = np.zeros_like(law), np.zeros_like(law), np.zeros_like(law)
        for (value, sd), factor in zip(self.observations, self._factors(points), strict=True):
            whole = np.logaddexp(law + factor, log_electrons)
            # Derivative of the total by the departure of the pulses.
            follows, left = np.exp(law + factor - whole), (value - whole) / sd
            square, weight, together = square + left**2, weight + (follows / sd) ** 2, together + follows * left / sd
        departure = np.exp(2.0 * points[:, 2:3])
        spread = 1.0 + departure * weight
        return -0.5 * (square - departure * together**2 / spread + np.log(spread)).sum(axis=1)

    def settings(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Return draws of the pulse part of every gain: from its own noise, and combined with the law."""
        law = points[:, :1] + points[:, 1:2] * self.x
        electrons = self.electrons(points)
        weight, own = np.zeros_like(law), np.zeros_like(law)
        for (value, sd), factor in zip(self.observations, self._factors(points), strict=True):
            whole = np.exp(value)
            part = np.maximum(whole - electrons, 1e-3 * whole)
            surety = (part / (whole * np.maximum(sd, 1e-9))) ** 2
            weight, own = weight + surety, own + surety * (np.log(part) - factor)
        own, chance = own / weight, rng.standard_normal(law.shape)
        law_weight = np.exp(-2.0 * points[:, 2:3])
        total = weight + law_weight
        return np.exp(own + chance / np.sqrt(weight)), np.exp(
            (own * weight + law * law_weight) / total + chance / np.sqrt(total)
        )


def without_bound_flag(posterior: Posterior) -> Posterior:
    """Return the posterior without the flag `prior-bound`: an undetectably small departure or fraction is harmless."""
    return replace(posterior, flags=tuple(flag for flag in posterior.flags if flag != "prior-bound"))


def line_fit(x: Array, y: Array, sd: Array) -> Array:
    """Return intercept and slope of a weighted line fit."""
    design = np.stack([np.ones_like(x), x], axis=1) / sd[:, None]
    return np.asarray(np.linalg.lstsq(design, y / sd, rcond=None)[0], np.float64)


def line_departure(x: Array, y: Array, sd: Array) -> tuple[float, float] | None:
    """Return the largest deviation of the best parabola from its best line, and its standard error; None for two
    settings.

    `x`: positions, of unit span; `y`, `sd`: ln gain and standard errors, shape (setting,).
    """
    if len(x) < 3:
        return None
    design = np.stack([np.ones_like(x), x, x**2], axis=1) / sd[:, None]
    covariance = np.linalg.pinv(design.T @ design)
    best = covariance @ design.T @ (y / sd)
    rest = y / sd - design @ best
    excess = max(1.0, float(rest @ rest) / (len(x) - 3)) if len(x) > 3 else 1.0
    # A parabola q x^2 over unit span deviates from its best line by q/8.
    return float(best[2]) / 8.0, float(np.sqrt(excess * covariance[2, 2])) / 8.0
