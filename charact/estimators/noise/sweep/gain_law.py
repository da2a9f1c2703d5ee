"""Gain law along a control: ln gain is linear, with normal deviations of settings.

Settings are exchangeable: their deviations have one unknown standard deviation, so an imprecise
setting shrinks towards the law (Gelman et al., Bayesian Data Analysis, ch. 5).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from charact.estimators.noise.linear_fit import draw_posterior, linear_fit
from charact.estimators.noise.thresholds import SWEEP
from charact.inference import importance_sample, sample
from labdata import Array
from labdata.measurement import Posterior

LOG_DEPARTURE = np.log([1e-4, 0.3])


Values = tuple[Array, Array]


def sampler_of(quick: bool) -> Callable[..., Posterior]:
    """Return the sampler; importance sampling for speed, as few settings leave a skewed
    departure.
    """
    return importance_sample if quick else sample


class Axis(NamedTuple):
    """Positions of settings along a control, scaled to unit span about the centre."""

    middle: float
    span: float
    x: Array  # shape (setting,), within -1/2 and 1/2

    @classmethod
    def of(cls, position: Array) -> "Axis":
        """Return the axis of positions."""
        middle, span = 0.5 * float(position.min() + position.max()), float(np.ptp(position))
        return cls(middle, span, (position - middle) / span)


@dataclass(frozen=True, kw_only=True)
class GainLaw:
    """Posterior of the pulse part of the covariance gain, ln P = log_gain + rise x, x along the
    axis.
    """

    # draws of `log_gain` (in the middle of the axis), `rise` (from the first setting to the last),
    # `log_departure`; `log_blur`, ln of the blur factor of pulses, if noise is not white; and
    # `electron_share` for the noise of electrons
    posterior: Posterior
    # draws of the pulse part of every covariance gain from its own noise, shape (draw, setting), DN
    pulses: Array
    settings: Array  # draws of every covariance gain from its noise and the law, same shape, DN
    # draws of the electron part of every covariance gain, shape (draw,), DN
    electron_gain_dn: Array

    @property
    def blur(self) -> Array:
        """Draws of the blur factor of pulses, 1 of white noise, shape (draw,)."""
        if "log_blur" in self.posterior.names:
            return np.exp(self.posterior["log_blur"])
        return np.ones(len(self.pulses))


def departure_prior(log_departure: Array) -> Array:
    """Return ln of the prior density of ln departure, shape (point,)."""
    return -0.5 * ((log_departure - np.log(SWEEP.departure)) / SWEEP.departure_spread) ** 2


def law_of(
    x: Array,
    covariance: Values,
    variance: Values | None,
    *,
    electron_share: tuple[float, float] | None,
    seed: int,
    quick: bool,
) -> GainLaw:
    """Fit the gain law to the gains of settings.

    `x`: positions on the axis, shape (setting,). `covariance`: ln of the covariance gain in DN, and
    its standard error. `variance`: the same of a pixel's variance over signal; None for white
    noise, where both agree. `electron_share`: normal prior of the electron gain over the smallest
    covariance gain, mean and standard deviation; None if the control changes it.

    Covariance gain is K + P and variance over signal K + S P, P the pulse part k F^2 and S the blur
    factor of pulses. At equal blur, variances give gain ratios ten times more precisely than
    covariance sums. S may differ between settings by `SWEEP.blur_relative_sd`. ln P = log_gain +
    rise x + departure.
    """
    likelihood = _GainLikelihood(covariance, variance, x, electron_share is not None)

    def log_probability(points: Array) -> Array:
        value = likelihood.log_likelihood(points) + departure_prior(points[:, 2])
        return (
            value
            if electron_share is None
            else value - 0.5 * ((points[:, -1] - electron_share[0]) / electron_share[1]) ** 2
        )

    names, units, free = (
        ["log_gain", "rise", "log_departure"],
        ["log DN", "1", "1"],
        (-np.inf, np.inf),
    )
    limits = [free, free, tuple(LOG_DEPARTURE)]
    first = [*line_fit(x, covariance[0], np.hypot(covariance[1], 0.02)), np.log(0.02)]
    if variance is not None:
        names, units, limits = [*names, "log_blur"], [*units, "1"], [*limits, free]
        first.append(float(np.median(variance[0] - covariance[0])))
    if electron_share is not None:
        names, units, limits = (
            [*names, "electron_share"],
            [*units, "1"],
            [*limits, (0.0, likelihood.most_share)],
        )
        first.append(
            min(max(electron_share[0], 0.2 * electron_share[1]), 0.5 * likelihood.most_share)
        )
    posterior = draw_posterior(
        log_probability,
        np.array(first, float),
        np.array(limits, float),
        names=tuple(names),
        units=tuple(units),
        seed=seed,
        method=sampler_of(quick),
    )
    rng = np.random.default_rng([seed, 7])
    electrons = likelihood.electrons(posterior.draws)[:, 0]
    pulses, settings = likelihood.settings(posterior.draws, rng)
    if variance is not None:
        # All spectra are extrapolated with one blur model, whose error is common: the mean level is
        # no more precise than the best setting. Ratios and variances are unaffected.
        level_sd = float(np.std(np.log(settings).mean(axis=1)))
        common_sd = np.sqrt(max(0.0, float(covariance[1].min()) ** 2 - level_sd**2))
        common = common_sd * rng.standard_normal((len(settings), 1))
        draws = posterior.draws.copy()
        for name, sign in (("log_gain", 1.0), ("log_blur", -1.0)):
            draws[:, posterior.names.index(name)] += sign * common[:, 0]
        posterior = replace(posterior, draws=draws)
        pulses, settings = pulses * np.exp(common), settings * np.exp(common)
    return GainLaw(
        posterior=posterior,
        pulses=pulses,
        settings=electrons[:, None] + settings,
        electron_gain_dn=electrons,
    )


class _GainLikelihood:
    """Likelihood of covariances and variances over signal, which have the departure of each setting
    in common.
    """

    def __init__(
        self, covariance: Values, variance: Values | None, x: Array, electrons: bool
    ) -> None:
        self.x, self.has_electrons, self.observations = x, electrons, [covariance]
        if variance is not None:
            self.observations.append((variance[0], np.hypot(variance[1], SWEEP.blur_relative_sd)))
        self.smallest = float(np.exp(covariance[0].min()))
        # Electron noise is white: no variance is smaller.
        smallest_ratio = float(np.exp(self.observations[-1][0].min())) / self.smallest
        self.most_share = SWEEP.max_electron_fraction * min(1.0, smallest_ratio)

    def electrons(self, points: Array) -> Array:
        """Return the electron gain, shape (point, 1), DN."""
        return self.smallest * points[:, -1:] if self.has_electrons else np.zeros((len(points), 1))

    def _factors(self, points: Array) -> list[Array]:
        """Return ln of the pulse fraction in covariance and variance, shape (point, 1) each."""
        return [np.zeros((len(points), 1)), points[:, 3:4]][: len(self.observations)]

    def log_likelihood(self, points: Array) -> Array:
        """Return the log-likelihood, shape (point,)."""
        law = points[:, :1] + points[:, 1:2] * self.x
        log_electrons = np.log(np.maximum(self.electrons(points), 1e-300))
        square, weight, together = np.zeros_like(law), np.zeros_like(law), np.zeros_like(law)
        for (value, sd), factor in zip(self.observations, self._factors(points), strict=True):
            total = np.logaddexp(law + factor, log_electrons)
            # Derivative of the total by the departure of the pulses.
            follows, deviation = np.exp(law + factor - total), (value - total) / sd
            square, weight, together = (
                square + deviation**2,
                weight + (follows / sd) ** 2,
                together + follows * deviation / sd,
            )
        departure = np.exp(2.0 * points[:, 2:3])
        spread = 1.0 + departure * weight
        return -0.5 * (square - departure * together**2 / spread + np.log(spread)).sum(axis=1)

    def settings(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Return draws of the pulse part of every gain: from its own noise, and combined with the
        law.
        """
        law = points[:, :1] + points[:, 1:2] * self.x
        electrons = self.electrons(points)
        weight, log_pulses = np.zeros_like(law), np.zeros_like(law)
        for (value, sd), factor in zip(self.observations, self._factors(points), strict=True):
            total_gain = np.exp(value)
            part = np.maximum(total_gain - electrons, 1e-3 * total_gain)
            surety = (part / (total_gain * np.maximum(sd, 1e-9))) ** 2
            weight, log_pulses = weight + surety, log_pulses + surety * (np.log(part) - factor)
        log_pulses, chance = log_pulses / weight, rng.standard_normal(law.shape)
        law_weight = np.exp(-2.0 * points[:, 2:3])
        total = weight + law_weight
        return np.exp(log_pulses + chance / np.sqrt(weight)), np.exp(
            (log_pulses * weight + law * law_weight) / total + chance / np.sqrt(total)
        )


def line_fit(x: Array, y: Array, sd: Array) -> Array:
    """Return intercept and slope of a weighted line fit."""
    return linear_fit([np.ones_like(x), x], y, sd).best


def line_departure(x: Array, y: Array, sd: Array) -> tuple[float, float] | None:
    """Return the largest deviation of the best parabola from its best line, and its standard error;
    None for two settings.
    """
    if len(x) < 3:
        return None
    fit = linear_fit([np.ones_like(x), x, x**2], y, sd)
    stretch = fit.stretch(len(x)) if len(x) > 3 else 1.0
    # A parabola q x^2 over unit span deviates from its best line by q/8.
    return float(fit.best[2]) / 8.0, stretch * float(np.sqrt(fit.covariance[2, 2])) / 8.0
