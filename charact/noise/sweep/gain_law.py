"""The law that gain follows along a knob: a straight line of its logarithm, about which settings may depart a little.

Settings are exchangeable about the law: each departs from it by a normal amount of one unknown size, so that a setting
measured badly is drawn towards the law and one measured well is not (Gelman et al., Bayesian Data Analysis, ch. 5).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.posterior import find_maximum, importance_sample, sample
from labdata.measurement import Posterior

Array = NDArray[np.float64]

# Departure of a setting from the law beyond its noise, a logarithm: prior normal in its own logarithm about this with
# this standard deviation, within bounds. Supplies set a plate to a part in a thousand, which its gain's tenth power
# makes a hundredth, and lamps repeat to some. Settings that lie on a line by luck must not pass for a law that holds
# exactly: the prior keeps from zero.
DEPARTURE, DEPARTURE_SPREAD = 0.04, 0.5
LOG_DEPARTURE = np.log([1e-4, 0.3])
# Share of the electrons' own noise in the least covariance gain: half-normal prior of this width where the camera is
# not described. A photoelectron makes hundreds of electrons at full gain, so that ten are little.
ELECTRON_SHARE = 0.05
MOST_SHARE = 0.9
# How far the pulses' share in the variance, which blur sets, may differ between settings: the blur lies behind the
# plate, and what leaves the plate at another voltage spreads but little otherwise.
BLUR = 0.02
# A law is bent where a parabola leaves its best line by more than this and by so many standard errors.
BENT = 0.03
BENT_ERRORS = 3.0


@dataclass(frozen=True, kw_only=True)
class Axis:
    """Places of settings along a knob, brought to a span of one about their middle.

    Parameters
    ----------
    middle, span
        Of the places, in the knob's own.
    x
        Shape (setting,), within -1/2 and 1/2.
    """

    middle: float
    span: float
    x: Array

    @classmethod
    def of(cls, place: Array) -> "Axis":
        """Return the axis of places."""
        middle, span = 0.5 * float(place.min() + place.max()), float(np.ptp(place))
        return cls(middle=middle, span=span, x=(place - middle) / span)


@dataclass(frozen=True, kw_only=True)
class Gains:
    """What the noise of every setting tells of its gain, all of shape (setting,).

    Parameters
    ----------
    covariance, covariance_sd
        Logarithm of the covariance gain in DN, and its standard error.
    variance, variance_sd
        The same of a pixel's variance over the signal; None where noise is white and both are one.
    """

    covariance: Array
    covariance_sd: Array
    variance: Array | None = None
    variance_sd: Array | None = None


@dataclass(frozen=True, kw_only=True)
class GainLaw:
    """Posterior of the pulses' part of the covariance gain, log_gain + rise x, x along the axis.

    Parameters
    ----------
    posterior
        Draws of `log_gain` (in the middle of the axis), `rise` (from the first setting to the last), `log_departure`;
        `log_blur`, the share of the pulses' covariance that is left in the variance, where noise is not white; and
        `electron_share` where electrons have noise of their own.
    pulses
        Draws of the pulses' part of every setting's covariance gain from its own noise, shape (draw, setting), DN.
    settings
        Draws of the covariance gain of each setting as law and own noise together tell it, same shape, DN.
    electron_gain_dn
        Draws of the electrons' part of every covariance gain, shape (draw,), DN.
    """

    posterior: Posterior
    pulses: Array
    settings: Array
    electron_gain_dn: Array


def departure_prior(log_departure: Array) -> Array:
    """Return the logarithm of the prior of a departure, for its logarithm, shape (point,)."""
    return -0.5 * ((log_departure - np.log(DEPARTURE)) / DEPARTURE_SPREAD) ** 2


def draw_posterior(log_probability: Callable[[Array], Array], start: Array, bounds: Array, *, names: tuple[str, ...],
               units: tuple[str, ...], seed: int, quick: bool) -> Posterior:  # fmt: skip
    """Draw from a posterior; quickly by importance, for few settings leave the departure far from normal."""
    point, covariance = find_maximum(log_probability, start, bounds)
    method = importance_sample if quick else sample
    return method(log_probability, names=names, units=units, start=point, covariance=covariance, seed=seed,
                  bounds=bounds)  # fmt: skip


def law_of(x: Array, gains: Gains, *, share: tuple[float, float] | None, seed: int, quick: bool) -> GainLaw:
    """Fit the law to the gains of settings.

    Parameters
    ----------
    x
        Places along the axis, shape (setting,).
    gains
        What the noise of each tells.
    share
        Normal prior of the electrons' gain over the least covariance gain, mean and standard deviation; None where
        the knob acts on the electrons, too.
    seed, quick
        Seed of the draws; without a Markov chain.

    Notes
    -----
    Covariance gain is K + P and variance over signal K + S P, P the pulses' part k F^2 and S what blur leaves of their
    variance: of two settings of one blur the variances tell the ratio of the gains ten times better than sums of
    covariance do. S may differ from setting to setting by `BLUR`. ln P = log_gain + rise x + departure.
    """
    told = _GainLikelihood(gains, x, share is not None)

    def log_probability(points: Array) -> Array:
        inside = np.all((points >= bounds[:, 0]) & (points <= bounds[:, 1]), axis=1)
        safe = np.where(inside[:, None], points, start)
        value = told.log_likelihood(safe) + departure_prior(safe[:, 2])
        if share is not None:
            value = value - 0.5 * ((safe[:, -1] - share[0]) / share[1]) ** 2
        return np.where(inside, value, -np.inf)

    names, units, free = ["log_gain", "rise", "log_departure"], ["log DN", "1", "1"], (-np.inf, np.inf)
    walls = [free, free, tuple(LOG_DEPARTURE)]
    first = [*weighted_line(x, gains.covariance, np.hypot(gains.covariance_sd, 0.02)), np.log(0.02)]
    if gains.variance is not None:
        names, units, walls = [*names, "log_blur"], [*units, "1"], [*walls, free]
        first.append(float(np.median(gains.variance - gains.covariance)))
    if share is not None:
        names, units, walls = [*names, "electron_share"], [*units, "1"], [*walls, (0.0, told.most_share)]
        first.append(min(max(share[0], 0.2 * share[1]), 0.5 * told.most_share))
    bounds, start = np.array(walls, float), np.array(first, float)
    posterior = without_bound_flag(
        draw_posterior(log_probability, start, bounds, names=tuple(names), units=tuple(units), seed=seed, quick=quick)
    )
    rng = np.random.default_rng([seed, 7])
    electrons = told.electrons(posterior.draws)[:, 0]
    pulses, settings = told.settings(posterior.draws, rng)
    if gains.variance is not None:
        common = _common_error(settings, gains.covariance_sd, rng)
        posterior = _with_common_error(posterior, common)
        pulses, settings = pulses * np.exp(common), settings * np.exp(common)
    return GainLaw(
        posterior=posterior, pulses=pulses, settings=electrons[:, None] + settings, electron_gain_dn=electrons
    )


def _common_error(settings: Array, sd: Array, rng: np.random.Generator) -> Array:
    """Draws of an error that all covariance gains share, shape (draw, 1), a logarithm.

    The spectrum of every setting is extrapolated with one form of blur: where that errs, all err alike, and many
    settings know their common level no better than the best of them. Ratios stay as they are.
    """
    level_sd = float(np.std(np.log(settings).mean(axis=1)))
    return np.sqrt(max(0.0, float(sd.min()) ** 2 - level_sd**2)) * rng.standard_normal((len(settings), 1))


def _with_common_error(posterior: Posterior, common: Array) -> Posterior:
    """Return the posterior with an error of all covariance gains; the variances are known as they are."""
    draws = posterior.draws.copy()
    for name, sign in (("log_gain", 1.0), ("log_blur", -1.0)):
        draws[:, posterior.names.index(name)] += sign * common[:, 0]
    return replace(posterior, draws=draws)


class _GainLikelihood:
    """The likelihood of covariances and variances over signal; of each setting they share its departure."""

    def __init__(self, gains: Gains, x: Array, electrons: bool) -> None:
        self.x, self.has_electrons = x, electrons
        self.seen = [(gains.covariance, gains.covariance_sd)]
        if gains.variance is not None and gains.variance_sd is not None:
            self.seen.append((gains.variance, np.hypot(gains.variance_sd, BLUR)))
        self.least = float(np.exp(gains.covariance.min()))
        # Electrons' noise is white: no variance is smaller.
        self.most_share = MOST_SHARE * min(1.0, float(np.exp(self.seen[-1][0].min())) / self.least)

    def electrons(self, points: Array) -> Array:
        """Return the electrons' gain, shape (point, 1), DN."""
        return self.least * points[:, -1:] if self.has_electrons else np.zeros((len(points), 1))

    def _factors(self, points: Array) -> list[Array]:
        """Logarithm of the pulses' share that covariance and variance hold, shape (point, 1) each."""
        return [np.zeros((len(points), 1)), points[:, 3:4]][: len(self.seen)]

    def log_likelihood(self, points: Array) -> Array:
        """Return the logarithm of the likelihood, shape (point,)."""
        law = points[:, :1] + points[:, 1:2] * self.x
        log_electrons = np.log(np.maximum(self.electrons(points), 1e-300))
        square, weight, together = np.zeros_like(law), np.zeros_like(law), np.zeros_like(law)
        for (value, sd), factor in zip(self.seen, self._factors(points), strict=True):
            whole = np.logaddexp(law + factor, log_electrons)
            # How much of a departure of the pulses the whole shows.
            follows, left = np.exp(law + factor - whole), (value - whole) / sd
            square, weight, together = square + left**2, weight + (follows / sd) ** 2, together + follows * left / sd
        departure = np.exp(2.0 * points[:, 2:3])
        spread = 1.0 + departure * weight
        return -0.5 * (square - departure * together**2 / spread + np.log(spread)).sum(axis=1)

    def settings(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw the pulses' part of every setting's gain: from its own noise, and drawn towards the law as well."""
        law = points[:, :1] + points[:, 1:2] * self.x
        electrons = self.electrons(points)
        weight, own = np.zeros_like(law), np.zeros_like(law)
        for (value, sd), factor in zip(self.seen, self._factors(points), strict=True):
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
    """Return the posterior without the flag of leaning on a bound: that a departure or a share is too small to be
    seen harms nothing."""
    return replace(posterior, flags=tuple(flag for flag in posterior.flags if flag != "prior-bound"))


def weighted_line(x: Array, y: Array, sd: Array) -> Array:
    """Return intercept and slope of the weighted straight line."""
    design = np.stack([np.ones_like(x), x], axis=1) / sd[:, None]
    return np.asarray(np.linalg.lstsq(design, y / sd, rcond=None)[0], np.float64)


def line_departure(x: Array, y: Array, sd: Array) -> tuple[float, float] | None:
    """Return how far the best parabola leaves its best line at most, and the standard error; None for two settings.

    Parameters
    ----------
    x
        Places, of span one.
    y, sd
        Logarithms of the gain and their standard errors, shape (setting,).
    """
    if len(x) < 3:
        return None
    design = np.stack([np.ones_like(x), x, x**2], axis=1) / sd[:, None]
    covariance = np.linalg.pinv(design.T @ design)
    best = covariance @ design.T @ (y / sd)
    rest = y / sd - design @ best
    excess = max(1.0, float(rest @ rest) / (len(x) - 3)) if len(x) > 3 else 1.0
    # A parabola q x^2 over a span of one leaves its best line by q/8.
    return float(best[2]) / 8.0, float(np.sqrt(excess * covariance[2, 2])) / 8.0
